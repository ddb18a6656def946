"""From the bytes of a G-code file to the beads that it lays."""

from .read import read_gcode

__all__ = ["read_gcode"]
