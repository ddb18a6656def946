"""What all routes share. A route checks its permission, parses, calls, answers; errors become JSON in one place."""

from __future__ import annotations

from typing import Any

import flask


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
