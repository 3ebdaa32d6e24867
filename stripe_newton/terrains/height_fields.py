# SPDX-License-Identifier: Apache-2.0
"""Heights of the sub-terrains that Isaac Lab makes as height fields: pure functions of NumPy.

Each is ``function(difficulty, cfg, rng)`` and returns heights [m], shape ``(nrow, ncol)``, rows along y.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .shapes import TINY, axes, from_edge, from_middle, interpolate, lerp, perlin, shape_of, window

__all__ = [
    "discrete_obstacles_terrain",
    "perlin_terrain",
    "pyramid_sloped_terrain",
    "pyramid_stairs_terrain",
    "random_uniform_terrain",
    "stepping_stones_terrain",
    "wave_terrain",
]


def _rounded(heights: np.ndarray, cfg: Any) -> np.ndarray:
    step = getattr(cfg, "vertical_scale", 0.0)
    return np.round(heights / step) * step if step > 0.0 else heights


def random_uniform_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Random heights, in steps, interpolated: from ``noise_range[0]`` to a bound that grows to ``noise_range[1]``."""
    low, high = cfg.noise_range[0], lerp(cfg.noise_range, difficulty)
    nrow, ncol = shape_of(cfg)
    spacing = cfg.downsampled_scale or cfg.horizontal_scale
    coarse = [max(2, round((n - 1) * cfg.horizontal_scale / spacing) + 1) for n in (nrow, ncol)]
    levels = int((high - low) / cfg.noise_step + TINY) + 1
    heights = low + cfg.noise_step * rng.integers(0, levels, coarse)
    inside = from_edge(cfg) > cfg.border_width + TINY
    return _rounded(np.where(inside, interpolate(heights, nrow, ncol), 0.0), cfg)


def pyramid_sloped_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """A pyramid with a level top: ``slope`` times the distance from the border."""
    slope = lerp(cfg.slope_range, difficulty) * (-1.0 if cfg.inverted else 1.0)
    reach = 0.5 * (min(cfg.size) - cfg.platform_width) - cfg.border_width
    return _rounded(slope * np.clip(from_edge(cfg) - cfg.border_width, 0.0, max(reach, 0.0)), cfg)


def pyramid_stairs_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Square steps of ``step_width`` up to a platform, or down."""
    height = lerp(cfg.step_height_range, difficulty) * (-1.0 if cfg.inverted else 1.0)
    way = from_edge(cfg) - cfg.border_width
    steps = int((min(cfg.size) - 2.0 * cfg.border_width - cfg.platform_width) / (2.0 * cfg.step_width) + TINY)
    level = np.clip(np.ceil(way / cfg.step_width - 1.0e-4), 0, steps + 1)
    return _rounded(height * level, cfg)


def discrete_obstacles_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Blocks and hollows at random places, of random sizes; none on the platform."""
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
    heights[from_middle(cfg) <= 0.5 * cfg.platform_width + TINY] = 0.0
    heights[from_edge(cfg) <= cfg.border_width + TINY] = 0.0
    return _rounded(heights, cfg)


def wave_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Waves along x and y: ``amplitude / 2 (cos(k y) + sin(k x))``, ``num_waves`` over the tile, level at its edges."""
    amplitude = lerp(cfg.amplitude_range, difficulty)
    x, y = axes(cfg)
    k = 2.0 * np.pi * cfg.num_waves / (np.array(cfg.size) - 2.0 * cfg.border_width)
    heights = 0.5 * amplitude * (np.cos(k[1] * (y - cfg.border_width)) + np.sin(k[0] * (x - cfg.border_width)))
    return _rounded(heights * window(cfg), cfg)


def stepping_stones_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Stones in rows with holes between; the harder, the smaller and the further apart."""
    width = lerp((cfg.stone_width_range[1], cfg.stone_width_range[0]), difficulty)
    gap = lerp(cfg.stone_distance_range, difficulty)
    x, y = axes(cfg)
    heights = np.full(shape_of(cfg), float(cfg.holes_depth))
    start = cfg.border_width + TINY
    rows = np.arange(start, cfg.size[1] - start, width + gap)
    for first_y in rows:
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


def perlin_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Fractal hills: octaves of gradient noise, each with half the wavelength and ``persistence`` times the height."""
    amplitude = lerp(cfg.amplitude_range, difficulty)
    total, heights = 0.0, np.zeros(shape_of(cfg))
    for octave in range(int(cfg.octaves)):
        share = cfg.persistence**octave
        heights += share * perlin(cfg, cfg.wavelength / 2.0**octave, rng)
        total += share
    return _rounded(amplitude * heights / total * window(cfg), cfg)
