# SPDX-License-Identifier: Apache-2.0
"""Assets of the rubble: specifications of loose and standing pieces, bars and debris."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from stripe_newton.specifications import AssetInstance, AssetSpec, TerrainInstance

from .library import kinds
from .relief import Building, RubbleTerrain
from .resting import Piece, Support, spread

__all__ = ["Bars", "Debris", "Loose", "Standing"]

HECTARE = 1.0e4
_TRIES = 12
"""Directions tried for a piece, until it crosses no wall."""


class _Rubble(AssetSpec):
    """Base of the rubble's assets: pieces of one kind, given by number or density.

    Args:
        name: An identifier, unique within the scene.
        kind: A kind of :func:`stripe_tasks.rubble.library.kinds`.
        density: Number per hectare.
        count: Number in all; overrides ``density``.
    """

    def __init__(self, name: str, kind: str, density: float = 0.0, count: int | None = None):
        super().__init__(name)
        if not 0.0 <= density < math.inf or (count is not None and count < 0):
            raise ValueError(f"asset '{name}': density is {density} and count {count}, must be 0 or more")
        if kind not in kinds():
            raise ValueError(f"asset '{name}': kind is '{kind}', must be one of {', '.join(kinds())}")
        self.kind, self.density, self.count = kind, density, count

    def _number(self, terrain: TerrainInstance) -> int:
        area = terrain.size[0] * terrain.size[1]
        return round(self.density * area / HECTARE) if self.count is None else self.count

    def _instance(self, index: int, mesh: Piece, position: np.ndarray, turn: np.ndarray, scale: float) -> AssetInstance:
        return self.create_instance(f"{self.name}_{index}", mesh, position.tolist(), turn.tolist(), scale)


def _buildings(terrain: TerrainInstance, name: str) -> RubbleTerrain:
    """Return a terrain that knows where buildings stood; raise a ValueError for another one."""
    if not isinstance(terrain, RubbleTerrain):
        raise ValueError(f"asset '{name}': stands on a {type(terrain).__name__}, must be a RubbleTerrain")
    return terrain


class Loose(_Rubble):
    """Loose pieces: they lie on the heaps and on each other, some with one end raised and the other in the heap.

    Args:
        name: An identifier.
        kind: ``"slab"``, ``"beam"``, ``"pipe"``, ``"chunk"`` or ``"brick"``.
        density: Number per hectare.
        count: Number in all; overrides ``density``.
        apart: Least distance between two pieces [m].
        raised: Share of pieces with one end raised.
        stray: Density on streets, as a share of that on the heaps.
        scale: Least and greatest factor on the size.
    """

    def __init__(
        self,
        name: str,
        kind: str,
        density: float = 0.0,
        count: int | None = None,
        apart: float = 0.5,
        raised: float = 0.0,
        stray: float = 0.0,
        scale: tuple[float, float] = (0.85, 1.15),
    ):
        super().__init__(name, kind, density, count)
        self.apart, self.raised, self.stray, self.scale = apart, raised, stray, scale

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        number, meshes = self._number(terrain), kinds()[self.kind]
        if number == 0:
            return
        street, support = _buildings(terrain, self.name).maps["street"], Support(terrain)
        weight = self._weight(terrain, street, support, meshes)
        for index, place in enumerate(spread(weight, terrain.size, number, self.apart, rng)):
            mesh, scale = meshes[int(rng.integers(len(meshes)))], float(rng.uniform(*self.scale))
            raised = rng.uniform(0.2, 0.62) if rng.random() < self.raised else 0.0
            turns = rng.uniform(-math.pi, math.pi, _TRIES)
            position, turn = _clear_pose(support, mesh, place, turns, scale, raised)
            made = self._instance(index, mesh, position, turn, scale)
            support.add(made)  # later pieces may lie on this one
            yield made

    def _weight(
        self, terrain: TerrainInstance, street: np.ndarray, support: Support, meshes: list[Piece]
    ) -> np.ndarray:
        """Density of the pieces over the field: most on the heaps, none at the edge or in what stands there."""
        weight = (1.0 - street) ** 2 + self.stray * np.clip(1.6 - street, 0.0, 1.0)
        x, y = (np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(terrain.size, weight.shape[::-1], strict=True))
        grid = np.stack(np.meshgrid(x, y), axis=-1)
        edge = (0.5 * np.array(terrain.size) - np.abs(grid)).min(axis=-1)
        room = support.room(grid.reshape(-1, 2)).reshape(weight.shape)
        thin = min(0.3, 0.4 * min(mesh.radius for mesh in meshes))
        # the small constant keeps room for pieces where no heap is in the field
        return np.where((edge > min(1.7, 0.2 * min(terrain.size))) & (room > thin), weight + 1.0e-6, 0.0)


def _clear_pose(
    support: Support, mesh: Piece, place: np.ndarray, turns: np.ndarray, scale: float, raised: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pose at rest in the first of some directions [rad] that crosses no wall, or in the one that crosses least."""
    best: tuple[int, np.ndarray, np.ndarray] | None = None
    for yaw in turns:
        position, turn = support.rest(mesh, place, yaw, scale, raised)
        crossed = support.crossed(mesh, position, turn, scale)
        if best is None or crossed < best[0]:
            best = crossed, position, turn
        if crossed == 0:
            break
    assert best is not None  # there are turns
    return best[1], best[2]


class Standing(_Rubble):
    """Standing pieces: walls or columns where a building's outer walls were, leaning a little.

    There are fewer than requested where the buildings within the field have no more room.

    Args:
        name: An identifier.
        kind: ``"wall"`` or ``"column"``.
        density: Number per hectare.
        count: Largest number; overrides ``density``.
        lean: Greatest lean [rad].
    """

    def __init__(
        self, name: str, kind: str, density: float = 0.0, count: int | None = None, lean: float = math.radians(9.0)
    ):
        super().__init__(name, kind, density, count)
        self.lean = lean

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        meshes, wide = kinds()[self.kind], self.kind == "wall"
        space, margin = (6.2, 3.0) if wide else (4.4, 1.2)
        buildings = _buildings(terrain, self.name).buildings
        found = np.array([spot for b in buildings for spot in _wall_spots(b, space, wide)]).reshape(-1, 3)
        # whole pieces only: a wall must not stand out of the field, or in another piece
        inside = (np.abs(found[:, :2]) <= 0.5 * np.array(terrain.size) - margin).all(axis=1)
        near = [terrain.placed.get(name, []) for name in terrain.placed]
        taken = np.array([i.position[:2] for placed in near for i in placed]).reshape(-1, 2)
        gap = np.linalg.norm(found[:, None, :2] - taken, axis=2).min(axis=1, initial=np.inf)
        found = rng.permutation(found[inside & (gap > (2.6 if len(taken) else 0.0))])
        for index, (x, y, yaw) in enumerate(found[: self._number(terrain)]):
            mesh = meshes[int(rng.integers(len(meshes)))]
            turn = Rotation.from_euler(
                "zxy", [yaw, *rng.uniform(-self.lean, self.lean, 2) * ((1, 0.15) if wide else 1)]
            )
            reach = turn.apply(np.array([[u, 0.0, 0.0] for u in np.linspace(-1.0, 1.0, 9) * (1.8 if wide else 0.15)]))
            below = terrain.ground.height_at(reach[:, 0] + x, reach[:, 1] + y) - reach[:, 2]
            yield self._instance(index, mesh, np.array([x, y, below.min()]), turn.as_quat(), 1.0)


def _wall_spots(building: Building, space: float, wide: bool) -> Iterator[tuple[float, float, float]]:
    """Places [m] and directions [rad] along a building's outer walls, about every ``space`` [m].

    Wide pieces stand in the middle of their part of the wall, others at its beginning, where columns would be.
    """
    for side in range(4):
        long, away = building.half[side % 2], building.half[1 - side % 2]
        many = max(1, int(2.0 * long / space))
        shift = 0.5 * (many - 1) if wide else 0.5 * many
        for k in range(many):
            along = (k - shift) * (2.0 * long / many)
            u, v = ((along, away), (away, along), (-along, -away), (-away, -along))[side]
            x, y = building.world(u, v)
            yield x, y, building.yaw + (0.0, -0.5, 1.0, 0.5)[side] * math.pi


class Bars(_Rubble):
    """Reinforcing bars: bent, they stick out where slabs and beams have broken.

    Args:
        name: An identifier.
        of: Names of the specs from whose pieces they stick out.
        each: Mean number for each piece.
    """

    def __init__(self, name: str, of: tuple[str, ...], each: float):
        super().__init__(name, "rebar")
        if not 0.0 <= each < math.inf:
            raise ValueError(f"asset '{name}': each is {each}, must be 0 or more")
        self.of, self.each = of, each

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        meshes, support = kinds()["rebar"], Support(terrain)
        index = 0
        for piece in (i for name in self.of for i in terrain.placed.get(name, ())):
            assert isinstance(piece.mesh, Piece)
            stubs, turn = piece.mesh.stubs, Rotation.from_quat(piece.rotation)
            for pick in rng.permutation(len(stubs))[: rng.poisson(self.each)]:
                mesh, scale = meshes[int(rng.integers(len(meshes)))], float(rng.uniform(0.8, 1.1))
                point, way = stubs[pick]
                at = np.array(piece.position) + piece.scale * turn.apply(point)
                along = Rotation.from_euler("z", math.atan2(way[1], way[0]))
                # six directions about the bar's axis and bends; the one with its tip highest over the ground is taken
                tries = turn * along * Rotation.from_euler("xz", rng.uniform((-2.6, -0.3), (2.6, 0.3), (6, 2)))
                tips = np.array([t.apply(scale * mesh.samples).mean(axis=0) for t in tries]) + at
                clear = tips[:, 2] - support.at(tips[:, :2])
                best = int(np.argmax(clear))
                if clear[best] > 0.06:  # else every try points into the heap
                    yield self._instance(index, mesh, at, tries[best].as_quat(), scale)
                    index += 1


class Debris(_Rubble):
    """Debris: patches of chips on the ground without colliders, most of them around the foot of the heaps."""

    def __init__(self, name: str, density: float = 0.0, count: int | None = None):
        super().__init__(name, "debris", density, count)

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        number, meshes, ground = self._number(terrain), kinds()["debris"], terrain.ground
        if number == 0:
            return
        weight, reach = 1.12 - _buildings(terrain, self.name).maps["street"], 0.5
        inner = np.array(terrain.size) - 2.0 * 1.3 * reach
        # twice as many places as patches, of which the most even ones are taken
        at = spread(weight, (float(inner[0]), float(inner[1])), 2 * number, 0.15, rng)
        turns = np.arange(8) * 0.25 * math.pi
        ring = reach * np.column_stack([np.cos(turns), np.sin(turns)])
        around = ground.height_at(*np.moveaxis(at[:, None] + ring, 2, 0))
        rise = around @ ring / (4.0 * reach * reach)  # of the plane that fits the ring best
        high = ground.height_at(*at.T)
        left = (np.abs(around - high[:, None] - rise @ ring.T)).max(axis=1)
        even = np.sort(np.argsort(left, kind="stable")[:number])  # over a crest chips would visibly hover
        at, rise, high = at[even], rise[even], high[even]
        up = np.column_stack([-rise, np.ones(len(at))])
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        half = np.column_stack([-up[:, 1], up[:, 0], np.zeros(len(at)), 1.0 + up[:, 2]])  # from the z axis to it
        turn = Rotation.from_quat(half) * Rotation.from_euler("z", rng.uniform(-math.pi, math.pi, (len(at), 1)))
        place = np.column_stack([at, high])
        for index, quat in enumerate(turn.as_quat()):
            mesh = meshes[int(rng.integers(len(meshes)))]
            yield self._instance(index, mesh, place[index], quat, float(rng.uniform(0.7, 1.3)))
