"""Drawing that goes on when OpenGL does not: a driver that is updated, a chip that resets, a context that is lost."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Callable

import numpy as np

from ..core.expected.raster import CvRenderer

if TYPE_CHECKING:
    from ..core.expected.views import MaskRenderer

log = logging.getLogger("moop.lasting")


class LastingRenderer:
    """A MaskRenderer that draws with another one, and with OpenCV from its first failure on."""

    def __init__(self, first: MaskRenderer) -> None:
        self._renderer, self.name = first, first.name

    def birth_map(self, *asked: Any, **more: Any) -> np.ndarray:
        """As MaskRenderer says."""
        return self._drawn(lambda renderer: renderer.birth_map(*asked, **more))

    def solid_map(self, *asked: Any, **more: Any) -> np.ndarray:
        """As MaskRenderer says."""
        return self._drawn(lambda renderer: renderer.solid_map(*asked, **more))

    def _drawn(self, draw: Callable[[MaskRenderer], np.ndarray]) -> np.ndarray:
        if isinstance(self._renderer, CvRenderer):
            return draw(self._renderer)
        try:
            return draw(self._renderer)
        except MemoryError:
            raise
        except Exception as error:  # whatever a driver makes of its trouble
            log.warning("%s has failed (%s: %s); OpenCV draws from now on", self.name, type(error).__name__, error)
            self._renderer = CvRenderer()
            self.name = self._renderer.name
            return draw(self._renderer)
