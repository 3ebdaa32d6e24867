# SPDX-License-Identifier: Apache-2.0
"""Heights of the sub-terrains that Isaac Lab makes of boxes: pure functions of NumPy.

Each is ``function(difficulty, cfg, rng)`` and returns heights [m], shape ``(nrow, ncol)``, rows along y. A wall is one
cell wide: the heights on its foot and on its top are neighbours.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .shapes import TINY, axes, from_edge, from_middle, lerp, shape_of

__all__ = [
    "box_terrain",
    "flat_terrain",
    "gap_terrain",
    "pit_terrain",
    "rails_terrain",
    "random_grid_terrain",
    "star_terrain",
]


def flat_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Level ground."""
    return np.zeros(shape_of(cfg))


def random_grid_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Square blocks of random heights within plus and minus ``grid_height_range``; with ``holes`` a cross of them."""
    bound = lerp(cfg.grid_height_range, difficulty)
    x, y = axes(cfg)
    count = [int(size / cfg.grid_width + TINY) for size in cfg.size]
    margin = [0.5 * (size - n * cfg.grid_width) for size, n in zip(cfg.size, count, strict=True)]
    col, row = (np.ceil((t - m) / cfg.grid_width - 1.0e-4).astype(int) - 1 for t, m in zip((x, y), margin, strict=True))
    blocks = rng.uniform(-bound, bound, (count[1], count[0]))
    if cfg.holes:
        middle_x, middle_y = (m + cfg.grid_width * (np.arange(n) + 0.5) for m, n in zip(margin, count, strict=True))
        far_x = abs(middle_x - 0.5 * cfg.size[0]) > 0.5 * cfg.platform_width
        far_y = abs(middle_y - 0.5 * cfg.size[1]) > 0.5 * cfg.platform_width
        blocks[far_y[:, None] & far_x[None, :]] = -abs(cfg.holes_depth)
    inside = (col >= 0) & (col < count[0]) & (row >= 0) & (row < count[1])
    heights = np.where(inside, blocks[row.clip(0, count[1] - 1), col.clip(0, count[0] - 1)], 0.0)
    heights[from_middle(cfg) <= 0.5 * cfg.platform_width + TINY] = 0.0
    return heights


def rails_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Two square rails about the platform, a third and two thirds of the way to the edge; thinner and higher with
    difficulty."""
    thickness = lerp((max(cfg.rail_thickness_range), min(cfg.rail_thickness_range)), difficulty)
    height, reach = lerp(cfg.rail_height_range, difficulty), from_middle(cfg)
    half, spare = 0.5 * cfg.platform_width, 0.5 * (min(cfg.size) - cfg.platform_width)
    heights = np.zeros(shape_of(cfg))
    for share in (1.0 / 3.0, 2.0 / 3.0):
        radius = np.round((half + share * spare) / cfg.horizontal_scale) * cfg.horizontal_scale
        heights[abs(reach - radius) <= 0.5 * thickness + TINY] = height
    return heights


def pit_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """A square pit to climb out of, with ``double_pit`` in two steps."""
    depth, reach = lerp(cfg.pit_depth_range, difficulty), from_middle(cfg)
    half = 0.5 * cfg.platform_width
    heights = np.where(reach <= half + TINY, -depth, 0.0)
    if cfg.double_pit:
        heights = np.where((reach > half + TINY) & (reach <= half + 1.0 + TINY), -0.5 * depth, heights)
    return heights


def box_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """A square block to climb down from, with ``double_box`` in two steps."""
    height, reach = lerp(cfg.box_height_range, difficulty), from_middle(cfg)
    half = 0.5 * cfg.platform_width
    heights = np.where(reach <= half + TINY, height, 0.0)
    if cfg.double_box:
        heights = np.where((reach > half + TINY) & (reach <= half + 1.0 + TINY), 0.5 * height, heights)
    return heights


def gap_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """A ditch about the platform; its opening is a whole number of cells, at least two."""
    gap, reach = lerp(cfg.gap_width_range, difficulty), from_middle(cfg)
    half = round(0.5 * cfg.platform_width / cfg.horizontal_scale) * cfg.horizontal_scale
    opening = max(round(gap / cfg.horizontal_scale), 2) * cfg.horizontal_scale
    return np.where((reach > half + TINY) & (reach < half + opening - TINY), -float(cfg.depth), 0.0)


def star_terrain(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
    """Beams that lead from the platform over a pit, narrower above a deeper pit with difficulty."""
    width = lerp((max(cfg.bar_width_range), min(cfg.bar_width_range)), difficulty)
    depth = lerp(cfg.bar_height_range, difficulty)
    x, y = axes(cfg)
    x, y = x - 0.5 * cfg.size[0], y - 0.5 * cfg.size[1]
    heights = np.where(from_edge(cfg) > cfg.border_width + TINY, -depth, 0.0)
    half = 0.5 * max(width, 1.5 * cfg.horizontal_scale)  # no beam falls between two heights
    for i in range(int(cfg.num_bars)):
        angle = 2.0 * np.pi * i / cfg.num_bars
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        heights[(along >= 0.0) & (abs(across) <= half + TINY)] = 0.0
    heights[from_middle(cfg) <= 0.5 * cfg.platform_width + TINY] = 0.0
    return heights
