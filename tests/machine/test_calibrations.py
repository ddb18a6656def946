"""Calibrations are named, dated, and never lost by making another."""

from __future__ import annotations

import json
from datetime import datetime, timezone

import pytest

from octoprint_moop.core.errors import CalibrationError
from octoprint_moop.machine.calibrations import MOST_KEPT, Calibrations, Seen, stale

KEY = ("default", "cam")


def parts(number, size=(640, 480)):
    return {"printer": {"bed": 1}, "camera": {"image_size_px": list(size), "number": number}}


@pytest.fixture
def kept(tmp_path):
    return Calibrations(tmp_path / "setups.json")


def test_the_last_one_made_is_in_use_and_dated(kept, tmp_path):
    assert kept.get(*KEY) is None
    before = datetime.now(timezone.utc)
    assert kept.put(*KEY, parts(1), how="pose") == ["camera", "printer"]
    assert kept.put(*KEY, parts(2), "After the move") == ["camera"]
    again = Calibrations(tmp_path / "setups.json")
    assert again.get(*KEY) == parts(2)
    names = [each.name for each in again.all(*KEY)]
    assert names[0] == "After the move" and names[1].startswith("Marker plate, ")
    made_at = datetime.fromisoformat(again.all(*KEY)[1].made_at)
    assert abs((made_at - before).total_seconds()) < 5


def test_what_is_the_same_makes_no_second_one(kept):
    kept.put(*KEY, parts(1))
    assert kept.put(*KEY, parts(1)) == []
    assert len(kept.all(*KEY)) == 1


def test_going_back_is_one_step_and_another_one_leads_forward_again(kept):
    for number in (1, 2, 3):
        kept.put(*KEY, parts(number))
    assert kept.revert(*KEY).parts == parts(2)
    assert kept.revert(*KEY).parts == parts(1) == kept.get(*KEY)
    with pytest.raises(CalibrationError, match="no earlier"):
        kept.revert(*KEY)
    kept.use(*KEY, 3)
    assert kept.get(*KEY) == parts(3)
    assert kept.revert(*KEY).parts == parts(1)


def test_each_webcam_and_profile_has_its_own(kept):
    kept.put(*KEY, parts(1))
    kept.put("default", "other", parts(2))
    assert kept.get(*KEY) == parts(1) and kept.get("default", "other") == parts(2)
    assert kept.get("big", "cam") is None


def test_the_one_in_use_cannot_be_removed(kept):
    kept.put(*KEY, parts(1))
    kept.put(*KEY, parts(2))
    with pytest.raises(CalibrationError, match="in use"):
        kept.remove(*KEY, 2)
    kept.remove(*KEY, 1)
    assert [each.id for each in kept.all(*KEY)] == [2]
    with pytest.raises(CalibrationError, match="number 1"):
        kept.use(*KEY, 1)


def test_old_ones_go_but_never_the_one_in_use(kept):
    kept.put(*KEY, parts(0))
    for number in range(1, MOST_KEPT + 5):
        kept.put(*KEY, parts(number))
        kept.use(*KEY, 1)
    assert len(kept.all(*KEY)) == MOST_KEPT
    assert kept.current(*KEY).id == 1


def test_a_set_up_from_before_there_were_several_is_still_in_use(kept, tmp_path):
    (tmp_path / "setups.json").write_text(json.dumps({json.dumps(list(KEY)): parts(7)}))
    assert kept.get(*KEY) == parts(7)
    kept.put(*KEY, parts(8))
    assert kept.revert(*KEY).parts == parts(7)


def test_a_damaged_file_is_no_calibration(kept, tmp_path):
    for damage in ("{", "[]", json.dumps({json.dumps(list(KEY)): {"made": [{"id": "x"}, 3], "used": [1, "a"]}})):
        (tmp_path / "setups.json").write_text(damage)
        assert kept.get(*KEY) is None
    kept.put(*KEY, parts(1))
    assert kept.get(*KEY) == parts(1)


def test_a_name_can_be_changed_but_not_to_nothing(kept):
    kept.put(*KEY, parts(1))
    assert kept.rename(*KEY, 1, " Left shelf ").name == "Left shelf"
    with pytest.raises(CalibrationError, match="needs a name"):
        kept.rename(*KEY, 1, "  ")


@pytest.mark.parametrize(
    ("now", "said"),
    [
        (Seen([640, 480]), None),
        (Seen(None), None),
        (Seen([1280, 960]), "scaled"),
        (Seen([1280, 720]), "another shape"),
        (Seen([640, 480], flip_h=True), "flip horizontally"),
        (Seen([640, 480], rotate_90=True), "rotate"),
    ],
)
def test_a_camera_that_delivers_otherwise_is_told_as_stale(kept, now, said):
    kept.put(*KEY, parts(1), seen=Seen([640, 480]))
    why = stale(kept.current(*KEY), now)
    assert (not why) if said is None else said in " ".join(why)


def test_another_bed_motion_does_not_make_an_old_camera_new(kept):
    kept.put(*KEY, parts(1), how="pose", seen=Seen([640, 480]), error_px={"mean": 0.2, "max": 0.7})
    kept.put(*KEY, {**parts(1), "printer": {"bed": 2}}, seen=Seen([640, 480], flip_h=True))
    assert stale(kept.current(*KEY), Seen([640, 480], flip_h=True))
    assert kept.current(*KEY).error_px == {"mean": 0.2, "max": 0.7}


def test_an_accuracy_that_is_no_number_is_none(kept):
    kept.put(*KEY, parts(1), error_px={"mean": float("nan"), "max": 1})
    assert kept.current(*KEY).error_px is None
