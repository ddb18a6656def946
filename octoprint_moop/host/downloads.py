"""`GET recordings/<name>.zip`: sent piece by piece.

OctoPrint's server collects the whole answer of a Flask route in memory before it sends the first byte. A recording may be
as large as all the memory that the printer's computer has; so it goes by the server below Flask, as OctoPrint's own
downloads do.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Callable

from octoprint.access.permissions import Permissions
from octoprint.server.util.flask import permission_validator
from octoprint.server.util.tornado import CorsSupportMixin, access_validation_factory
from tornado.ioloop import IOLoop
from tornado.iostream import StreamClosedError
from tornado.web import RequestHandler

from ..core.errors import RecordingError
from ..machine.packing import packed


class RecordingDownload(CorsSupportMixin, RequestHandler):
    """find : the folder of that name; raises RecordingError. may : raises HTTPError where the request has no permission"""

    def initialize(self, find: Callable[[str], Path], may: Callable[[Any], None]) -> None:
        self._find, self._may = find, may

    async def get(self, name: str) -> None:
        """The recording; without its pictures where `?pictures=0`."""
        self._may(self.request)
        try:
            folder = self._find(name)
        except RecordingError as error:
            self.set_status(400)
            self.set_header("Content-Type", "application/json")
            self.finish(json.dumps({"code": error.code, "message": str(error)}))
            return
        self.set_header("Content-Type", "application/zip")
        self.set_header("Content-Disposition", f'attachment; filename="{folder.name}.zip"')
        self.set_header("Cache-Control", "no-store")
        pieces = packed(folder, self.get_query_argument("pictures", "1") != "0")
        try:
            # Read by another thread: this one serves everybody.
            while (piece := await IOLoop.current().run_in_executor(None, next, pieces, None)) is not None:
                self.write(piece)
                await self.flush()
        except StreamClosedError:  # whoever wanted it has gone
            pass
        finally:
            pieces.close()


def recording_route(find: Callable[[str], Path]) -> tuple[str, type, dict[str, Any]]:
    """For OctoPrint's hook octoprint.server.http.routes."""
    from octoprint.server import app  # there when the server asks for its routes

    may = access_validation_factory(app, permission_validator, Permissions.PLUGIN_MOOP_VIEW)
    return r"/recordings/([^/]+)\.zip", RecordingDownload, {"find": find, "may": may}
