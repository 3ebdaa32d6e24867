# SPDX-License-Identifier: Apache-2.0
"""A grid of tiles as one height field."""

from __future__ import annotations

import numpy as np

from .ground import Ground
from .patches import find_flat_patches
from .sub_terrain_cfg import HfTerrainBaseCfg, SubTerrainBaseCfg
from .terrain_generator_cfg import TerrainGeneratorCfg

__all__ = ["TerrainGenerator", "sub_terrain_heights"]


def sub_terrain_heights(cfg: SubTerrainBaseCfg, difficulty: float, rng: np.random.Generator) -> np.ndarray:
    """Heights of one tile [m], shape ``(nrow, ncol)``, rows along y, 0 on its edges.

    Raises:
        ValueError: if the kind's function returns another shape, or what is not finite.
    """
    heights = np.array(cfg.function(difficulty, cfg, rng), dtype=float)
    shape = tuple(round(length / cfg.horizontal_scale) + 1 for length in reversed(cfg.size))
    if heights.shape != shape or not np.isfinite(heights).all():
        name = getattr(cfg.function, "__name__", cfg.function)
        raise ValueError(f"'{name}' returned heights of shape {heights.shape}, must be {shape} and finite")
    heights[[0, -1]] = 0.0
    heights[:, [0, -1]] = 0.0
    return heights


class TerrainGenerator:
    """Makes the tiles.

    The grid is centred on the world's origin; rows lie along x, columns along y. A tile is random by the seed and its
    place in the grid, so it stays the same when others are added.

    Attributes:
        cfg: The config.
        ground: Heights of all tiles and of the border, origins and level patches.
        kinds: Name of each tile's kind, shape ``(num_rows, num_cols)``.
        difficulties: Difficulty of each tile, shape ``(num_rows, num_cols)``.
    """

    def __init__(self, cfg: TerrainGeneratorCfg):
        cfg.validate()
        self.cfg = cfg = cfg.copy()
        names, proportions = list(cfg.sub_terrains), np.array([s.proportion for s in cfg.sub_terrains.values()])
        for sub in cfg.sub_terrains.values():
            sub.size, sub.horizontal_scale = cfg.size, cfg.horizontal_scale
            if isinstance(sub, HfTerrainBaseCfg):
                sub.vertical_scale = cfg.vertical_scale
            sub.validate()
        shares = np.cumsum(proportions / proportions.sum())
        rows, cols, step = cfg.num_rows, cfg.num_cols, cfg.horizontal_scale
        cells_x, cells_y = (round(length / step) for length in cfg.size)
        border = round(cfg.border_width / step)
        heights = np.full(
            (cols * cells_y + 2 * border + 1, rows * cells_x + 2 * border + 1), max(-cfg.border_height, 0.0)
        )
        lower = np.array([-0.5 * rows * cells_x - border, -0.5 * cols * cells_y - border]) * step
        self.kinds, self.difficulties = np.empty((rows, cols), dtype=object), np.zeros((rows, cols))
        origins = np.zeros((rows, cols, 3))
        found: dict[tuple[int, int], dict[str, np.ndarray]] = {}
        for row in range(rows):
            for col in range(cols):
                rng = np.random.default_rng([cfg.seed or 0, row, col])
                share, within = rng.uniform(size=2)
                if cfg.curriculum:
                    share, within = (col + 1.0e-3) / cols, (row + within) / rows
                kind = names[min(int(np.searchsorted(shares, share, side="right")), len(names) - 1)]
                difficulty = cfg.difficulty_range[0] + within * (cfg.difficulty_range[1] - cfg.difficulty_range[0])
                tile = sub_terrain_heights(cfg.sub_terrains[kind], difficulty, rng)
                y, x = border + col * cells_y, border + row * cells_x
                heights[y : y + cells_y + 1, x : x + cells_x + 1] = tile
                own = np.array([0.5 * cells_x * step, 0.5 * cells_y * step, _middle(tile)])
                corner = np.array([lower[0] + x * step, lower[1] + y * step, 0.0])
                origins[row, col] = corner + own
                self.kinds[row, col], self.difficulties[row, col] = kind, difficulty
                found[row, col] = {
                    name: corner
                    + find_flat_patches(tile, step, own, sampling, rng, f"'{kind}', row {row}, column {col}, '{name}'")
                    for name, sampling in (cfg.sub_terrains[kind].flat_patch_sampling or {}).items()
                }
        patches = _gather(found, origins)
        lower_x, lower_y = map(float, lower)
        tile_size = cells_x * step, cells_y * step
        self.ground = Ground(heights, (lower_x, lower_y), (step, step), origins, tile_size, patches, cfg.seed or 0)


def _middle(tile: np.ndarray) -> float:
    """Height in the middle of a tile [m], which is a vertex, or lies between two or on the cut of a cell."""
    nrow, ncol = tile.shape
    row, col = (nrow - 1) // 2, (ncol - 1) // 2
    odd_row, odd_col = 1 - nrow % 2, 1 - ncol % 2
    return float(0.5 * (tile[row + odd_row, col] + tile[row, col + odd_col]))


def _gather(found: dict[tuple[int, int], dict[str, np.ndarray]], origins: np.ndarray) -> dict[str, np.ndarray]:
    """Patches by name, shape ``(rows, cols, most, 3)``: a tile with fewer repeats them, one without has its origin."""
    names = sorted({name for patches in found.values() for name in patches})
    gathered = {}
    for name in names:
        most = max(len(patches[name]) for patches in found.values() if name in patches)
        gathered[name] = np.repeat(origins[:, :, None], most, axis=2)
        for (row, col), patches in found.items():
            if name in patches:
                gathered[name][row, col] = np.resize(patches[name], (most, 3))
    return gathered
