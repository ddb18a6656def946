"""The whole set-up in a real browser and against a real server: from the first start to a calibrated camera, before a
webcam whose place and lens are known to the test, with a checkerboard and ring markers in its world."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh

from octoprint_moop.core.calibration.markers import MarkerPlate
from octoprint_moop.core.camera import Camera
from octoprint_moop.demo import notebook, witness
from octoprint_moop.demo.server import SILENT, DemoServer
from octoprint_moop.demo.webcam import SnapshotServer

from .stage import OCTOPRINT, give_name, serious_violations, show_tab, wait_for_page

SIZE = (640, 480)
CORNERS = np.array([[0, 0, 0], [200, 0, 0], [200, 200, 0], [0, 200, 0]], dtype=float)  # of OctoPrint's default profile
FINER = 4
FILAMENT_BGR = (30, 150, 40)
RING_BGR = (30, 110, 235)


def rectangle(x: float, y: float, width: float, depth: float) -> np.ndarray:
    return np.array([[x, y, 0], [x + width, y, 0], [x + width, y + depth, 0], [x, y + depth, 0]], dtype=float)


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
    """What stands before the webcam: a bed that moves with Y, a piece of filament on it, ring markers once they are
    printed; or a checkerboard held in some way."""

    def __init__(self, notes: Path) -> None:
        self.camera = true_camera()  # in print coordinates while the machine stands at Y 0
        self.notes = notes
        self.tilt: tuple[float, float, float, float, float] | None = None
        self.markers: MarkerPlate | None = None
        self._bed = np.random.default_rng(7).integers(45, 80, (20, 20))
        self._shots = 0

    def jpeg(self) -> bytes:
        self._shots += 1
        picture = np.full((FINER * SIZE[1], FINER * SIZE[0], 3), (150, 160, 165), np.uint8)
        if self.tilt is None:
            _, (_, y, _) = notebook.read(self.notes)
            moved = np.array([0.0, -y, 0.0])
            for row, greys in enumerate(self._bed):
                for column, grey in enumerate(greys):
                    self._fill(picture, rectangle(10 * column, 10 * row, 10, 10) + moved, (int(grey),) * 3)
            self._fill(picture, rectangle(90, 90, 30, 30) + moved, FILAMENT_BGR)
            self._rings(picture, moved)
        else:
            self._board(picture, *self.tilt)
        picture = cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA)  # each pixel sees an area
        noise = np.random.default_rng(self._shots).normal(0, 2, picture.shape)
        noisy = np.clip(picture + noise, 0, 255).astype(np.uint8)
        return bytes(cv2.imencode(".jpg", noisy, [cv2.IMWRITE_JPEG_QUALITY, 95])[1])

    def _rings(self, picture: np.ndarray, moved: np.ndarray) -> None:
        plate = self.markers
        if plate is None:
            return
        for x, y in plate.centres_mm:
            for height, shade in ((0.0, 0.6), (plate.height_mm, 1.0)):  # the side, then the top
                for diameter, colour in (
                    (plate.outer_diameter_mm, tuple(shade * value for value in RING_BGR)),
                    (plate.hole_diameter_mm, (62, 62, 62)),
                ):
                    turn = np.linspace(0, 2 * np.pi, 64, endpoint=False)
                    ring = np.stack(
                        [x + diameter / 2 * np.cos(turn), y + diameter / 2 * np.sin(turn), 0 * turn + height], 1
                    )
                    self._fill(picture, ring + moved, colour)

    def _fill(self, picture: np.ndarray, corners_mm: np.ndarray, colour: Any) -> None:
        along = np.linspace(0, 1, 20)[:-1, None]
        edge = np.concatenate([a + along * (b - a) for a, b in zip(corners_mm, np.roll(corners_mm, -1, axis=0))])
        self._polygon(picture, self.camera.project(edge), colour)

    def _polygon(self, picture: np.ndarray, points_px: np.ndarray, colour: Any) -> None:
        """Filled; fillPoly draws the outline too, a line of the finer picture, which is too much by half of it."""
        finer = (points_px + 0.5) * FINER - 0.5
        cv2.fillPoly(picture, [np.round(finer * 16).astype(np.int32)], colour, shift=4)

    def _board(self, picture: np.ndarray, rx: float, ry: float, rz: float, x: float, y: float) -> None:
        """A 10 x 7 board of 15 mm squares, each square's outline drawn through the lens."""
        rotation = cv2.Rodrigues(np.array([rx, ry, rz]))[0]
        lens = Camera(SIZE, self.camera.K, self.camera.distortion, np.zeros(3), np.zeros(3))

        def fill(x0: float, y0: float, x1: float, y1: float, colour: int) -> None:
            corners = np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0]], float)
            along = np.linspace(0, 1, 6)[:-1, None]
            edge = np.concatenate([a + along * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0))])
            room = edge @ rotation.T + [x, y, 330]
            self._polygon(picture, lens.project(room), (colour,) * 3)

        fill(-90, -67.5, 90, 67.5, 245)
        for column in range(10):
            for row in range(7):
                if (column + row) % 2:
                    fill(-75 + 15 * column, -52.5 + 15 * row, -60 + 15 * column, -37.5 + 15 * row, 15)


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    notes = tmp_path_factory.mktemp("notes") / "notebook"
    notebook.make(notes)
    return Stage(notes)


@pytest.fixture(scope="module")
def new_server(stage: Stage, tmp_path_factory: pytest.TempPathFactory) -> Iterator[DemoServer]:
    """Of somebody who has just installed the plugin."""
    with (
        SnapshotServer(stage.jpeg) as webcam,
        DemoServer(
            tmp_path_factory.mktemp("new"), snapshot_url=webcam.url, octoprint_python=OCTOPRINT,
            # OctoPrint's own assistant has questions of its own, which are not ours to answer.
            settings={"server": {"seenWizards": {"moop": None}}, "plugins": {"_disabled": [*SILENT, "corewizard"]}},
            plugins={"moop_demo_witness": Path(witness.__file__)}, environment={"MOOP_DEMO_WITNESS": str(stage.notes)},
        ) as running,
    ):  # fmt: skip
        yield running


@pytest.fixture(scope="module")
def page(chromium: Any, new_server: DemoServer) -> Iterator[Any]:
    context = chromium.new_context(viewport={"width": 1280, "height": 1600})
    page = context.new_page()
    errors: list[str] = []
    page.on(
        "console",
        lambda message: errors.append(f"{message.text} {message.location}") if message.type == "error" else None,
    )
    page.on("pageerror", lambda error: errors.append(str(error)))
    give_name(page, new_server.url, new_server.user, new_server.password)
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


def setup_says(page: Any, expression: str) -> Any:
    return page.evaluate(f"ko.dataFor(document.getElementById('moop_setup')).{expression}")


def apart_px(found: Camera, truth: Camera) -> np.ndarray:
    """(N,): how far apart both cameras see points on the bed and up to 60 mm above it."""
    x, y, z = np.meshgrid([40, 100, 160], [40, 100, 160], [0, 30, 60])
    over_the_bed = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(float)
    return np.linalg.norm(found.project(over_the_bed) - truth.project(over_the_bed), axis=1)


def test_octoprints_assistant_points_a_new_user_to_the_set_up(page: Any) -> None:
    page.wait_for_selector("#wizard_dialog:visible :text('show it where the camera stands')", timeout=60_000)
    page.click("#wizard_dialog .button-finish")
    page.wait_for_selector("[data-test-id=moop-setup-verdicts]:visible")  # which opens of itself afterwards
    page.reload()  # which OctoPrint wants after its assistant
    wait_for_page(page)
    show_tab(page)
    page.wait_for_selector("[data-test-id=moop-setup-verdicts]:visible")


def test_who_has_set_nothing_up_is_led_to_the_set_up(page: Any) -> None:
    page.click("[data-test-id=moop-page-watch]")
    page.click("[data-test-id=moop-not-set-up] button")
    page.wait_for_selector("[data-test-id=moop-setup-verdicts] li >> nth=1")
    assert "It is bright enough." in page.inner_text("[data-test-id=moop-setup-verdicts]")


def test_the_bed_and_its_motion_are_asked_for(page: Any) -> None:
    page.click("[data-test-id=moop-next]")
    assert "200 x 200 mm" in page.inner_text("[data-test-id=moop-volume]")
    page.check("[data-test-id=moop-bed-fixed]")  # which is wrong: the measurement will tell
    page.click("[data-test-id=moop-keep-bed]")
    page.wait_for_selector("[data-test-id=moop-lens-capture]:visible")


def test_nothing_moves_before_the_person_has_agreed(page: Any, stage: Stage) -> None:
    page.click("[data-test-id=moop-step-bed]")
    idle(page)
    page.click("[data-test-id=moop-home]")
    dialog = page.wait_for_selector(".modal:visible:has-text('Home the printer?')")
    assert "All axes move" in dialog.inner_text() and "Nothing is heated" in dialog.inner_text()
    moves: list[str] = []
    page.on("request", lambda request: moves.append(request.url) if "printhead" in request.url else None)
    page.click(".modal:visible a:has-text('Cancel')")
    page.wait_for_timeout(500)
    assert moves == []
    page.click("[data-test-id=moop-home]")
    page.click(".modal:visible a:has-text('Home it')")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('homing')")


def test_the_lens_is_found_while_both_hands_hold_the_board(page: Any, stage: Stage) -> None:
    page.click("[data-test-id=moop-step-lens]")
    idle(page)
    page.click("[data-test-id=moop-lens-capture]")  # there is no board to be seen yet
    page.wait_for_selector("[data-test-id=moop-lens-announced]:has-text('not seen')")
    idle(page)
    page.click("[data-test-id=moop-lens-live]")
    for number, tilt in enumerate([
        (0.5, 0.0, 0.1, -40, -30), (-0.5, 0.1, 0.0, 45, 35), (0.0, 0.55, -0.1, 50, -35), (0.1, -0.5, 0.2, -50, 30),
        (0.4, 0.4, 0.0, 0, 0), (-0.4, -0.35, 0.1, 20, -20), (0.35, -0.4, -0.2, -55, -40), (-0.3, 0.4, 0.3, 55, 40),
    ]):  # fmt: skip
        stage.tilt = tilt
        page.wait_for_function(
            f"ko.dataFor(document.getElementById('moop_setup')).lens.views().length === {number + 1}", timeout=60_000
        )
    page.wait_for_selector("[data-test-id=moop-lens-announced]:has-text('like this already')")
    page.click("[data-test-id=moop-lens-live]")
    stage.tilt = None
    idle(page)
    page.click("[data-test-id=moop-lens-solve]")
    page.wait_for_selector("[data-test-id=moop-lens-told]:has-text('8 pictures fit to')", timeout=120_000)
    assert "of the picture covered" in page.inner_text("[data-test-id=moop-lens-count]")
    assert setup_says(page, "lens.found().K[0][0]") == pytest.approx(690, rel=0.02)


def test_the_cameras_place_is_found_from_four_clicks_and_shown_by_a_grid(page: Any, stage: Stage) -> None:
    page.click("[data-test-id=moop-step-place]")
    page.wait_for_timeout(300)
    idle(page)
    for pixel in stage.camera.project(CORNERS):
        click_at(page, "#moop_setup_picture", pixel)
    page.click("[data-test-id=moop-place-points]")
    page.wait_for_selector("[data-test-id=moop-place-found]", timeout=60_000)
    told = page.inner_text("[data-test-id=moop-place-found]")
    assert " px, or " in told and " mm, on average" in told
    page.wait_for_function("ko.dataFor(document.getElementById('moop_setup')).place.lines().length > 10")
    lines = setup_says(page, "place.lines()")
    ends = np.array([line["px"][index] for line in lines if line["what"] == "bed" for index in (0, -1)])
    for corner in stage.camera.project(CORNERS):
        assert np.linalg.norm(ends - corner, axis=1).min() < 4  # pixels; the clicks are a pixel off themselves
    found = Camera.from_json(setup_says(page, "place.found()"))
    assert apart_px(found, stage.camera).max() < 5
    page.fill("[data-test-id=moop-calibration-name]", "By hand")
    page.click("[data-test-id=moop-place-keep]")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('place is kept')")


def test_what_was_begun_is_still_there_when_one_goes_back_and_when_the_page_is_loaded_anew(page: Any) -> None:
    page.click("[data-test-id=moop-step-lens]")
    assert "8 pictures fit to" in page.inner_text("[data-test-id=moop-lens-told]")
    page.click("[data-test-id=moop-step-place]")
    assert setup_says(page, "place.clicked().length") == 4
    idle(page)
    page.reload()
    wait_for_page(page)
    show_tab(page)
    page.wait_for_selector("[data-test-id=moop-place-points]:visible")  # the step that was left
    page.wait_for_function("ko.dataFor(document.getElementById('moop_setup')).lens.views().length === 8")
    assert setup_says(page, "place.clicked().length") == 4
    idle(page)


def test_the_markers_are_made_printed_and_give_the_right_place(page: Any, stage: Stage, new_server: DemoServer) -> None:
    page.click("[data-test-id=moop-place-markers]")
    with page.expect_response("**/calibrate/markers") as made:
        page.click("[data-test-id=moop-make-markers]")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('moop-markers.gcode')", timeout=60_000)
    assert new_server.request("GET", "/api/files/local/moop-markers.gcode").ok
    stage.markers = MarkerPlate.from_json(made.value.json()["markers"])  # they are printed now
    idle(page)
    page.click("[data-test-id=moop-find-markers]")
    page.wait_for_selector("[data-test-id=moop-place-found]", timeout=120_000)
    found = Camera.from_json(setup_says(page, "place.found()"))
    off_px = apart_px(found, stage.camera)
    assert off_px.mean() < 1.0 and off_px.max() < 2.0


def test_a_model_comes_back_with_markers_around_it(page: Any, tmp_path: Path) -> None:
    idle(page)
    (tmp_path / "cube.stl").write_bytes(trimesh.creation.box(extents=(20, 20, 20)).export(file_type="stl"))
    page.click("[data-test-id=moop-markers-model] summary")
    page.set_input_files("[data-test-id=moop-markers-model-file]", tmp_path / "cube.stl")
    with page.expect_download() as download:
        page.click("[data-test-id=moop-markers-model-get]", timeout=60_000)
    download.value.save_as(tmp_path / "marked.stl")
    marked = trimesh.load(tmp_path / "marked.stl")
    assert marked.body_count == 5 and marked.bounds[1][2] == pytest.approx(20)


def test_the_beds_motion_is_measured_once_the_person_has_agreed(page: Any, stage: Stage) -> None:
    idle(page)
    page.click("[data-test-id=moop-place-measure]")
    dialog = page.wait_for_selector(".modal:visible:has-text('Move the printer?')")
    assert "Z moves from 0 to 30 mm, Y from 0 to 60 mm" in dialog.inner_text()
    page.click(".modal:visible a:has-text('Cancel')")
    page.wait_for_timeout(500)
    assert notebook.read(stage.notes)[1] == (0, 0, 0)
    page.click("[data-test-id=moop-place-measure]")
    page.click(".modal:visible a:has-text('Move it')")
    page.wait_for_selector(
        "[data-test-id=moop-place-found]:has-text('Measured: the bed moves forwards')", timeout=90_000
    )
    assert notebook.read(stage.notes)[1] == (0, 0, 0)  # moved back


def test_the_wizard_ends_with_the_right_camera(page: Any, stage: Stage, new_server: DemoServer) -> None:
    idle(page)
    page.fill("[data-test-id=moop-calibration-name]", "With markers")
    page.click("[data-test-id=moop-place-keep]")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('place is kept')")
    header = new_server.api("GET", "/plugin/moop/setup")
    assert header["printer"]["bed_motion"] == "y" and header["printer"]["bed_reference_mm"]["y"] == 0
    assert header["calibration"]["name"] == "With markers" and header["calibration"]["error_px"]["mean"] < 2
    off_px = apart_px(Camera.from_json(header["camera"]), stage.camera)
    assert off_px.mean() < 1.0 and off_px.max() < 2.0


def test_calibrations_are_named_reverted_exported_and_taken_over(
    page: Any, new_server: DemoServer, tmp_path: Path
) -> None:
    page.click("[data-test-id=moop-kept] summary")
    page.wait_for_selector("[data-test-id=moop-kept-name] >> nth=1")
    names = [field.input_value() for field in page.locator("[data-test-id=moop-kept-name]").all()]
    assert names == ["With markers", "By hand"]
    with page.expect_download() as download:
        page.locator("[data-test-id=moop-kept-export]").first.click()
    download.value.save_as(tmp_path / "exported.json")
    page.click("[data-test-id=moop-kept-revert]")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('from before')")
    assert new_server.api("GET", "/plugin/moop/setup")["calibration"]["name"] == "By hand"
    page.set_input_files("[data-test-id=moop-kept-import]", tmp_path / "exported.json")
    page.wait_for_selector("[data-test-id=moop-setup-saved]:has-text('in the file')")
    assert new_server.api("GET", "/plugin/moop/setup")["calibration"]["name"] == "With markers"
    page.locator("[data-test-id=moop-kept-name]").first.fill("On the shelf")
    page.keyboard.press("Tab")
    page.wait_for_function(
        "ko.dataFor(document.getElementById('moop_setup')).kept.calibrations()[0].name === 'On the shelf'"
    )


def test_a_webcam_whose_settings_have_changed_since_is_told(page: Any, new_server: DemoServer) -> None:
    new_server.api("POST", "/api/settings", json={"plugins": {"classicwebcam": {"flipH": True}}})
    page.click("[data-test-id=moop-step-filament]")
    page.click("[data-test-id=moop-step-place]")
    page.wait_for_selector("[data-test-id=moop-setup-stale]:has-text('flip horizontally')")
    new_server.api("POST", "/api/settings", json={"plugins": {"classicwebcam": {"flipH": False}}})
    page.click("[data-test-id=moop-step-filament]")
    page.click("[data-test-id=moop-step-place]")
    page.wait_for_selector("[data-test-id=moop-setup-stale]", state="detached")


def test_the_filament_is_clicked_on_and_kept(page: Any, stage: Stage, new_server: DemoServer) -> None:
    idle(page)
    page.click("[data-test-id=moop-step-filament]")
    page.wait_for_selector("#moop_setup_filament .moop-note:has-text('Click on the filament')")
    click_at(page, "#moop_setup_filament .moop-picture", stage.camera.project(np.array([[105.0, 105, 0]]))[0])
    page.wait_for_selector("#moop_setup_filament [data-test-id=moop-filament-share]:has-text('counts as filament')")
    with page.expect_response(lambda answer: answer.url.endswith("/api/settings")):
        page.click("[data-test-id=moop-keep-filament]")
    kept = new_server.api("GET", "/api/settings")["plugins"]["moop"]
    assert kept["hue_min_deg"] < 115 < kept["hue_max_deg"]  # green: BGR (30, 150, 40)


def test_what_is_done_at_a_failure_is_chosen(page: Any, new_server: DemoServer) -> None:
    page.click("[data-test-id=moop-step-action]")
    page.check("input[name=moop_on_failed][value=notify]")
    with page.expect_response(lambda answer: answer.url.endswith("/api/settings")):
        page.click("[data-test-id=moop-keep-action]")
    assert new_server.api("GET", "/api/settings")["plugins"]["moop"]["on_failed"] == "notify"


def test_the_trial_shows_that_everything_is_known(page: Any) -> None:
    page.click("[data-test-id=moop-step-trial]")
    page.wait_for_function(
        "!document.querySelector('[data-test-id=moop-trial]').innerText.includes('Not yet')", timeout=20_000
    )
    idle(page)
    page.click("[data-test-id=moop-finish]")
    page.wait_for_selector("[data-test-id=moop-state-text]:visible")
    assert not page.is_visible("[data-test-id=moop-not-set-up]")


@pytest.mark.parametrize("step", ["camera", "bed", "lens", "place", "filament", "action", "trial"])
def test_axe_finds_nothing_serious_in_the_set_up(page: Any, axe: str, step: str) -> None:
    page.click("[data-test-id=moop-page-setup]")
    page.click(f"[data-test-id=moop-step-{step}]")
    page.wait_for_timeout(500)
    idle(page)
    assert serious_violations(page, axe, "#tab_plugin_moop") == []
