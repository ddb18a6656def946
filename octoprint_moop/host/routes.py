"""What all routes share. A route checks its permission, parses, calls, answers; errors become JSON in one place."""

from __future__ import annotations

from pathlib import Path
from typing import IO, Any

import flask
from octoprint.settings import settings as octoprint_settings

UPLOAD_PREFIX = "octoprint-file-upload-"


def body() -> dict[str, Any]:
    """The request's JSON object; a request without one is answered with 400."""
    data = flask.request.get_json(silent=True)
    if not isinstance(data, dict):
        flask.abort(400, "A JSON object is needed.")
    return data


def picture_response(data: bytes, mimetype: str = "image/jpeg") -> flask.Response:
    """A picture that the browser must not keep: the next one has the same address."""
    response = flask.Response(data, mimetype=mimetype)
    response.headers["Cache-Control"] = "no-store"
    return response


def sent_file() -> tuple[str, IO[bytes]]:
    """The file of a form, with its name. OctoPrint's server has put it on disk and tells where."""
    uploads = octoprint_settings().get(["server", "uploads"], merged=True) or {}
    path = flask.request.form.get(f"file.{uploads.get('pathSuffix', 'path')}")
    name = flask.request.form.get(f"file.{uploads.get('nameSuffix', 'name')}")
    # The server refuses a request that names a path itself; looking twice at which file is read costs nothing.
    if path and name and Path(path).name.startswith(UPLOAD_PREFIX):
        return Path(name).name, open(path, "rb")
    sent = flask.request.files.get("file")
    if sent is None or not sent.filename:
        flask.abort(400, "A form with a `file` is needed.")
    return Path(sent.filename).name, sent.stream
