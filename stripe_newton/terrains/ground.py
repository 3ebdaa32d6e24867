# SPDX-License-Identifier: Apache-2.0
"""Ground: a height field on the host, with the origins and flat patches of its tiles."""

from __future__ import annotations

from dataclasses import dataclass, field

import newton
import numpy as np

__all__ = ["Ground", "surface_height"]


@dataclass
class Ground:
    """A height field along the axes of the world, and where robots start and go on it.

    Heights are those that Newton and MuJoCo use: both store a height as a share of the whole range, in float32.
    """

    heights: np.ndarray
    """World z [m], shape ``(nrow, ncol)``, rows along y, columns along x."""
    lower: tuple[float, float]
    """World x and y of ``heights[0, 0]`` [m]."""
    cell: tuple[float, float]
    """Spacing in x and y [m]."""
    origins: np.ndarray | None = None
    """Origins of the tiles [m], shape ``(levels, types, 3)``; None without tiles."""
    tile: tuple[float, float] = (0.0, 0.0)
    """Size of a tile in x and y [m]."""
    patches: dict[str, np.ndarray] = field(default_factory=dict)
    """Flat patches by name [m], shape ``(levels, types, num_patches, 3)``."""

    seed: int = 0
    """Seed of the levels on which environments start."""

    def __post_init__(self) -> None:
        heights = np.ascontiguousarray(self.heights, dtype=np.float32)
        if heights.ndim != 2 or min(heights.shape) < 2 or not np.isfinite(heights).all():
            raise ValueError(f"heights of shape {heights.shape}: must be finite, at least 2 rows and 2 columns")
        # The heights as given: a field that is exported and read again must be made from the same numbers.
        self.raw = heights
        size_x, size_y = self.size
        nrow, ncol = heights.shape
        self.source = newton.Heightfield(heights, nrow, ncol, hx=0.5 * size_x, hy=0.5 * size_y)
        # Newton's heights after its normalisation to [0, 1], so that lookups agree with contacts to the last bit.
        low, high = self.source.min_z, self.source.max_z
        self.heights = (np.float32(low) + self.source.data * np.float32(high - low)).astype(np.float32)

    @property
    def size(self) -> tuple[float, float]:
        """Extent in x and y [m]."""
        nrow, ncol = self.heights.shape
        return (ncol - 1) * self.cell[0], (nrow - 1) * self.cell[1]

    @property
    def middle(self) -> tuple[float, float]:
        """World x and y of the middle [m]."""
        return self.lower[0] + 0.5 * self.size[0], self.lower[1] + 0.5 * self.size[1]

    def height_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Height at points of the world [m], equal to ``stripe_kernels.terrain.terrain_height``."""
        return surface_height(self.heights, self.lower, self.cell, x, y)


def surface_height(
    heights: np.ndarray, lower: tuple[float, float], cell: tuple[float, float], x: np.ndarray, y: np.ndarray
) -> np.ndarray:
    """Height of the surface that robots stand on [m], float64 of the shape of ``x`` and ``y``.

    Each cell is two triangles, cut from (row + 1, column) to (row, column + 1), as in ``stripe_kernels.terrain``.
    Outside the field, the height of its nearest edge continues.

    Args:
        heights: Heights [m], shape ``(nrow, ncol)``, rows along y, columns along x.
        lower: x and y of ``heights[0, 0]`` [m].
        cell: Spacing in x and y [m].
        x: x of the points [m].
        y: y of the points [m].
    """
    nrow, ncol = heights.shape
    u = np.clip((np.asarray(x, dtype=float) - lower[0]) / cell[0], 0.0, ncol - 1)
    v = np.clip((np.asarray(y, dtype=float) - lower[1]) / cell[1], 0.0, nrow - 1)
    # A point on the upper edge belongs to the last cell, at its end.
    col, row = np.minimum(u.astype(int), ncol - 2), np.minimum(v.astype(int), nrow - 2)
    u, v = u - col, v - row
    near, right, up, far = (heights[row + i, col + j].astype(float) for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)))
    low = near + u * (right - near) + v * (up - near)
    return np.where(u + v <= 1.0, low, far + (1.0 - u) * (up - far) + (1.0 - v) * (right - far))
