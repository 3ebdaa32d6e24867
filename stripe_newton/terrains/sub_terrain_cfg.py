# SPDX-License-Identifier: Apache-2.0
"""What the configs of all sub-terrains share, and how level patches are looked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from stripe_newton.configclass import MISSING, configclass

__all__ = ["FlatPatchSamplingCfg", "HfTerrainBaseCfg", "Range", "SubTerrainBaseCfg"]

Range = tuple[float, float]
"""Lower and upper bound, or the values at difficulty 0 and 1."""


@configclass
class FlatPatchSamplingCfg:
    """Level patches of ground to look for on each tile."""

    num_patches: int = MISSING
    """Patches of a tile; where fewer places are level, some are taken more than once."""
    patch_radius: float | Sequence[float] = MISSING
    """Radius that must be level [m]; of several the largest counts."""
    x_range: Range = (-1.0e6, 1.0e6)
    """Where to look, relative to the tile's origin [m]."""
    y_range: Range = (-1.0e6, 1.0e6)
    """Where to look, relative to the tile's origin [m]."""
    z_range: Range = (-1.0e6, 1.0e6)
    """Heights of patches, relative to the tile's origin [m]."""
    max_height_diff: float = MISSING
    """Greatest difference of height in a patch [m]."""

    @property
    def radius(self) -> float:
        """The largest of ``patch_radius`` [m]."""
        several = isinstance(self.patch_radius, Sequence)
        return float(max(self.patch_radius) if several else self.patch_radius)  # type: ignore[arg-type]

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.num_patches is not MISSING and self.num_patches < 1:
            yield "num_patches", f"is {self.num_patches}, must be 1 or more"
        if self.patch_radius is not MISSING and not (math.isfinite(self.radius) and self.radius > 0.0):
            yield "patch_radius", f"is {self.patch_radius}, must be positive [m]"
        if self.max_height_diff is not MISSING and not self.max_height_diff >= 0.0:
            yield "max_height_diff", f"is {self.max_height_diff}, must be 0 or more [m]"
        for name in ("x_range", "y_range", "z_range"):
            low, high = getattr(self, name)
            if not low <= high:
                yield name, f"is {(low, high)}, must be (low, high) with low <= high"


@configclass
class SubTerrainBaseCfg:
    """One kind of tile. A tile is level 0 along its edges, so that tiles join.

    A kind of one's own gives ``function(difficulty, cfg, rng)``, where difficulty goes from 0 to 1 and ``rng`` is a
    ``numpy.random.Generator``. It returns heights [m], shape ``(size[1] / horizontal_scale + 1,
    size[0] / horizontal_scale + 1)``, rows along y; those on the edges are set to 0.
    """

    function: Callable[..., Any] = MISSING
    """Function that makes the heights."""
    proportion: float = 1.0
    """Share of the tiles, relative to that of the other kinds."""
    size: Range = (8.0, 8.0)
    """Extent of a tile in x and y [m]; the generator sets it."""
    horizontal_scale: float = 0.1
    """Distance between two heights [m]; the generator sets it."""
    flat_patch_sampling: dict[str, FlatPatchSamplingCfg] | None = None
    """Level patches to look for, by name; ``"init_pos"`` and ``"target"`` are read by terms."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not (math.isfinite(self.proportion) and self.proportion >= 0.0):
            yield "proportion", f"is {self.proportion}, must be 0 or more"
        if not 0.0 < self.horizontal_scale < math.inf:
            yield "horizontal_scale", f"is {self.horizontal_scale}, must be positive [m]"
        for name in type(self).__dataclass_fields__:
            value = getattr(self, name)
            if name.endswith("_range") and value is not MISSING:
                if len(value) != 2 or not all(map(math.isfinite, value)):
                    yield name, f"is {value}, must be two finite numbers"
                elif not name.startswith(("noise", "grid_height")) and min(value) < 0.0:
                    yield name, f"is {value}, must not be negative"
            if name in _POSITIVE and value not in (None, MISSING) and not 0.0 < value < math.inf:
                yield name, f"is {value}, must be positive"


_POSITIVE = (
    "step_width", "grid_width", "num_waves", "num_obstacles", "num_bars", "wavelength", "octaves", "downsampled_scale",
)  # fmt: skip


@configclass
class HfTerrainBaseCfg(SubTerrainBaseCfg):
    """A kind of tile whose heights are multiples of ``vertical_scale``."""

    border_width: float = 0.0
    """Level ground about the tile's inside [m]."""
    vertical_scale: float = 0.005
    """Heights are rounded to multiples of it [m]; the generator sets it. 0: not rounded."""
    slope_threshold: float | None = None
    """Accepted for compatibility: in a height field a wall is one cell wide."""
