# SPDX-License-Identifier: Apache-2.0
"""Spiral grid: origins of the environments on a square grid, wound around the first one."""

from __future__ import annotations

import numpy as np

__all__ = ["spiral_grid"]


def spiral_grid(count: int, spacing: float) -> np.ndarray:
    """Origins on a square grid, wound around the first one.

    The place of an environment depends on its index alone, so what it computes does not change with the number of
    environments; the first one stands at the origin.

    Args:
        count: Number of origins.
        spacing: Distance between neighbours [m].

    Returns:
        Positions [m], shape ``(count, 3)``, float32.
    """
    n = np.arange(count)
    ring = np.ceil((np.sqrt(n + 1) - 1) / 2).astype(int)  # ring r holds (2r-1)^2 ... (2r+1)^2 - 1
    along = n - np.maximum(2 * ring - 1, 0) ** 2
    side, step = np.divmod(along, np.maximum(2 * ring, 1))
    a, b = ring, step - ring + 1
    x = np.select([side == 0, side == 1, side == 2], [a, -b, -a], b)
    y = np.select([side == 0, side == 1, side == 2], [b, a, -b], -a)
    x, y = np.where(ring == 0, 0, x), np.where(ring == 0, 0, y)
    return np.stack([x * spacing, y * spacing, np.zeros(count)], axis=1).astype(np.float32)
