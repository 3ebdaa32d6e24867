# SPDX-License-Identifier: Apache-2.0
"""Heights of Isaac Lab's sub-terrains, by its formulas, on the grid of a height field.

``Hf...`` kinds are computed in its units: cells of ``horizontal_scale`` and steps of ``vertical_scale``, both truncated
to whole numbers, within a border of at least one cell. ``Mesh...`` kinds are the upper sides of its boxes. A wall is
one cell wide; a height on an edge belongs to the lower side.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stripe_newton.terrains.tile_geometry import TINY, axes, from_edge, from_middle, lerp, shape_of

__all__ = [
    "box_terrain",
    "discrete_obstacles_terrain",
    "flat_terrain",
    "gap_terrain",
    "pit_terrain",
    "pyramid_sloped_terrain",
    "pyramid_stairs_mesh_terrain",
    "pyramid_stairs_terrain",
    "rails_terrain",
    "random_grid_terrain",
    "random_uniform_terrain",
    "star_terrain",
    "stepping_stones_terrain",
    "wave_terrain",
]

Cfg = Any  # the config of the kind: the fields differ
Core = Callable[[float, Cfg, np.random.Generator, tuple[int, int]], np.ndarray]
SECOND_RING = 0.6
"""Place of the second ring of rails, pits and boxes, on the way from the platform to the edge."""


# ---- Hf kinds: heights in steps of the vertical scale, first index along x -------------------------------------------


def _within_border(core: Core) -> Callable[[float, Cfg, np.random.Generator], np.ndarray]:
    """Heights [m], rows along y, of a function that computes steps within the border."""

    def heights(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
        count = [int(length / cfg.horizontal_scale) + 1 for length in cfg.size]
        border = int(cfg.border_width / cfg.horizontal_scale) + 1
        steps = np.zeros(count)
        inner = (count[0] - 2 * border, count[1] - 2 * border)
        steps[border:-border, border:-border] = np.rint(core(difficulty, cfg, rng, inner))
        return np.asarray(steps.T * cfg.vertical_scale)

    heights.__name__, heights.__doc__ = core.__name__, core.__doc__
    return heights


def _platform(cfg: Cfg, count: tuple[int, int]) -> tuple[slice, slice]:
    """Cells of the level square in the middle."""
    side = int(cfg.platform_width / cfg.horizontal_scale)
    return tuple(slice((n - side) // 2, (n + side) // 2) for n in count)  # type: ignore[return-value]  # two


@_within_border
def random_uniform_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator, count: tuple[int, int]) -> np.ndarray:
    """Heights drawn from ``noise_range`` in steps of ``noise_step``, whatever the difficulty.

    They are drawn every ``downsampled_scale`` and interpolated by cubic splines.
    """
    spacing = cfg.downsampled_scale or cfg.horizontal_scale
    low, high, step = (int(h / cfg.vertical_scale) for h in (*cfg.noise_range, cfg.noise_step))
    coarse = [int(n * cfg.horizontal_scale / spacing + TINY) for n in count]
    drawn = rng.choice(np.arange(low, high + step, step), size=coarse)
    if tuple(coarse) == count:
        return np.asarray(drawn)
    from scipy.interpolate import RectBivariateSpline  # for this kind alone

    ends = [n * cfg.horizontal_scale for n in count]
    spline = RectBivariateSpline(*(np.linspace(0.0, end, n) for end, n in zip(ends, coarse, strict=True)), drawn)
    return np.asarray(spline(*(np.linspace(0.0, end, n) for end, n in zip(ends, count, strict=True))))


@_within_border
def pyramid_sloped_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator, count: tuple[int, int]) -> np.ndarray:
    """The product of two ramps, cut off at the height of the platform's corner."""
    slope = lerp(cfg.slope_range, difficulty) * (-1.0 if cfg.inverted else 1.0)
    top = int(slope * count[0] * cfg.horizontal_scale / 2 / cfg.vertical_scale)
    ramps = []
    for n in count:
        middle = n // 2
        ramps.append((middle - np.abs(middle - np.arange(n))) / middle)
    heights = top * ramps[0][:, None] * ramps[1][None, :]
    half = int(cfg.platform_width / cfg.horizontal_scale / 2)
    corner = heights[count[0] // 2 - half, count[1] // 2 - half]
    return np.clip(heights, min(0.0, corner), max(0.0, corner))


@_within_border
def pyramid_stairs_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator, count: tuple[int, int]) -> np.ndarray:
    """Square steps up to the platform, which is what remains of it after the last step, or down to it."""
    rise = int(lerp(cfg.step_height_range, difficulty) * (-1.0 if cfg.inverted else 1.0) / cfg.vertical_scale)
    width, platform = (int(length / cfg.horizontal_scale) for length in (cfg.step_width, cfg.platform_width))
    heights, edge, level = np.zeros(count), 0, 0
    while min(count) - 2 * edge > platform:
        edge, level = edge + width, level + rise
        heights[edge : count[0] - edge, edge : count[1] - edge] = level
    return heights


@_within_border
def discrete_obstacles_terrain(
    difficulty: float, cfg: Cfg, rng: np.random.Generator, count: tuple[int, int]
) -> np.ndarray:
    """Blocks and hollows of random sizes at random places, none on the platform."""
    height = int(lerp(cfg.obstacle_height_range, difficulty) / cfg.vertical_scale)
    low, high = (int(width / cfg.horizontal_scale) for width in cfg.obstacle_width_range)
    heights = np.zeros(count)
    for _ in range(cfg.num_obstacles):
        rise = height
        if cfg.obstacle_height_mode == "choice":
            rise = rng.choice([-height, -height // 2, height // 2, height])
        size = [int(rng.choice(np.arange(low, high, 4))) for _ in count]
        start = [int(rng.choice(np.arange(0, n, 4))) for n in count]
        x, y = (min(s, n - k) for s, n, k in zip(start, count, size, strict=True))
        heights[x : x + size[0], y : y + size[1]] = rise
    heights[_platform(cfg, count)] = 0.0
    return heights


@_within_border
def wave_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator, count: tuple[int, int]) -> np.ndarray:
    """A cosine along y and a sine along x, ``num_waves`` of them along y."""
    amplitude = int(0.5 * lerp(cfg.amplitude_range, difficulty) / cfg.vertical_scale)
    turn = 2.0 * np.pi * cfg.num_waves / count[1]
    x, y = np.arange(count[0])[:, None], np.arange(count[1])[None, :]
    return np.asarray(amplitude * (np.cos(turn * y) + np.sin(turn * x)))


@_within_border
def stepping_stones_terrain(
    difficulty: float, cfg: Cfg, rng: np.random.Generator, count: tuple[int, int]
) -> np.ndarray:
    """Rows of square stones over a pit, each row shifted by a random length."""
    width = int(lerp(tuple(reversed(cfg.stone_width_range)), difficulty) / cfg.horizontal_scale)
    distance = int(lerp(cfg.stone_distance_range, difficulty) / cfg.horizontal_scale)
    highest = int(cfg.stone_height_max / cfg.vertical_scale)
    levels = np.arange(-highest - 1, highest)
    # Rows lie along the shorter side.
    rows, length = (count[1], count[0]) if count[1] >= count[0] else count
    heights = np.full((rows, length), int(cfg.holes_depth / cfg.vertical_scale), dtype=float)
    for row in range(0, rows, width + distance):
        first = int(rng.integers(0, width))
        heights[row : row + width, : max(0, first - distance)] = rng.choice(levels)
        for start in range(first, length, width + distance):
            heights[row : row + width, start : start + width] = rng.choice(levels)
    heights = heights.T if count[1] >= count[0] else heights
    heights[_platform(cfg, count)] = 0.0
    return heights


# ---- Mesh kinds: heights [m], rows along y ---------------------------------------------------------------------------


def flat_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
    """Level ground."""
    return np.zeros(shape_of(cfg))


def pyramid_stairs_mesh_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
    """Rings of steps, and a platform one step above the last of them, or below it."""
    height = lerp(cfg.step_height_range, difficulty) * (-1.0 if cfg.inverted else 1.0)
    inner = min(cfg.size) - 2.0 * cfg.border_width
    rings = int((inner - cfg.platform_width) // (2.0 * cfg.step_width)) + 1
    way = from_edge(cfg) - cfg.border_width
    # Up to rounding, a height on an edge belongs to the step nearer to the border.
    return height * np.clip(np.ceil(way / cfg.step_width - 1.0e-4), 0, rings + 1)


def random_grid_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
    """Square blocks of random heights, around a platform as high as the highest may be."""
    bound = lerp(cfg.grid_height_range, difficulty)
    count = [int(length / cfg.grid_width) for length in cfg.size]
    margin = 0.5 * (cfg.size[0] - min(count) * cfg.grid_width)
    x, y = axes(cfg)
    column, row = (np.ceil((t - margin) / cfg.grid_width - 1.0e-4).astype(int) - 1 for t in (x, y))
    blocks = rng.uniform(-bound, bound, (count[1], count[0]))
    if cfg.holes:
        middle_x, middle_y = (margin + cfg.grid_width * (np.arange(n) + 0.5) for n in count)
        # A block stays if all of it lies in the columns or the rows of the platform.
        reach = 0.5 * (cfg.platform_width + 2.0 * margin) - 0.5 * cfg.grid_width
        far = [abs(m - 0.5 * length) >= reach for m, length in zip((middle_x, middle_y), cfg.size, strict=True)]
        blocks[far[1][:, None] & far[0][None, :]] = -abs(cfg.holes_depth)
    inside = (column >= 0) & (column < count[0]) & (row >= 0) & (row < count[1])
    heights = np.where(inside, blocks[row.clip(0, count[1] - 1), column.clip(0, count[0] - 1)], 0.0)
    heights[from_middle(cfg) <= 0.5 * cfg.platform_width + TINY] = bound
    return heights


def rails_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
    """Two square rails, one at the platform and one farther out; the top of a rail is at least one height wide."""
    height, reach = lerp(cfg.rail_height_range, difficulty), from_middle(cfg)
    heights, step = np.zeros(shape_of(cfg)), cfg.horizontal_scale
    for inner, thickness in zip((cfg.platform_width, _second_side(cfg)), cfg.rail_thickness_range, strict=True):
        first = np.ceil(0.5 * inner / step - TINY) * step
        heights[(reach >= first - TINY) & (reach <= max(first, 0.5 * inner + thickness) + TINY)] = height
    return heights


def pit_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
    """A square pit to climb out of; with ``double_pit`` twice as deep, with a step on the way."""
    depth = lerp(cfg.pit_depth_range, difficulty)
    return -_two_steps(cfg, depth, cfg.double_pit)


def box_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
    """A square block to climb down from; with ``double_box`` twice as high, with a step on the way."""
    return _two_steps(cfg, lerp(cfg.box_height_range, difficulty), cfg.double_box)


def gap_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
    """A ditch around the platform, ``depth`` deep (Isaac Lab's has no ground)."""
    gap, reach = lerp(cfg.gap_width_range, difficulty), from_middle(cfg)
    half = 0.5 * cfg.platform_width
    # Both walls take a cell: a ditch of less than two has a bottom of one height.
    open_to = max(half + gap, half + 2.0 * cfg.horizontal_scale)
    return np.where((reach > half + TINY) & (reach < open_to - TINY), -abs(cfg.depth), 0.0)


def star_terrain(difficulty: float, cfg: Cfg, rng: np.random.Generator) -> np.ndarray:
    """Beams across a pit, through a round platform in its middle."""
    width = lerp(tuple(reversed(cfg.bar_width_range)), difficulty)
    x, y = axes(cfg)
    x, y = x - 0.5 * cfg.size[0], y - 0.5 * cfg.size[1]
    heights = np.where(from_edge(cfg) >= width - TINY, -lerp(cfg.bar_height_range, difficulty), 0.0)
    half = 0.5 * max(width, 1.5 * cfg.horizontal_scale)  # so that no beam falls between two heights
    for index in range(cfg.num_bars):
        angle = np.pi * index / cfg.num_bars
        heights[abs(y * np.cos(angle) - x * np.sin(angle)) <= half + TINY] = 0.0
    heights[x * x + y * y <= (0.5 * cfg.platform_width) ** 2 + TINY] = 0.0
    return heights


def _second_side(cfg: Cfg) -> float:
    """Side of the second ring [m]."""
    return float(cfg.platform_width + SECOND_RING * (min(cfg.size) - cfg.platform_width))


def _two_steps(cfg: Cfg, height: float, double: bool) -> np.ndarray:
    """A square of a height; if ``double`` twice as high, within a wider square of that height."""
    reach = from_middle(cfg)
    heights = np.where(reach <= 0.5 * cfg.platform_width + TINY, 2.0 * height if double else height, 0.0)
    if double:
        around = (reach > 0.5 * cfg.platform_width + TINY) & (reach <= 0.5 * _second_side(cfg) + TINY)
        heights = np.where(around, height, heights)
    return heights
