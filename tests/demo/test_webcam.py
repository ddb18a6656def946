"""The simulated webcam is a webcam like any other, and knows only what was sent to the printer."""

from __future__ import annotations

import urllib.error
import urllib.request

import pytest

from octoprint_moop.demo import notebook
from octoprint_moop.demo.webcam import SnapshotServer


def test_a_snapshot_is_what_was_taken_for_it():
    pictures = iter([b"first", b"second"])
    with SnapshotServer(lambda: next(pictures)) as webcam:
        for expected in (b"first", b"second"):
            with urllib.request.urlopen(webcam.url, timeout=5) as answer:
                assert answer.headers["Content-Type"] == "image/jpeg"
                assert answer.read() == expected


def test_a_stream_sends_picture_after_picture_until_the_webcam_ends():
    with SnapshotServer(lambda: b"picture") as webcam:
        stream = urllib.request.urlopen(webcam.url.replace("snapshot", "stream"), timeout=5)
        data = stream.read(200)
        assert b"image/jpeg" in data and b"picture" in data
    stream.close()


def test_what_is_posted_is_answered_with_a_sentence_or_not_found():
    with SnapshotServer(bytes, post=lambda path: "Done." if path == "/fault/none" else None) as webcam:
        with urllib.request.urlopen(f"{webcam.address}/fault/none", data=b"", timeout=5) as answer:
            assert answer.read() == b"Done.\n"
        with pytest.raises(urllib.error.HTTPError, match="404"):
            urllib.request.urlopen(f"{webcam.address}/elsewhere", data=b"", timeout=5)


def test_the_witness_follows_file_and_machine_through_what_is_sent(tmp_path):
    path = tmp_path / "notebook"
    notebook.make(path)
    assert notebook.read(path) == (0, (0.0, 0.0, 0.0))
    seen = notebook.Witness(path)

    def sent(cmd, *tags):
        seen.sent(cmd, cmd.split()[0], set(tags))

    sent("G28")
    sent("G1 X10 Y20.5 Z0.3 F6000", "source:file", "filepos:40")
    sent("G1 X12 E1", "source:file", "filepos:52")
    assert notebook.read(path) == (52, (12.0, 20.5, 0.3))
    sent("G91")
    sent("G1 Z5 X-2")  # a pause script: no tag of the file
    assert notebook.read(path) == (52, (10.0, 20.5, 5.3))
    sent("G90")
    sent("G28 X")
    assert notebook.read(path) == (52, (0.0, 20.5, 5.3))
    seen.sent("M105", "M105", None)  # a resent line has no tags
    assert notebook.read(path)[0] == 52
    assert notebook.read_job(path) is None
    seen.job("/uploads/a part.gcode")
    assert str(notebook.read_job(path)) == "/uploads/a part.gcode"
