# SPDX-License-Identifier: Apache-2.0
"""Many scenes on one ground: tiles that get harder level by level, each made from a spec and a seed of its own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stripe_newton.terrains import Ground

from .asset_mesh import MeshPart
from .asset_spec import AssetInstance, AssetSpec
from .places import Places
from .scene_spec import SceneSpec
from .terrain_instance import TerrainInstance

__all__ = ["TileGridSpec"]

Tile = tuple[int, int]


@dataclass(eq=False)
class _TiledTerrain(TerrainInstance):
    """The whole ground, and the tiles in frames of their own."""

    tiles: dict[Tile, TerrainInstance] = field(default_factory=dict)
    shifts: dict[Tile, np.ndarray] = field(default_factory=dict)


class _TileAssets(AssetSpec):
    """What the specs of one name put on the tiles."""

    def __init__(self, name: str, levels: Sequence[SceneSpec]):
        super().__init__(name)
        self._specs = [level.palette.get(name) for level in levels]

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterable[AssetInstance]:
        assert isinstance(terrain, _TiledTerrain)
        seed = int(rng.integers(1 << 63))
        for (level, kind), tile in terrain.tiles.items():
            own = np.random.default_rng([seed, level, kind])
            spec = self._specs[level]
            if spec is None:
                continue
            tile.placed[self.name] = list(spec.generate(tile, own))
            x, y = terrain.shifts[level, kind]
            for one in tile.placed[self.name]:
                place = (one.position[0] + x, one.position[1] + y, one.position[2])
                yield replace(one, name=f"{one.name}_l{level}_t{kind}", position=place)


class TileGridSpec(SceneSpec):
    """A grid of tiles on one ground, over which environments are spread and promoted by a curriculum.

    Levels lie along x, the easiest first; the tiles of a level, along y, differ by their seeds. Towards the edge of a
    tile its ground fades to height 0, so that it joins its neighbours. Instances are named as on their tile, with
    ``_l{level}_t{type}``. What is on a tile depends on the seed and on which one it is, not on how many there are.

    Args:
        levels: A spec for each level, all of one size and one spacing of heights.
        types: Number of tiles of each level.
        fade: Width over which the ground of a tile fades [m].
        border: Width of the level rim about the grid [m].
        places: Places to find on each tile; by default those of the first level.
        max_init_level: Highest level on which environments start; None: any.

    Raises:
        ValueError: for no levels, or levels of different sizes.
    """

    def __init__(
        self,
        levels: Sequence[SceneSpec],
        types: int = 4,
        fade: float = 3.0,
        border: float = 6.0,
        places: Mapping[str, Places] | None = None,
        max_init_level: int | None = None,
    ):
        if not levels or types != int(types) or types < 1:
            raise ValueError(f"TileGridSpec: {len(levels)} levels of {types} tiles; must be at least one of each")
        if max_init_level is not None and not 0 <= max_init_level < len(levels):
            raise ValueError(f"TileGridSpec: max_init_level is {max_init_level}, must be in 0 .. {len(levels) - 1}")
        sizes = {level.size for level in levels}
        if len(sizes) > 1:
            raise ValueError(f"TileGridSpec: levels have the sizes {sorted(sizes)} [m]; all must have one size")
        self.tile = levels[0].size
        if not 0.0 < fade <= 0.5 * min(self.tile):
            raise ValueError(f"TileGridSpec: fade is {fade}, must be above 0 and at most half a tile [m]")
        if not 0.0 <= border < np.inf:
            raise ValueError(f"TileGridSpec: border is {border}, must be 0 or more [m]")
        self.levels, self.types, self.fade, self.border = list(levels), types, fade, border
        self.max_init_level = max_init_level
        names = dict.fromkeys(name for level in levels for name in level.palette)
        first = levels[0]
        super().__init__(
            (len(levels) * self.tile[0] + 2.0 * border, types * self.tile[1] + 2.0 * border),
            [_TileAssets(name, levels) for name in names],
            first.distant_light,
            first.dome_light,
            first.places if places is None else places,
        )

    def generate(self, rng: np.random.Generator) -> TerrainInstance:
        tiles: dict[Tile, TerrainInstance] = {}
        seeds = int(rng.integers(1 << 63))
        for level, spec in enumerate(self.levels):
            for kind in range(self.types):
                tiles[level, kind] = spec.generate(np.random.default_rng([seeds, level, kind]))
        first = tiles[0, 0].ground
        cell, (nrow, ncol) = first.cell, first.heights.shape
        for (level, kind), tile in tiles.items():
            if tile.ground.heights.shape != (nrow, ncol) or not np.allclose(tile.ground.cell, cell):
                raise ValueError(
                    f"TileGridSpec: heights of tile {level}, {kind} are {tile.ground.heights.shape} spaced "
                    f"{tile.ground.cell} m, those of 0, 0 {(nrow, ncol)} spaced {cell} m; all must be alike"
                )
        rim = [round(self.border / c) for c in cell]
        if not np.allclose(np.array(rim) * cell, self.border, atol=0.01):
            raise ValueError(
                f"TileGridSpec: border is {self.border} m, must be a whole number of the spacings of heights, {cell} m"
            )
        shape = (self.types * (nrow - 1) + 1 + 2 * rim[1], len(self.levels) * (ncol - 1) + 1 + 2 * rim[0])
        heights = np.zeros(shape, dtype=np.float32)
        lower = np.array([-0.5 * (shape[1] - 1) * cell[0], -0.5 * (shape[0] - 1) * cell[1]])
        origins, shifts, weight = np.zeros((len(self.levels), self.types, 3)), {}, self._weight(first)
        parts: list[tuple[MeshPart, Sequence[str]]] = []
        for (level, kind), tile in tiles.items():
            corner = rim[0] + level * (ncol - 1), rim[1] + kind * (nrow - 1)
            at = lower + np.array(corner) * cell
            shift = shifts[level, kind] = at - np.array(tile.ground.lower)
            faded = weight * tile.ground.raw
            heights[corner[1] : corner[1] + nrow, corner[0] : corner[0] + ncol] = faded
            tile.ground = Ground(faded, tile.ground.lower, cell)
            x, y = (float(v) for v in tile.origin[:2])  # type: ignore[index]
            tile.origin = (x, y, float(tile.ground.height_at(np.array(x), np.array(y))))
            origins[level, kind] = np.array(tile.origin) + [*shift, 0.0]
            for part, tags in tile.parts:
                moved = replace(
                    part, vertices=part.vertices + np.array([*shift, 0.0]), name=f"{part.name}_{level}_{kind}"
                )
                parts.append((moved, tags))
        seed = int(rng.integers(1 << 31))
        ground = Ground(heights, (float(lower[0]), float(lower[1])), cell, origins, self.tile, seed=seed)
        example, start = tiles[0, 0], origins[0, self.types // 2]
        return _TiledTerrain(
            ground=ground,
            origin=(float(start[0]), float(start[1]), float(start[2])),
            parts=parts,
            tags=example.tags,
            color=example.color,
            static_friction=example.static_friction,
            dynamic_friction=example.dynamic_friction,
            max_init_level=self.max_init_level,
            tiles=tiles,
            shifts=shifts,
        )

    def survey(self, terrain: TerrainInstance) -> None:
        """Survey each tile, and put maps together that have a value for each height, as well as the colours."""
        assert isinstance(terrain, _TiledTerrain)
        for (level, _), tile in terrain.tiles.items():
            self.levels[level].survey(tile)
        tiles, shape = list(terrain.tiles.values()), terrain.ground.heights.shape
        own = tiles[0].ground.heights.shape
        for name in tiles[0].maps:
            values = [tile.maps.get(name) for tile in tiles]
            if all(v is not None and v.shape == own for v in values):
                terrain.maps[name] = self._together(terrain, np.zeros(shape, dtype=np.float32), values)
        colors = [tile.colors for tile in tiles]
        if all(c is not None for c in colors):
            rim = np.broadcast_to(np.array(terrain.color, dtype=np.float32), (*shape, 3)).copy()
            terrain.colors = self._together(terrain, rim, colors)

    def _together(self, terrain: _TiledTerrain, whole: np.ndarray, values: Sequence[Any]) -> np.ndarray:
        ground = terrain.ground
        for shift, tile, value in zip(terrain.shifts.values(), terrain.tiles.values(), values, strict=True):
            at = (np.array(tile.ground.lower) + shift - np.array(ground.lower)) / np.array(ground.cell)
            col, row = np.rint(at).astype(int)
            whole[row : row + value.shape[0], col : col + value.shape[1]] = value
        return whole

    def _weight(self, ground: Ground) -> np.ndarray:
        """1 inside of a tile, 0 at its edge."""
        nrow, ncol = ground.heights.shape
        ways = []
        for count, cell in ((nrow, ground.cell[1]), (ncol, ground.cell[0])):
            index = np.arange(count)
            share = np.clip(np.minimum(index, count - 1 - index) * cell / self.fade, 0.0, 1.0)
            ways.append(share * share * (3.0 - 2.0 * share))
        return np.asarray(ways[0][:, None] * ways[1][None, :], dtype=np.float32)
