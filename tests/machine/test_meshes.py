"""Models are kept by their content; which road a print takes follows from what can be read."""

from __future__ import annotations

import io

import pytest
import trimesh

from octoprint_moop.core.errors import GcodeError, MeshError
from octoprint_moop.core.header import Moment
from octoprint_moop.machine import meshes
from octoprint_moop.machine.meshes import Meshes
from octoprint_moop.machine.roads import MeshChoice, find_road

BOX_STL = trimesh.creation.box(bounds=[[0, 0, 0], [20, 10, 4]]).export(file_type="stl")
GCODE = "M83\n" + "".join(
    f"G1 Z{z / 5:.1f} F600\nG1 X90 Y90 F9000\nG1 X110 Y90 E1\nG1 X110 Y100 E.5\nG1 X90 Y100 E1\nG1 X90 Y90 E.5\n"
    for z in range(1, 21)
)


@pytest.fixture
def box(tmp_path):
    path = tmp_path / "box.stl"
    path.write_bytes(BOX_STL)
    return path


def test_a_model_is_kept_once_however_many_jobs_have_it_and_goes_with_the_last(tmp_path):
    kept = Meshes(tmp_path / "meshes")
    file = kept.store(io.BytesIO(BOX_STL), "box.STL")
    assert kept.store(io.BytesIO(BOX_STL), "copy of box.stl") == file and file.endswith(".stl")
    kept.put("one", {"file": file, "name": "box.stl", "use": True})
    kept.put("two", {"file": file, "name": "copy of box.stl", "use": False})
    again = Meshes(tmp_path / "meshes")
    assert again.get("one")["name"] == "box.stl" and again.get("three") is None
    with open(again.get("two")["path"], "rb") as same:
        assert same.read() == BOX_STL
    again.drop("one")
    assert kept.get("one") is None and kept.get("two") is not None
    again.drop("two")
    assert [path.name for path in (tmp_path / "meshes").iterdir()] == ["meshes.json"]


def test_what_is_no_model_or_too_large_is_refused_and_leaves_nothing_behind(tmp_path, monkeypatch):
    kept = Meshes(tmp_path)
    with pytest.raises(MeshError, match=r"\.stl, \.obj, \.3mf"):
        kept.store(io.BytesIO(b"MZ"), "virus.exe")
    monkeypatch.setattr(meshes, "MOST_BYTES", 100)
    with pytest.raises(MeshError, match="larger than"):
        kept.store(io.BytesIO(bytes(101)), "big.stl")
    assert list(tmp_path.iterdir()) == []


def test_models_that_nobody_printed_lately_make_room(tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "ROOM_BYTES", 2500)
    kept = Meshes(tmp_path)
    for name in ("a", "b", "c"):
        kept.put(name, {"file": kept.store(io.BytesIO(name.encode() * 1000), f"{name}.stl"), "use": True})
        if name == "b":
            kept.put("a", kept.get("a"))  # placed anew
    assert [name for name in "abc" if kept.get(name)] == ["a", "c"]
    assert len(list(tmp_path.glob("*.stl"))) == 2
    kept.put("d", {"file": kept.store(io.BytesIO(b"d" * 9000), "d.stl"), "use": True})
    assert kept.get("d") is not None, "however large, the one that was just attached is kept"
    assert not any(kept.get(name) for name in "abc")


def test_a_damaged_list_of_models_is_an_empty_one(tmp_path):
    (tmp_path / "meshes.json").write_text("{")
    assert Meshes(tmp_path).get("one") is None


def test_the_gcode_is_the_road_unless_a_model_is_chosen(tmp_path, box):
    job = tmp_path / "job.gcode"
    job.write_text(GCODE)
    assert find_road(job).name == "gcode"
    road = find_road(job, MeshChoice(box))
    assert road.name == "mesh" and any("moved by" in note for note in road.notes)
    assert road.solid.bounds_mm()[:, 0].tolist() == pytest.approx([90, 110], abs=0.5)
    moment = Moment("a.jpg", 100, 1, (0, 0, 0.4))
    assert road.moment(moment) is moment


@pytest.mark.parametrize("content", [b"GCDE binary", b"PRINT_START\nPRINT_END\n", None])
def test_where_no_gcode_can_be_read_a_model_and_its_layer_height_are_enough(tmp_path, box, content):
    job = None
    if content is not None:
        job = tmp_path / "job.gcode"
        job.write_bytes(content)
    with pytest.raises(GcodeError):
        find_road(job)
    with pytest.raises(MeshError, match="layer height"):
        find_road(job, MeshChoice(box))
    road = find_road(job, MeshChoice.from_json({"path": str(box), "x_mm": 100, "y_mm": 80, "layer_height_mm": "0.2"}))
    assert road.name == "height" and road.toolpath.layers == 20
    assert "nozzle's height" in road.notes[0]
    assert road.moment(Moment("a.jpg", 7, 0, (0, 0, 2.0))).file_pos == 10


@pytest.mark.parametrize("wrong", [{"layer_height_mm": "thin"}, {"x_mm": 1}])
def test_a_choice_that_makes_no_sense_is_refused_in_words(box, wrong):
    with pytest.raises(MeshError):
        MeshChoice.from_json({"path": str(box), **wrong})
