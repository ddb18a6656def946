"""The routes under /plugin/moop/ that look into recordings, and try other settings on them."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import flask
from octoprint.access.permissions import Permissions
from octoprint.plugin import BlueprintPlugin

from ..core.settings import DEFAULTS, read_value
from ..machine import recorder
from ..machine.link import EyeLink
from .routes import body, picture_response

REPLAY_S = 1800.0
THUMBNAIL_S = 20.0
THUMBNAIL_PX = 192
MASKS = ("seen", "expected", "ignored")


class MoopPastApi(BlueprintPlugin):
    """Mixed into the plugin, whose attributes it uses."""

    _bench_eye: EyeLink
    _replay_eye: EyeLink
    _recordings: Path

    @BlueprintPlugin.route("/recordings/<name>/checks", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_past_checks(self, name: str) -> Any:
        """What was concluded live. `id` is the check's place, by which its picture is asked for."""
        try:
            lines = (self._recording(name) / "checks.jsonl").read_text(encoding="utf-8").splitlines()
        except FileNotFoundError:
            lines = []
        checks: list[str] = []  # each by itself: all at once would keep the interpreter's lock for long
        for line in lines:
            try:
                checks.append(json.dumps({**json.loads(line), "id": len(checks)}))
            except ValueError:  # a power cut leaves half a line
                break
        return flask.Response(f'{{"checks": [{", ".join(checks)}]}}', mimetype="application/json")

    @BlueprintPlugin.route("/recordings/<name>/pictures/<int:check_id>/<kind>", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_past_picture(self, name: str, check_id: int, kind: str) -> Any:
        """frame.jpg as it was taken; seen.png, expected.png, ignored.png as the last replay found them."""
        folder = self._recording(name)
        path = _frame(folder, check_id) if kind == "frame.jpg" else self._masks(name) / f"{check_id}.{kind}"
        if kind not in ("frame.jpg", *(f"{mask}.png" for mask in MASKS)) or not path.is_file():
            flask.abort(404, "There is no such picture.")
        return picture_response(path.read_bytes(), "image/jpeg" if kind == "frame.jpg" else "image/png")

    @BlueprintPlugin.route("/recordings/<name>/thumbnail.jpg", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_thumbnail(self, name: str) -> Any:
        """A small picture of how the print ended; made once and kept in the cache."""
        path = _frame(self._recording(name), -1)
        if not path.is_file():
            flask.abort(404, "There is no picture.")
        small = self._recordings.parent / "cache" / "thumbnails" / f"{name}.{path.stem}.jpg"
        try:
            return picture_response(small.read_bytes())
        except OSError:
            pass
        _, blobs = self._bench_eye.ask("shrink", path.read_bytes(), timeout_s=THUMBNAIL_S, width_px=THUMBNAIL_PX)
        with contextlib.suppress(OSError):  # it is drawn anew the next time
            small.parent.mkdir(parents=True, exist_ok=True)
            for other in small.parent.glob("*.jpg"):
                its_name = other.name.rsplit(".", 2)[0]
                if its_name == name or not (self._recordings / its_name).is_dir():
                    other.unlink(missing_ok=True)
            small.write_bytes(blobs[0])
        return picture_response(blobs[0])

    @BlueprintPlugin.route("/recordings/<name>/keep", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_keep(self, name: str) -> Any:
        """Body: {"keep": true}, and it is never removed to make room; false, and it is like the others."""
        keep = body().get("keep")
        if not isinstance(keep, bool):
            flask.abort(400, 'Send {"keep": true} or {"keep": false}.')
        recorder.set_keep(self._recording(name), keep)
        return flask.jsonify(keep=keep)

    @BlueprintPlugin.route("/recordings/<name>/replay", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_replay(self, name: str) -> Any:
        """How far the replay that runs is: `done` of its `of` pictures, by the masks that it has drawn so far."""
        numbers = [int(path.name.partition(".")[0]) for path in self._masks(name).glob("*.png")]
        with contextlib.suppress(OSError), (self._recording(name) / "frames.jsonl").open("rb") as lines:
            return flask.jsonify(done=max(numbers, default=-1) + 1, of=sum(1 for _ in lines))
        return flask.jsonify(done=0, of=0)

    @BlueprintPlugin.route("/recordings/<name>/replay", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_replay(self, name: str) -> Any:
        """What would have happened with other settings. Body: settings by name; those not named are as they are now.

        Looking anew takes minutes of the computer that feeds the printer, which not everybody who may look may spend.
        """
        folder = self._recording(name)
        wanted = {key: read_value(key, value) for key, value in body().items()}
        values = {**{key: getattr(self._moop_settings, key) for key in DEFAULTS}, **wanted}
        _, (found,) = self._replay_eye.ask(
            "replay", timeout_s=REPLAY_S, recording=str(folder), material=self._material(values), settings=values,
            masks=str(self._masks(name)),
        )  # fmt: skip
        return flask.Response(found, mimetype="application/json")

    def _masks(self, name: str) -> Path:
        return self._recordings.parent / "cache" / "replay" / name


def _frame(folder: Path, number: int) -> Path:
    """Path of the recording's frame of that number; the folder itself where there is none, or its name leads out of it.

    Read here and not by `machine.recording`, which loads OpenCV: the server must not.
    """
    try:
        line = (folder / "frames.jsonl").read_text(encoding="utf-8").splitlines()[number]
        path = (folder / str(json.loads(line)["frame"])).resolve()
    except (OSError, ValueError, LookupError, TypeError):
        return folder
    return path if path.parent == (folder / "frames").resolve() else folder
