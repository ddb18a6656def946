import contextlib
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from octoprint_moop.core.errors import CameraError, FrameError
from octoprint_moop.machine.link import EyeGone, EyeLink, Interrupted


@pytest.fixture
def eye():
    link = EyeLink("tests.machine.eyes")
    yield link
    link.close()


def test_arguments_and_bytes_come_back_as_they_went(eye):
    blobs = [bytes(range(256)) * 4000, b"", b"\n"]
    assert eye.ask("echo", *blobs, timeout_s=10, a=1, b=["ü"]) == ({"a": 1, "b": ["ü"]}, blobs)


def test_what_the_eye_refuses_is_the_same_error_here(eye):
    with pytest.raises(CameraError, match=r"No such lens\."):
        eye.ask("refuse", timeout_s=10)
    assert eye.ask("echo", timeout_s=10, x=1)[0] == {"x": 1}


def test_a_death_is_told_with_its_status_and_the_next_question_starts_another(eye):
    eye.ask("echo", timeout_s=10)
    with pytest.raises(EyeGone, match="status 3"):
        eye.ask("die", timeout_s=10)
    assert eye.ask("echo", timeout_s=10, x=2)[0] == {"x": 2}
    assert eye.births == 2


def test_an_eye_that_was_killed_while_nobody_asked_it_anything_costs_no_question(eye):
    eye.ask("echo", timeout_s=10)
    os.kill(eye.pid, signal.SIGKILL)
    deadline_s = time.monotonic() + 10
    while eye.pid is not None and time.monotonic() < deadline_s:
        time.sleep(0.01)
    assert eye.ask("echo", timeout_s=10, x=2)[0] == {"x": 2}
    assert eye.births == 2


def test_what_only_one_eye_knows_is_not_asked_of_the_next(eye):
    eye.ask("echo", timeout_s=10)
    first = eye.births
    os.kill(eye.pid, signal.SIGKILL)
    with pytest.raises(EyeGone):  # whether its death was noticed by now or not
        eye.ask("echo", timeout_s=10, birth=first)
    eye.ask("echo", timeout_s=10)
    with pytest.raises(EyeGone, match="anew"):
        eye.ask("echo", timeout_s=10, birth=first)
    assert eye.births == first + 1


def test_an_eye_that_hangs_is_ended_in_time_even_while_a_large_picture_is_handed_over(eye):
    eye.ask("echo", timeout_s=10)
    first = eye.pid
    began_s = time.monotonic()

    def hang() -> None:
        with contextlib.suppress(EyeGone):
            eye.ask("hang", timeout_s=1)

    threading.Thread(target=hang).start()
    with pytest.raises(EyeGone):
        eye.ask("echo", bytes(20_000_000), timeout_s=1)
    assert time.monotonic() - began_s < 10
    assert eye.ask("echo", timeout_s=10, x=3)[0] == {"x": 3}
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)


def test_an_eye_that_hangs_on_what_nobody_wants_any_more_does_not_keep_the_next_waiting(eye):
    eye.ask("echo", timeout_s=10)
    unwanted = threading.Event()
    unwanted.set()
    with pytest.raises(Interrupted):
        eye.ask("hang", timeout_s=1, interrupted=unwanted)
    began_s = time.monotonic()
    with pytest.raises(EyeGone):
        eye.ask("echo", timeout_s=300)
    assert time.monotonic() - began_s < 10
    assert eye.ask("echo", timeout_s=10, x=4)[0] == {"x": 4}


def test_how_far_it_is_is_told_before_the_answer(eye):
    told, never = [], threading.Event()
    assert eye.ask("count", timeout_s=10, interrupted=never, progress=told.append, x=1)[0] == {"x": 1}
    assert told == [0.25, 0.75]
    assert eye.ask("count", timeout_s=10, x=2)[0] == {"x": 2}, "nobody need listen"


def test_an_answer_that_nobody_waits_for_any_more_is_dropped(eye):
    eye.ask("echo", timeout_s=10)
    interrupted = threading.Event()
    threading.Timer(0.2, interrupted.set).start()
    with pytest.raises(Interrupted):
        eye.ask("sleep", timeout_s=10, interrupted=interrupted, s=1.0)
    assert eye.ask("echo", timeout_s=10, x=4)[0] == {"x": 4}
    assert eye.births == 1


def test_babble_in_place_of_an_answer_ends_the_eye(eye):
    with pytest.raises(EyeGone):
        eye.ask("babble", timeout_s=10)


def test_a_library_that_cannot_be_loaded_is_named(eye, monkeypatch):
    monkeypatch.setenv("EYE", "broken")
    with pytest.raises(EyeGone, match=r"libGL\.so\.1: cannot open"):
        eye.ask("echo", timeout_s=10)


def test_questions_of_several_threads_do_not_mix(eye):
    wrong = []

    def ask(n: int) -> None:
        for k in range(20):
            if eye.ask("echo", str(n).encode(), timeout_s=30, n=n, k=k) != ({"n": n, "k": k}, [str(n).encode()]):
                wrong.append(n)

    threads = [threading.Thread(target=ask, args=(n,)) for n in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_the_real_eye_answers_and_survives_what_it_cannot_read():
    link = EyeLink()
    try:
        with pytest.raises(FrameError):
            link.ask("segment", b"\xff\xd8 not a picture \xff\xd9", timeout_s=60,
                     material={"hue_deg": [0, 360], "saturation_min": 0.3, "value_min": 0.2})  # fmt: skip
        born = link.births
        with pytest.raises(Exception, match="No print is being watched"):
            link.ask("pictures", timeout_s=60)
        assert link.births == born
    finally:
        link.close()


def test_the_server_loads_no_library_that_only_the_eye_needs():
    pytest.importorskip("octoprint")
    code = (
        "import sys, octoprint_moop.host.plugin; "
        "print([name for name in ('cv2', 'numpy', 'trimesh', 'moderngl') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.strip().splitlines()[-1:] == ["[]"], done.stderr


def test_a_question_that_waits_for_one_nobody_wants_any_more_is_told_how_far_that_is_and_given_time(eye):
    """As a file that is read ahead when its print begins."""
    eye.ask("echo", timeout_s=10)
    unwanted, told = threading.Event(), []
    unwanted.set()
    with pytest.raises(Interrupted):
        eye.ask("count", timeout_s=3.0, interrupted=unwanted, progress=told.append, s=2.0)
    assert eye.ask("echo", timeout_s=3.0, interrupted=threading.Event(), progress=told.append, x=1)[0] == {"x": 1}
    assert told == [0.25, 0.75] and eye.births == 1


def test_a_question_that_waits_for_its_turn_does_not_end_what_is_being_done(eye):
    """Who opens the past prints while a model is read must not cost the reading, nor its own pictures."""
    eye.ask("echo", timeout_s=10)
    answers = []
    reading = threading.Thread(target=lambda: answers.append(eye.ask("sleep", timeout_s=10, s=2.0)))
    reading.start()
    time.sleep(0.2)
    assert eye.ask("echo", timeout_s=1.0, x=1)[0] == {"x": 1}
    reading.join()
    assert answers and eye.births == 1


def test_a_question_behind_one_that_hangs_is_freed_with_it(eye):
    eye.ask("echo", timeout_s=10)

    def hang() -> None:
        with contextlib.suppress(EyeGone):
            eye.ask("hang", timeout_s=1)

    hung = threading.Thread(target=hang)
    hung.start()
    time.sleep(0.2)
    with pytest.raises(EyeGone):
        eye.ask("echo", timeout_s=5)
    hung.join()


def test_an_eye_that_nobody_asks_anything_rests_and_the_next_question_wakes_another():
    eye = EyeLink("tests.machine.eyes", rest_s=0.3)
    try:
        eye.ask("echo", timeout_s=10)
        deadline_s = time.monotonic() + 10
        while eye.pid is not None and time.monotonic() < deadline_s:
            time.sleep(0.01)
        assert eye.pid is None
        assert eye.ask("sleep", timeout_s=10, s=0.6)[0] == {"s": 0.6}, "at work it does not"
        assert eye.births == 2
    finally:
        eye.close()
