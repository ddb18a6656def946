import pytest

from octoprint_moop.machine.acting import WELL_CHECKS, Actor


class Printer:
    def __init__(self):
        self.done = []

    def pause_print(self, *, tags):
        self.done.append("pause")

    def cancel_print(self, *, tags):
        self.done.append("cancel")

    def commands(self, commands, *, tags):
        self.done += commands


@pytest.fixture
def printer():
    return Printer()


@pytest.fixture
def actor(printer):
    actor = Actor(printer)
    actor.begin(["ship", "flag", "stand"], ["M486 P0", "M486 P1", ""])
    return actor


def failed(*names):
    return {"verdict": "failed", "objects": [{"name": name, "verdict": "failed"} for name in names]}


def test_a_good_check_and_a_suspect_one_do_nothing(actor, printer):
    for verdict in ("ok", "suspect", "unusable", "camera_moved"):
        assert actor.act({"verdict": verdict, "objects": []}, "pause") == "none"
    assert printer.done == []


def test_what_is_known_is_not_acted_on_again(actor, printer):
    assert actor.act(failed(), "pause") == "pause"
    assert actor.act(failed(), "pause") == "none"
    assert actor.act(failed("ship"), "pause") == "pause", "an object is something new"
    assert printer.done == ["pause", "pause"]
    actor.begin()
    assert actor.act(failed(), "pause") == "pause", "and so is another print"


def test_after_a_while_of_good_checks_the_same_may_fail_anew(actor, printer):
    good = {"verdict": "ok", "objects": []}
    assert actor.act(failed("ship"), "pause") == "pause"
    for _ in range(WELL_CHECKS - 1):
        actor.act(good, "pause")
    assert actor.act(failed("ship"), "pause") == "none"
    for _ in range(WELL_CHECKS):
        actor.act(good, "pause")
    assert actor.act(failed("ship"), "pause") == "pause"


def test_only_the_failed_object_is_cancelled_while_there_is_another(actor, printer):
    assert actor.act(failed("flag"), "cancel_object") == "cancel_object"
    assert printer.done == ["M486 P1"]


@pytest.mark.parametrize("names", [("stand",), (), ("ship", "flag")])
def test_an_object_that_cannot_be_cancelled_alone_is_a_pause(actor, printer, names):
    actor_only = Actor(printer)
    actor_only.begin(["ship", "flag", "stand"], ["M486 P0", "M486 P1", ""])
    assert actor_only.act(failed(*names), "cancel_object") == "pause"


def test_telling_alone_touches_nothing(actor, printer):
    assert actor.act(failed(), "notify") == "notify"
    assert printer.done == []


def test_a_cancelled_object_is_gone_for_good_whoever_cancelled_it(printer):
    actor = Actor(printer)
    actor.begin(["ship", "flag"], ["M486 P0", "M486 P1"])
    assert actor.cancelled_by("M486 P0") == "ship" and actor.cancelled_by("M105") is None
    assert actor.act(failed("flag"), "cancel_object") == "pause", "nothing would be left to print"


def test_what_is_suspected_is_told_once_and_what_then_fails_is_acted_on(actor, printer):
    suspect = {"verdict": "suspect", "objects": []}
    assert actor.act(suspect, "pause", on_suspect="notify") == "notify"
    assert actor.act(suspect, "pause", on_suspect="notify") == "none"
    assert printer.done == []
    assert actor.act(failed(), "pause", on_suspect="notify") == "pause"
    assert actor.act(suspect, "pause", on_suspect="notify") == "none", "it is known to have failed"
