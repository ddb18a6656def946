"""What is said to the user about a pose: what is missing, how the camera hangs, why none was found."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..camera import Camera
from .markers import Disc, MarkerPlate

_DOUBTFUL_PX = 1.5  # told standard error, at 640 pixels across


def roll_deg(camera: Camera) -> float:
    """By how much the picture is turned: 0 where the bed's up is the picture's up, 180 for upside down."""
    up = camera.camera_from_room[:3, 2]
    if math.hypot(up[0], up[1]) < 0.1:  # straight from above there is no up
        return 0.0
    return math.degrees(math.atan2(up[0], -up[1]))


def notes_on(camera: Camera, markers: Sequence[int], plate: MarkerPlate, discs: int) -> tuple[str, ...]:
    """What the user should know of a pose. markers : those that were found; discs : all that might have been some."""
    notes = []
    if len(markers) < len(plate.centres_mm):
        lost = [str(marker + 1) for marker in range(len(plate.centres_mm)) if marker not in markers]
        notes.append(
            f"{len(markers)} of {len(plate.centres_mm)} markers were found; missing: {', '.join(lost)}. "
            "The pose is less sure on that side."
        )
    if discs > len(markers):
        notes.append(f"{discs - len(markers)} other things of the marker's colour were left aside.")
    turned = roll_deg(camera)
    if abs(turned) > 150:
        notes.append("The camera hangs upside down; that is well, and known now.")
    elif abs(turned) > 20:
        notes.append(f"The camera is rolled by {turned:.0f} degrees; that is well, and known now.")
    return tuple(notes)


def doubt_of(worst_px: float, width_px: int) -> tuple[str, ...]:
    if worst_px <= _DOUBTFUL_PX * max(1.0, width_px / 640):
        return ()
    return (
        f"The pose is sure only to {worst_px:.1f} px at worst. Show all markers, larger, sharper and evenly lit, to better it.",
    )


def not_found(discs: Sequence[Disc], plate: MarkerPlate) -> str:
    wanted = len(plate.centres_mm)
    if len(discs) < 3:
        return (
            f"Only {len(discs)} of {wanted} markers were found by their colour, and three are needed. Pick the colour "
            "on the picture again, light the bed evenly, or move the camera so that all markers are seen."
        )
    return (
        f"{len(discs)} things of the markers' colour were found, but no three of them lie as the plate's {wanted} "
        "markers do. Check markers.json against the plate, the lens against this camera, and the picture for other "
        "things of that colour."
    )
