# SPDX-License-Identifier: Apache-2.0
"""Tile geometry: distances over the grid of a tile, interpolation and smooth noise, for functions of sub-terrains."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

__all__ = [
    "BorderedTile",
    "Tile",
    "axes",
    "from_edge",
    "from_middle",
    "interpolate",
    "lerp",
    "perlin",
    "shape_of",
    "window",
]

TINY = 1.0e-6
"""Slack in comparisons of lengths [m]."""


class Tile(Protocol):
    """The grid of a tile, as every :class:`SubTerrainBaseCfg` has it."""

    size: tuple[float, float]
    horizontal_scale: float


class BorderedTile(Tile, Protocol):
    """A tile with level ground along its edges, as every :class:`HfTerrainBaseCfg` has it."""

    border_width: float


def shape_of(cfg: Tile) -> tuple[int, int]:
    """Rows and columns of a tile's heights."""
    return round(cfg.size[1] / cfg.horizontal_scale) + 1, round(cfg.size[0] / cfg.horizontal_scale) + 1


def axes(cfg: Tile) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the heights along x and y from the tile's corner [m], shapes ``(1, ncol)`` and ``(nrow, 1)``."""
    nrow, ncol = shape_of(cfg)
    return np.linspace(0.0, cfg.size[0], ncol)[None, :], np.linspace(0.0, cfg.size[1], nrow)[:, None]


def from_edge(cfg: Tile) -> np.ndarray:
    """Distance to the nearest edge of the tile [m], shape ``(nrow, ncol)``."""
    x, y = axes(cfg)
    return np.minimum(np.minimum(x, cfg.size[0] - x), np.minimum(y, cfg.size[1] - y))


def from_middle(cfg: Tile) -> np.ndarray:
    """The larger of the distances from the middle along x and y [m], shape ``(nrow, ncol)``."""
    x, y = axes(cfg)
    return np.maximum(abs(x - 0.5 * cfg.size[0]), abs(y - 0.5 * cfg.size[1]))


def lerp(values: Sequence[float], difficulty: float) -> float:
    """Linear interpolation from the first value at difficulty 0 to the second at difficulty 1."""
    return float(values[0] + difficulty * (values[1] - values[0]))


def window(cfg: BorderedTile, blend: float = 0.5) -> np.ndarray:
    """Weights that are 0 within the border and rise smoothly to 1 over ``blend`` metres, shape ``(nrow, ncol)``."""
    s = np.clip((from_edge(cfg) - cfg.border_width) / blend, 0.0, 1.0)
    return np.asarray(s * s * (3.0 - 2.0 * s))  # smoothstep


def interpolate(coarse: np.ndarray, nrow: int, ncol: int) -> np.ndarray:
    """Heights on a finer grid over the same extent, linear between the given ones, shape ``(nrow, ncol)``."""
    rows, cols = np.linspace(0, len(coarse) - 1, nrow), np.linspace(0, coarse.shape[1] - 1, ncol)
    # The last row and column belong to the cell before them: there is none after.
    row, col = rows.astype(int).clip(0, len(coarse) - 2), cols.astype(int).clip(0, coarse.shape[1] - 2)
    v, u = (rows - row)[:, None], (cols - col)[None, :]
    low = coarse[row][:, col] * (1 - u) + coarse[row][:, col + 1] * u
    high = coarse[row + 1][:, col] * (1 - u) + coarse[row + 1][:, col + 1] * u
    return np.asarray(low * (1 - v) + high * v)


def perlin(cfg: Tile, wavelength: float, rng: np.random.Generator) -> np.ndarray:
    """Gradient noise between about -1 and 1, shape ``(nrow, ncol)``.

    Source: K. Perlin, "Improving Noise", 2002: fade ``t^3 (6 t^2 - 15 t + 10)``. The unit gradients are random.
    """
    x, y = axes(cfg)
    u, v = x / wavelength, y / wavelength
    angles = rng.uniform(0.0, 2.0 * np.pi, (int(v.max()) + 2, int(u.max()) + 2))
    # Cell of the noise's grid, and place within it.
    col, row = u.astype(int), v.astype(int)
    fu, fv = u - col, v - row

    def corner(dr: int, dc: int) -> np.ndarray:
        angle = angles[row + dr, col + dc]
        return np.asarray(np.cos(angle) * (fu - dc) + np.sin(angle) * (fv - dr))

    su, sv = (t**3 * (t * (6.0 * t - 15.0) + 10.0) for t in (fu, fv))
    low = corner(0, 0) * (1 - su) + corner(0, 1) * su
    high = corner(1, 0) * (1 - su) + corner(1, 1) * su
    # With unit gradients the sum lies within 1 / sqrt(2) of 0.
    return np.asarray((low * (1 - sv) + high * sv) * np.sqrt(2.0))
