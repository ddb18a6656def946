"""What of OctoPrint's events reaches the watch. The events themselves come from a real server in the other tests."""

from __future__ import annotations

from unittest.mock import Mock, call

import pytest
from octoprint.events import Events

from octoprint_moop.host.plugin import MoopPlugin


@pytest.mark.parametrize(
    ("event", "told"),
    [
        (Events.PRINT_PAUSED, call.job_paused()),
        (Events.PRINT_RESUMED, call.job_resumed()),
        (Events.PRINT_DONE, call.job_over("done")),
        (Events.PRINT_CANCELLED, call.job_over("cancelled")),
        (Events.PRINT_FAILED, call.job_over("failed")),
        (Events.PRINT_CANCELLING, call.job_stopping("the print is being cancelled")),
        (Events.PRINTER_RESET, call.job_stopping("the printer went away (PrinterReset)")),
        (Events.DISCONNECTED, call.job_over("disconnected", lost=True)),
        (Events.SHUTDOWN, call.job_stopping("the server stops")),
    ],
)
def test_each_turn_of_a_print_is_told_to_the_watch_once(event, told):
    plugin = MoopPlugin()
    plugin._watch, plugin._homing = Mock(), Mock()
    plugin.on_event(event, {"origin": "local", "path": "a.gcode"})
    assert plugin._watch.mock_calls == [told]


@pytest.mark.parametrize(
    ("event", "payload", "read"),
    [
        (Events.FILE_ADDED, {"storage": "local", "path": "a.gcode", "type": ["machinecode", "gcode"]}, True),
        (Events.FILE_SELECTED, {"origin": "local", "path": "a.gcode"}, True),
        (Events.FILE_ADDED, {"storage": "local", "path": "a.stl", "type": ["model", "stl"]}, False),
        (Events.FILE_SELECTED, {"origin": "sdcard", "path": "a.gcode"}, False),
    ],
)
def test_a_file_is_read_as_soon_as_it_may_be_printed(event, payload, read):
    plugin = MoopPlugin()
    plugin._watch, plugin._file_manager = Mock(), Mock()
    plugin.on_event(event, payload)
    assert plugin._watch.job_expected.called == read
