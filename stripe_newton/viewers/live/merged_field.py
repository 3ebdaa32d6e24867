# SPDX-License-Identifier: Apache-2.0
"""Merged height field: the triangles of a height field with even squares of cells in one piece, for browsers."""

from __future__ import annotations

import numpy as np

__all__ = ["merged_field"]

_LARGEST = 64
"""Side of the largest square that is tried, in cells."""
_TOLERANCE = 5.0e-4
"""Largest distance of the field from the two triangles of a square [m]: what opens between neighbours is as wide."""


def merged_field(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a height field, with squares of cells that are even in two triangles.

    Args:
        points: The surface, x along the columns and y along the rows [m], shape ``(rows, columns, 3)``.

    Returns:
        Vertices, shape ``(n, 3)``, and faces, counterclockwise seen from above, shape ``(m, 3)``.
    """
    heights = points[..., 2]
    rows, columns = heights.shape
    is_covered = np.zeros((rows - 1, columns - 1), dtype=bool)
    faces = []
    size = _LARGEST
    while size >= 1:
        row, column = _even_squares(heights, is_covered, size)
        for r in range(size):
            for c in range(size):
                is_covered[row + r, column + c] = True
        low, high = row * columns + column, (row + size) * columns + column
        # Cut as the cells themselves are, from (row + 1, column) to (row, column + 1).
        faces.append(np.stack([low, low + size, high], axis=1))
        faces.append(np.stack([low + size, high + size, high], axis=1))
        size //= 2
    used, index = np.unique(np.concatenate(faces), return_inverse=True)
    return points.reshape(-1, 3)[used], index.reshape(-1, 3)


def _even_squares(heights: np.ndarray, is_covered: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
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
        even = np.abs(windows - np.where(x + y <= 1.0, upper, lower)).max(axis=(2, 3)) <= _TOLERANCE
        free &= even
    row, column = np.nonzero(free)
    return row * size, column * size
