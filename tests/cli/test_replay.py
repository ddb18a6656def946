"""`moop replay` and `moop mask`, called as other programs call them."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from octoprint_moop.demo.faults import Fault
from octoprint_moop.demo.simulate import Nuisance
from tests.recordings import make_recording

CHECK_KEYS = {
    "type", "frame", "layer", "file_pos", "E", "xor_px", "missing_px", "extra_px", "expected_px", "observed_px",
    "ignored_px", "total_px", "verdict", "mode", "reason", "objects", "ms",
}  # fmt: skip
SUMMARY_KEYS = {
    "type", "checks", "first_suspect_layer", "first_failed_layer", "mode", "failed_objects", "action", "ms_p50",
    "ms_p95",
}  # fmt: skip


def moop(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "octoprint_moop.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120)


def replay(recording: Path) -> tuple[list[dict], dict]:
    done = moop("replay", recording, "--json")
    assert done.returncode == 0, done.stderr
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    return rows[:-1], rows[-1]


@pytest.fixture(scope="module")
def clean(tmp_path_factory) -> Path:
    return make_recording(tmp_path_factory.mktemp("recordings") / "clean", layers=14, seed=1)


@pytest.fixture(scope="module")
def detached(tmp_path_factory) -> Path:
    fault = Fault("detachment", layer=10)
    return make_recording(tmp_path_factory.mktemp("recordings") / "detached", layers=14, faults=(fault,), seed=2)


def test_every_check_and_the_summary_have_the_keys_that_other_programs_read(clean):
    checks, summary = replay(clean)
    assert len(checks) == 14 == summary["checks"]
    assert all(set(check) >= CHECK_KEYS for check in checks)
    assert set(summary) >= SUMMARY_KEYS and summary["type"] == "summary"
    for check in checks:
        assert check["xor_px"] == check["missing_px"] + check["extra_px"]
        assert check["E"] == pytest.approx(check["xor_px"] / check["total_px"], abs=1e-6)


def test_a_clean_print_is_left_alone(clean):
    checks, summary = replay(clean)
    assert {check["verdict"] for check in checks} == {"ok"}
    assert (summary["first_failed_layer"], summary["mode"], summary["action"]) == (None, None, "none")


def test_a_print_that_comes_off_is_caught_at_its_layer_and_named(detached):
    checks, summary = replay(detached)
    assert all(check["verdict"] == "ok" for check in checks[:10])
    assert summary["first_failed_layer"] == 10
    assert summary["mode"] == "detachment"
    assert summary["action"] == "pause"
    assert "come off" in checks[10]["reason"]
    assert checks[9]["E"] < checks[9]["limit"] < checks[10]["E"]


def test_replay_never_looks_ahead(detached, tmp_path):
    """Cut off after any check, the recording gives the same checks up to there."""
    whole, _ = replay(detached)
    part = shutil.copytree(detached, tmp_path / "part")
    lines = (part / "frames.jsonl").read_text().splitlines()
    (part / "frames.jsonl").write_text("\n".join(lines[:11]) + "\n")
    checks, _ = replay(part)
    assert [{**check, "ms": 0} for check in checks] == [{**check, "ms": 0} for check in whole[:11]]


def test_light_a_hand_a_black_frame_and_a_nudge_are_not_failures(tmp_path):
    nuisances = (
        Nuisance("dim", 4, 3), Nuisance("hand", 8, 2), Nuisance("black", 11, 1), Nuisance("white_balance", 12, 2),
    )  # fmt: skip
    checks, summary = replay(make_recording(tmp_path / "nuisances", layers=16, nuisances=nuisances, seed=3))
    assert summary["first_failed_layer"] is None
    assert checks[11]["verdict"] == "unusable" and "black" in checks[11]["reason"]


def test_a_recording_without_a_picture_of_the_empty_bed_is_checked_too(tmp_path):
    fault = Fault("detachment", layer=9)
    recording = make_recording(tmp_path / "bare", layers=11, reference=False, faults=(fault,), seed=4)
    assert replay(recording)[1]["first_failed_layer"] == 9


def test_a_compressed_job_is_read_as_well(clean, tmp_path):
    import gzip

    packed = shutil.copytree(clean, tmp_path / "packed")
    job = packed / "job.gcode"
    (packed / "job.gcode.gz").write_bytes(gzip.compress(job.read_bytes()))
    job.unlink()
    assert [check["E"] for check in replay(packed)[0]] == [check["E"] for check in replay(clean)[0]]


def spoil_header(recording: Path, **changes: object) -> None:
    header = json.loads((recording / "recording.json").read_text())
    (recording / "recording.json").write_text(json.dumps({**header, **changes}))


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: shutil.rmtree(folder), "no such folder"),
        (lambda folder: (folder / "recording.json").unlink(), "recording.json"),
        (lambda folder: (folder / "recording.json").write_text("{"), "JSON"),
        (lambda folder: spoil_header(folder, version=9), "version 9"),
        (lambda folder: spoil_header(folder, format="timelapse"), "timelapse"),
        (lambda folder: spoil_header(folder, camera=None), "camera"),
        (lambda folder: spoil_header(folder, job={"file": "../../etc/passwd"}), "leads out"),
        (lambda folder: (folder / "job.gcode").unlink(), "job.gcode"),
        (lambda folder: (folder / "job.gcode").write_bytes(b""), "job.gcode"),
        (lambda folder: (folder / "job.gcode").write_bytes(bytes(range(256)) * 40), "job.gcode"),
        (lambda folder: (folder / "frames.jsonl").unlink(), "frames.jsonl"),
        (lambda folder: (folder / "frames.jsonl").write_text('{"frame": 1}\n{"frame": 2}\n'), "line 1"),
        (lambda folder: (folder / "frames" / "000003.jpg").write_bytes(b"not a picture"), "000003.jpg"),
    ],
)
def test_a_damaged_recording_gets_one_sentence_and_exit_status_2(clean, tmp_path, spoil, says):
    broken = shutil.copytree(clean, tmp_path / "broken")
    spoil(broken)
    done = moop("replay", broken, "--json")
    assert done.returncode == 2
    assert says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_line_that_a_power_cut_left_unfinished_is_passed_over(clean, tmp_path):
    cut = shutil.copytree(clean, tmp_path / "cut")
    text = (cut / "frames.jsonl").read_text()
    (cut / "frames.jsonl").write_text(text[:-40])
    assert replay(cut)[1]["checks"] == 13


def test_a_frame_of_another_shape_is_unusable_and_said_so(clean, tmp_path):
    odd = shutil.copytree(clean, tmp_path / "odd")
    path = str(odd / "frames" / "000005.jpg")
    cv2.imwrite(path, cv2.imread(path)[:, :300])
    checks, _ = replay(odd)
    assert checks[5]["verdict"] == "unusable" and "300 x 300" in checks[5]["reason"]
    assert checks[6]["verdict"] == "ok"


def test_the_mask_of_a_frame_is_the_mask_of_its_moment(clean, tmp_path):
    line = json.loads((clean / "frames.jsonl").read_text().splitlines()[7])
    position = ",".join(str(line["position_mm"][axis]) for axis in "xyz")
    by_frame, by_position, complete = (tmp_path / name for name in ("frame.png", "position.png", "complete.png"))
    assert moop("mask", clean, "--frame", line["frame"], "--distorted", "-o", by_frame).returncode == 0
    wanted = ("--file-pos", line["file_pos"], "--position", position, "--distorted")
    assert moop("mask", clean, *wanted, "-o", by_position).returncode == 0
    assert moop("mask", clean, "--complete", "--distorted", "-o", complete).returncode == 0
    masks = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in (by_frame, by_position, complete)]
    assert set(np.unique(masks[0])) == {0, 255}
    assert np.array_equal(masks[0], masks[1])
    assert np.all(masks[2][masks[0] > 0] == 255) and masks[2].sum() > masks[0].sum()


def test_the_mask_needs_exactly_one_moment(clean, tmp_path):
    done = moop("mask", clean, "--complete", "--file-pos", 5, "-o", tmp_path / "x.png")
    assert done.returncode == 2 and "exactly one" in done.stderr


def test_nonsense_for_a_position_is_named(clean, tmp_path):
    done = moop("mask", clean, "--file-pos", 5, "--position", "left,up", "-o", tmp_path / "x.png")
    assert done.returncode == 2 and "left,up" in done.stderr


def test_shared_recordings_are_judged_right(shared):
    """Rendered recordings: each failure at the layer where it is first visible, or the next; none where there is none."""
    for recording in sorted((shared / "cases").iterdir()):
        if not (recording / "truth.json").is_file():
            continue
        fault = json.loads((recording / "truth.json").read_text())["fault"]
        _, summary = replay(recording)
        if fault is None:
            assert summary["first_failed_layer"] is None, recording.name
        else:
            assert summary["first_failed_layer"] - fault["first_visible_layer"] in (0, 1), recording.name


def test_the_report_is_one_page_that_shows_the_failure_with_its_pictures_and_needs_nothing_else(tmp_path: Path) -> None:
    recording = make_recording(tmp_path / "<b>loose", 12, faults=[Fault("detachment", 6)])
    page = tmp_path / "report.html"
    done = moop("replay", recording, "--report", page)
    assert done.returncode == 0, done.stderr
    text = page.read_text(encoding="utf-8")
    assert "The print has come off" in text or "detachment" in text
    assert text.count("data:image/jpeg;base64,") >= 9  # three of the first, of the last good and of the first bad check
    assert "&lt;b&gt;loose" in text and "<b>loose" not in text
    assert "http" not in text.replace("http-equiv", "")


def test_a_report_that_cannot_be_written_is_said_in_one_line(tmp_path: Path) -> None:
    recording = make_recording(tmp_path / "print", 3)
    done = moop("replay", recording, "--report", tmp_path / "nowhere" / "report.html")
    assert done.returncode == 2
    assert "nowhere" in done.stderr and len(done.stderr.splitlines()) == 1
