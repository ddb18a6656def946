import json
from pathlib import Path

import pytest

from octoprint_moop.core.errors import RecordingError
from octoprint_moop.machine import recorder as recorders
from octoprint_moop.machine.recorder import Recorder, find, kept, make_room
from octoprint_moop.machine.recording import Recording

HEADER = {
    "format": "moop-recording", "version": 1, "job": {"file": "job.gcode", "bytes": 3},
    "printer": {"volume_mm": {"width": 200, "depth": 200, "height": 200}},
    "camera": {"image_size_px": [64, 48], "K": [[60, 0, 32], [0, 60, 24], [0, 0, 1]], "distortion": [0, 0, 0, 0, 0],
               "rvec": [0, 0, 0], "tvec_mm": [0, 0, 500]},
}  # fmt: skip


def moment(n: int) -> dict:
    position_mm = {"x": 0, "y": 0, "z": n * 0.2}
    return {"frame": f"frames/{n:06d}.jpg", "file_pos": n * 100, "layer": n, "position_mm": position_mm,
            "time_s": float(n), "parked": True}  # fmt: skip


def check(verdict: str = "ok", layer: int = 0) -> dict:
    return {"verdict": verdict, "mode": "detachment" if verdict == "failed" else None, "layer": layer}


def record(root: Path, name: str, verdicts: list[str], jpeg: bytes = b"x" * 1000, ended: str = "done") -> Path:
    recorder = Recorder(root, name, HEADER, 10**9)
    for n, verdict in enumerate(verdicts):
        recorder.add(jpeg, moment(n), check(verdict, n))
    if ended:
        recorder.end(ended)
    assert recorder.folder is not None
    return recorder.folder


def test_what_is_written_can_be_read(tmp_path):
    folder = record(tmp_path, "cube.gcode", ["ok", "suspect", "failed"])
    recording = Recording.open(folder)
    assert [moment.layer for moment in recording.moments] == [0, 1, 2]
    (only,) = kept(tmp_path)
    assert only.to_json() == {"name": folder.name, "bytes": only.bytes, "job": "cube.gcode", "checks": 3,
                              "verdict": "failed", "mode": "detachment", "layer": 2, "ended": "done",
                              "keep": False}  # fmt: skip


def test_a_power_cut_in_the_middle_of_a_line_leaves_a_readable_recording(tmp_path):
    folder = record(tmp_path, "cube", ["ok"] * 3, ended="")
    with open(folder / "frames.jsonl", "a") as file:
        file.write('{"frame": "frames/0000')
    assert len(Recording.open(folder).moments) == 3
    assert "ended" not in kept(tmp_path)[0].outcome


def test_the_oldest_go_first_and_failures_last(tmp_path):
    folders = [record(tmp_path, f"{n}", [verdict]) for n, verdict in enumerate(["failed", "ok", "ok", "ok"])]
    size = kept(tmp_path)[0].bytes
    make_room(tmp_path, 2 * size + 100)
    assert {recording.name for recording in kept(tmp_path)} == {folders[0].name, folders[3].name}
    make_room(tmp_path, size + 100)
    assert [recording.name for recording in kept(tmp_path)] == [folders[0].name]


def test_a_recording_that_the_user_keeps_is_never_removed(tmp_path):
    folders = [record(tmp_path, name, ["ok"] * 5) for name in ("one", "two", "three")]
    recorders.set_keep(folders[0], True)
    make_room(tmp_path, 0)
    assert [(recording.name, recording.keep) for recording in kept(tmp_path)] == [(folders[0].name, True)]
    recorders.set_keep(folders[0], False)
    make_room(tmp_path, 0)
    assert kept(tmp_path) == []


def test_the_recording_that_is_being_written_is_never_removed(tmp_path):
    folder = record(tmp_path, "one", ["ok"] * 5)
    make_room(tmp_path, 0, keep=folder)
    assert folder.is_dir()


@pytest.mark.parametrize("job", ["../../etc/passwd", "...", "", "a/b\\c.gcode", "日本語.gcode", "x" * 300, "-rf"])
def test_no_name_of_a_job_leads_out_of_the_folder(tmp_path, job):
    root = tmp_path / "recordings"
    folder = record(root, job, ["ok"])
    assert folder.parent == root and find(root, folder.name) == folder


@pytest.mark.parametrize("name", ["..", ".", "../recordings", "/etc", "", "x" * 200])
def test_only_names_of_recordings_are_found(tmp_path, name):
    (tmp_path / "recordings").mkdir()
    assert find(tmp_path / "recordings", name) is None


def test_a_disk_that_is_almost_full_is_left_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(recorders, "SPARE_BYTES", 10**18)
    recorder = Recorder(tmp_path, "cube", HEADER, 10**9)
    recorder.add(b"x", moment(0), check())
    assert recorder.folder is None and "not recorded" in recorder.trouble
    assert not kept(tmp_path)


def test_a_disk_that_fails_in_mid_print_ends_the_recording_and_nothing_else(tmp_path):
    recorder = Recorder(tmp_path, "cube", HEADER, 10**9)
    folder = recorder.folder
    recorder.add(b"x", moment(0), check())
    (folder / "frames" / "000001.jpg").mkdir()
    recorder.add(b"x", moment(1), check())
    recorder.add(b"x", moment(2), check())
    recorder.end("done")
    assert recorder.folder is None and "not recorded" in recorder.trouble
    assert len(Recording.open(folder).moments) == 1
    assert json.loads((folder / "outcome.json").read_text())["verdict"] == "ok"


def test_what_is_recorded_and_why_no_more_is_told_as_it_happens(tmp_path, monkeypatch):
    told = []
    recorder = Recorder(tmp_path, "cube", HEADER, 10**9, lambda *said: told.append(said))
    assert told == [(recorder.folder.name, "")]
    monkeypatch.setattr(recorders, "SPARE_BYTES", 10**18)
    for n in range(50):
        recorder.add(b"x", moment(n), check())
    full = "the disk is almost full. Make room, and the next print is recorded again."
    assert told[1:] == [(None, f"This print is not recorded any more: {full}")]
    recorder.end("done")
    Recorder(tmp_path, "cube", HEADER, 10**9, lambda *said: told.append(said))
    assert told[2:] == [(None, f"This print is not recorded: {full}")]


def test_the_end_of_a_recording_is_told(tmp_path):
    told = []
    recorder = Recorder(tmp_path, "cube", HEADER, 10**9, lambda *said: told.append(said))
    recorder.end("done")
    assert told[1:] == [(None, "")]


def test_a_recording_of_which_a_part_is_deleted_already_is_told_without_a_traceback(tmp_path, caplog):
    recorder = Recorder(tmp_path, "cube", HEADER, 10**9)
    (recorder.folder / "frames").rmdir()
    recorder.add(b"x", moment(0), check())
    assert "its recording was deleted" in recorder.trouble
    assert caplog.records and not any(record.exc_info for record in caplog.records)


def test_deleting_the_recording_that_is_being_written_ends_it_and_is_told_without_a_traceback(tmp_path, caplog):
    recorder = Recorder(tmp_path, "cube", HEADER, 10**9)
    recorder.add(b"x", moment(0), check())
    recorders.remove(recorder.folder)
    recorder.add(b"x", moment(1), check())
    recorder.end("done")
    assert recorder.folder is None and "its recording was deleted" in recorder.trouble
    assert caplog.records and not any(record.exc_info for record in caplog.records)
    assert not kept(tmp_path)


def test_a_recording_that_is_not_there_cannot_be_removed(tmp_path):
    with pytest.raises(RecordingError, match="cannot be removed"):
        recorders.remove(tmp_path / "2026-01-01_cube")


def test_a_recording_is_counted_once_when_it_has_ended_and_by_its_files_where_it_has_not(tmp_path):
    ended, cut_short = record(tmp_path, "one", ["ok"] * 3), record(tmp_path, "two", ["ok"] * 3, ended="")
    sizes = [sum(path.stat().st_size for path in folder.rglob("*") if path.is_file()) for folder in (ended, cut_short)]
    found = [recording.bytes for recording in kept(tmp_path)]
    assert found[1] == sizes[1] and 0 <= sizes[0] - found[0] < 40, "but for the line that says so"
    for folder in (ended, cut_short):
        (folder / "frames" / "more.jpg").write_bytes(b"x" * 5000)
    assert [recording.bytes - size for recording, size in zip(kept(tmp_path), found)] == [0, 5000]


def test_a_print_makes_room_for_itself_as_it_begins(tmp_path):
    old = record(tmp_path, "old", ["ok"] * 5)
    Recorder(tmp_path, "new", HEADER, 1000)
    assert not old.is_dir()


def test_a_long_print_makes_room_for_itself_when_the_budget_is_used_up(tmp_path):
    old = record(tmp_path, "old", ["ok"] * 5)
    recorder = Recorder(tmp_path, "long", HEADER, 60_000)
    for n in range(50):
        recorder.add(b"x" * 500, moment(n), check())
    assert old.is_dir()
    for n in range(50, 100):
        recorder.add(b"x" * 500, moment(n), check())
    assert not old.is_dir() and recorder.folder is not None and recorder.folder.is_dir()
