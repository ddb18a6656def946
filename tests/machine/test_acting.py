import pytest

from octoprint_moop.machine.acting import WELL_CHECKS, Actor


class Printer:
    def __init__(self):
        self.done, self.temperatures = [], {"tool0": {"target": 215.0}, "bed": {"target": 60.0}}

    def pause_print(self, *, tags):
        self.done.append("pause")

    def cancel_print(self, *, tags):
        self.done.append("cancel")

    def commands(self, commands, *, tags):
        self.done += commands

    def set_temperature(self, heater, value):
        self.done.append(f"{heater}={value}")

    def get_current_temperatures(self):
        return self.temperatures


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


@pytest.mark.parametrize(
    ("temperatures", "commands"),
    [
        ({"tool0": {"target": 215.0}, "bed": {"target": 60.0}}, ["M109 S215"]),
        ({"tool0": {"target": 215.0}, "tool1": {"target": 230.0}}, ["M109 T0 S215", "M109 T1 S230"]),
        ({"tool0": {"target": 0}, "bed": {"target": 60.0}}, []),
    ],
)
def test_hot_ends_are_turned_off_and_heated_again_once_and_the_bed_is_left(actor, printer, temperatures, commands):
    printer.temperatures = temperatures
    actor.cool_later(0)
    actor._cooling.join()
    assert "bed=0" not in printer.done
    assert actor.reheating() == commands
    assert actor.reheating() == []


def test_who_resumes_in_time_finds_it_hot(actor, printer):
    actor.cool_later(60)
    actor.forget_cooling()
    assert actor.reheating() == [] and printer.done == []
