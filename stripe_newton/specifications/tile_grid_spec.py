# SPDX-License-Identifier: Apache-2.0
"""Tile grid specification: many scenes on one ground, as tiles that get harder from level to level."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from stripe_newton.terrains import Ground

from .asset_instance import AssetInstance
from .asset_mesh import MeshPart
from .asset_spec import AssetSpec
from .places import Places
from .scene_spec import SceneSpec
from .terrain_instance import TerrainInstance

__all__ = ["TileGridSpec"]

Tile = tuple[int, int]
"""Level and type of a tile."""


@dataclass(eq=False)
class _TiledTerrain(TerrainInstance):
    """The whole ground, and the tiles in their own frames."""

    tiles: dict[Tile, TerrainInstance] = field(default_factory=dict)
    shifts: dict[Tile, np.ndarray] = field(default_factory=dict)
    """Position of each tile's frame in the world, x and y [m]."""


class _TileAssets(AssetSpec):
    """Assets of the specifications of one name, one for each level, on all tiles."""

    def __init__(self, name: str, levels: Sequence[SceneSpec]):
        super().__init__(name)
        self._specs = [level.palette.get(name) for level in levels]

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterable[AssetInstance]:
        assert isinstance(terrain, _TiledTerrain)
        seed = int(rng.integers(1 << 63))
        for (level, kind), tile in terrain.tiles.items():
            spec = self._specs[level]
            if spec is None:
                continue
            # A generator for each tile: its assets stay the same when levels or types are added.
            tile.placed[self.name] = list(spec.generate(tile, np.random.default_rng([seed, level, kind])))
            x, y = terrain.shifts[level, kind]
            # The tile keeps its instances in its own frame, for the survey; the whole gets moved copies.
            for one in tile.placed[self.name]:
                place = (one.position[0] + x, one.position[1] + y, one.position[2])
                yield replace(one, name=f"{one.name}_l{level}_t{kind}", position=place)


class TileGridSpec(SceneSpec):
    """A grid of tiles on one ground, over which environments are spread and moved by a curriculum.

    Levels lie along x, the easiest first. The tiles of a level lie along y and differ by their seeds. Towards the edges
    of a tile its ground fades to height 0, so that it joins its neighbours. Instances have the name that they have on
    their tile, with ``_l{level}_t{type}`` appended. The content of a tile depends on the seed and on its level and
    type, not on the number of tiles.

    Args:
        levels: A scene specification for each level, all of one size and one spacing of heights.
        types: Number of tiles per level.
        fade: Width over which the ground of a tile fades [m].
        border: Width of the level ground around the grid [m].
        places: Places to find on each tile. None: those of the first level.
        max_init_level: Highest level on which environments start. None: any.

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
        self.tile = _common_size(levels)
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
        # One number for all tiles: drawing one for each would make a tile depend on how many come before it.
        for level, spec in enumerate(self.levels):
            for kind in range(self.types):
                # A generator for each tile: a tile stays the same when levels or types are added.
                tiles[level, kind] = spec.generate(np.random.default_rng([seeds, level, kind]))
        self._check_grids(tiles)
        example = tiles[0, 0]
        cell, (nrow, ncol) = example.ground.cell, example.ground.heights.shape
        rim = self._rim_cells(cell)
        shape = (self.types * (nrow - 1) + 1 + 2 * rim[1], len(self.levels) * (ncol - 1) + 1 + 2 * rim[0])
        heights = np.zeros(shape, dtype=np.float32)
        lower = np.array([-0.5 * (shape[1] - 1) * cell[0], -0.5 * (shape[0] - 1) * cell[1]])
        origins, shifts = np.zeros((len(self.levels), self.types, 3)), {}
        weight = self._fade_weights(example.ground)
        for (level, kind), tile in tiles.items():
            # Neighbouring tiles share the heights on their common edge, which are 0 on both.
            corner = rim[0] + level * (ncol - 1), rim[1] + kind * (nrow - 1)
            shift = shifts[level, kind] = lower + np.array(corner) * cell - np.array(tile.ground.lower)
            faded = weight * tile.ground.raw
            heights[corner[1] : corner[1] + nrow, corner[0] : corner[0] + ncol] = faded
            _flatten_edges(tile, faded)
            origins[level, kind] = np.array(tile.origin) + [*shift, 0.0]
        seed = int(rng.integers(1 << 31))
        ground = Ground(heights, (float(lower[0]), float(lower[1])), cell, origins, self.tile, seed=seed)
        start = origins[0, self.types // 2]  # where a single robot starts: the middle of the easiest level
        return _TiledTerrain(
            ground=ground,
            origin=(float(start[0]), float(start[1]), float(start[2])),
            parts=_moved_parts(tiles, shifts),
            tags=example.tags,
            color=example.color,
            static_friction=example.static_friction,
            dynamic_friction=example.dynamic_friction,
            max_init_level=self.max_init_level,
            tiles=tiles,
            shifts=shifts,
        )

    def _check_grids(self, tiles: Mapping[Tile, TerrainInstance]) -> None:
        """Check that the heights of all tiles lie on equal grids, as they become one."""
        first = tiles[0, 0].ground
        for (level, kind), tile in tiles.items():
            if tile.ground.heights.shape != first.heights.shape or not np.allclose(tile.ground.cell, first.cell):
                raise ValueError(
                    f"TileGridSpec: heights of tile {level}, {kind} are {tile.ground.heights.shape} spaced "
                    f"{tile.ground.cell} m, those of 0, 0 {first.heights.shape} spaced {first.cell} m; "
                    "all must be alike"
                )

    def _rim_cells(self, cell: tuple[float, float]) -> tuple[int, int]:
        """Width of the border in cells along x and y."""
        rim = round(self.border / cell[0]), round(self.border / cell[1])
        if not np.allclose(np.array(rim) * cell, self.border, atol=0.01):
            raise ValueError(
                f"TileGridSpec: border is {self.border} m, must be a whole number of the spacings of heights, {cell} m"
            )
        return rim

    def _fade_weights(self, ground: Ground) -> np.ndarray:
        """Factors on the heights of a tile: 1 inside, falling smoothly to 0 at its edges."""
        nrow, ncol = ground.heights.shape
        ways = []
        for count, cell in ((nrow, ground.cell[1]), (ncol, ground.cell[0])):
            index = np.arange(count)
            share = np.clip(np.minimum(index, count - 1 - index) * cell / self.fade, 0.0, 1.0)
            ways.append(share * share * (3.0 - 2.0 * share))  # smoothstep
        return np.asarray(ways[0][:, None] * ways[1][None, :], dtype=np.float32)

    def survey(self, terrain: TerrainInstance) -> None:
        """Survey each tile, then join their colours and those of their maps that have a value for each height."""
        assert isinstance(terrain, _TiledTerrain)
        for (level, _), tile in terrain.tiles.items():
            self.levels[level].survey(tile)
        shape = terrain.ground.heights.shape
        for name in terrain.tiles[0, 0].maps:
            values = [tile.maps.get(name) for tile in terrain.tiles.values()]
            if (joined := _joined(terrain, np.zeros(shape, dtype=np.float32), values)) is not None:
                terrain.maps[name] = joined
        rim = np.broadcast_to(np.array(terrain.color, dtype=np.float32), (*shape, 3)).copy()
        terrain.colors = _joined(terrain, rim, [tile.colors for tile in terrain.tiles.values()])


def _common_size(levels: Sequence[SceneSpec]) -> tuple[float, float]:
    sizes = {level.size for level in levels}
    if len(sizes) > 1:
        raise ValueError(f"TileGridSpec: levels have the sizes {sorted(sizes)} [m]; all must have one size")
    return levels[0].size


def _flatten_edges(tile: TerrainInstance, faded: np.ndarray) -> None:
    """Give a tile the heights that fade towards its edges, and put its origin onto them."""
    assert tile.origin is not None
    tile.ground = Ground(faded, tile.ground.lower, tile.ground.cell)
    x, y = (float(v) for v in tile.origin[:2])
    tile.origin = (x, y, float(tile.ground.height_at(np.array(x), np.array(y))))


def _moved_parts(
    tiles: Mapping[Tile, TerrainInstance], shifts: Mapping[Tile, np.ndarray]
) -> list[tuple[MeshPart, Sequence[str]]]:
    """The surfaces of all tiles, in the frame of the whole ground."""
    return [
        (
            replace(part, vertices=part.vertices + np.array([*shifts[at], 0.0]), name=f"{part.name}_{at[0]}_{at[1]}"),
            tags,
        )
        for at, tile in tiles.items()
        for part, tags in tile.parts
    ]


def _joined(terrain: _TiledTerrain, whole: np.ndarray, values: Sequence[np.ndarray | None]) -> np.ndarray | None:
    """Values of the tiles written into those of the whole ground; None unless each tile has one for each height."""
    ground = terrain.ground
    for shift, tile, value in zip(terrain.shifts.values(), terrain.tiles.values(), values, strict=True):
        if value is None or value.shape != (*tile.ground.heights.shape, *whole.shape[2:]):
            return None
        at = (np.array(tile.ground.lower) + shift - np.array(ground.lower)) / np.array(ground.cell)
        col, row = np.rint(at).astype(int)
        whole[row : row + value.shape[0], col : col + value.shape[1]] = value
    return whole
