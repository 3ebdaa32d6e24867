# SPDX-License-Identifier: Apache-2.0
"""Merged height field: the triangles of a height field with even squares of cells in one piece, for browsers."""

from __future__ import annotations

import numpy as np

__all__ = ["merged_field"]

_LARGEST = 64
"""Side of the largest square that is tried, in cells."""


def merged_field(points: np.ndarray, tolerance: float = 1.0e-3) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a height field, with squares of cells that are even in a few triangles.

    Args:
        points: The surface, x along the columns and y along the rows [m], shape ``(rows, columns, 3)``.
        tolerance: Largest distance of the field from the two triangles of a square [m].

    Returns:
        Vertices, shape ``(n, 3)``, and faces, counterclockwise seen from above, shape ``(m, 3)``. Neighbours share the
        vertices between them, so that nothing shines through.
    """
    heights = points[..., 2]
    rows, columns = heights.shape
    is_covered = np.zeros((rows - 1, columns - 1), dtype=bool)
    is_corner = np.zeros((rows, columns), dtype=bool)
    squares: dict[int, np.ndarray] = {}  # numbers of their first corners, by side
    size = _LARGEST
    while size >= 1:
        row, column = _even_squares(heights, is_covered, size, tolerance)
        for r in range(size):
            for c in range(size):
                is_covered[row + r, column + c] = True
        for r in (0, size):
            for c in (0, size):
                is_corner[row + r, column + c] = True
        squares[size] = row * columns + column
        size //= 2
    faces = np.concatenate([_triangles(low, side, columns, is_corner.reshape(-1)) for side, low in squares.items()])
    used, index = np.unique(faces, return_inverse=True)
    return points.reshape(-1, 3)[used], index.reshape(-1, 3)


def _triangles(low: np.ndarray, size: int, columns: int, is_corner: np.ndarray) -> np.ndarray:
    """Triangles of squares of one size: two, or a fan to all corners of neighbours on their edges."""
    side = np.arange(size)
    # Once around, counterclockwise from the first corner.
    around = np.concatenate([side, size + side * columns, size * columns + size - side, (size - side) * columns])
    edge = low[:, None] + around
    is_met = is_corner[edge]
    is_plain = is_met.sum(axis=1) == 4
    a = low[is_plain]
    b, c, d = a + size, a + size * columns, a + size * columns + size
    # Cut as the cells themselves are, from (row + 1, column) to (row, column + 1).
    plain = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    edge, is_met, middle = edge[~is_plain], is_met[~is_plain], low[~is_plain] + size // 2 * (columns + 1)
    square, place = np.nonzero(is_met)
    if not len(square):
        return plain
    # The next one around the same square; after the last of a square comes its first.
    first = np.concatenate([[True], square[1:] != square[:-1]])
    following = np.append(np.arange(1, len(square)), 0)
    last = np.append(first[1:], True)
    following[last] = np.flatnonzero(first)
    fan = np.stack([middle[square], edge[square, place], edge[square, place[following]]], axis=1)
    return np.concatenate([plain, fan])


def _even_squares(
    heights: np.ndarray, is_covered: np.ndarray, size: int, tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the first cells of squares that two triangles replace and that nothing covers yet."""
    if min(is_covered.shape) < size:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    view = np.lib.stride_tricks.sliding_window_view
    free = ~view(is_covered, (size, size))[::size, ::size].any(axis=(2, 3))
    if size > 1:
        windows = view(heights, (size + 1, size + 1))[::size, ::size]
        a, b, c, d = (windows[..., i, j, None, None] for i in (0, -1) for j in (0, -1))
        y, x = (np.arange(size + 1) / size for _ in range(2))
        y = y[:, None]
        upper = (1.0 - x - y) * a + x * b + y * c  # the triangle at the first corner
        lower = (x + y - 1.0) * d + (1.0 - y) * b + (1.0 - x) * c
        even = np.abs(windows - np.where(x + y <= 1.0, upper, lower)).max(axis=(2, 3)) <= tolerance
        free &= even
    row, column = np.nonzero(free)
    return row * size, column * size
