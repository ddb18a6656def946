"""What is kept beside a recording: as good as looking again, and never used where anything has changed."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from octoprint_moop.core.errors import RecordingError
from octoprint_moop.core.expected.raster import CvRenderer
from octoprint_moop.core.inspection import Inspector
from octoprint_moop.core.settings import Settings
from octoprint_moop.demo.faults import Fault
from octoprint_moop.machine import replaying
from octoprint_moop.machine.recording import Recording
from octoprint_moop.machine.replaying import FILE, MATTERS, Replay
from tests.recordings import make_recording

SENSITIVITIES = ("low", "medium", "high")


@pytest.fixture(scope="module")
def detached(tmp_path_factory) -> Path:
    fault = Fault("detachment", layer=8)
    folder = make_recording(tmp_path_factory.mktemp("kept") / "detached", layers=11, faults=(fault,), seed=2)
    lines = (folder / "frames.jsonl").read_text().splitlines()
    again = {**json.loads(lines[8]), "frame": "frames/again.jpg", "again": True}  # a second frame in the same hold
    shutil.copy(folder / "frames/000008.jpg", folder / "frames/again.jpg")
    (folder / "frames/again.jpg").write_bytes(_another_exposure(folder / "frames/000008.jpg"))
    (folder / "frames.jsonl").write_text("\n".join([*lines[:9], json.dumps(again), *lines[9:]]) + "\n")
    return folder


def _another_exposure(path: Path) -> bytes:
    import cv2

    return cv2.imencode(".jpg", cv2.imread(str(path)), [cv2.IMWRITE_JPEG_QUALITY, 70])[1].tobytes()


def opened(folder: Path, sensitivity: str = "medium", **settings: object) -> Replay:
    return Replay(Recording.open(folder), Settings(sensitivity=sensitivity, **settings))


def looked(folder: Path, sensitivity: str = "medium"):
    return [check for check, _ in opened(folder, sensitivity).looked(CvRenderer())]


def live(folder: Path, sensitivity: str):
    """As the plugin would have concluded: one Inspector of that sensitivity from the first frame to the last."""
    recording = Recording.open(folder)
    road = recording.road()
    inspector = Inspector(
        recording.header, road.toolpath, CvRenderer(), Settings(sensitivity=sensitivity), recording.reference()
    )
    return [inspector.check(recording.frame(moment), moment) for moment in recording.moments]


def bare(checks):
    return [replace(check, ms=0.0) for check in checks]


@pytest.fixture(scope="module")
def with_looks(detached) -> Path:
    looked(detached)
    return detached


@pytest.mark.parametrize("sensitivity", SENSITIVITIES)
def test_what_is_kept_says_what_an_inspector_of_that_sensitivity_says(with_looks, sensitivity):
    kept = opened(with_looks, sensitivity).kept()
    assert bare(kept) == bare(live(with_looks, sensitivity))
    assert "failed" in [check.verdict for check in kept]
    assert all(check.ms > 0 for check in kept)


def test_nothing_is_kept_before_the_first_replay_nor_by_one_that_was_broken_off(detached, tmp_path):
    fresh = shutil.copytree(detached, tmp_path / "fresh", ignore=shutil.ignore_patterns(FILE))
    assert opened(fresh).kept() is None
    next(opened(fresh).looked(CvRenderer()))
    assert opened(fresh).kept() is None


def _a_frame(folder: Path) -> None:
    path = folder / "frames/000005.jpg"
    path.write_bytes(path.read_bytes() + b"\0")


def _a_line(folder: Path) -> None:
    path = folder / "frames.jsonl"
    path.write_text(path.read_text().replace('"time_s": 90.0', '"time_s": 91.0'))


def _a_line_less(folder: Path) -> None:
    path = folder / "frames.jsonl"
    path.write_text("\n".join(path.read_text().splitlines()[:-1]) + "\n")


def _the_header(folder: Path) -> None:
    data = json.loads((folder / "recording.json").read_text())
    data["camera"]["tvec_mm"][2] += 0.01
    (folder / "recording.json").write_text(json.dumps(data))


def _the_job(folder: Path) -> None:
    path = folder / "job.gcode"
    path.write_bytes(path.read_bytes() + b"\n")


def _the_reference(folder: Path) -> None:
    (folder / "reference.jpg").unlink()


def _what_is_kept(folder: Path) -> None:
    path = folder / FILE
    path.write_text(path.read_text()[:-40])


@pytest.mark.parametrize(
    "change", [_a_frame, _a_line, _a_line_less, _the_header, _the_job, _the_reference, _what_is_kept]
)
def test_a_change_of_anything_that_was_looked_at_is_noticed(with_looks, tmp_path, change):
    copy = shutil.copytree(with_looks, tmp_path / "copy")
    assert opened(copy).kept() is not None
    change(copy)
    assert opened(copy).kept() is None


def test_another_program_segmentation_or_head_looks_again(with_looks, monkeypatch):
    assert opened(with_looks, segmentation="thresholds").kept() is None
    assert opened(with_looks, head='{"head": [], "gantry": null}').kept() is None
    assert opened(with_looks, on_failed="cancel").kept() is not None
    monkeypatch.setattr(replaying, "_program", lambda: "the next release")
    assert opened(with_looks).kept() is None


def test_the_settings_that_an_inspector_asks_for_are_those_that_matter():
    source = (replaying.PACKAGE / "core" / "inspection.py").read_text()
    assert set(re.findall(r"ettings\.([a-z_]+)", source)) - {"sensitivity", "import"} == set(MATTERS)


def test_a_recording_that_cannot_be_written_to_is_replayed_all_the_same(detached, tmp_path, monkeypatch):
    copy = shutil.copytree(detached, tmp_path / "copy", ignore=shutil.ignore_patterns(FILE))

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    assert len(looked(copy)) == 12
    assert not (copy / FILE).exists()


def test_the_page_tries_another_sensitivity_without_looking_again_and_its_masks_stay(with_looks, tmp_path, monkeypatch):
    from octoprint_moop.machine import bench, renderers

    material = json.loads((with_looks / "recording.json").read_text())["material"]
    masks, others = tmp_path / "this", tmp_path / "another"
    others.mkdir()

    def tried(**settings: object):
        _, (text,) = bench.replay([], str(with_looks), material, settings, str(masks))
        found = json.loads(text)
        summary = {key: value for key, value in found["summary"].items() if not key.startswith("ms_")}
        return [check["verdict"] for check in found["checks"]], summary

    monkeypatch.setattr(renderers, "open_renderer", lambda: _Opened())
    first = tried(sensitivity="medium")
    drawn = sorted(path.name for path in masks.glob("*.png"))
    assert len(drawn) == 3 * 12 and not others.exists()
    monkeypatch.setattr(renderers, "open_renderer", None)  # nobody draws from here on
    assert tried(sensitivity="medium") == first
    assert tried(sensitivity="high")[1]["first_failed_layer"] <= first[1]["first_failed_layer"]
    assert sorted(path.name for path in masks.glob("*.png")) == drawn
    with pytest.raises(TypeError):
        tried(sensitivity="medium", segmentation="thresholds")


def test_a_replay_whose_pictures_find_no_room_says_so(with_looks, tmp_path):
    from octoprint_moop.machine import bench

    material = json.loads((with_looks / "recording.json").read_text())["material"]
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="There is no room for the pictures of a replay"):
        bench.replay([], str(with_looks), material, {}, str(tmp_path / "file" / "masks"))


class _Opened(CvRenderer):
    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        pass
