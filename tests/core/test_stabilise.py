"""The camera's turn, found from a picture that was turned by a known amount through an independent warp."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from octoprint_moop.core.camera import BedMotion, Camera
from octoprint_moop.core.view import stabilise
from octoprint_moop.core.view.belief import AT_ONCE
from octoprint_moop.core.view.glance import Glance
from octoprint_moop.core.view.stabilise import Stabiliser
from octoprint_moop.core.view.turns import STILL

SIZE = (640, 480)
BED_MM = ((0.0, 0.0), (250.0, 210.0))


@pytest.fixture
def camera() -> Camera:
    return Camera(
        SIZE, [[620, 0, 319.5], [0, 620, 239.5], [0, 0, 1]], [-0.2, 0.05, 0.0008, -0.0006, 0],
        [2.14, -0.72, 0.35], [-36, 104, 13],
    )  # fmt: skip


def room(rng: np.random.Generator) -> np.ndarray:
    """A picture with structure of all sizes, as a bed with scratches before a bench has."""
    picture = np.zeros((SIZE[1], SIZE[0], 3), np.float32)
    for cell in (4, 12, 40, 120):
        patches = rng.uniform(0, 60, (SIZE[1] // cell + 2, SIZE[0] // cell + 2, 1)).astype(np.float32)
        picture += cv2.resize(patches, SIZE, interpolation=cv2.INTER_CUBIC)[..., None]
    return np.clip(picture, 5, 250).astype(np.uint8)


def seen_by_turned(picture: np.ndarray, camera: Camera, rvec: np.ndarray) -> np.ndarray:
    """The picture as the turned camera sees it, every pixel's ray computed by itself."""
    x, y = np.meshgrid(np.arange(SIZE[0], dtype=np.float64), np.arange(SIZE[1], dtype=np.float64))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1).reshape(-1, 1, 2)
    plane = cv2.undistortPoints(pixels, camera.K, camera.distortion).reshape(-1, 2)
    rays = np.column_stack([plane, np.ones(len(plane))]) @ cv2.Rodrigues(rvec)[0]  # turned frame -> calibrated frame
    source, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.K, camera.distortion)
    source = source.reshape(SIZE[1], SIZE[0], 2).astype(np.float32)
    return cv2.remap(picture, source[..., 0], source[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)


def noisy(picture: np.ndarray, rng: np.random.Generator, gain: float = 1.0) -> np.ndarray:
    return np.clip(picture * gain + rng.normal(0, 2, picture.shape), 0, 255).astype(np.uint8)


def stabiliser(camera: Camera, reference: np.ndarray, bed: BedMotion = BedMotion()) -> Stabiliser:
    return Stabiliser(camera, bed, BED_MM, reference, bed.reference_mm, np.zeros(SIZE[::-1], np.uint8))


@pytest.mark.parametrize("turn_px", [1.5, 4, 12, 35])
def test_a_knock_is_measured_to_half_a_pixel_even_when_the_lamp_is_dimmed(camera, turn_px):
    rng = np.random.default_rng(4)
    reference = room(rng)
    rvec = np.array([0.9, -0.4, 0.25]) * turn_px / camera.K[0, 0]
    found = stabiliser(camera, reference).turn(
        Glance(noisy(seen_by_turned(reference, camera, rvec), rng, 0.6)), (0, 0, 0)
    )
    assert np.abs(found.rvec - rvec).max() * camera.K[0, 0] < 0.5
    assert found.motion_px == pytest.approx(turn_px, rel=0.15, abs=0.5)


def test_a_camera_that_stands_still_is_never_said_to_have_moved(camera):
    rng = np.random.default_rng(5)
    reference = room(rng)
    watcher = stabiliser(camera, reference)
    assert all(watcher.turn(Glance(noisy(reference, rng, gain)), (0, 0, 0)) is STILL for gain in (0.4, 0.7, 1.0, 1.2))


def test_a_hand_over_a_third_of_the_picture_is_not_taken_for_motion(camera):
    rng = np.random.default_rng(6)
    reference = room(rng)
    frame = noisy(reference, rng)
    cv2.ellipse(frame, (180, 300), (170, 190), 20, 0, 360, (120, 150, 210), -1)
    assert stabiliser(camera, reference).turn(Glance(frame), (0, 0, 0)) is STILL


def test_undoing_a_turn_gives_the_calibrated_view_back(camera):
    rng = np.random.default_rng(7)
    reference = room(rng)
    rvec = np.array([0.01, -0.006, 0.004])
    watcher = stabiliser(camera, reference)
    frame = seen_by_turned(reference, camera, rvec)
    steady, outside = watcher.turns.undo(frame, watcher.turn(Glance(frame), (0, 0, 0)))
    inside = cv2.erode(cv2.bitwise_not(outside), np.ones((9, 9), np.uint8)) > 0
    before = np.abs(frame.astype(int) - reference)[inside].mean()
    after = np.abs(steady.astype(int) - reference)[inside].mean()
    assert after < before / 4
    assert 0.005 < (outside > 0).mean() < 0.1


def test_a_knock_is_told_from_a_bed_that_the_machine_has_moved(camera):
    """Bed at another Y and camera turned at once: only the turn is reported, since the bed is where it must be."""
    rng = np.random.default_rng(8)
    bed = BedMotion("y", (0.0, 200.0, 0.0))
    texture = cv2.resize(rng.integers(30, 220, (70, 84)).astype(np.uint8), (1000, 840), interpolation=cv2.INTER_NEAREST)
    corners = np.array([[0, 0, 0], [250, 0, 0], [250, 210, 0], [0, 210, 0]], float)
    perfect = camera.undistorted()

    def seen_at(y_mm: float, turn: np.ndarray) -> np.ndarray:
        """The bed's texture through a homography from its corners: planes need no renderer."""
        rotation = cv2.Rodrigues(turn)[0] @ cv2.Rodrigues(perfect.rvec)[0]
        tvec = cv2.Rodrigues(turn)[0] @ perfect.tvec_mm
        to, _ = cv2.projectPoints(corners + [0, 200 - y_mm, 0], cv2.Rodrigues(rotation)[0], tvec, perfect.K, None)
        source = np.float32([[0, 0], [1000, 0], [1000, 840], [0, 840]])
        warp = cv2.getPerspectiveTransform(source, to.reshape(4, 2).astype(np.float32))
        return cv2.cvtColor(cv2.warpPerspective(texture, warp, SIZE, borderValue=90), cv2.COLOR_GRAY2BGR)

    watcher = stabiliser(perfect, seen_at(200, np.zeros(3)), bed)
    turn = np.array([0.008, -0.005, 0.003])
    found = watcher.turn(Glance(noisy(seen_at(185, turn), rng)), (0, 185, 0))
    assert np.abs(found.rvec - turn).max() * camera.K[0, 0] < 0.6
    assert watcher.turn(Glance(noisy(seen_at(185, np.zeros(3)), rng)), (0, 185, 0)) is STILL


def test_a_picture_without_structure_claims_nothing(camera):
    plain = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
    assert stabiliser(camera, plain).turn(Glance(plain + np.uint8(3)), (0, 0, 0)) is STILL


def plain_bed(rng: np.random.Generator) -> np.ndarray:
    """A bed of one colour that fills all of the picture but a strip of bench at its upper edge."""
    picture = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
    picture[:90] = room(rng)[:90]
    return picture


def test_noise_on_a_plain_bed_has_no_say_in_whether_the_camera_was_knocked(camera):
    rng = np.random.default_rng(11)
    scene = plain_bed(rng)
    watcher = stabiliser(camera, noisy(scene, rng))
    for _ in range(3):
        assert watcher.turn(Glance(noisy(scene, rng)), (0, 0, 0)) is STILL
        assert watcher.sure
    rvec = np.array([0.6, -0.7, 0.1]) * 14 / camera.K[0, 0]
    found = watcher.turn(Glance(noisy(seen_by_turned(scene, camera, rvec), rng)), (0, 0, 0))
    assert np.abs(found.rvec - rvec).max() * camera.K[0, 0] < 1.5


def test_a_gantry_that_climbs_before_a_plain_bed_is_no_turn_of_the_camera(camera):
    """Two bright rods of a gantry are all that moves and most of what has structure."""
    rng = np.random.default_rng(12)
    scene = plain_bed(rng)

    def seen(height: int) -> np.ndarray:
        frame = scene.copy()
        for row in (height, height + 60):
            cv2.line(frame, (0, row), (639, row + 20), (215, 225, 230), 9)
        return noisy(frame, rng)

    watcher = stabiliser(camera, seen(300))
    assert all(watcher.turn(Glance(seen(300 - 6 * step)), (0, 0, 0)) is STILL for step in range(8))


def test_a_view_in_which_nothing_is_where_it_was_is_lost_until_it_comes_back(camera):
    rng = np.random.default_rng(14)
    scene, elsewhere = room(rng), room(rng)
    watcher = stabiliser(camera, scene)
    assert watcher.turn(Glance(noisy(scene, rng)), (0, 0, 0)) is STILL
    assert not watcher.lost
    for _ in range(3):
        watcher.turn(Glance(noisy(elsewhere, rng)), (0, 0, 0))
        assert watcher.lost
        assert not watcher.sure
    assert watcher.turn(Glance(noisy(scene, rng)), (0, 0, 0)) is STILL
    assert watcher.sure
    assert not watcher.lost


def test_a_plain_picture_is_neither_sure_nor_lost(camera):
    rng = np.random.default_rng(15)
    plain = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
    watcher = stabiliser(camera, noisy(plain, rng))
    for _ in range(4):
        assert watcher.turn(Glance(noisy(plain, rng)), (0, 0, 0)) is STILL
        assert not watcher.sure
        assert not watcher.lost


def test_a_camera_that_wobbles_all_print_long_fills_no_memory(camera):
    rng = np.random.default_rng(5)
    reference = room(rng)
    finder, turn, kept_bytes = stabiliser(camera, reference), STILL, []
    for number in range(16):
        rvec = np.array([0.9, -0.4, 0.25]) * (2 + 3 * (number % 2) + 0.7 * number) / camera.K[0, 0]
        before, turn = turn, finder.turn(Glance(noisy(seen_by_turned(reference, camera, rvec), rng)), (0, 0, 0), turn)
        assert turn is not before
        kept_bytes.append(sum(kept.nbytes for kept in finder._aim._kept_pixels.values()))
    assert max(kept_bytes[8:]) <= max(kept_bytes[:8])


def behind_a_head(scene: np.ndarray, x: int, y: int) -> np.ndarray:
    """A plain dark head with its fan hangs before nearly half of the picture."""
    frame = scene.copy()
    cv2.rectangle(frame, (x - 190, 0), (x + 190, y), (26, 24, 24), -1)
    cv2.circle(frame, (x, y - 150), 120, (40, 38, 38), -1)
    return frame


@pytest.mark.parametrize(("way", "at"), [((1.0, 0.3, 0.0), 300), ((-0.5, 0.9, 0.3), 260), ((0.1, 1.0, 0.4), 260)])
def test_a_knock_is_found_though_a_dark_head_hides_half_of_what_tells(camera, way, at):
    rng = np.random.default_rng(21)
    scene = cv2.addWeighted(room(rng), 0.3, np.full((SIZE[1], SIZE[0], 3), 60, np.uint8), 1.0, 0)
    watcher = stabiliser(camera, noisy(scene, rng))
    for x in (330, 210, 400):
        assert watcher.turn(Glance(noisy(behind_a_head(scene, x, 330), rng)), (0, 0, 0)) is STILL
    rvec = np.array(way) * 30 / camera.K[0, 0]
    found = watcher.turn(Glance(noisy(seen_by_turned(behind_a_head(scene, at, 330), camera, rvec), rng)), (0, 0, 0))
    assert watcher.sure
    assert np.abs(found.rvec - rvec).max() * camera.K[0, 0] < 1.0


def test_a_knock_of_which_each_frame_leaves_some_doubt_is_believed_once_two_tell_the_same(camera, monkeypatch):
    rng = np.random.default_rng(25)
    scene = room(rng)
    monkeypatch.setattr(stabilise, "AT_ONCE", replace(AT_ONCE, total_sigma=np.inf))  # so that each leaves some
    watcher = stabiliser(camera, noisy(scene, rng))
    watcher.turn(Glance(noisy(scene, rng)), (0, 0, 0))
    knocked, again = (np.array(way) * 20 / camera.K[0, 0] for way in ([0.6, -0.7, 0.1], [-0.3, 0.9, 0.2]))
    for rvec in (knocked, again):
        assert watcher.turn(Glance(noisy(seen_by_turned(scene, camera, rvec), rng)), (0, 0, 0)) is STILL
        assert not watcher.sure
        assert not watcher.twice
    found = watcher.turn(Glance(noisy(seen_by_turned(scene, camera, again), rng)), (0, 0, 0))
    assert watcher.sure
    assert watcher.twice
    assert np.abs(found.rvec - again).max() * camera.K[0, 0] < 1.0
