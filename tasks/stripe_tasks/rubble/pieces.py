# SPDX-License-Identifier: Apache-2.0
"""Where pieces of rubble lie, stick out and still stand, as asset specifications.

All work on a :class:`stripe_tasks.rubble.relief.RubbleTerrain` and rest on what earlier specs of the palette put there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from stripe_newton.specifications import AssetInstance, AssetSpec, TerrainInstance

from .library import kinds
from .relief import RubbleTerrain
from .resting import Piece, Support, spread

__all__ = ["Bars", "Debris", "Loose", "Standing"]

HECTARE = 1.0e4
_TRIES = 12
"""Directions that are tried for a piece beside a wall."""


class _Rubble(AssetSpec):
    """Pieces of one kind, by number or density.

    Args:
        name: An identifier, unique within the scene.
        kind: A kind of :func:`stripe_tasks.rubble.library.kinds`.
        density: How many a hectare.
        count: How many; goes before ``density``.
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
    if not isinstance(terrain, RubbleTerrain):
        raise ValueError(f"asset '{name}': stands on a {type(terrain).__name__}, must be a RubbleTerrain")
    return terrain


class Loose(_Rubble):
    """Pieces that lie on the heaps and on each other, some with one end raised and the other in the heap.

    Args:
        name: An identifier.
        kind: ``"slab"``, ``"beam"``, ``"pipe"``, ``"chunk"`` or ``"brick"``.
        density: How many a hectare.
        count: How many; goes before ``density``.
        apart: Least distance between two [m].
        raised: Share of them of which one end is raised.
        stray: Share of the density on the heaps that streets have.
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
        weight = (1.0 - street) ** 2 + self.stray * np.clip(1.6 - street, 0.0, 1.0)
        x, y = (np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(terrain.size, weight.shape[::-1], strict=True))
        grid = np.stack(np.meshgrid(x, y), axis=-1)
        edge = (0.5 * np.array(terrain.size) - np.abs(grid)).min(axis=-1)
        room = support.room(grid.reshape(-1, 2)).reshape(weight.shape)
        thin = min(0.3, 0.4 * min(mesh.radius for mesh in meshes))
        weight = np.where((edge > min(1.7, 0.2 * min(terrain.size))) & (room > thin), weight + 1.0e-6, 0.0)
        for index, place in enumerate(spread(weight, terrain.size, number, self.apart, rng)):
            mesh, scale = meshes[int(rng.integers(len(meshes)))], float(rng.uniform(*self.scale))
            up = rng.uniform(0.2, 0.62) if rng.random() < self.raised else 0.0
            turns = rng.uniform(-math.pi, math.pi, _TRIES)
            best: tuple[int, np.ndarray, np.ndarray] | None = None
            for yaw in turns:  # until it does not cross a wall
                position, turn = support.rest(mesh, place, yaw, scale, up)
                crossed = support.crossed(mesh, position, turn, scale)
                if best is None or crossed < best[0]:
                    best = crossed, position, turn
                if crossed == 0:
                    break
            assert best is not None
            made = self._instance(index, mesh, best[1], best[2], scale)
            support.add(made)
            yield made


class Standing(_Rubble):
    """Walls or columns that still stand where a building's outer walls were, leaning a little.

    Fewer than asked for where the buildings within the field have no more room.

    Args:
        name: An identifier.
        kind: ``"wall"`` or ``"column"``.
        density: How many a hectare.
        count: How many at most; goes before ``density``.
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
        spots = []
        for building in _buildings(terrain, self.name).buildings:
            for side in range(4):
                long, away = building.half[side % 2], building.half[1 - side % 2]
                many = max(1, int(2.0 * long / space))
                shift = 0.5 * (many - 1) if wide else 0.5 * many
                for k in range(many):
                    along = (k - shift) * (2.0 * long / many)
                    u, v = ((along, away), (away, along), (-along, -away), (-away, -along))[side]
                    spots.append((*building.world(u, v), building.yaw + (0.0, -0.5, 1.0, 0.5)[side] * math.pi))
        found = np.array(spots).reshape(-1, 3)
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


class Bars(_Rubble):
    """Reinforcing bars, bent, that stick out where slabs and beams have broken.

    Args:
        name: An identifier.
        of: Names of the specs out of whose pieces they stick.
        each: How many a piece, on average.
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
                tries = turn * along * Rotation.from_euler("xz", rng.uniform((-2.6, -0.3), (2.6, 0.3), (6, 2)))
                tips = np.array([t.apply(scale * mesh.samples).mean(axis=0) for t in tries]) + at
                clear = tips[:, 2] - support.at(tips[:, :2])
                best = int(np.argmax(clear))
                if clear[best] > 0.06:  # not into the heap
                    yield self._instance(index, mesh, at, tries[best].as_quat(), scale)
                    index += 1


class Debris(_Rubble):
    """Patches of chips on the ground, which are seen and not touched; most about the foot of the heaps."""

    def __init__(self, name: str, density: float = 0.0, count: int | None = None):
        super().__init__(name, "debris", density, count)

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        number, meshes, ground = self._number(terrain), kinds()["debris"], terrain.ground
        if number == 0:
            return
        weight, reach = 1.12 - _buildings(terrain, self.name).maps["street"], 0.5
        inner = np.array(terrain.size) - 2.0 * 1.3 * reach
        at = spread(weight, (float(inner[0]), float(inner[1])), 2 * number, 0.15, rng)
        turns = np.arange(8) * 0.25 * math.pi
        ring = reach * np.column_stack([np.cos(turns), np.sin(turns)])
        around = ground.height_at(*np.moveaxis(at[:, None] + ring, 2, 0))
        rise = around @ ring / (4.0 * reach * reach)  # of the plane that fits the ring best
        high = ground.height_at(*at.T)
        left = (np.abs(around - high[:, None] - rise @ ring.T)).max(axis=1)
        even = np.sort(np.argsort(left, kind="stable")[:number])  # chips are seen to hover over crests
        at, rise, high = at[even], rise[even], high[even]
        up = np.column_stack([-rise, np.ones(len(at))])
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        half = np.column_stack([-up[:, 1], up[:, 0], np.zeros(len(at)), 1.0 + up[:, 2]])  # from the z axis to it
        turn = Rotation.from_quat(half) * Rotation.from_euler("z", rng.uniform(-math.pi, math.pi, (len(at), 1)))
        place = np.column_stack([at, high])
        for index, quat in enumerate(turn.as_quat()):
            mesh = meshes[int(rng.integers(len(meshes)))]
            yield self._instance(index, mesh, place[index], quat, float(rng.uniform(0.7, 1.3)))
