# SPDX-License-Identifier: Apache-2.0
"""Terrains of the Isaac Lab dialect: Isaac Lab's kinds of tiles with its heights, and its rough terrain."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np

from stripe_newton import terrains as native
from stripe_newton.configclass import configclass

from . import terrain_heights as heights

__all__ = [
    "ROUGH_TERRAINS_CFG",
    "HfDiscreteObstaclesTerrainCfg",
    "HfInvertedPyramidSlopedTerrainCfg",
    "HfInvertedPyramidStairsTerrainCfg",
    "HfPyramidSlopedTerrainCfg",
    "HfPyramidStairsTerrainCfg",
    "HfRandomUniformTerrainCfg",
    "HfSteppingStonesTerrainCfg",
    "HfTerrainBaseCfg",
    "HfWaveTerrainCfg",
    "MeshBoxTerrainCfg",
    "MeshGapTerrainCfg",
    "MeshInvertedPyramidStairsTerrainCfg",
    "MeshPitTerrainCfg",
    "MeshPlaneTerrainCfg",
    "MeshPyramidStairsTerrainCfg",
    "MeshRailsTerrainCfg",
    "MeshRandomGridTerrainCfg",
    "MeshRepeatedBoxesTerrainCfg",
    "MeshRepeatedCylindersTerrainCfg",
    "MeshRepeatedPyramidsTerrainCfg",
    "MeshStarTerrainCfg",
    "TerrainGeneratorCfg",
]

Heights = Callable[..., np.ndarray]


class _Origin:
    """Tiles whose origin is at the highest point within one metre of the middle."""

    horizontal_scale: float

    def origin_height(self, tile: np.ndarray) -> float:
        """Height of the tile's origin [m]."""
        ends = [
            [int(((n - 1) * self.horizontal_scale * 0.5 + side) / self.horizontal_scale) for side in (-1.0, 1.0)]
            for n in tile.shape
        ]
        return float(tile[max(ends[0][0], 0) : ends[0][1], max(ends[1][0], 0) : ends[1][1]].max())


@configclass
class HfTerrainBaseCfg(_Origin, native.HfTerrainBaseCfg):
    """Base of kinds that are height fields."""


@configclass
class HfRandomUniformTerrainCfg(_Origin, native.HfRandomUniformTerrainCfg):
    """Random heights."""

    function: Heights = heights.random_uniform_terrain


@configclass
class HfPyramidSlopedTerrainCfg(_Origin, native.HfPyramidSlopedTerrainCfg):
    """A hill with a level top."""

    function: Heights = heights.pyramid_sloped_terrain


@configclass
class HfInvertedPyramidSlopedTerrainCfg(HfPyramidSlopedTerrainCfg):
    """A hollow with a level bottom."""

    inverted: bool = True


@configclass
class HfPyramidStairsTerrainCfg(_Origin, native.HfPyramidStairsTerrainCfg):
    """Stairs up to a platform."""

    function: Heights = heights.pyramid_stairs_terrain


@configclass
class HfInvertedPyramidStairsTerrainCfg(HfPyramidStairsTerrainCfg):
    """Stairs down to a platform."""

    inverted: bool = True


@configclass
class HfDiscreteObstaclesTerrainCfg(_Origin, native.HfDiscreteObstaclesTerrainCfg):
    """Blocks and hollows."""

    function: Heights = heights.discrete_obstacles_terrain


@configclass
class HfWaveTerrainCfg(_Origin, native.HfWaveTerrainCfg):
    """Waves."""

    function: Heights = heights.wave_terrain


@configclass
class HfSteppingStonesTerrainCfg(_Origin, native.HfSteppingStonesTerrainCfg):
    """Stones over a pit."""

    function: Heights = heights.stepping_stones_terrain


@configclass
class MeshPlaneTerrainCfg(native.MeshPlaneTerrainCfg):
    """Level ground."""

    function: Heights = heights.flat_terrain


@configclass
class MeshPyramidStairsTerrainCfg(native.MeshPyramidStairsTerrainCfg):
    """Stairs up to a platform."""

    function: Heights = heights.pyramid_stairs_mesh_terrain
    holes: bool = False

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from native.MeshPyramidStairsTerrainCfg.problems(self)
        if self.holes:
            yield "holes", "is set, but the ground is a height field, which has none"


@configclass
class MeshInvertedPyramidStairsTerrainCfg(MeshPyramidStairsTerrainCfg):
    """Stairs down to a platform."""

    inverted: bool = True


@configclass
class MeshRandomGridTerrainCfg(native.MeshRandomGridTerrainCfg):
    """Square blocks of random heights."""

    function: Heights = heights.random_grid_terrain


@configclass
class MeshRailsTerrainCfg(native.MeshRailsTerrainCfg):
    """Two square rails."""

    function: Heights = heights.rails_terrain


@configclass
class MeshPitTerrainCfg(native.MeshPitTerrainCfg):
    """A pit to climb out of."""

    function: Heights = heights.pit_terrain


@configclass
class MeshBoxTerrainCfg(native.MeshBoxTerrainCfg):
    """A block to climb down from."""

    function: Heights = heights.box_terrain


@configclass
class MeshGapTerrainCfg(native.MeshGapTerrainCfg):
    """A ditch around the platform."""

    function: Heights = heights.gap_terrain


@configclass
class MeshStarTerrainCfg(native.MeshStarTerrainCfg):
    """Beams over a pit."""

    function: Heights = heights.star_terrain


@configclass
class _Repeated(native.MeshRepeatedObjectsTerrainCfg):
    """Isaac Lab's other fields of repeated objects."""

    object_type: object = None
    max_height_noise: float | None = None

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.object_type is not None:
            yield "object_type", "is set, but objects are those of the class; derive from it and override faces()"
        if self.max_height_noise is not None:
            noise = -self.max_height_noise, self.max_height_noise
            yield "max_height_noise", f"is the former spelling; set abs_height_noise to {noise}"


@configclass
class MeshRepeatedBoxesTerrainCfg(_Repeated, native.MeshRepeatedBoxesTerrainCfg):
    """Boxes on level ground."""


@configclass
class MeshRepeatedCylindersTerrainCfg(_Repeated, native.MeshRepeatedCylindersTerrainCfg):
    """Cylinders on level ground."""


@configclass
class MeshRepeatedPyramidsTerrainCfg(_Repeated, native.MeshRepeatedPyramidsTerrainCfg):
    """Pyramids on level ground."""


@configclass
class TerrainGeneratorCfg(native.TerrainGeneratorCfg):
    """:class:`stripe_newton.terrains.TerrainGeneratorCfg`; a wall of a tile is one cell wide, whatever the slopes."""

    class_type: type = native.TerrainGenerator
    IGNORED: ClassVar[dict[str, str]] = {
        **native.TerrainGeneratorCfg.IGNORED,
        "class_type": "the ground is made by stripe_newton's generator",
    }


def _of_isaac_lab(cfg: native.SubTerrainBaseCfg) -> native.SubTerrainBaseCfg:
    """A kind of the package as Isaac Lab's of the same name."""
    kind = globals()[type(cfg).__name__]
    made: native.SubTerrainBaseCfg = kind(**{k: v for k, v in vars(cfg).items() if k != "function"})
    return made


_ROUGH = native.ROUGH_TERRAINS_CFG
ROUGH_TERRAINS_CFG = TerrainGeneratorCfg(
    **{name: getattr(_ROUGH, name) for name in ("size", "border_width", "num_rows", "num_cols")},
    horizontal_scale=_ROUGH.horizontal_scale,
    vertical_scale=_ROUGH.vertical_scale,
    sub_terrains={name: _of_isaac_lab(sub) for name, sub in _ROUGH.sub_terrains.items()},
)
"""Isaac Lab's rough terrain: stairs, blocks, random ground and slopes."""
