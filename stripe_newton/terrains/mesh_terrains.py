# SPDX-License-Identifier: Apache-2.0
"""Box sub-terrains (``Mesh...TerrainCfg``): the kinds of tiles that Isaac Lab makes as meshes; here height fields too.

Each kind is a pure NumPy function ``function(difficulty, cfg, rng)`` and its config. The function returns heights [m],
shape ``(nrow, ncol)``, rows along y. A wall is one cell wide: the heights at its foot and at its top are neighbours.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stripe_newton.configclass import MISSING, configclass

from .hf_terrains import pyramid_stairs_terrain
from .sub_terrain import Range, SubTerrainBaseCfg
from .tile_geometry import TINY, axes, from_edge, from_middle, lerp, shape_of

__all__ = [
    "MeshBoxTerrainCfg",
    "MeshGapTerrainCfg",
    "MeshInvertedPyramidStairsTerrainCfg",
    "MeshPitTerrainCfg",
    "MeshPlaneTerrainCfg",
    "MeshPyramidStairsTerrainCfg",
    "MeshRailsTerrainCfg",
    "MeshRandomGridTerrainCfg",
    "MeshStarTerrainCfg",
    "box_terrain",
    "flat_terrain",
    "gap_terrain",
    "pit_terrain",
    "rails_terrain",
    "random_grid_terrain",
    "star_terrain",
]


def flat_terrain(difficulty: float, cfg: MeshPlaneTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Level ground."""
    return np.zeros(shape_of(cfg))


@configclass
class MeshPlaneTerrainCfg(SubTerrainBaseCfg):
    """Level ground."""

    function: Callable[..., np.ndarray] = flat_terrain
    """Function that computes the heights."""


@configclass
class MeshPyramidStairsTerrainCfg(SubTerrainBaseCfg):
    """Stairs on four sides, up to a platform."""

    function: Callable[..., np.ndarray] = pyramid_stairs_terrain
    """Function that computes the heights."""
    border_width: float = 0.0
    """Width of the level ground around the stairs [m]."""
    step_height_range: Range = MISSING
    """Height of a step at difficulty 0 and 1 [m]."""
    step_width: float = MISSING
    """Depth of a step [m]."""
    platform_width: float = 1.0
    """Smallest side of the platform [m]."""
    inverted: bool = False
    """Stairs down to the platform instead of up."""


@configclass
class MeshInvertedPyramidStairsTerrainCfg(MeshPyramidStairsTerrainCfg):
    """Stairs on four sides, down to a platform."""

    inverted: bool = True
    """Stairs down to the platform instead of up."""


def random_grid_terrain(difficulty: float, cfg: MeshRandomGridTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Square blocks of random heights within plus and minus ``grid_height_range``.

    With ``holes`` only a cross remains: the blocks in the rows and columns of the platform.
    """
    bound = lerp(cfg.grid_height_range, difficulty)
    x, y = axes(cfg)
    count = [int(size / cfg.grid_width + TINY) for size in cfg.size]
    # Whole blocks, centred; what remains along the edges is level.
    margin = [0.5 * (size - n * cfg.grid_width) for size, n in zip(cfg.size, count, strict=True)]
    # A height on the edge between two blocks, up to rounding, belongs to the lower index.
    col, row = (np.ceil((t - m) / cfg.grid_width - 1.0e-4).astype(int) - 1 for t, m in zip((x, y), margin, strict=True))
    blocks = rng.uniform(-bound, bound, (count[1], count[0]))
    if cfg.holes:
        middle_x, middle_y = (m + cfg.grid_width * (np.arange(n) + 0.5) for m, n in zip(margin, count, strict=True))
        far_x = abs(middle_x - 0.5 * cfg.size[0]) > 0.5 * cfg.platform_width
        far_y = abs(middle_y - 0.5 * cfg.size[1]) > 0.5 * cfg.platform_width
        blocks[far_y[:, None] & far_x[None, :]] = -abs(cfg.holes_depth)
    inside = (col >= 0) & (col < count[0]) & (row >= 0) & (row < count[1])
    heights = np.where(inside, blocks[row.clip(0, count[1] - 1), col.clip(0, count[0] - 1)], 0.0)
    heights[from_middle(cfg) <= 0.5 * cfg.platform_width + TINY] = 0.0  # where robots start
    return heights


@configclass
class MeshRandomGridTerrainCfg(SubTerrainBaseCfg):
    """Square blocks of random heights."""

    function: Callable[..., np.ndarray] = random_grid_terrain
    """Function that computes the heights."""
    grid_width: float = MISSING
    """Side of a block [m]."""
    grid_height_range: Range = MISSING
    """Largest height at difficulty 0 and 1 [m]; blocks are higher or lower by up to this."""
    platform_width: float = 1.0
    """Side of the level square in the middle [m]."""
    holes: bool = False
    """Leave out the blocks that are neither in the rows nor in the columns of the platform."""
    holes_depth: float = 1.0
    """Depth of the holes where blocks are left out [m]."""


def rails_terrain(difficulty: float, cfg: MeshRailsTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Two square rails around the platform, a third and two thirds of the way to the edge.

    With difficulty they get thinner and higher.
    """
    thickness = lerp((max(cfg.rail_thickness_range), min(cfg.rail_thickness_range)), difficulty)
    height, reach = lerp(cfg.rail_height_range, difficulty), from_middle(cfg)
    half, spare = 0.5 * cfg.platform_width, 0.5 * (min(cfg.size) - cfg.platform_width)
    heights = np.zeros(shape_of(cfg))
    for share in (1.0 / 3.0, 2.0 / 3.0):
        # The rail's centre lies on a height, or a thin rail could fall between two of them.
        radius = np.round((half + share * spare) / cfg.horizontal_scale) * cfg.horizontal_scale
        heights[abs(reach - radius) <= 0.5 * thickness + TINY] = height
    return heights


@configclass
class MeshRailsTerrainCfg(SubTerrainBaseCfg):
    """Two square rails around the middle."""

    function: Callable[..., np.ndarray] = rails_terrain
    """Function that computes the heights."""
    rail_thickness_range: Range = MISSING
    """Thickness of the rails [m]; the larger value is for difficulty 0. The top of a rail is whole cells wide."""
    rail_height_range: Range = MISSING
    """Height of the rails at difficulty 0 and 1 [m]."""
    platform_width: float = 1.0
    """Side of the level square in the middle [m]."""


def _platform(height: float, cfg: MeshPitTerrainCfg | MeshBoxTerrainCfg, has_step: bool) -> np.ndarray:
    """A square platform in the middle, if asked for with a step of half its height, one metre wide, around it."""
    reach, half = from_middle(cfg), 0.5 * cfg.platform_width
    heights = np.where(reach <= half + TINY, height, 0.0)
    if has_step:
        heights = np.where((reach > half + TINY) & (reach <= half + 1.0 + TINY), 0.5 * height, heights)
    return heights


def pit_terrain(difficulty: float, cfg: MeshPitTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """A square pit to climb out of; with ``double_pit`` it has two steps."""
    return _platform(-lerp(cfg.pit_depth_range, difficulty), cfg, cfg.double_pit)


@configclass
class MeshPitTerrainCfg(SubTerrainBaseCfg):
    """A square pit to climb out of."""

    function: Callable[..., np.ndarray] = pit_terrain
    """Function that computes the heights."""
    pit_depth_range: Range = MISSING
    """Depth at difficulty 0 and 1 [m]."""
    platform_width: float = 1.0
    """Side of the bottom [m]."""
    double_pit: bool = False
    """Add a step, one metre wide, at half the depth."""


def box_terrain(difficulty: float, cfg: MeshBoxTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """A square block to climb down from; with ``double_box`` it has two steps."""
    return _platform(lerp(cfg.box_height_range, difficulty), cfg, cfg.double_box)


@configclass
class MeshBoxTerrainCfg(SubTerrainBaseCfg):
    """A square block to climb down from."""

    function: Callable[..., np.ndarray] = box_terrain
    """Function that computes the heights."""
    box_height_range: Range = MISSING
    """Height at difficulty 0 and 1 [m]."""
    platform_width: float = 1.0
    """Side of the top [m]."""
    double_box: bool = False
    """Add a step, one metre wide, at half the height."""


def gap_terrain(difficulty: float, cfg: MeshGapTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """A ditch around the platform; its width is a whole number of cells, at least two."""
    gap, reach = lerp(cfg.gap_width_range, difficulty), from_middle(cfg)
    half = round(0.5 * cfg.platform_width / cfg.horizontal_scale) * cfg.horizontal_scale
    # Each wall of the ditch takes a cell, so a ditch of one cell would have no bottom.
    opening = max(round(gap / cfg.horizontal_scale), 2) * cfg.horizontal_scale
    return np.where((reach > half + TINY) & (reach < half + opening - TINY), -float(cfg.depth), 0.0)


@configclass
class MeshGapTerrainCfg(SubTerrainBaseCfg):
    """A ditch around the platform."""

    function: Callable[..., np.ndarray] = gap_terrain
    """Function that computes the heights."""
    gap_width_range: Range = MISSING
    """Width of the ditch at difficulty 0 and 1 [m], rounded to whole cells, at least two."""
    platform_width: float = 1.0
    """Side of the platform [m]."""
    depth: float = 1.0
    """Depth of the ditch [m]."""


def star_terrain(difficulty: float, cfg: MeshStarTerrainCfg, rng: np.random.Generator) -> np.ndarray:
    """Beams that lead from the platform over a pit. With difficulty the beams get narrower and the pit deeper."""
    width = lerp((max(cfg.bar_width_range), min(cfg.bar_width_range)), difficulty)
    depth = lerp(cfg.bar_height_range, difficulty)
    x, y = axes(cfg)
    x, y = x - 0.5 * cfg.size[0], y - 0.5 * cfg.size[1]
    heights = np.where(from_edge(cfg) > cfg.border_width + TINY, -depth, 0.0)
    half = 0.5 * max(width, 1.5 * cfg.horizontal_scale)  # so that no beam falls between two heights
    for i in range(int(cfg.num_bars)):
        angle = 2.0 * np.pi * i / cfg.num_bars
        along, across = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
        heights[(along >= 0.0) & (abs(across) <= half + TINY)] = 0.0
    heights[from_middle(cfg) <= 0.5 * cfg.platform_width + TINY] = 0.0
    return heights


@configclass
class MeshStarTerrainCfg(SubTerrainBaseCfg):
    """Beams that lead from the platform over a pit."""

    function: Callable[..., np.ndarray] = star_terrain
    """Function that computes the heights."""
    num_bars: int = MISSING
    """Number of beams, at equal angles."""
    bar_width_range: Range = MISSING
    """Width of the beams [m]; the larger value is for difficulty 0."""
    bar_height_range: Range = MISSING
    """Height of the beams above the pit at difficulty 0 and 1 [m]."""
    platform_width: float = 1.0
    """Side of the platform [m]."""
    border_width: float = 0.5
    """Width of the level ground around the pit, where the beams end [m]."""
