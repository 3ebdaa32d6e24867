# SPDX-License-Identifier: Apache-2.0
"""Terrain generator: a grid of tiles as one height field, with levels of difficulty along x and kinds along y."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import NonNegativeFloat, PositiveFloat, PositiveInt, Seed, UnitFloat

from .flat_patches import find_flat_patches
from .ground import Ground
from .sub_terrain import HfTerrainBaseCfg, Range, SubTerrainBaseCfg, sub_terrain_heights

__all__ = ["TerrainGenerator", "TerrainGeneratorCfg"]


@configclass
class TerrainGeneratorCfg:
    """A grid of tiles: rows along x are levels of difficulty, columns along y are kinds of ground."""

    seed: Seed | None = None
    """Seed of everything random; ``None`` is 0. A tile depends on it and on its own place in the grid alone."""
    curriculum: bool = False
    """Difficulty grows with the row and each column is of one kind. Otherwise both are random on every tile."""
    size: Range = MISSING
    """Size of a tile in x and y [m]."""
    border_width: NonNegativeFloat = 0.0
    """Width of the ground around all tiles [m]."""
    border_height: float = 1.0
    """A negative number raises the ground around the tiles above their edges by its magnitude [m]; otherwise it is
    level with them."""
    num_rows: PositiveInt = 1
    """Number of rows (levels)."""
    num_cols: PositiveInt = 1
    """Number of columns (types)."""
    color_scheme: str = "none"
    """Ignored: the ground has the colour of ``TerrainImporterCfg.visual_material``."""
    horizontal_scale: PositiveFloat = 0.1
    """Distance between neighbouring heights [m]."""
    vertical_scale: NonNegativeFloat = 0.005
    """Heights of the ``Hf...`` kinds are multiples of it [m]."""
    slope_threshold: float | None = 0.75
    """Ignored: a wall of a height field is always one cell wide."""
    sub_terrains: dict[str, Any] = MISSING
    """Kinds of tiles by name, each a :class:`SubTerrainBaseCfg`. ``Any`` lets type checkers accept the fields of its
    subclasses: ``cfg.sub_terrains["boxes"].grid_height_range = (0.02, 0.1)``."""
    difficulty_range: tuple[UnitFloat, UnitFloat] = (0.0, 1.0)
    """Difficulty of the first and the last level."""
    use_cache: bool = False
    """Ignored: tiles are generated each time."""
    cache_dir: str = ""
    """Ignored: tiles are generated each time."""

    IGNORED: ClassVar[dict[str, str]] = {
        "color_scheme": "the ground has the colour of TerrainImporterCfg.visual_material",
        "slope_threshold": "a wall of a height field is always one cell wide",
        "use_cache": "tiles are generated each time",
        "cache_dir": "tiles are generated each time",
    }

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from self._length_problems()
        low, high = self.difficulty_range
        if not low <= high:
            yield "difficulty_range", f"is {(low, high)}, must be (low, high) with 0 <= low <= high <= 1"
        if self.sub_terrains is not MISSING:
            yield from self._sub_terrain_problems()

    def _length_problems(self) -> Iterator[tuple[str, str]]:
        step, lengths = self.horizontal_scale, {"border_width": self.border_width}
        if self.size is not MISSING:
            lengths |= {f"size[{i}]": length for i, length in enumerate(self.size)}
        for name, length in lengths.items():
            cells = length / step
            if math.isfinite(cells) and abs(cells - round(cells)) > 1.0e-3:
                yield name, f"is {length} m, must be a multiple of horizontal_scale, {step} m"
        if self.size is not MISSING and not min(self.size) >= 2.0 * step:
            yield "size", f"is {tuple(self.size)}, a tile must have at least two cells of {step} m each way"

    def _sub_terrain_problems(self) -> Iterator[tuple[str, str]]:
        wrong = [k for k, sub in self.sub_terrains.items() if not isinstance(sub, SubTerrainBaseCfg)]
        for kind in wrong:
            yield f"sub_terrains.{kind}", f"is {self.sub_terrains[kind]!r}, must be a SubTerrainBaseCfg"
        if wrong:
            return
        if not self.sub_terrains or not sum(s.proportion for s in self.sub_terrains.values()) > 0.0:
            yield "sub_terrains", "has no kind with a proportion above 0"
        if self.size is MISSING:
            return
        tile = min(self.size)
        for kind, sub in self.sub_terrains.items():
            # Most kinds have a platform and a border, the base has neither.
            inner = getattr(sub, "platform_width", 0.0) + 2.0 * getattr(sub, "border_width", 0.0)
            if inner > tile:
                yield f"sub_terrains.{kind}.platform_width", f"with two borders is {inner:g} m, the tile is {tile:g} m"
            for name, patches in (sub.flat_patch_sampling or {}).items():
                if patches.patch_radius is not MISSING and 2.0 * patches.radius >= tile:
                    path = f"sub_terrains.{kind}.flat_patch_sampling.{name}.patch_radius"
                    yield path, f"is {patches.radius} m, which no tile has room for"


class TerrainGenerator:
    """Generates a grid of tiles as one height field.

    The grid is centred on the world's origin; rows lie along x, columns along y. The random numbers of a tile depend
    on the seed and its place in the grid, so a tile stays the same when others are added.

    Attributes:
        cfg: The config.
        ground: Heights of all tiles and of the border, origins and flat patches.
        kinds: Name of each tile's kind, shape ``(num_rows, num_cols)``.
        difficulties: Difficulty of each tile, shape ``(num_rows, num_cols)``.
    """

    def __init__(self, cfg: TerrainGeneratorCfg):
        cfg.validate()
        self.cfg = cfg = cfg.copy()
        for sub in cfg.sub_terrains.values():
            # The grid's scales apply to all kinds, and a kind's checks depend on them.
            sub.size, sub.horizontal_scale = cfg.size, cfg.horizontal_scale
            if isinstance(sub, HfTerrainBaseCfg):
                sub.vertical_scale = cfg.vertical_scale
            sub.validate()
        rows, cols, step = cfg.num_rows, cfg.num_cols, cfg.horizontal_scale
        cells_x, cells_y = (round(length / step) for length in cfg.size)
        border = round(cfg.border_width / step)
        # Rows of heights lie along y, rows of tiles along x.
        heights = np.full(
            (cols * cells_y + 2 * border + 1, rows * cells_x + 2 * border + 1), max(-cfg.border_height, 0.0)
        )
        lower = np.array([-0.5 * rows * cells_x - border, -0.5 * cols * cells_y - border]) * step
        self.kinds, self.difficulties = np.empty((rows, cols), dtype=object), np.zeros((rows, cols))
        origins = np.zeros((rows, cols, 3))
        found: dict[tuple[int, int], dict[str, np.ndarray]] = {}
        for row, col in np.ndindex(rows, cols):
            rng = np.random.default_rng([cfg.seed or 0, row, col])
            kind, difficulty = self._draw_kind(row, col, rng)
            tile = sub_terrain_heights(cfg.sub_terrains[kind], difficulty, rng)
            # Neighbouring tiles share the heights on their common edge, which are 0 on both.
            y, x = border + col * cells_y, border + row * cells_x
            heights[y : y + cells_y + 1, x : x + cells_x + 1] = tile
            origin = cfg.sub_terrains[kind].origin_height(tile)
            own = np.array([0.5 * cells_x * step, 0.5 * cells_y * step, origin])
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

    def _draw_kind(self, row: int, col: int, rng: np.random.Generator) -> tuple[str, float]:
        """Kind and difficulty of a tile: by its column and row in a curriculum, else random."""
        cfg = self.cfg
        proportions = np.array([s.proportion for s in cfg.sub_terrains.values()])
        shares = np.cumsum(proportions / proportions.sum())
        # Both numbers are drawn either way, so that a tile's own random numbers are the same with a curriculum.
        share, within = rng.uniform(size=2)
        if cfg.curriculum:
            # 1e-3: a column on the bound between two kinds belongs to the second, whatever the sum was rounded to.
            share, within = (col + 1.0e-3) / cfg.num_cols, (row + within) / cfg.num_rows
        index = min(int(np.searchsorted(shares, share, side="right")), len(shares) - 1)
        low, high = cfg.difficulty_range
        return list(cfg.sub_terrains)[index], low + within * (high - low)


def _gather(found: dict[tuple[int, int], dict[str, np.ndarray]], origins: np.ndarray) -> dict[str, np.ndarray]:
    """Patches of all tiles by name, shape ``(rows, cols, most, 3)``.

    A tile with fewer patches than ``most`` repeats them, a tile without any has its origin.
    """
    names = sorted({name for patches in found.values() for name in patches})
    gathered = {}
    for name in names:
        most = max(len(patches[name]) for patches in found.values() if name in patches)
        gathered[name] = np.repeat(origins[:, :, None], most, axis=2)
        for (row, col), patches in found.items():
            if name in patches:
                gathered[name][row, col] = np.resize(patches[name], (most, 3))
    return gathered
