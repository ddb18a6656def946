"""Recordings as ZIP files."""

from __future__ import annotations

import io
import os
import tracemalloc
import zipfile

import pytest

from octoprint_moop.machine.packing import packed


@pytest.fixture
def folder(tmp_path):
    made = tmp_path / "2026-11-22_12-00-00_box"
    (made / "frames").mkdir(parents=True)
    (made / "recording.json").write_text("{}")
    (made / "job.gcode.gz").write_bytes(os.urandom(9_000_000))
    for number in range(3):
        (made / "frames" / f"{number:06d}.jpg").write_bytes(os.urandom(100_000))
    return made


def opened(folder, **choice):
    return zipfile.ZipFile(io.BytesIO(b"".join(packed(folder, **choice))))


def test_what_is_unpacked_is_what_was_packed(folder, tmp_path):
    with opened(folder) as archive:
        assert archive.testzip() is None
        archive.extractall(tmp_path / "out")
        assert not any(entry.flag_bits & 8 for entry in archive.infolist()), "not every reader knows sizes that follow"
    files = [path for path in folder.rglob("*") if path.is_file()]
    for path in files:
        assert (tmp_path / "out" / folder.name / path.relative_to(folder)).read_bytes() == path.read_bytes()
    assert len(archive.namelist()) == len(files) == 5


def test_without_pictures(folder):
    assert sorted(opened(folder, pictures=False).namelist()) == [
        f"{folder.name}/job.gcode.gz", f"{folder.name}/recording.json"
    ]  # fmt: skip


def test_a_clock_that_stood_in_1970_costs_no_recording(folder):
    """As a Raspberry Pi's does until it has heard the time."""
    os.utime(folder / "recording.json", (0, 0))
    assert opened(folder).read(f"{folder.name}/recording.json") == b"{}"


def test_what_is_removed_or_half_written_meanwhile_is_left_out(folder):
    (folder / "outcome.json.part").write_text("{")
    pieces = packed(folder)
    first = next(pieces)
    (folder / "job.gcode.gz").unlink()
    (folder / "recording.json").unlink()
    with zipfile.ZipFile(io.BytesIO(first + b"".join(pieces))) as archive:
        assert archive.testzip() is None
        assert [name.split("/")[-1] for name in archive.namelist()] == [f"{number:06d}.jpg" for number in range(3)]


def test_a_large_recording_is_never_whole_in_memory(folder):
    tracemalloc.start()
    sent = sum(len(piece) for piece in packed(folder))
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert sent > 9_000_000 and most < 6_000_000
    assert [path.name for path in folder.parent.iterdir()] == [folder.name], "and nothing is left behind"
