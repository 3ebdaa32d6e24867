# SPDX-License-Identifier: Apache-2.0
"""Height-field sub-terrains (``Hf...TerrainCfg``): the kinds of tiles that Isaac Lab makes as height fields.

Each kind is a pure NumPy function ``function(difficulty, cfg, rng)`` and its config. The function returns heights [m],
shape ``(nrow, ncol)``, rows along y.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

import numpy as np

from stripe_newton.configclass import MISSING, configclass

from .sub_terrain import HfTerrainBaseCfg, Range
from .tile_geometry import (
    TINY,
    BorderedTile,
    Tile,
    axes,
    from_edge,
    from_middle,
    interpolate,
    lerp,
    perlin,
    shape_of,
    window,
)

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
    "discrete_obstacles_terrain",
    "perlin_terrain",
    "pyramid_sloped_terrain",
    "pyramid_stairs_terrain",
    "random_uniform_terrain",
    "stepping_stones_terrain",
    "wave_terrain",
]


def _rounded(heights: np.ndarray, cfg: Tile) -> np.ndarray:
    """Heights as multiples of ``vertical_scale``; ``Mesh...`` kinds have none and stay as they are."""
    step = cfg.vertical_scale if isinstance(cfg, HfTerrainBaseCfg) else 0.0
    return np.round(heights / step) * step if step > 0.0 else heights


# ---- random heights --------------------------------------------------------------------------------------------------


def random_uniform_terrain(difficulty: float, cfg: HfRandomUniformTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Random heights in steps, interpolated. Their upper bound grows from ``noise_range[0]`` to ``noise_range[1]``."""
    low, high = cfg.noise_range[0], lerp(cfg.noise_range, difficulty)
    nrow, ncol = shape_of(cfg)
    spacing = cfg.downsampled_scale or cfg.horizontal_scale
    # Numbers are drawn on a coarse grid over the tile and interpolated: steps of noise_step become slopes.
    coarse = [max(2, round((n - 1) * cfg.horizontal_scale / spacing) + 1) for n in (nrow, ncol)]
    levels = int((high - low) / cfg.noise_step + TINY) + 1
    heights = low + cfg.noise_step * rng.integers(0, levels, coarse)
    inside = from_edge(cfg) > cfg.border_width + TINY
    return _rounded(np.where(inside, interpolate(heights, nrow, ncol), 0.0), cfg)


@configclass
class HfRandomUniformTerrainCfg(HfTerrainBaseCfg):
    """Random heights."""

    function: Callable[..., np.ndarray] = random_uniform_terrain
    """Function that computes the heights."""
    noise_range: Range = MISSING
    """Lowest and highest height [m]; at difficulty 0 all heights are the lowest."""
    noise_step: float = MISSING
    """Difference between possible heights [m]."""
    downsampled_scale: float | None = None
    """Distance between random heights, with linear interpolation between them [m]. ``None``: every height is random."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.noise_step is not MISSING and not self.noise_step > 0.0:
            yield "noise_step", f"is {self.noise_step}, must be positive [m]"
        if self.noise_range is not MISSING and not self.noise_range[0] <= self.noise_range[1]:
            yield "noise_range", f"is {self.noise_range}, must be (low, high) with low <= high"


# ---- slopes ----------------------------------------------------------------------------------------------------------


def pyramid_sloped_terrain(difficulty: float, cfg: HfPyramidSlopedTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """A pyramid with a level top: ``slope`` times the distance from the border."""
    slope = lerp(cfg.slope_range, difficulty) * (-1.0 if cfg.inverted else 1.0)
    # Beyond this distance from the border lies the platform.
    reach = 0.5 * (min(cfg.size) - cfg.platform_width) - cfg.border_width
    return _rounded(slope * np.clip(from_edge(cfg) - cfg.border_width, 0.0, max(reach, 0.0)), cfg)


@configclass
class HfPyramidSlopedTerrainCfg(HfTerrainBaseCfg):
    """A pyramid with a level top."""

    function: Callable[..., np.ndarray] = pyramid_sloped_terrain
    """Function that computes the heights."""
    slope_range: Range = MISSING
    """Rise over run at difficulty 0 and 1."""
    platform_width: float = 1.0
    """Side of the level top [m]."""
    inverted: bool = False
    """Slope down to the middle instead of up."""


@configclass
class HfInvertedPyramidSlopedTerrainCfg(HfPyramidSlopedTerrainCfg):
    """A hollow with a level bottom."""

    inverted: bool = True
    """Slope down to the middle instead of up."""


# ---- stairs ----------------------------------------------------------------------------------------------------------


class Stairs(BorderedTile, Protocol):
    """Fields of the stairs, ``Hf...`` and ``Mesh...`` alike."""

    step_height_range: Range
    step_width: float
    platform_width: float
    inverted: bool


def pyramid_stairs_terrain(difficulty: float, cfg: Stairs, rng: np.random.Generator) -> np.ndarray:
    """Square steps of ``step_width`` up to a platform, or down to it."""
    height = lerp(cfg.step_height_range, difficulty) * (-1.0 if cfg.inverted else 1.0)
    way = from_edge(cfg) - cfg.border_width
    steps = int((min(cfg.size) - 2.0 * cfg.border_width - cfg.platform_width) / (2.0 * cfg.step_width) + TINY)
    # A height on the edge of a step, up to rounding, belongs to the lower step. The platform is one step higher.
    level = np.clip(np.ceil(way / cfg.step_width - 1.0e-4), 0, steps + 1)
    return _rounded(height * level, cfg)


@configclass
class HfPyramidStairsTerrainCfg(HfTerrainBaseCfg):
    """Stairs on four sides, up to a platform."""

    function: Callable[..., np.ndarray] = pyramid_stairs_terrain
    """Function that computes the heights."""
    step_height_range: Range = MISSING
    """Height of a step at difficulty 0 and 1 [m]."""
    step_width: float = MISSING
    """Depth of a step [m]."""
    platform_width: float = 1.0
    """Smallest side of the platform [m]."""
    inverted: bool = False
    """Stairs down to the platform instead of up."""


@configclass
class HfInvertedPyramidStairsTerrainCfg(HfPyramidStairsTerrainCfg):
    """Stairs on four sides, down to a platform."""

    inverted: bool = True
    """Stairs down to the platform instead of up."""


# ---- obstacles and stones --------------------------------------------------------------------------------------------


def discrete_obstacles_terrain(
    difficulty: float, cfg: HfDiscreteObstaclesTerrainCfg, rng: np.random.Generator
) -> np.ndarray:
    """Blocks and hollows of random sizes at random places, none on the platform."""
    height = lerp(cfg.obstacle_height_range, difficulty)
    x, y = axes(cfg)
    heights = np.zeros(shape_of(cfg))
    low, high = cfg.obstacle_width_range
    for _ in range(int(cfg.num_obstacles)):
        width, length = rng.uniform(low, high, 2)
        first_x, first_y = (rng.uniform(0.0, 1.0, 2) * np.subtract(cfg.size, (width, length))).clip(0.0)
        rise = height * rng.choice((-1.0, -0.5, 0.5, 1.0)) if cfg.obstacle_height_mode == "choice" else height
        over = (x >= first_x) & (x <= first_x + width) & (y >= first_y) & (y <= first_y + length)
        heights[over] = rise
    # Robots start on the platform and cross the border between tiles: both stay level.
    heights[from_middle(cfg) <= 0.5 * cfg.platform_width + TINY] = 0.0
    heights[from_edge(cfg) <= cfg.border_width + TINY] = 0.0
    return _rounded(heights, cfg)


@configclass
class HfDiscreteObstaclesTerrainCfg(HfTerrainBaseCfg):
    """Blocks and hollows at random places."""

    function: Callable[..., np.ndarray] = discrete_obstacles_terrain
    """Function that computes the heights."""
    obstacle_height_mode: str = "choice"
    """``"choice"``: plus or minus the height or half of it; ``"fixed"``: the height."""
    obstacle_width_range: Range = MISSING
    """Smallest and largest width [m]."""
    obstacle_height_range: Range = MISSING
    """Height at difficulty 0 and 1 [m]."""
    num_obstacles: int = MISSING
    """Obstacles per tile."""
    platform_width: float = 1.0
    """Side of the level square in the middle [m]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.obstacle_height_mode not in ("choice", "fixed"):
            yield "obstacle_height_mode", f"is '{self.obstacle_height_mode}', must be 'choice' or 'fixed'"


def stepping_stones_terrain(difficulty: float, cfg: HfSteppingStonesTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Rows of stones with holes between them. With difficulty the stones get smaller and their distance grows."""
    width = lerp((cfg.stone_width_range[1], cfg.stone_width_range[0]), difficulty)
    gap = lerp(cfg.stone_distance_range, difficulty)
    x, y = axes(cfg)
    heights = np.full(shape_of(cfg), float(cfg.holes_depth))
    start = cfg.border_width + TINY
    rows = np.arange(start, cfg.size[1] - start, width + gap)
    for first_y in rows:
        # Each row starts at a random offset, up to one stone outside, so that stones of two rows do not line up.
        first_x = start + rng.uniform(0.0, width + gap) - width
        while first_x < cfg.size[0] - start:
            rise = rng.uniform(-cfg.stone_height_max, cfg.stone_height_max)
            over = (x >= first_x - TINY) & (x <= first_x + width + TINY)
            over = over & (y >= first_y - TINY) & (y <= first_y + width + TINY)
            heights[over] = rise
            first_x += width + gap
    heights[from_middle(cfg) <= 0.5 * cfg.platform_width + TINY] = 0.0
    heights[from_edge(cfg) <= cfg.border_width + TINY] = 0.0
    return _rounded(heights, cfg)


@configclass
class HfSteppingStonesTerrainCfg(HfTerrainBaseCfg):
    """Stones with holes between them."""

    function: Callable[..., np.ndarray] = stepping_stones_terrain
    """Function that computes the heights."""
    stone_height_max: float = MISSING
    """Stones are higher or lower than the platform by up to this [m]."""
    stone_width_range: Range = MISSING
    """Width of stones at difficulty 1 and 0 [m]."""
    stone_distance_range: Range = MISSING
    """Distance between stones at difficulty 0 and 1 [m]."""
    holes_depth: float = -10.0
    """Height of the bottom of the holes [m]."""
    platform_width: float = 1.0
    """Side of the level square in the middle [m]."""


# ---- waves and hills -------------------------------------------------------------------------------------------------


def wave_terrain(difficulty: float, cfg: HfWaveTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Waves along x and y, level at the edges of the tile: ``amplitude / 2 (cos(k y) + sin(k x))``."""
    amplitude = lerp(cfg.amplitude_range, difficulty)
    x, y = axes(cfg)
    k = 2.0 * np.pi * cfg.num_waves / (np.array(cfg.size) - 2.0 * cfg.border_width)
    heights = 0.5 * amplitude * (np.cos(k[1] * (y - cfg.border_width)) + np.sin(k[0] * (x - cfg.border_width)))
    # The window fades the waves out, as neighbouring tiles would meet at different heights.
    return _rounded(heights * window(cfg), cfg)


@configclass
class HfWaveTerrainCfg(HfTerrainBaseCfg):
    """Waves along x and y."""

    function: Callable[..., np.ndarray] = wave_terrain
    """Function that computes the heights."""
    amplitude_range: Range = MISSING
    """Largest height at difficulty 0 and 1 [m]."""
    num_waves: float = 1.0
    """Number of waves across the tile."""


def perlin_terrain(difficulty: float, cfg: HfPerlinTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Fractal hills: octaves of gradient noise, each with half the wavelength and ``persistence`` times the height."""
    amplitude = lerp(cfg.amplitude_range, difficulty)
    total, heights = 0.0, np.zeros(shape_of(cfg))
    for octave in range(int(cfg.octaves)):
        share = cfg.persistence**octave  # divided by their sum below, so that the amplitude stays that of the config
        heights += share * perlin(cfg, cfg.wavelength / 2.0**octave, rng)
        total += share
    return _rounded(amplitude * heights / total * window(cfg), cfg)


@configclass
class HfPerlinTerrainCfg(HfTerrainBaseCfg):
    """Hills of fractal gradient noise."""

    function: Callable[..., np.ndarray] = perlin_terrain
    """Function that computes the heights."""
    amplitude_range: Range = MISSING
    """Largest height at difficulty 0 and 1, approximately [m]."""
    wavelength: float = 2.0
    """Distance between the largest hills [m]."""
    octaves: int = 3
    """Number of octaves: sizes of hills, each half of the one before."""
    persistence: float = 0.5
    """Height of the hills of one octave relative to those of the octave before."""
