"""Checkerboards: their size, and their inner corners found in pictures, or the reason why not."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..errors import CalibrationError

_BLURRED_RATIO = 0.3  # of a square's side over which an edge goes from black to white
_ALIKE_RATIO = 0.01  # of the picture's diagonal by which corners differ on average


@dataclass(frozen=True)
class Board:
    """A checkerboard of `columns` x `rows` inner corners (one less than squares) at `square_mm`."""

    columns: int
    rows: int
    square_mm: float

    def __post_init__(self) -> None:
        if not (3 <= self.columns <= 60 and 3 <= self.rows <= 60):
            raise CalibrationError(
                f"A board of {self.columns} x {self.rows} inner corners cannot be used; 3 to 60 each way. "
                "Count the points where four squares meet."
            )
        if not 0.1 <= self.square_mm <= 1000:
            raise CalibrationError(f"Squares of {self.square_mm} mm cannot be used; measure one, 0.1 to 1000 mm.")

    @classmethod
    def parse(cls, corners: str, square_mm: float) -> Board:
        """From "9x6". Raises CalibrationError."""
        match = re.fullmatch(r"\s*(\d{1,4})\s*[xX×*,]\s*(\d{1,4})\s*", corners)
        if match is None:
            raise CalibrationError(f"The board's size {corners!r} is not of the kind 9x6 (inner corners).")
        return cls(int(match[1]), int(match[2]), float(square_mm))

    def points_mm(self) -> np.ndarray:
        """(columns * rows, 3) float64, row by row, z = 0."""
        y, x = np.mgrid[0 : self.rows, 0 : self.columns]
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * self.square_mm


@dataclass(frozen=True, eq=False)
class BoardView:
    """The board in one picture: `corners_px` (columns * rows, 2) float64, in the order of Board.points_mm."""

    name: str
    corners_px: np.ndarray


def find_corners(image: np.ndarray, board: Board) -> np.ndarray | None:
    """(columns * rows, 2) float64 px, in the order of `board.points_mm`; None where the board is not found.

    Two estimates are averaged, as their errors are independent and of about the same size: the sector model of
    findChessboardCornersSB, which suppresses noise, and the gradient's saddle of cornerSubPix, which is unbiased.
    """
    grey = to_grey(image)
    found, corners = cv2.findChessboardCornersSB(
        grey, (board.columns, board.rows), flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    )
    if not found:
        found, corners = cv2.findChessboardCorners(
            grey, (board.columns, board.rows), flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
        )
        if not found:
            return None
    corners = corners.reshape(-1, 2).astype(np.float32)
    window_px = int(np.clip(0.45 * _spacing_px(corners, board), 2, 25))
    saddles = cv2.cornerSubPix(
        cv2.GaussianBlur(grey, (0, 0), 1.0), corners.copy().reshape(-1, 1, 2), (window_px, window_px), (-1, -1),
        (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4),
    ).reshape(-1, 2)  # fmt: skip
    strayed = np.linalg.norm(saddles - corners, axis=1) > 1.5
    return np.where(strayed[:, None], corners, (corners + saddles) / 2).astype(np.float64)


def find_views(
    images: Sequence[tuple[str, np.ndarray]], board: Board
) -> tuple[tuple[int, int], list[BoardView], list[tuple[str, str]]]:
    """The pictures' (width, height), the views that can be used, and (name, reason) for each that cannot.

    Raises CalibrationError where there is no picture, or no board in any of them.
    """
    if not images:
        raise CalibrationError("There are no pictures. Take about 12 of the checkerboard, tilted in different ways.")
    size_px = Counter(picture.shape[1::-1] for _, picture in images).most_common(1)[0][0]
    views: list[BoardView] = []
    rejected: list[tuple[str, str]] = []
    for name, picture in images:
        if picture.shape[1::-1] != size_px:
            sizes = f"{picture.shape[1]} x {picture.shape[0]} px, the others {size_px[0]} x {size_px[1]} px"
            rejected.append((name, sizes))
            continue
        corners_px = find_corners(picture, board)
        why = "no board with that many inner corners found in it" if corners_px is None else ""
        if corners_px is not None:
            why = _blur(picture, corners_px, board) or _like_another(corners_px, views, board, size_px)
        if why or corners_px is None:
            rejected.append((name, why))
        else:
            views.append(BoardView(name, corners_px))
    if not views and all(why.startswith("no board") for _, why in rejected):
        raise CalibrationError(_no_board(images, board))
    return (int(size_px[0]), int(size_px[1])), views, rejected


def to_grey(image: np.ndarray) -> np.ndarray:
    """(H, W) uint8 of a picture that is grey or BGR."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def _spacing_px(corners_px: np.ndarray, board: Board) -> float:
    """The smallest distance of neighbouring corners."""
    grid = corners_px.reshape(board.rows, board.columns, 2)
    return float(min(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min() for axis in (0, 1)))


def _blur(picture: np.ndarray, corners_px: np.ndarray, board: Board) -> str:
    """Why the view is too blurred, or ""."""
    sharpness, _ = cv2.estimateChessboardSharpness(
        to_grey(picture), (board.columns, board.rows), corners_px.astype(np.float32).reshape(-1, 1, 2)
    )
    edge_px, spacing_px = float(np.ravel(sharpness)[0]), _spacing_px(corners_px, board)
    if spacing_px < 6:
        return f"the squares are only {spacing_px:.0f} px wide; bring the board nearer"
    if edge_px > max(_BLURRED_RATIO * spacing_px, 5.0):
        return f"too blurred: edges are {edge_px:.0f} px wide; hold the board still and in focus"
    return ""


def _like_another(corners_px: np.ndarray, views: Sequence[BoardView], board: Board, size_px: Sequence[int]) -> str:
    """Which view this one repeats, or "". A board turned by half counts as the same."""
    limit_px = _ALIKE_RATIO * float(np.hypot(size_px[0], size_px[1]))
    for view in views:
        for other_px in (view.corners_px, view.corners_px[::-1]):
            if np.linalg.norm(corners_px - other_px, axis=1).mean() < limit_px:
                return f"too like {view.name}; move or tilt the board between pictures"
    return ""


def _no_board(images: Sequence[tuple[str, np.ndarray]], board: Board) -> str:
    """What to say where no picture shows the board: perhaps another size is there."""
    near = [(board.columns + dx, board.rows + dy) for dx in (-1, 0, 1) for dy in (-1, 0, 1) if (dx, dy) != (0, 0)]
    for _, picture in images[:3]:
        for columns, rows in sorted((pair for pair in near if min(pair) >= 3), reverse=True):
            if cv2.findChessboardCornersSB(to_grey(picture), (columns, rows))[0]:
                return (
                    f"No picture shows a board with {board.columns} x {board.rows} inner corners, but one shows "
                    f"{columns} x {rows}. Inner corners are one less than squares; give {columns}x{rows}."
                )
    return (
        f"None of the {len(images)} pictures shows a board with {board.columns} x {board.rows} inner corners. Count "
        "the points where four squares meet, show the whole board with its white margin, and light it evenly."
    )
