import threading

import pytest

from octoprint_moop.machine.holds import Holds


class Printer:
    """Counts holds as OctoPrint does."""

    def __init__(self, answer=True):
        self.held, self.answer, self.sent = 0, answer, []

    def set_job_on_hold(self, value, blocking=True):
        if isinstance(self.answer, Exception):
            raise self.answer
        if self.answer:
            self.held = max(self.held + (1 if value else -1), 0)
        return self.answer

    def commands(self, commands, *, tags):
        self.sent.append((commands, tags))


@pytest.fixture
def printer():
    return Printer()


@pytest.fixture
def taken():
    return []


@pytest.fixture
def holds(printer, taken):
    return Holds(printer, taken.append)


def test_the_job_is_held_at_a_layers_end_and_nowhere_else(holds, printer, taken):
    holds.plan([100, 200, 300])
    assert holds.line_queuing("G1 X1", 50) is None and printer.held == 0
    sent = holds.line_queuing("G1 X2", 100)
    assert [entry if isinstance(entry, str) else entry[0] for entry in sent] == ["G1 X2", "M400", "M114"]
    assert printer.held == 1 and taken[0].layer == 0
    assert holds.line_queuing("G1 X3", 200) is None, "one hold at a time"
    holds.release(taken[0])
    holds.release(taken[0])
    assert printer.held == 0


def test_only_the_report_that_answers_our_own_question_counts(holds, taken):
    holds.plan([100])
    holds.line_queuing("G1", 100)
    (hold,) = taken
    report = "ok X:1.00 Y:2.50 Z:-0.30 E:4.00 Count X:80"
    holds.line_received(report)
    assert hold.position_mm is None, "an automatic report came first"
    holds.line_sent("M114", {"source:plugin", "plugin:other"})
    holds.line_received(report)
    assert hold.position_mm is None, "somebody else asked"
    holds.line_sent("M114", {hold.tag})
    holds.line_received("ok T:200 /200 B:60 /60")
    holds.line_received(report)
    assert hold.position_mm == (1.0, 2.5, -0.3) and hold.e_mm == 4.0 and hold.over.is_set()


def test_a_line_that_another_plugin_swallowed_costs_one_layer(holds, taken):
    holds.plan([100, 200])
    assert holds.line_queuing("G1", 110) is None
    assert holds.missed == 1
    assert holds.line_queuing("G1", 200) is not None
    assert taken[0].layer == 1 and holds.missed == 0


@pytest.mark.parametrize(
    ("answer", "again", "refused"),
    [(False, True, ""), (None, False, "no hold"), (RuntimeError("No connection"), True, "No connection")],
)
def test_a_hold_that_is_refused_lets_the_line_pass(taken, answer, again, refused):
    printer = Printer(answer)
    holds = Holds(printer, taken.append)
    holds.plan([100, 200])
    assert holds.line_queuing("G1", 100) is None and not taken
    assert refused in holds.refused
    printer.answer = True
    assert (holds.line_queuing("G1", 200) is not None) == again


def test_a_hold_whose_connection_has_gone_is_not_released_on_the_next_one(holds, printer, taken):
    holds.plan([100])
    holds.line_queuing("G1", 100)
    holds.drop("disconnected", lost=True)
    printer.held = 1  # another plugin's, on a new connection
    holds.release(taken[0])
    assert printer.held == 1 and taken[0].over.is_set()


def test_who_asks_gets_a_hold_at_the_next_line(holds, taken):
    assert not holds.ask()
    holds.plan([100, 200])
    assert holds.ask()
    assert holds.line_queuing("G1", 140) is not None
    assert taken[0].layer == 1


def test_before_its_time_a_boundary_is_passed_over(holds, taken):
    holds.plan([100, 200], not_before_s=float("inf"))
    assert holds.line_queuing("G1", 100) is None and not taken


def test_a_marked_spot_is_held_with_the_layer_before_it(holds, printer, taken):
    holds.plan([100, 200], every_layers=0)
    assert holds.line_queuing("G1", 100) is None
    holds.mark_queuing(150)
    assert taken[0].layer == 0 and taken[0].marked
    assert printer.sent[0][0] == ["M400", "M114"]


def test_where_a_printer_stands_can_be_asked_while_nothing_prints(holds, printer):
    found = []
    asking = threading.Thread(target=lambda: found.append(holds.where(5)))
    asking.start()
    while not printer.sent:
        pass
    holds.line_sent("M114", printer.sent[0][1])
    holds.line_received("X:1 Y:2 Z:3")
    asking.join()
    assert found == [(1.0, 2.0, 3.0)]
    holds.plan([100])
    assert holds.where(0.01) is None, "not while a print is watched"


def test_a_question_where_the_printer_stands_costs_a_print_that_begins_meanwhile_one_look_at_most(
    holds, printer, taken
):
    asking = threading.Thread(target=lambda: holds.where(5))
    asking.start()
    while not printer.sent:
        pass
    holds.plan([100, 200])
    assert holds.line_queuing("G1", 100) is None, "it still stands in the way"
    holds.drop("that is enough")
    asking.join()
    assert holds.line_queuing("G1", 200) is not None and taken[0].layer == 1


def test_a_look_in_passing_that_cannot_be_sent_does_not_stand_in_the_way_of_the_next(holds, printer, taken):
    def gone(commands, *, tags):
        raise RuntimeError("No connection")

    holds.plan([100])
    sends, printer.commands = printer.commands, gone
    holds.glance(1.5)
    assert not taken and "No connection" in holds.refused
    printer.commands = sends
    holds.begin()
    holds.plan([100])
    assert holds.line_queuing("G1", 100) is not None
