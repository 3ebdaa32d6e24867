# SPDX-License-Identifier: Apache-2.0
"""Assets of the forest: specifications of trees, rocks, stumps, lying wood and undergrowth.

All work on terrains of :class:`stripe_tasks.forest.ForestSpec`, whose maps they read: ``moisture`` in [0, 1], ``slope``
[rad] and ``open``, the share of each place that is kept free of trees. Sizes are in metres, densities per hectare.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from stripe_newton.specifications import AssetInstance, AssetSpec, DynamicMesh, TerrainInstance
from stripe_newton.specifications.places import footprints

from .growth import SPECIES, GrowthCfg, grow
from .library import BRANCHES, LOGS, ROCK_RADIUS, kinds, tree_choice, tree_meshes
from .lying import clashes, crossed, floating, on_path
from .placement import lie_on_slope, patch_map, sample_map, scatter

__all__ = ["Lying", "Rocks", "Stumps", "Trees", "Undergrowth"]

HECTARE = 1.0e4


def _area(terrain: TerrainInstance) -> float:
    """Area of the field [m^2]."""
    return terrain.size[0] * terrain.size[1]


def _on_ground(terrain: TerrainInstance, xy: np.ndarray) -> np.ndarray:
    """Points ``(N, 3)`` on the ground at positions ``(N, 2)`` [m]."""
    return np.column_stack([xy, terrain.ground.height_at(xy[:, 0], xy[:, 1])])


def _yaw(angle: np.ndarray) -> np.ndarray:
    """Quaternions (x, y, z, w) of turns about z [rad]."""
    zero = np.zeros_like(angle)
    return np.column_stack([zero, zero, np.sin(0.5 * angle), np.cos(0.5 * angle)])


def _untrodden(terrain: TerrainInstance, shape: tuple[int, ...]) -> np.ndarray:
    """Map of the share of the ground that is not trodden, with the given shape."""
    if "trodden" not in terrain.maps:
        return np.ones(shape)
    x, y = (np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(terrain.size, shape[::-1], strict=True))
    trodden = sample_map(terrain.maps["trodden"], terrain.size, np.stack(np.meshgrid(x, y), axis=-1))
    return np.clip(1.0 - trodden, 0.0, 1.0)


def _discs(terrain: TerrainInstance, *names: str) -> tuple[np.ndarray, np.ndarray]:
    """Positions and radii of the assets of other specs [m]."""
    there = [i for name in names for i in terrain.placed.get(name, ())]
    at = np.array([i.position[:2] for i in there]).reshape(-1, 2)
    return at, np.array([i.scale * getattr(i.mesh, "radius", 0.0) for i in there])


class _ForestAssets(AssetSpec):
    """Base of the forest's assets, given by number or density.

    Args:
        name: An identifier, unique within the scene.
        density: Number per hectare.
        count: Number in all; overrides ``density``.
    """

    def __init__(self, name: str, density: float = 0.0, count: int | None = None):
        super().__init__(name)
        if not 0.0 <= density < math.inf:
            raise ValueError(f"asset '{name}': density is {density}, must be 0 or more [1/ha]")
        if count is not None and (count != int(count) or count < 0):
            raise ValueError(f"asset '{name}': count is {count}, must be a whole number, 0 or more")
        self.density, self.count = density, None if count is None else int(count)

    def _number(self, terrain: TerrainInstance) -> int:
        return round(self.density * _area(terrain) / HECTARE) if self.count is None else self.count

    def _make(
        self, meshes: Iterable[DynamicMesh], at: np.ndarray, turn: np.ndarray, scale: np.ndarray
    ) -> Iterator[AssetInstance]:
        """Instances of meshes at positions ``(N, 3)``, with orientations ``(N, 4)`` and scales ``(N,)``."""
        for index, (mesh, place, quat, size) in enumerate(zip(meshes, at, turn, scale, strict=True)):
            yield self.create_instance(f"{self.name}_{index}", mesh, place, quat, float(size))


class Trees(_ForestAssets):
    """Stand of trees, grown on its site by :func:`stripe_tasks.forest.growth.grow`.

    Args:
        name: An identifier.
        density: Stems per hectare of wooded ground.
        count: Stems in all; overrides ``density``.
        years: Age of the stand.
        mix: Shares of the species among the stems.
    """

    def __init__(
        self,
        name: str,
        density: float = 600.0,
        count: int | None = None,
        years: float = 120.0,
        mix: Mapping[str, float] | None = None,
    ):
        super().__init__(name, density, count)
        self.years, self.mix = years, dict(GrowthCfg().mix if mix is None else mix)
        GrowthCfg(years=years, mix=self.mix).validate()
        unknown = sorted(set(self.mix) - set(SPECIES))
        if unknown:
            raise ValueError(f"asset '{name}': mix has no known species {unknown[0]!r}; known are {', '.join(SPECIES)}")

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        maps, size = terrain.maps, terrain.size
        wooded = 1.0 - float(maps["open"].mean())
        number = self._number(terrain) if self.count is not None else round(self._number(terrain) * wooded)
        if number == 0:
            return
        # one seed for all tries: a larger stand is another stand, but always the same one
        seed = int(rng.integers(1 << 31))
        more = 1.0
        # Trees on ground that is kept open are dropped, so more are grown than asked for, until enough are left.
        while True:
            cfg = GrowthCfg(
                size=size, count=math.ceil(more * number / wooded), years=self.years, mix=self.mix, seed=seed
            )
            stand = grow(cfg, maps["moisture"], maps["slope"])
            free = np.flatnonzero(sample_map(maps["open"], size, stand.position) < 0.5)
            if len(free) >= number:
                break
            more *= 1.05
        keep = free if len(free) == number else np.sort(rng.permutation(free)[:number])
        # A tree is the mesh of its species with the nearest height, scaled; the variant is drawn.
        which, scale = tree_choice(stand.height[keep])
        variant = rng.integers(0, 1 << 16, number)
        meshes: list[DynamicMesh] = []
        library = tree_meshes()
        for species, row, pick in zip(stand.species[keep], which, variant, strict=True):
            there = library[stand.species_names[species]][row]
            meshes.append(there[pick % len(there)])
        at = _on_ground(terrain, stand.position[keep])
        yield from self._make(meshes, at, _yaw(rng.uniform(-math.pi, math.pi, number)), scale)


class Rocks(_ForestAssets):
    """Boulders: more of them on slopes, and more small ones than large ones.

    Args:
        name: An identifier.
        density: Number per hectare.
        count: Number in all; overrides ``density``.
        radius: Smallest and largest radius [m].
    """

    def __init__(
        self, name: str, density: float = 60.0, count: int | None = None, radius: tuple[float, float] = (0.1, 0.7)
    ):
        super().__init__(name, density, count)
        if not 0.0 < radius[0] <= radius[1] < math.inf:
            raise ValueError(f"asset '{name}': radius is {radius}, must be the smallest and the largest, above 0 [m]")
        self.radius = radius

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        number, meshes = self._number(terrain), kinds()["rock"]
        weight = 0.3 + np.clip(terrain.maps["slope"] / math.radians(25.0), 0.0, 1.0)
        low, high = self.radius
        # log-uniform, with the square of the draw in favour of small ones
        radius = low * (high / low) ** (rng.random(number) ** 2)
        weight, avoid = weight * _untrodden(terrain, weight.shape), _discs(terrain, "trees")
        at, _ = scatter(terrain.size, rng, count=number, weight=weight, radius=radius, avoid=avoid)
        pick = rng.integers(0, len(meshes), number)
        turn = _yaw(rng.uniform(-math.pi, math.pi, number))
        yield from self._make([meshes[i] for i in pick], _on_ground(terrain, at), turn, radius / ROCK_RADIUS)


class Stumps(_ForestAssets):
    """Stumps of felled trees."""

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        number, meshes = self._number(terrain), kinds()["stump"]
        pick, scale = rng.integers(0, len(meshes), number), rng.uniform(0.8, 1.2, number)
        room = scale * np.array([m.radius for m in meshes])[pick]
        weight, avoid = _untrodden(terrain, terrain.ground.heights.shape), _discs(terrain, "trees", "rocks")
        at, _ = scatter(terrain.size, rng, count=number, weight=weight, radius=room, avoid=avoid)
        turn = _yaw(rng.uniform(-math.pi, math.pi, number))
        yield from self._make([meshes[i] for i in pick], _on_ground(terrain, at), turn, scale)


class Lying(_ForestAssets):
    """Lying wood: fallen trunks or branches, at rest on the slope, between the trees.

    Args:
        name: An identifier.
        kind: ``"log"`` or ``"branch"``, which is thin enough to trip over.
        density: Number per hectare.
        count: Number in all; overrides ``density``.
    """

    def __init__(self, name: str, kind: str, density: float = 0.0, count: int | None = None):
        super().__init__(name, density, count)
        if kind not in ("log", "branch"):
            raise ValueError(f"asset '{name}': kind is '{kind}', must be 'log' or 'branch'")
        self.kind, self.sizes = kind, np.array(LOGS if kind == "log" else BRANCHES)

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        number, meshes = self._number(terrain), kinds()[self.kind]
        if number == 0:
            return
        pick, scale = rng.integers(0, len(meshes), number), rng.uniform(0.8, 1.15, number)
        length, radius = (self.sizes[pick % len(self.sizes)] * scale[:, None]).T
        at, yaw = np.zeros((number, 2)), np.zeros(number)
        # Beyond this, throwing anew would hardly ever end.
        if (2.0 * radius * length).sum() > 0.5 * _area(terrain):
            raise ValueError(f"asset '{self.name}': {number} find no room, they would cover half of it; ask for fewer")
        circles = footprints(terrain)
        discs, room = (
            np.concatenate(both)
            for both in zip(_discs(terrain, *terrain.placed), (circles[:, :2], circles[:, 2]), strict=True)
        )
        left = np.arange(number)
        for _ in range(50):  # those that hit something are placed anew, until all lie clear
            if not len(left):
                break
            half = 0.5 * np.array(terrain.size) - 0.5 * length[left, None]
            at[left] = rng.uniform(-1.0, 1.0, (len(left), 2)) * half
            yaw[left] = rng.uniform(-math.pi, math.pi, len(left))
            hit = np.zeros(number, dtype=bool)
            hit[left] = crossed(at[left], yaw[left], length[left], radius[left], discs, room)
            hit[left] |= on_path(terrain, at[left], yaw[left], length[left])
            fresh = np.zeros(number, dtype=bool)
            fresh[left] = True
            # of two that overlap, the one just placed is placed anew; of two such, the later one
            pairs = clashes(at, yaw, length, radius, fresh)
            hit[np.where(fresh[pairs[:, 1]], pairs[:, 1], pairs[:, 0])] = True
            left = np.flatnonzero(hit)
        else:
            if len(left):
                raise ValueError(f"asset '{self.name}': {len(left)} of {number} find no room; ask for fewer")
        place, turn = lie_on_slope(terrain.ground.heights, terrain.size, at, yaw, length, radius)
        chosen = [meshes[i] for i in pick]
        # The pose is that of a straight log: a bent one would float over a slope across it.
        for index, mesh in enumerate(chosen):
            place[index, 2] -= max(floating(terrain, mesh, place[index], turn[index], scale[index]), 0.0)
        yield from self._make(chosen, place, turn, scale)


class Undergrowth(_ForestAssets):
    """Undergrowth: bushes, ferns or grass in patches, without colliders.

    Args:
        name: An identifier.
        kind: ``"bush"``, ``"fern"`` or ``"grass"``.
        density: Number per hectare.
        count: Number in all; overrides ``density``.
        patch: Width of a patch [m].
        cover: Share of the ground that has any of it.
        wet: Preference for wet ground: 0 for none, 1 if it grows on wet ground alone.
    """

    def __init__(
        self,
        name: str,
        kind: str,
        density: float = 0.0,
        count: int | None = None,
        patch: float = 6.0,
        cover: float = 0.4,
        wet: float = 0.0,
    ):
        super().__init__(name, density, count)
        if kind not in ("bush", "fern", "grass"):
            raise ValueError(f"asset '{name}': kind is '{kind}', must be 'bush', 'fern' or 'grass'")
        if not (0.0 < patch < math.inf and 0.0 < cover <= 1.0 and 0.0 <= wet <= 1.0):
            raise ValueError(
                f"asset '{name}': patch is {patch}, cover {cover}, wet {wet}; must be above 0 [m], in (0, 1], in [0, 1]"
            )
        self.kind, self.patch, self.cover, self.wet = kind, patch, cover, wet

    def generate(self, terrain: TerrainInstance, rng: np.random.Generator) -> Iterator[AssetInstance]:
        number, meshes, size = self._number(terrain), kinds()[self.kind], terrain.size
        # a grid of half a metre: patches are wider than that
        rows, cols = (max(8, math.ceil(s / 0.5)) for s in size[::-1])
        shape = rows, cols
        weight = patch_map(shape, size, rng, self.patch, self.cover)
        x, y = (np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(size, shape[::-1], strict=True))
        grid = np.stack(np.meshgrid(x, y), axis=-1)
        moist = sample_map(terrain.maps["moisture"], size, grid)
        # never 0 everywhere, so that the number asked for always finds places
        weight = weight * (1.0 - self.wet + self.wet * np.clip(moist - 0.2, 0.0, 1.0)) + 1.0e-4
        weight = weight * _untrodden(terrain, shape)
        at = _draw(weight, size, number, rng)
        pick, scale = rng.integers(0, len(meshes), number), rng.uniform(0.7, 1.3, number).round(2)  # few sizes
        turn = _yaw(rng.uniform(-math.pi, math.pi, number))
        yield from self._make([meshes[i] for i in pick], _on_ground(terrain, at), turn, scale)


def _draw(weight: np.ndarray, size: tuple[float, float], count: int, rng: np.random.Generator) -> np.ndarray:
    """Points drawn from a density map, uniform within each cell, ``(count, 2)`` [m]."""
    cell = rng.choice(weight.size, count, p=(weight / weight.sum()).ravel())
    row, col = np.divmod(cell, weight.shape[1])
    at = (np.column_stack([col, row]) + rng.random((count, 2))) / np.array(weight.shape[::-1])
    return np.asarray((at - 0.5) * np.array(size))
