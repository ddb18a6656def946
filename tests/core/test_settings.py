import math
from dataclasses import fields

import pytest

from octoprint_moop.core.errors import SettingsError
from octoprint_moop.core.settings import DEFAULTS, VERSION, Settings, migrate, read_settings, read_value


def test_nothing_stored_gives_the_defaults():
    assert read_settings({}) == Settings()


def test_every_default_lies_within_its_own_range():
    assert read_settings(DEFAULTS) == Settings()


def test_every_setting_has_a_sentence_that_ends_like_one():
    for field in fields(Settings):
        assert field.metadata["sentence"].endswith("."), field.name


def test_numbers_from_a_form_arrive_as_text_and_leave_as_numbers():
    settings = read_settings({"settle_s": "0.5", "every_layers": "3", "record": "false"})
    assert (settings.settle_s, settings.every_layers, settings.record) == (0.5, 3, False)
    assert isinstance(settings.every_layers, int)


def test_what_is_not_known_and_what_is_empty_is_passed_over():
    assert read_settings({"colour": "blue", "hue_min_deg": None}) == Settings()


@pytest.mark.parametrize("value", [-1, 360.5, math.nan, math.inf, "warm", [], {}])
def test_a_number_out_of_its_range_is_refused_by_name_and_range(value):
    with pytest.raises(SettingsError, match=r"hue_min_deg is .*360"):
        read_value("hue_min_deg", value)


def test_a_choice_that_does_not_exist_is_refused_with_those_that_do():
    with pytest.raises(SettingsError, match=r"'explode'.*notify, pause"):
        read_value("on_failed", "explode")


def test_a_switch_is_not_a_number_of_any_size():
    with pytest.raises(SettingsError, match="true or false"):
        read_value("record", 2)


def test_an_unknown_setting_has_no_value():
    with pytest.raises(SettingsError, match="'colour'"):
        read_value("colour", 1)


@pytest.mark.parametrize("version", [None, VERSION])
def test_values_of_todays_format_are_not_touched_by_migration(version):
    assert migrate({"settle_s": 1.5}, version) == {"settle_s": 1.5}
