"""The routes under /plugin/moop/ that give a job a mesh to be compared with."""

from __future__ import annotations

import threading
from typing import Any

import flask
from octoprint.access.permissions import Permissions
from octoprint.plugin import BlueprintPlugin

from ..core.errors import MeshError
from ..machine.link import EyeLink
from ..machine.meshes import MOST_BYTES, Meshes
from ..machine.watch import Watch
from .routes import body, sent_file

LOOK_S = 300.0
SHOWN = ("name", "bytes", "triangles", "size_mm", "use", "x_mm", "y_mm", "turn_deg", "layer_height_mm", "notes")
CHOICES = ("use", "x_mm", "y_mm", "turn_deg", "layer_height_mm")


class MoopJobsApi(BlueprintPlugin):
    """Mixed into the plugin, whose attributes it uses. What a mesh file holds is only ever read by the bench's eye.

    Every route is about the job that is selected, unless `origin` and `path` name another.
    """

    _watch: Watch
    _bench_eye: EyeLink
    _meshes: Meshes
    _meshes_lock: threading.Lock

    def body_sizes(self, current: Any, *args: Any, **kwargs: Any) -> list[tuple[str, str, int]]:
        return [("POST", path, MOST_BYTES + 65536) for path in (r"/mesh", r"/calibrate/markers/model")]

    @BlueprintPlugin.route("/mesh", methods=["GET"])
    @Permissions.PLUGIN_MOOP_VIEW.require(403)
    def get_mesh(self) -> Any:
        job = self._wanted_job(flask.request.args)
        return self._told(job)

    @BlueprintPlugin.route("/mesh", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_mesh(self) -> Any:
        """Attach the `file` of a form; it is used from now on, placed by the G-code's bounds."""
        job = self._needed_job(flask.request.values)
        name, stream = sent_file()
        with stream, self._meshes_lock:
            file = self._meshes.store(stream, name)
            try:
                self._keep(job, {"file": file, "name": name, "use": True})
            except MeshError:
                self._meshes.tidy()
                raise
        return self._told(job)

    @BlueprintPlugin.route("/mesh/choice", methods=["POST"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def post_mesh_choice(self) -> Any:
        """Whether the mesh is used, and how it is placed. What is not named stays as it is."""
        wanted = body()
        job = self._needed_job(wanted)
        with self._meshes_lock:
            entry = self._meshes.get(job[0])
            if entry is None:
                raise MeshError("This job has no model. Attach one first.")
            changes = {name: wanted[name] for name in CHOICES if name in wanted}
            if not isinstance(changes.get("use", True), bool):
                flask.abort(400, '"use" must be true or false.')
            self._keep(job, {**entry, **changes})
        return self._told(job)

    @BlueprintPlugin.route("/mesh", methods=["DELETE"])
    @Permissions.PLUGIN_MOOP_CONTROL.require(403)
    def delete_mesh(self) -> Any:
        job = self._needed_job(flask.request.args)
        with self._meshes_lock:
            self._meshes.drop(job[0])
        self._watch.mesh_changed(job[0], None)
        return self._told(job)

    def _keep(self, job: tuple[str, dict[str, str]], entry: dict[str, Any]) -> None:
        """Have the mesh looked at, and keep it for the job. Raises MeshError where it makes no sense."""
        key, named = job
        path = self._path(named)
        mesh = {**{name: entry.get(name) for name in CHOICES}, "path": str(self._meshes.path(entry["file"]))}
        found, _ = self._bench_eye.ask("mesh", timeout_s=LOOK_S, mesh=mesh, job=path)
        self._meshes.put(key, {**entry, **found})
        self._watch.mesh_changed(key, self._mesh_of(key))

    def _told(self, job: tuple[str, dict[str, str]] | None) -> Any:
        entry = None if job is None else self._meshes.get(job[0])
        told = None if entry is None else {name: entry.get(name) for name in SHOWN}
        return flask.jsonify(job=None if job is None else job[1], mesh=told)

    # --- jobs -----------------------------------------------------------------------------------------------------

    def _mesh_of(self, key: str) -> dict[str, Any] | None:
        """What the eye must know of the job's mesh; None where none is to be used."""
        entry = self._meshes.get(key)
        return entry if entry is not None and entry.get("use") else None

    def _job_key(self, origin: str, path: str) -> str:
        """Tells a job from others: by its content, where OctoPrint knows it; a file of the same name may be another."""
        if origin == "local":
            known = self._file_manager.get_metadata("local", path) or {}
            return f"local:{known.get('hash') or path}"
        return f"{origin}:{path}"

    def _wanted_job(self, named: Any) -> tuple[str, dict[str, str]] | None:
        """The job's key, and its origin and path; None where none is named and none is selected."""
        path, origin = named.get("path"), str(named.get("origin") or "local")
        if not path:
            file = (self._printer.get_current_job() or {}).get("file") or {}
            path, origin = file.get("path"), str(file.get("origin") or "local")
        if not path:
            return None
        path = str(path)
        if origin == "local" and not self._exists(path):
            raise MeshError(f"There is no file {path!r}. Select one that there is.")
        return self._job_key(origin, path), {"origin": origin, "path": path}

    def _exists(self, path: str) -> bool:
        try:
            return bool(self._file_manager.file_exists("local", path))
        except ValueError:  # it leads out of the uploads, or is no path at all
            return False

    def _needed_job(self, named: Any) -> tuple[str, dict[str, str]]:
        job = self._wanted_job(named)
        if job is None:
            raise MeshError("No file is selected. Select the one that the model belongs to.")
        return job

    def _path(self, job: dict[str, str]) -> str | None:
        if job["origin"] != "local":
            return None
        return str(self._file_manager.path_on_disk("local", job["path"]))
