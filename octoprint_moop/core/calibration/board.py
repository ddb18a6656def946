"""A checkerboard to print on paper, with a bar by which to see whether the printer scaled it."""

from __future__ import annotations

from .chessboard import Board

_MARGIN_SQUARES = 1.0
_BAR_MM = 100.0


def board_svg(board: Board) -> str:
    """SVG in real millimetres: the squares with their white margin, what they are, and a scale bar below.

    Corners are found only where a white margin of a square's width surrounds the squares.
    """
    side = board.square_mm
    margin = _MARGIN_SQUARES * side
    columns, rows = board.columns + 1, board.rows + 1
    bar = min(_BAR_MM, 10.0 * max(1, int(columns * side / 10)))
    width = columns * side + 2 * margin
    height = rows * side + 2 * margin + 14
    squares = "".join(
        f"M{margin + column * side:g} {margin + row * side:g}h{side:g}v{side:g}h{-side:g}z"
        for row in range(rows)
        for column in range(columns)
        if (row + column) % 2 == 0
    )
    y = rows * side + 2 * margin + 3
    ticks = "".join(f"M{margin + at:g} {y - 1.5:g}v3" for at in range(0, int(bar) + 1, 10))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">\n'
        f'<rect width="{width:g}" height="{height:g}" fill="#fff"/>\n'
        f'<path d="{squares}" fill="#000" shape-rendering="crispEdges"/>\n'
        f'<path d="M{margin:g} {y:g}h{bar:g}{ticks}" fill="none" stroke="#000" stroke-width="0.3"/>\n'
        f'<text x="{margin:g}" y="{y + 6:g}" font-family="sans-serif" font-size="3.5">'
        f"{board.columns} x {board.rows} inner corners, {side:g} mm squares. This bar is {bar:g} mm long: if not, "
        "measure a square and give that.</text>\n</svg>\n"
    )
