"""Heaters in a pause of ours."""

import threading

import pytest

from octoprint_moop.machine.resting import Resting


class Heaters:
    def __init__(self, **targets):
        self.targets = targets

    def set_temperature(self, heater, value):
        self.targets[heater] = value

    def get_current_temperatures(self):
        return {heater: {"actual": 20.0, "target": target} for heater, target in self.targets.items()}


def wait_for(resting):
    for timer in resting._timers:
        timer.join()


@pytest.mark.parametrize(
    ("targets", "commands"),
    [
        ({"tool0": 215.0, "bed": 60.0}, ["M109 S215"]),
        ({"tool0": 215.0, "tool1": 230.0, "bed": 0}, ["M109 T0 S215", "M109 T1 S230"]),
        ({"tool0": 0, "tool1": 230.0, "bed": 60.0}, ["M109 T1 S230"]),
        ({"tool0": 215.0, "tool1": 0, "bed": 60.0}, ["M109 T0 S215"]),
        ({"tool0": 0, "bed": 60.0}, []),
    ],
)
def test_hot_ends_are_turned_off_after_a_while_and_hot_again_before_the_print_goes_on(targets, commands):
    heaters = Heaters(**targets)
    resting = Resting(heaters)
    resting.begin(hot_ends_off_s=0.01)
    wait_for(resting)
    assert not any(target for heater, target in heaters.targets.items() if heater.startswith("tool"))
    assert heaters.targets["bed"] == targets["bed"], "the bed holds the print"
    assert resting.reheating() == commands
    assert resting.reheating() == []


def test_the_bed_is_kept_warm_for_as_long_as_is_set_and_heated_first():
    heaters = Heaters(tool0=215.0, bed=60.0)
    resting = Resting(heaters)
    resting.begin(hot_ends_off_s=0.01, bed_off_s=0.02)
    wait_for(resting)
    assert heaters.targets == {"tool0": 0, "bed": 0}
    assert resting.reheating() == ["M190 S60", "M109 S215"]


def test_what_a_firmware_turned_off_by_itself_is_hot_again_too():
    heaters = Heaters(tool0=215.0, bed=60.0, chamber=45.0)
    resting = Resting(heaters)
    resting.begin()
    heaters.targets.update(tool0=0, bed=0, chamber=0)
    assert resting.reheating() == ["M190 S60", "M191 S45", "M109 S215"]


def test_a_temperature_that_the_user_has_changed_stays_as_it_is():
    heaters = Heaters(tool0=215.0, bed=60.0)
    resting = Resting(heaters)
    resting.begin()
    heaters.targets.update(tool0=205.0)
    assert resting.reheating() == []


def test_who_resumes_in_time_finds_it_hot():
    resting = Resting(Heaters(tool0=215.0))
    resting.begin(hot_ends_off_s=60)
    resting.end()
    assert resting.reheating() == [] and not resting._timers


def test_heaters_whose_time_is_up_in_the_moment_of_resuming_are_not_left_cold():
    """Resuming looks at the temperatures while the timer does; whichever comes first, the print does not go on cold."""
    heaters = Heaters(tool0=215.0, bed=60.0)
    resting, sent = Resting(heaters), []
    looks = heaters.get_current_temperatures

    def meanwhile():
        found = looks()
        if threading.current_thread() is not threading.main_thread():
            heaters.get_current_temperatures = looks
            sent.extend(resting.reheating())
        return found

    resting.begin(hot_ends_off_s=0.01)
    heaters.get_current_temperatures = meanwhile
    wait_for(resting)
    assert heaters.targets["tool0"] or "M109 S215" in sent
