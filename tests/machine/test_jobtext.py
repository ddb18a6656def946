from __future__ import annotations

import gzip

from octoprint_moop.machine.jobtext import job_text


def test_a_text_is_seen_as_octoprint_counts_it_packed_or_not(tmp_path):
    """OctoPrint opens files as UTF-8 and puts three bytes in the place of what is none."""
    for number, written in enumerate(
        (b"G28\n", "; größe\nG28\n".encode(), b"; gr\xf6\xdfe\nG28\n", b"; cut \xc3", b"")
    ):
        plain, packed = tmp_path / f"{number}.gcode", tmp_path / f"{number}.gcode.gz"
        plain.write_bytes(written)
        packed.write_bytes(gzip.compress(written))
        for path in (plain, packed):
            with job_text(path) as text:
                assert text[:] == written.decode("utf-8", errors="replace").encode()
