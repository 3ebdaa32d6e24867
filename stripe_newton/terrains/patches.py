# SPDX-License-Identifier: Apache-2.0
"""Level patches of ground on a tile."""

from __future__ import annotations

import numpy as np

from .sub_terrain_cfg import FlatPatchSamplingCfg

__all__ = ["find_flat_patches"]


def find_flat_patches(
    heights: np.ndarray,
    cell: float,
    origin: np.ndarray,
    cfg: FlatPatchSamplingCfg,
    rng: np.random.Generator,
    where: str,
) -> np.ndarray:
    """Points of a tile about which the ground is level.

    Args:
        heights: Heights of the tile [m], shape ``(nrow, ncol)``.
        cell: Distance between two of them [m].
        origin: Where one starts on the tile, from its corner [m], shape ``(3,)``.
        cfg: What to look for.
        rng: Source of random numbers.
        where: What the tile is called in an error.

    Returns:
        Points from the tile's corner [m], shape ``(num_patches, 3)``; different ones as far as there are.

    Raises:
        ValueError: if no place is level.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    reach = int(np.ceil(cfg.radius / cell - 1.0e-6))
    span = np.arange(-reach, reach + 1)
    disc = np.hypot(span[:, None], span[None, :]) <= cfg.radius / cell + np.sqrt(2.0)  # covers the cells it touches
    rise = maximum_filter(heights, footprint=disc) - minimum_filter(heights, footprint=disc)
    nrow, ncol = heights.shape
    x, y = np.arange(ncol)[None, :] * cell, np.arange(nrow)[:, None] * cell
    good = rise <= cfg.max_height_diff + 1.0e-6
    for value, (low, high) in (
        (x - origin[0], cfg.x_range),
        (y - origin[1], cfg.y_range),
        (heights - origin[2], cfg.z_range),
    ):
        good = good & (value >= low - 1.0e-6) & (value <= high + 1.0e-6)
    for position, count in ((x, ncol), (y, nrow)):  # the whole patch lies on the tile
        good = good & (position >= cfg.radius - 1.0e-6) & (position <= (count - 1) * cell - cfg.radius + 1.0e-6)
    rows, cols = np.nonzero(good)
    if not len(rows):
        raise ValueError(
            f"{where}: no place of radius {cfg.radius} m is level to {cfg.max_height_diff} m within its ranges; "
            "allow a greater max_height_diff or a smaller patch_radius"
        )
    pick = rng.permutation(len(rows))[: cfg.num_patches]
    if len(pick) < cfg.num_patches:
        pick = np.concatenate([pick, rng.integers(0, len(rows), cfg.num_patches - len(pick))])
    rows, cols = rows[pick], cols[pick]
    return np.stack([cols * cell, rows * cell, heights[rows, cols]], axis=1)
