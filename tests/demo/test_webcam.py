"""The simulated webcam is a webcam like any other, and knows only what was sent to the printer."""

from __future__ import annotations

import urllib.request

from octoprint_moop.demo import witness
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


def test_the_witness_follows_file_and_machine_through_what_is_sent(tmp_path):
    path = tmp_path / "witness"
    witness.make(path)
    assert witness.read(path) == (0, (0.0, 0.0, 0.0))
    seen = witness.Witness(path)

    def sent(cmd, *tags):
        seen.on_sent(None, "sent", cmd, None, cmd.split()[0], tags=set(tags))

    sent("G28")
    sent("G1 X10 Y20.5 Z0.3 F6000", "source:file", "filepos:40")
    sent("G1 X12 E1", "source:file", "filepos:52")
    assert witness.read(path) == (52, (12.0, 20.5, 0.3))
    sent("G91")
    sent("G1 Z5 X-2")  # a pause script: no tag of the file
    assert witness.read(path) == (52, (10.0, 20.5, 5.3))
    sent("G90")
    sent("G28 X")
    assert witness.read(path) == (52, (0.0, 20.5, 5.3))
    seen.on_sent(None, "sent", "M105", None, "M105", tags=None)  # a resent line has no tags
    assert witness.read(path)[0] == 52
