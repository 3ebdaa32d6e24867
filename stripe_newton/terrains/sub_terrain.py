# SPDX-License-Identifier: Apache-2.0
"""Sub-terrain configs: the base of all kinds of tiles, and the heights of one tile."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np

from stripe_newton.configclass import MISSING, configclass

from .flat_patches import FlatPatchSamplingCfg, Range

__all__ = ["HfTerrainBaseCfg", "SubTerrainBaseCfg", "sub_terrain_heights"]

_POSITIVE = (
    "step_width", "grid_width", "num_waves", "num_obstacles", "num_bars", "wavelength", "octaves", "downsampled_scale",
)  # fmt: skip
"""Fields of the kinds of tiles that must be positive."""
_MAY_BE_NEGATIVE = ("noise", "grid_height")
"""Beginnings of the names of ranges that may have negative bounds."""


@configclass
class SubTerrainBaseCfg:
    """Base of the configs of tiles. The edges of a tile are at height 0, so that neighbouring tiles join.

    A kind of your own sets ``function(difficulty, cfg, rng)``: ``difficulty`` goes from 0 to 1 and ``rng`` is a
    ``numpy.random.Generator``. It returns heights [m], shape ``(size[1] / horizontal_scale + 1,
    size[0] / horizontal_scale + 1)``, rows along y. Heights on the edges are set to 0 afterwards.
    """

    function: Callable[..., np.ndarray] = MISSING
    """Function that computes the heights."""
    proportion: float = 1.0
    """Share of the tiles that are of this kind, relative to the other kinds."""
    size: Range = (8.0, 8.0)
    """Size of a tile in x and y [m]. The generator sets it."""
    horizontal_scale: float = 0.1
    """Distance between neighbouring heights [m]. The generator sets it."""
    flat_patch_sampling: dict[str, FlatPatchSamplingCfg] | None = None
    """Flat patches to sample, by name. Terms read ``"init_pos"`` and ``"target"``."""

    def heights(self, difficulty: float, rng: np.random.Generator) -> np.ndarray:
        """Heights of a tile [m], rows along y, made by :attr:`function`."""
        return self.function(difficulty, self, rng)

    def origin_height(self, tile: np.ndarray) -> float:
        """Height of the tile's origin, where robots start [m]: that of its middle.

        It is the height of a vertex, or between two vertices where the number of rows or columns is even.
        """
        nrow, ncol = tile.shape
        row, col = (nrow - 1) // 2, (ncol - 1) // 2
        odd_row, odd_col = 1 - nrow % 2, 1 - ncol % 2
        # In the middle of a cell that is the mean along its diagonal, on which the cell's two triangles meet.
        return float(0.5 * (tile[row + odd_row, col] + tile[row, col + odd_col]))

    def problems(self) -> Iterator[tuple[str, str]]:
        if not (math.isfinite(self.proportion) and self.proportion >= 0.0):
            yield "proportion", f"is {self.proportion}, must be 0 or more"
        if not 0.0 < self.horizontal_scale < math.inf:
            yield "horizontal_scale", f"is {self.horizontal_scale}, must be positive [m]"
        # Subclasses follow one naming scheme, so their ranges and lengths are checked here once.
        for name in type(self).__dataclass_fields__:
            value = getattr(self, name)
            if name.endswith("_range") and value is not MISSING:
                yield from _range_problems(name, value)
            elif name in _POSITIVE and value not in (None, MISSING) and not 0.0 < value < math.inf:
                yield name, f"is {value}, must be positive"


def _range_problems(name: str, value: Range) -> Iterator[tuple[str, str]]:
    if len(value) != 2 or not all(map(math.isfinite, value)):
        yield name, f"is {value}, must be two finite numbers"
    elif not name.startswith(_MAY_BE_NEGATIVE) and min(value) < 0.0:
        yield name, f"is {value}, must not be negative"


@configclass
class HfTerrainBaseCfg(SubTerrainBaseCfg):
    """Base of the configs of tiles whose heights are multiples of ``vertical_scale``."""

    border_width: float = 0.0
    """Width of the level ground along the edges of the tile [m]."""
    vertical_scale: float = 0.005
    """Heights are rounded to multiples of it [m]; 0 switches rounding off. The generator sets it."""
    slope_threshold: float | None = None
    """Ignored: a wall of a height field is always one cell wide."""

    IGNORED: ClassVar[dict[str, str]] = {"slope_threshold": "a wall of a height field is always one cell wide"}


def sub_terrain_heights(cfg: SubTerrainBaseCfg, difficulty: float, rng: np.random.Generator) -> np.ndarray:
    """Heights of one tile [m], shape ``(nrow, ncol)``, rows along y, 0 on the edges.

    Raises:
        ValueError: if the config's function returns another shape, or values that are not finite.
    """
    heights = np.array(cfg.heights(difficulty, rng), dtype=float)
    shape = tuple(round(length / cfg.horizontal_scale) + 1 for length in reversed(cfg.size))
    if heights.shape != shape or not np.isfinite(heights).all():
        name = getattr(cfg.function, "__name__", cfg.function)  # a functools.partial has no name
        raise ValueError(f"'{name}' returned heights of shape {heights.shape}, must be {shape} and finite")
    # Neighbouring tiles share the heights on their common edge.
    heights[[0, -1]] = 0.0
    heights[:, [0, -1]] = 0.0
    return heights
