"""The set-up in a real browser and against a real server, before a webcam whose place and lens are known to the test."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from octoprint_moop.core.camera import Camera
from octoprint_moop.demo.server import DemoServer
from octoprint_moop.demo.webcam import SnapshotServer

from .stage import OCTOPRINT, log_in, serious_violations, show_tab

SIZE = (640, 480)
CORNERS = np.array([[0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0]], dtype=float)  # of OctoPrint's default profile
FILAMENT_BGR = (30, 150, 40)


def true_camera() -> Camera:
    """In front of the bed and to the left, with a lens that bends lines."""
    eye, target = np.array([40.0, -260.0, 260.0]), np.array([100.0, 95.0, 0.0])
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    K = [[690, 0, 322], [0, 690, 236], [0, 0, 1]]
    return Camera(SIZE, K, [-0.08, 0.01, 0, 0, 0], cv2.Rodrigues(rotation)[0].ravel(), -rotation @ eye)


class Stage:
    """What stands before the webcam: the bed with a piece of filament on it, or a checkerboard held in some way."""

    def __init__(self) -> None:
        self.camera = true_camera()
        self.tilt: tuple[float, float, float, float, float] | None = None
        self._shots = 0

    def jpeg(self) -> bytes:
        self._shots += 1
        picture = np.full((SIZE[1], SIZE[0], 3), (150, 160, 165), np.uint8)
        if self.tilt is None:
            self._fill(picture, CORNERS, (60, 55, 50))
            self._fill(picture, np.array([[90, 90, 0], [120, 90, 0], [120, 120, 0], [90, 120, 0]], float), FILAMENT_BGR)
        else:
            self._board(picture, *self.tilt)
        noise = np.random.default_rng(self._shots).normal(0, 2, picture.shape)
        noisy = np.clip(picture + noise, 0, 255).astype(np.uint8)
        return bytes(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 95])[1])

    def _fill(self, picture: np.ndarray, corners_mm: np.ndarray, colour: Any) -> None:
        along = np.linspace(0, 1, 20)[:-1, None]
        edge = np.concatenate([a + along * (b - a) for a, b in zip(corners_mm, np.roll(corners_mm, -1, axis=0))])
        polygon = np.round(self.camera.project(edge) * 16).astype(np.int32)
        cv2.fillPoly(picture, [polygon], colour, cv2.LINE_AA, shift=4)

    def _board(self, picture: np.ndarray, rx: float, ry: float, rz: float, x: float, y: float) -> None:
        """A 10 x 7 board of 15 mm squares, each square's outline drawn through the lens."""
        rotation = cv2.Rodrigues(np.array([rx, ry, rz]))[0]
        lens = Camera(SIZE, self.camera.K, self.camera.distortion, np.zeros(3), np.zeros(3))

        def fill(x0: float, y0: float, x1: float, y1: float, colour: int) -> None:
            corners = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]], float)
            along = np.linspace(0, 1, 6)[:-1, None]
            edge = np.concatenate([a + along * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0))])
            room = edge @ rotation.T + [x, y, 330]
            cv2.fillPoly(
                picture, [np.round(lens.project(room) * 16).astype(np.int32)], (colour,) * 3, cv2.LINE_AA, shift=4
            )

        fill(-90, -67.5, 90, 67.5, 245)
        for column in range(10):
            for row in range(7):
                if (column + row) % 2:
                    fill(-75 + 15 * column, -52.5 + 15 * row, -60 + 15 * column, -37.5 + 15 * row, 15)


@pytest.fixture(scope="module")
def stage() -> Stage:
    return Stage()


@pytest.fixture(scope="module")
def bare_server(stage: Stage, tmp_path_factory: pytest.TempPathFactory) -> Iterator[DemoServer]:
    with (
        SnapshotServer(stage.jpeg) as webcam,
        DemoServer(tmp_path_factory.mktemp("bare"), snapshot_url=webcam.url, octoprint_python=OCTOPRINT) as running,
    ):
        yield running


@pytest.fixture(scope="module")
def page(chromium: Any, bare_server: DemoServer) -> Iterator[Any]:
    context = chromium.new_context(viewport={"width": 1280, "height": 1600})
    page = context.new_page()
    errors: list[str] = []
    page.on(
        "console",
        lambda message: errors.append(f"{message.text} {message.location}") if message.type == "error" else None,
    )
    page.on("pageerror", lambda error: errors.append(str(error)))
    log_in(page, bare_server.url, bare_server.user, bare_server.password)
    show_tab(page)
    yield page
    context.close()
    assert errors == []


def click_at(page: Any, selector: str, pixel: np.ndarray) -> None:
    canvas = page.locator(selector)
    canvas.scroll_into_view_if_needed()
    box = canvas.bounding_box()
    scale = box["width"] / SIZE[0]
    canvas.click(position={"x": (pixel[0] + 0.5) * scale, "y": (pixel[1] + 0.5) * scale})


def idle(page: Any) -> None:
    page.wait_for_function("!ko.dataFor(document.getElementById('moop_setup')).busy()", timeout=120_000)


def test_who_has_set_nothing_up_is_led_to_the_set_up(page: Any) -> None:
    page.wait_for_selector("[data-test-id=moop-not-set-up]")
    page.click("[data-test-id=moop-not-set-up] button")
    page.wait_for_selector("[data-test-id=moop-setup-verdicts] li >> nth=1")
    assert "It is bright enough." in page.inner_text("[data-test-id=moop-setup-verdicts]")


def test_the_bed_and_its_motion_are_asked_for(page: Any) -> None:
    page.click("[data-test-id=moop-next]")
    assert "200 x 200 mm" in page.inner_text("[data-test-id=moop-volume]")
    page.check("[data-test-id=moop-bed-y]")
    page.click("[data-test-id=moop-keep-bed]")
    page.wait_for_selector("[data-test-id=moop-lens-capture]:visible")


def test_nothing_moves_before_the_person_has_agreed(page: Any, bare_server: DemoServer) -> None:
    page.click("[data-test-id=moop-step-bed]")
    before = bare_server.log_text()
    page.click("[data-test-id=moop-try-y]")
    dialog = page.wait_for_selector(".modal:visible:has-text('Move the printer?')")
    assert "Y axis moves 30 mm" in dialog.inner_text() and "Nothing is heated" in dialog.inner_text()
    jogs: list[str] = []
    page.on("request", lambda request: jogs.append(request.url) if "printhead" in request.url else None)
    page.click(".modal:visible a:has-text('Cancel')")
    page.wait_for_timeout(600)
    assert jogs == [] and "jog" not in bare_server.log_text()[len(before) :]


def test_the_lens_is_found_from_pictures_of_a_checkerboard(page: Any, stage: Stage) -> None:
    page.click("[data-test-id=moop-step-lens]")
    idle(page)
    page.click("[data-test-id=moop-lens-capture]")  # there is no board to be seen yet
    page.wait_for_selector("[data-test-id=moop-lens-announced]:has-text('not seen')")
    for number, tilt in enumerate([
        (0.5, 0.0, 0.1, -40, -30), (-0.5, 0.1, 0.0, 45, 35), (0.0, 0.55, -0.1, 50, -35), (0.1, -0.5, 0.2, -50, 30),
        (0.4, 0.4, 0.0, 0, 0), (-0.4, -0.35, 0.1, 20, -20), (0.35, -0.4, -0.2, -55, -40), (-0.3, 0.4, 0.3, 55, 40),
    ]):  # fmt: skip
        stage.tilt = tilt
        idle(page)
        page.click("[data-test-id=moop-lens-capture]")
        page.wait_for_function(
            f"ko.dataFor(document.getElementById('moop_setup')).lens.views().length === {number + 1}", timeout=60_000
        )
    stage.tilt = None
    idle(page)
    page.click("[data-test-id=moop-lens-solve]")
    page.wait_for_selector("[data-test-id=moop-lens-told]:has-text('8 pictures fit to')", timeout=120_000)
    focal_px = page.evaluate("ko.dataFor(document.getElementById('moop_setup')).lens.found().K[0][0]")
    assert focal_px == pytest.approx(690, rel=0.02)


def test_the_cameras_place_is_found_from_four_clicks_and_shown_by_a_grid(
    page: Any, stage: Stage, bare_server: DemoServer
) -> None:
    page.click("[data-test-id=moop-step-place]")
    page.wait_for_timeout(300)
    idle(page)
    for pixel in stage.camera.project(CORNERS):
        click_at(page, "#moop_setup_picture", pixel)
    page.click("[data-test-id=moop-place-points]")
    page.wait_for_selector("[data-test-id=moop-place-found]", timeout=60_000)
    page.wait_for_function("ko.dataFor(document.getElementById('moop_setup')).place.lines().length > 10")
    lines = page.evaluate("ko.dataFor(document.getElementById('moop_setup')).place.lines()")
    ends = np.array([line["px"][index] for line in lines if line["what"] == "bed" for index in (0, -1)])
    for corner in stage.camera.project(CORNERS):
        assert np.linalg.norm(ends - corner, axis=1).min() < 4  # pixels; the clicks are a pixel off themselves
    page.click("[data-test-id=moop-place-keep]")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('place is kept')")
    header = bare_server.api("GET", "/plugin/moop/setup")
    assert header["printer"]["bed_motion"] == "y"
    found = Camera.from_json(header["camera"])
    assert np.linalg.norm(found.centre_mm - stage.camera.centre_mm) < 8
    over_the_bed = np.array([[60, 60, 40], [140, 140, 40], [100, 100, 80]], dtype=float)
    assert np.abs(found.project(over_the_bed) - stage.camera.project(over_the_bed)).max() < 5


def test_going_back_loses_nothing(page: Any) -> None:
    page.click("[data-test-id=moop-step-bed]")
    assert page.is_checked("[data-test-id=moop-bed-y]")
    page.click("[data-test-id=moop-step-lens]")
    assert "8 pictures fit to" in page.inner_text("[data-test-id=moop-lens-told]")


def test_the_marker_plate_is_put_among_the_files(page: Any, bare_server: DemoServer) -> None:
    page.click("[data-test-id=moop-step-place]")
    idle(page)
    page.click("[data-test-id=moop-place-markers]")
    page.click("[data-test-id=moop-make-markers]")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('moop-markers.gcode')", timeout=60_000)
    assert bare_server.request("GET", "/api/files/local/moop-markers.gcode").ok


def test_the_filament_is_clicked_on_and_kept(page: Any, stage: Stage, bare_server: DemoServer) -> None:
    page.click("[data-test-id=moop-step-filament]")
    page.wait_for_selector("#moop_setup_filament .moop-note:has-text('Click on the filament')")
    click_at(page, "#moop_setup_filament .moop-picture", stage.camera.project(np.array([[105.0, 105, 0]]))[0])
    with page.expect_response(lambda answer: answer.url.endswith("/api/settings")):
        page.click("[data-test-id=moop-keep-filament]")
    kept = bare_server.api("GET", "/api/settings")["plugins"]["moop"]
    assert kept["hue_min_deg"] < 115 < kept["hue_max_deg"]  # green: BGR (30, 150, 40)


def test_the_trial_shows_that_everything_is_known(page: Any) -> None:
    page.click("[data-test-id=moop-step-trial]")
    page.wait_for_selector("[data-test-id=moop-trial]")
    idle(page)
    page.wait_for_timeout(300)
    assert "Not yet" not in page.inner_text("[data-test-id=moop-trial]")
    page.click("[data-test-id=moop-finish]")
    page.wait_for_selector("[data-test-id=moop-state-text]:visible")


@pytest.mark.parametrize("step", ["camera", "bed", "lens", "place", "filament", "action", "trial"])
def test_axe_finds_nothing_serious_in_the_set_up(page: Any, axe: str, step: str) -> None:
    page.click("[data-test-id=moop-page-setup]")
    page.click(f"[data-test-id=moop-step-{step}]")
    page.wait_for_timeout(500)
    idle(page)
    assert serious_violations(page, axe, "#tab_plugin_moop") == []
