"""A job with a model of its own: attached in the page, placed, used for checks, kept in the recording."""

from __future__ import annotations

import pytest
import trimesh

from octoprint_moop.machine.recording import Recording

from .conftest import open_room
from .room import SLOWLY, box_gcode

LAYERS, SIDE_MM = 8, 30.0


def model(extents=(SIDE_MM + 0.8, SIDE_MM, 0.3 * LAYERS)) -> bytes:
    """The box of `box_gcode`, standing somewhere else."""
    return trimesh.creation.box(extents=extents).export(file_type="stl")


def attach(room, content: bytes | None = None, name: str = "box.stl", **form):
    return room.server.request(
        "POST", "/plugin/moop/mesh", files={"file": (name, model() if content is None else content)}, data=form
    )


@pytest.fixture(scope="module")
def shared_room(tmp_path_factory):
    """A room of their own: nothing that was printed before may be the job."""
    with open_room(tmp_path_factory.mktemp("meshes")) as room:
        yield room


@pytest.fixture
def job(room):
    """A file of the room's that nobody prints yet; its model goes with the test."""
    path = room.folder / "meshed.gcode"
    path.write_text(box_gcode(layers=LAYERS))
    room.server.upload(path, print=False)
    room.wait("it is selected", lambda: room.server.api("GET", "/api/job")["job"]["file"]["name"] == path.name)
    yield path
    room.moop("DELETE", "mesh", params={"path": path.name})


def test_a_model_is_attached_placed_chosen_and_taken_off_again(room, job):
    assert room.moop("GET", "mesh")["mesh"] is None
    attached = attach(room).json()
    assert attached["job"] == {"origin": "local", "path": "meshed.gcode"}
    mesh = attached["mesh"]
    assert mesh["use"] and mesh["name"] == "box.stl" and mesh["triangles"] == 12
    assert mesh["size_mm"] == [30.8, 30.0, 2.4]
    assert len(mesh["notes"]) == 1 and "moved by" in mesh["notes"][0]
    placed = room.moop("POST", "mesh/choice", json={"x_mm": 100, "y_mm": 99.6, "turn_deg": 180})["mesh"]
    assert (placed["x_mm"], placed["turn_deg"], placed["notes"]) == (100, 180, [])
    assert not room.moop("POST", "mesh/choice", json={"use": False, "path": "meshed.gcode"})["mesh"]["use"]
    assert room.moop("GET", "mesh", params={"path": "meshed.gcode"})["mesh"]["x_mm"] == 100
    assert room.moop("DELETE", "mesh")["mesh"] is None
    assert list((room.server.basedir / "data/moop/meshes").glob("*.stl")) == []


def test_what_is_no_model_is_refused_with_a_sentence_and_not_kept(room, job):
    for content, name, word in (
        (b"solid nothing\nendsolid\n", "nothing.stl", "surface"),
        (b"PK\x03\x04 no project", "broken.3mf", "3MF"),
        (b"\x7fELF", "run.sh", ".stl, .obj, .3mf"),
    ):
        answer = attach(room, content, name)
        assert answer.status_code == 400 and answer.json()["code"] == "mesh", answer.text
        assert word in answer.json()["message"]
    answer = room.server.request("POST", "/plugin/moop/mesh/choice", json={"use": True})
    assert answer.status_code == 400 and "Attach one" in answer.json()["message"]
    assert attach(room, path="no such file.gcode").status_code == 400
    attach(room)
    answer = room.server.request("POST", "/plugin/moop/mesh/choice", json={"x_mm": 7})
    assert answer.status_code == 400 and "x_mm and y_mm" in answer.json()["message"]
    assert room.moop("GET", "mesh")["mesh"]["x_mm"] is None
    assert len(list((room.server.basedir / "data/moop/meshes").glob("*.*"))) == 2  # the model, and the list


def test_a_path_on_the_server_cannot_be_named_in_place_of_a_file(room, job):
    secret = room.server.basedir / "config.yaml"
    for options in (
        {"data": {"file.path": str(secret), "file.name": "secret.stl"}},
        {"params": {"file.path": str(secret), "file.name": "secret.stl"}, "files": {"other": ("a.stl", b"x")}},
        {"files": {"file.path": (None, str(secret)), "file.name": (None, "secret.stl")}},
    ):
        answer = room.server.request("POST", "/plugin/moop/mesh", **options)
        assert answer.status_code == 400, answer.text
    assert room.moop("GET", "mesh")["mesh"] is None


def test_a_print_is_watched_by_its_model_and_so_is_its_replay(room, job):
    attach(room)
    room.print(job.read_text(), name=job.name)
    room.wait_done()
    assert room.status["road"] == "mesh"
    checks = room.checks
    assert [check["layer"] for check in checks] == list(range(LAYERS))
    assert {check["verdict"] for check in checks} == {"ok"}
    assert max(check["E"] for check in checks) < 0.08
    name = room.moop("GET", "recordings")["recordings"][0]["name"]
    recording = Recording.open(room.server.basedir / "data/moop/recordings" / name)
    road = recording.road()
    assert road.name == "mesh"
    assert road.solid.bounds_mm().ravel().tolist() == pytest.approx([84.6, 84.6, 0, 115.4, 114.6, 2.4], abs=0.2)
    again = room.moop("POST", f"recordings/{name}/replay", json={})["checks"]
    assert [check["E"] for check in again] == pytest.approx([check["E"] for check in checks], abs=1e-4)


def test_a_model_that_is_attached_while_printing_is_looked_at_from_then_on(room, job):
    room.print(box_gcode(layers=40, feed_mm_min=SLOWLY), name=job.name)
    room.wait_checks(2)
    assert room.status["road"] == "gcode"
    assert attach(room, model((SIDE_MM + 0.8, SIDE_MM, 0.3 * 40))).status_code == 200
    room.wait("the model is used", lambda: room.status["road"] == "mesh")
    count = len(room.checks)
    assert {check["verdict"] for check in room.wait_checks(count + 3)[count:]} == {"ok"}
    room.moop("POST", "mesh/choice", json={"use": False})
    room.wait("the G-code is used again", lambda: room.status["road"] == "gcode")


def test_a_file_that_cannot_be_read_is_watched_by_a_model_and_its_layer_height(room, job):
    text = box_gcode(layers=40, feed_mm_min=SLOWLY).replace("\nG1 Z60", "\n; \0\nG1 Z60")
    path = room.folder / "unreadable.gcode"
    path.write_text(text)
    readable = room.folder / "readable.gcode"
    readable.write_text(text.replace("\0", "0"))
    room.server.upload(path, print=False)
    assert "layer height" in attach(room, model((30.8, 30.0, 12.0))).json()["mesh"]["notes"][-1]
    choice = {"x_mm": 100, "y_mm": 99.6, "layer_height_mm": 0.3}
    mesh = room.moop("POST", "mesh/choice", json=choice)["mesh"]
    assert "nozzle's height" in mesh["notes"][0]
    room.save(longest_s=0.1, capture="stand")
    try:
        room.print(text, name=path.name, seen_as=readable)
        checks = room.wait_checks(3, 60)
        assert room.status["road"] == "height" and room.status["watching"]
    finally:
        room.save(longest_s=300.0, capture="park")
    layers = [check["layer"] for check in checks]
    assert layers == sorted(layers) and layers[-1] > layers[0]
    assert {check["verdict"] for check in checks} <= {"ok", "unusable"}, checks
    room.command(command="cancel")
    room.moop("DELETE", "mesh", params={"path": path.name})


def test_a_print_from_the_printers_own_storage_is_watched_by_a_model(room, job):
    # The head creeps aside: what a firmware has in its buffer is done before it stands still.
    text = "G1 Z2.4 F3000\nG1 X2 Y188 F9000\n" + "".join(f"G1 Y{188 + n / 10:.1f} F2.4\n" for n in range(1, 100))
    origin, path = room.store(text, "box_of_the_printer.gcode")
    form = {"origin": origin, "path": path}
    assert attach(room, model((30.8, 30.0, 12.0)), **form).status_code == 200
    room.moop("POST", "mesh/choice", json={**form, "x_mm": 100, "y_mm": 99.6, "layer_height_mm": 0.3})
    room.webcam.look_at(job)
    before, room.webcam.file_pos = room.webcam.file_pos, lambda: 10**9
    room.save(longest_s=0.5)
    try:
        room.print_stored(origin, path)
        room.wait(
            "it is this print that is watched", lambda: room.status["job"] == path and room.status["watching"], 60
        )
        checks = room.wait_checks(2, 60)
        assert room.status["road"] == "height"
    finally:
        room.save(longest_s=300.0)
        room.webcam.file_pos = before
        room.command(command="cancel")
    assert {check["verdict"] for check in checks} == {"ok"}, checks
    assert [check["layer"] for check in checks[:2]] == [7, 7]
    room.moop("DELETE", "mesh", params=form)
    sent = [command for command, _ in room.sent()]
    glance = ["M27", "M400", "M27", "M114", "G4 P1500"]
    assert any(sent[n : n + 5] == glance for n in range(len(sent)))
