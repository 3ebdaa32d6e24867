# SPDX-License-Identifier: Apache-2.0
"""Configs of the sub-terrains that Isaac Lab makes as height fields, under its names."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from stripe_newton.configclass import MISSING, configclass

from . import height_fields
from .sub_terrain_cfg import HfTerrainBaseCfg, Range

__all__ = [
    "HfDiscreteObstaclesTerrainCfg",
    "HfInvertedPyramidSlopedTerrainCfg",
    "HfInvertedPyramidStairsTerrainCfg",
    "HfPerlinTerrainCfg",
    "HfPyramidSlopedTerrainCfg",
    "HfPyramidStairsTerrainCfg",
    "HfRandomUniformTerrainCfg",
    "HfSteppingStonesTerrainCfg",
    "HfWaveTerrainCfg",
]


@configclass
class HfRandomUniformTerrainCfg(HfTerrainBaseCfg):
    """Random heights."""

    function: Callable[..., Any] = height_fields.random_uniform_terrain
    """Function that makes the heights."""
    noise_range: Range = MISSING
    """Least and greatest height [m]; at difficulty 0 all have the least."""
    noise_step: float = MISSING
    """Distance between possible heights [m]."""
    downsampled_scale: float | None = None
    """Distance between random heights, others are interpolated [m]; ``None``: each is random."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.noise_step is not MISSING and not self.noise_step > 0.0:
            yield "noise_step", f"is {self.noise_step}, must be positive [m]"
        if self.noise_range is not MISSING and not self.noise_range[0] <= self.noise_range[1]:
            yield "noise_range", f"is {self.noise_range}, must be (low, high) with low <= high"


@configclass
class HfPyramidSlopedTerrainCfg(HfTerrainBaseCfg):
    """A pyramid with a level top."""

    function: Callable[..., Any] = height_fields.pyramid_sloped_terrain
    """Function that makes the heights."""
    slope_range: Range = MISSING
    """Rise over run at difficulty 0 and 1."""
    platform_width: float = 1.0
    """Side of the level top [m]."""
    inverted: bool = False
    """Down instead of up."""


@configclass
class HfInvertedPyramidSlopedTerrainCfg(HfPyramidSlopedTerrainCfg):
    """A hollow with a level bottom."""

    inverted: bool = True
    """Down instead of up."""


@configclass
class HfPyramidStairsTerrainCfg(HfTerrainBaseCfg):
    """Stairs on four sides, up to a platform."""

    function: Callable[..., Any] = height_fields.pyramid_stairs_terrain
    """Function that makes the heights."""
    step_height_range: Range = MISSING
    """Height of a step at difficulty 0 and 1 [m]."""
    step_width: float = MISSING
    """Depth of a step [m]."""
    platform_width: float = 1.0
    """Least side of the platform [m]."""
    inverted: bool = False
    """Down instead of up."""


@configclass
class HfInvertedPyramidStairsTerrainCfg(HfPyramidStairsTerrainCfg):
    """Stairs on four sides, down to a platform."""

    inverted: bool = True
    """Down instead of up."""


@configclass
class HfDiscreteObstaclesTerrainCfg(HfTerrainBaseCfg):
    """Blocks and hollows at random places."""

    function: Callable[..., Any] = height_fields.discrete_obstacles_terrain
    """Function that makes the heights."""
    obstacle_height_mode: str = "choice"
    """``"choice"``: plus or minus the height or half of it; ``"fixed"``: the height."""
    obstacle_width_range: Range = MISSING
    """Least and greatest width [m]."""
    obstacle_height_range: Range = MISSING
    """Height at difficulty 0 and 1 [m]."""
    num_obstacles: int = MISSING
    """Obstacles of a tile."""
    platform_width: float = 1.0
    """Side of the level square in the middle [m]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.obstacle_height_mode not in ("choice", "fixed"):
            yield "obstacle_height_mode", f"is '{self.obstacle_height_mode}', must be 'choice' or 'fixed'"


@configclass
class HfWaveTerrainCfg(HfTerrainBaseCfg):
    """Waves along x and y."""

    function: Callable[..., Any] = height_fields.wave_terrain
    """Function that makes the heights."""
    amplitude_range: Range = MISSING
    """Greatest height at difficulty 0 and 1 [m]."""
    num_waves: float = 1.0
    """Waves over the tile."""


@configclass
class HfSteppingStonesTerrainCfg(HfTerrainBaseCfg):
    """Stones with holes between."""

    function: Callable[..., Any] = height_fields.stepping_stones_terrain
    """Function that makes the heights."""
    stone_height_max: float = MISSING
    """Stones are higher or lower by up to this [m]."""
    stone_width_range: Range = MISSING
    """Width of stones at difficulty 1 and 0 [m]."""
    stone_distance_range: Range = MISSING
    """Distance between stones at difficulty 0 and 1 [m]."""
    holes_depth: float = -10.0
    """Height of the bottom of the holes [m]."""
    platform_width: float = 1.0
    """Side of the level square in the middle [m]."""


@configclass
class HfPerlinTerrainCfg(HfTerrainBaseCfg):
    """Hills of fractal gradient noise."""

    function: Callable[..., Any] = height_fields.perlin_terrain
    """Function that makes the heights."""
    amplitude_range: Range = MISSING
    """Greatest height at difficulty 0 and 1, about [m]."""
    wavelength: float = 2.0
    """Distance between the largest hills [m]."""
    octaves: int = 3
    """Sizes of hills, each half of the one before."""
    persistence: float = 0.5
    """Height of the hills of a size, as a share of that of the size before."""
