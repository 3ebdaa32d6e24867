# SPDX-License-Identifier: Apache-2.0
"""Config of a grid of tiles."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from stripe_newton.configclass import MISSING, configclass

from .sub_terrain_cfg import Range, SubTerrainBaseCfg

__all__ = ["TerrainGeneratorCfg"]


@configclass
class TerrainGeneratorCfg:
    """A grid of tiles: rows along x, which are levels of difficulty, columns along y, which are kinds of ground."""

    seed: int | None = None
    """Seed of what is random; ``None`` is 0. A tile depends on it and on its own place alone."""
    curriculum: bool = False
    """Difficulty grows with the row and each column is of one kind; else both are random on every tile."""
    size: Range = MISSING
    """Extent of a tile in x and y [m]."""
    border_width: float = 0.0
    """Width of the ground around all tiles [m]."""
    border_height: float = 1.0
    """With a negative number the ground around is higher by so much than the tiles' edges [m]; else it is level."""
    num_rows: int = 1
    """Rows: levels."""
    num_cols: int = 1
    """Columns: types."""
    color_scheme: str = "none"
    """Accepted for compatibility."""
    horizontal_scale: float = 0.1
    """Distance between two heights [m]."""
    vertical_scale: float = 0.005
    """Heights of the ``Hf...`` kinds are multiples of it [m]."""
    slope_threshold: float | None = 0.75
    """Accepted for compatibility: in a height field a wall is one cell wide."""
    sub_terrains: dict[str, Any] = MISSING
    """Kinds of tiles by name: each a :class:`SubTerrainBaseCfg`."""
    difficulty_range: Range = (0.0, 1.0)
    """Difficulty of the first and the last level."""
    use_cache: bool = False
    """Accepted for compatibility: tiles are made anew each time."""
    cache_dir: str = ""
    """Accepted for compatibility."""

    def problems(self) -> Iterator[tuple[str, str]]:
        for name in ("num_rows", "num_cols"):
            if getattr(self, name) < 1:
                yield name, f"is {getattr(self, name)}, must be 1 or more"
        step = self.horizontal_scale
        if not (math.isfinite(step) and step > 0.0):
            yield "horizontal_scale", f"is {step}, must be positive [m]"
            return
        if not self.vertical_scale >= 0.0:
            yield "vertical_scale", f"is {self.vertical_scale}, must be 0 or more [m]"
        if not (math.isfinite(self.border_width) and self.border_width >= 0.0):
            yield "border_width", f"is {self.border_width}, must be 0 or more [m]"
        lengths = {"border_width": self.border_width}
        if self.size is not MISSING:
            lengths |= {f"size[{i}]": length for i, length in enumerate(self.size)}
        for name, length in lengths.items():
            cells = length / step
            if math.isfinite(cells) and abs(cells - round(cells)) > 1.0e-3:
                yield name, f"is {length} m, must be a multiple of horizontal_scale, {step} m"
        if self.size is not MISSING and not min(self.size) >= 2.0 * step:
            yield "size", f"is {tuple(self.size)}, a tile must have at least two cells of {step} m each way"
        low, high = self.difficulty_range
        if not 0.0 <= low <= high <= 1.0:
            yield "difficulty_range", f"is {(low, high)}, must be (low, high) with 0 <= low <= high <= 1"
        if self.sub_terrains is not MISSING:
            wrong = [k for k, sub in self.sub_terrains.items() if not isinstance(sub, SubTerrainBaseCfg)]
            for kind in wrong:
                yield f"sub_terrains.{kind}", f"is {self.sub_terrains[kind]!r}, must be a SubTerrainBaseCfg"
            if wrong:
                return
            if not self.sub_terrains or not sum(s.proportion for s in self.sub_terrains.values()) > 0.0:
                yield "sub_terrains", "has no kind with a proportion above 0"
            for kind, sub in self.sub_terrains.items() if self.size is not MISSING else ():
                inner = getattr(sub, "platform_width", 0.0) + 2.0 * getattr(sub, "border_width", 0.0)
                if inner > min(self.size):
                    path = f"sub_terrains.{kind}.platform_width"
                    yield path, f"with two borders is {inner:g} m, the tile is {min(self.size):g} m"
            radii = {
                (kind, name): patches.radius
                for kind, sub in self.sub_terrains.items()
                for name, patches in (sub.flat_patch_sampling or {}).items()
                if MISSING not in (patches.patch_radius, self.size)
            }
            for (kind, name), radius in radii.items():
                if 2.0 * radius >= min(self.size):
                    path = f"sub_terrains.{kind}.flat_patch_sampling.{name}.patch_radius"
                    yield path, f"is {radius} m, which no tile has room for"
