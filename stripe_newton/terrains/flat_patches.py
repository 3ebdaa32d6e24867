# SPDX-License-Identifier: Apache-2.0
"""Flat patches: places on a tile where the ground is level, for robots to start at or to go to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import NonNegativeFloat, PositiveFloat, PositiveInt

__all__ = ["FlatPatchSamplingCfg", "Range", "find_flat_patches"]

Range = tuple[float, float]
"""Lower and upper bound, or the values at difficulty 0 and 1."""

_SLACK = 1.0e-6
"""Slack in comparisons, so that rounding excludes no place on a bound [m]."""


@configclass
class FlatPatchSamplingCfg:
    """Flat patches to sample on each tile."""

    num_patches: PositiveInt = MISSING
    """Patches per tile. Where fewer places are level, some are taken more than once."""
    patch_radius: PositiveFloat | Sequence[PositiveFloat] = MISSING
    """Radius that must be level [m]. Of several radii the largest counts."""
    x_range: Range = (-1.0e6, 1.0e6)
    """Range of the x coordinate, relative to the tile's origin [m]."""
    y_range: Range = (-1.0e6, 1.0e6)
    """Range of the y coordinate, relative to the tile's origin [m]."""
    z_range: Range = (-1.0e6, 1.0e6)
    """Range of the height, relative to the tile's origin [m]."""
    max_height_diff: NonNegativeFloat = MISSING
    """Largest height difference within a patch [m]."""

    @property
    def radius(self) -> float:
        """The largest of ``patch_radius`` [m]."""
        several = isinstance(self.patch_radius, Sequence)
        return float(max(self.patch_radius) if several else self.patch_radius)  # type: ignore[arg-type]

    def problems(self) -> Iterator[tuple[str, str]]:
        for name in ("x_range", "y_range", "z_range"):
            low, high = getattr(self, name)
            if not low <= high:
                yield name, f"is {(low, high)}, must be (low, high) with low <= high"


def find_flat_patches(
    heights: np.ndarray,
    cell: float,
    origin: np.ndarray,
    cfg: FlatPatchSamplingCfg,
    rng: np.random.Generator,
    where: str,
) -> np.ndarray:
    """Sample points of a tile that have level ground around them.

    Args:
        heights: Heights of the tile [m], shape ``(nrow, ncol)``.
        cell: Distance between neighbouring heights [m].
        origin: Origin of the tile relative to its corner [m], shape ``(3,)``.
        cfg: Size, number and ranges of the patches.
        rng: Source of random numbers.
        where: Name of the tile for error messages.

    Returns:
        Points relative to the tile's corner [m], shape ``(num_patches, 3)``; all different if there are enough.

    Raises:
        ValueError: if no place is level.
    """
    from scipy.ndimage import maximum_filter, minimum_filter  # takes long to import, and few tiles have patches

    reach = int(np.ceil(cfg.radius / cell - 1.0e-6))
    span = np.arange(-reach, reach + 1)
    # A disc wider by the diagonal of a cell covers each cell that the patch touches, not only those it contains.
    disc = np.hypot(span[:, None], span[None, :]) <= cfg.radius / cell + np.sqrt(2.0)
    rise = maximum_filter(heights, footprint=disc) - minimum_filter(heights, footprint=disc)
    nrow, ncol = heights.shape
    x, y = np.arange(ncol)[None, :] * cell, np.arange(nrow)[:, None] * cell
    good = rise <= cfg.max_height_diff + _SLACK
    for value, (low, high) in (
        (x - origin[0], cfg.x_range),
        (y - origin[1], cfg.y_range),
        (heights - origin[2], cfg.z_range),
    ):
        good = good & (value >= low - _SLACK) & (value <= high + _SLACK)
    # The whole patch must lie on this tile: beyond the edge, the filters have repeated its heights.
    for position, count in ((x, ncol), (y, nrow)):
        good = good & (position >= cfg.radius - _SLACK) & (position <= (count - 1) * cell - cfg.radius + _SLACK)
    rows, cols = np.nonzero(good)
    if not len(rows):
        raise ValueError(
            f"{where}: no place of radius {cfg.radius} m is level to {cfg.max_height_diff} m within its ranges; "
            "allow a greater max_height_diff or a smaller patch_radius"
        )
    # Without repetition while there are enough places; the shape must not depend on how many there are.
    pick = rng.permutation(len(rows))[: cfg.num_patches]
    if len(pick) < cfg.num_patches:
        pick = np.concatenate([pick, rng.integers(0, len(rows), cfg.num_patches - len(pick))])
    rows, cols = rows[pick], cols[pick]
    return np.stack([cols * cell, rows * cell, heights[rows, cols]], axis=1)
