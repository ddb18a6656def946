from octoprint_moop.machine import blindness
from octoprint_moop.machine.ledger import KEPT_PICTURES, Ledger


def check(verdict="ok", **changes):
    plain = {"type": "check", "verdict": verdict, "layer": 0, "reason": "", "total_px": 1000, "action": "none"}
    return {**plain, **changes}


def test_a_week_of_checks_is_told_one_by_one_and_pictures_are_kept_of_the_last():
    told = []
    ledger = Ledger(lambda kind, payload: told.append(kind), "1.0")
    ledger.begin("cube")
    ledger.note(blind=None)
    for _ in range(10_000):
        ledger.add(check(), {"frame.jpg": b"x"}, 0.5)
    assert ledger.status["checks"] == 10_000 and ledger.status["held_s"] == 5000.0
    assert told.count("check") == 10_000 and told.count("ok") == 0
    assert ledger.picture(9_999, "frame.jpg") == b"x"
    assert ledger.picture(9_999 - KEPT_PICTURES, "frame.jpg") is None


def test_nothing_is_told_twice():
    told = []
    ledger = Ledger(lambda kind, payload: told.append((kind, payload.get("reason"))), "1.0")
    ledger.begin("cube")
    told.clear()
    ledger.blind("frame", "The webcam is away.")
    ledger.blind("frame", "The webcam is away.")
    ledger.note(blind=None)
    ledger.idle()
    assert [kind for kind, _ in told] == ["status", "blind", "status", "status"]


def test_blindness_has_a_code_for_as_long_as_it_lasts():
    ledger = Ledger(lambda kind, payload: None, "1.0")
    assert ledger.status["blind_code"] == blindness.IDLE
    ledger.begin("cube")
    assert ledger.status["blind_code"] == blindness.READING
    ledger.note(blind=None)
    assert ledger.status["blind_code"] is None
    ledger.add(check("camera_moved", reason="It was knocked."), {}, 0.1)
    assert ledger.status["blind_code"] == blindness.CAMERA_MOVED


def test_a_frame_that_shows_nothing_of_the_print_is_blindness_not_wellbeing():
    ledger = Ledger(lambda kind, payload: None, "1.0")
    ledger.begin("cube")
    ledger.add(check("unusable", reason="Nothing is in view.", total_px=0), {}, 0.1)
    assert ledger.status["blind"] == "Nothing is in view." and not ledger.status["watching"]
    assert ledger.status["blind_code"] == blindness.OUT_OF_VIEW
    ledger.add(check("unusable", reason="Too dark.", total_px=None), {}, 0.1)
    assert ledger.status["blind"] == "Too dark."
    ledger.add(check(), {}, 0.1)
    assert ledger.status["blind"] is None


def test_a_published_status_does_not_change_any_more():
    ledger = Ledger(lambda kind, payload: None, "1.0")
    before = ledger.status
    ledger.begin("cube")
    assert before["job"] is None and ledger.status["job"] == "cube"
