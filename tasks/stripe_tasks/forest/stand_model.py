# SPDX-License-Identifier: Apache-2.0
"""Stand model: the rules by which trees compete, grow, die and spread, step by step; :mod:`.growth` runs it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from .darts import Size, sample_map
from .traits import BREAST_HEIGHT, SpeciesTraits, columns, site_suitability

__all__ = ["StandModel", "competition_index"]

_TRUNK_GAP = 0.3  # least distance between the surfaces of two trunks [m]
_SEED_RAIN = 0.05  # share of the seeds that come from far away
_STORMS = 0.007  # share of the trees that wind, snow and beetles kill each year
_SAPLING = 0.04  # added to diameters in competition [m], so that saplings count beside trunks
_REACH = 6.0  # largest distance of competition and shade [m]


def _pairs(position: np.ndarray, size: tuple[float, float], reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Pairs ``(P, 2)`` of trees nearer than ``reach``, and their distances ``(P,)`` [m], across the edges too."""
    pairs = cKDTree(position, boxsize=size).query_pairs(reach, output_type="ndarray")
    offset = np.abs(position[pairs[:, 0]] - position[pairs[:, 1]])
    return pairs, np.linalg.norm(np.minimum(offset, np.array(size) - offset), axis=1)


def competition_index(
    position: np.ndarray, diameter: np.ndarray, size: tuple[float, float], reach: float
) -> np.ndarray:
    """Hegyi's index ``sum_j (d_j / d_i) / (l_ij + 1)`` over neighbours nearer than ``reach`` [m], shape ``(N,)``.

    ``position`` is ``(N, 2)`` in ``[0, size)``, ``diameter`` ``(N,)`` [m]; ``l`` is the distance [m]. The 1 m, a common
    variant, keeps near neighbours from counting without bound.
    """
    pairs, distance = _pairs(position, size, reach)
    return _hegyi(pairs, distance, diameter)


def _hegyi(pairs: np.ndarray, distance: np.ndarray, diameter: np.ndarray) -> np.ndarray:
    """Hegyi's index of each tree, from pairs of neighbours."""
    i, j = pairs.T
    near = 1.0 / (distance + 1.0)
    index = np.bincount(i, near * diameter[j], len(diameter)) + np.bincount(j, near * diameter[i], len(diameter))
    return index / diameter


def _rank_within_kind(kind: np.ndarray) -> np.ndarray:
    """For each entry, the number of entries of its kind before it."""
    order = np.argsort(kind, kind="stable")
    first = np.searchsorted(kind[order], kind[order])
    rank = np.empty(len(kind), dtype=int)
    rank[order] = np.arange(len(kind)) - first
    return rank


class _Trees:
    """Living trees, as arrays that are filtered and extended together."""

    names = ("position", "species", "age", "stage", "height", "diameter", "site", "vigour")

    def __init__(self) -> None:
        self.position, self.species = np.zeros((0, 2)), np.zeros(0, dtype=np.int32)
        # stage: the age at which a tree without neighbours is as tall
        self.age, self.stage, self.height = np.zeros(0), np.zeros(0), np.zeros(0)
        self.diameter, self.site, self.vigour = np.zeros(0), np.zeros(0), np.zeros(0)

    def keep(self, mask: np.ndarray) -> None:
        for name in self.names:
            setattr(self, name, getattr(self, name)[mask])

    def add(self, **new: np.ndarray) -> None:
        for name in self.names:
            setattr(self, name, np.concatenate([getattr(self, name), new[name]]))


class StandModel:
    """Stand that grows step by step. Positions are in ``[0, size)`` and wrap around.

    Args:
        size: Extent of the field [m].
        kinds: Traits of the species by name.
        shares: Share of each species among the stems, summing to 1.
        target: Number of stems in the end.
        maps: Maps ``moisture`` and ``slope``, if there are any.
        seed: Seed of the random numbers.
    """

    def __init__(
        self, size: Size, kinds: Mapping[str, SpeciesTraits], shares: np.ndarray, target: int,
        maps: Mapping[str, np.ndarray], seed: int,
    ):  # fmt: skip
        self.size, self.maps, self.shares = size, maps, shares
        self.rng = np.random.default_rng(seed)
        self.kinds = list(kinds.values())
        self.of = columns(self.kinds)
        self.sapling_age = np.array([t.age_at(BREAST_HEIGHT + 0.1) for t in self.kinds])
        # competition index that halves the growth of a species
        self.endures = 0.9 + 1.8 * self.of["shade_tolerance"]
        spacing = math.sqrt(size[0] * size[1] / max(target, 1))
        self.reach = min(_REACH, 2.0 * spacing + 1.0, 0.45 * min(size))
        self.trees = _Trees()
        # Chances to come up are relative to the mean site of a species: rare good sites do not make it rare.
        places = self.rng.random((4096, 2)) * np.array(size)
        means = [self.suitability(places, np.full(4096, k)).mean() for k in range(len(self.kinds))]
        self.mean_site = np.array(means)
        for name, mean in zip(kinds, means):
            if mean <= 0.0:
                raise ValueError(
                    f"no place of the field suits '{name}': all of it is too steep; take it out of the mix"
                )

    def suitability(self, position: np.ndarray, species: np.ndarray) -> np.ndarray:
        """Suitability of each position for its species, in [0, 1]."""
        centred = position - 0.5 * np.array(self.size)
        read = {name: sample_map(values, self.size, centred) for name, values in self.maps.items()}
        good = np.ones(len(position))
        for kind, traits in enumerate(self.kinds):
            own = species == kind
            good[own] = site_suitability(traits, **{name: v[own] for name, v in read.items()})
        return good

    def light(self, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Share of the light that reaches the ground at positions, and a mask of those clear of trunks.

        Beer-Lambert law (Monsi and Saeki 1953) through crowns that thin out toward their rims.
        """
        trees = self.trees
        leaves: np.ndarray = np.zeros(len(position))
        clear = np.ones(len(position), dtype=bool)
        if len(trees.position) and len(position):
            here, there = cKDTree(position, boxsize=self.size), cKDTree(trees.position, boxsize=self.size)
            near = here.sparse_distance_matrix(there, self.reach, output_type="ndarray")
            i, j, distance = near["i"], near["j"], near["v"]
            # leaves thin out linearly to 1.2 crown radii; 5 is the leaf area index in the middle
            crown = 1.2 * self.crown_radius()[j]
            leaves = np.bincount(i, 5.0 * np.maximum(1.0 - distance / crown, 0.0), len(position))
            clear[i[distance < 0.5 * trees.diameter[j] + 0.5]] = False
        return np.exp(-0.5 * leaves), clear

    def crown_radius(self) -> np.ndarray:
        """Radius of each crown [m], narrower among neighbours."""
        kind, trees = self.trees.species, self.trees
        wide = self.of["crown_scale"][kind] * trees.diameter ** self.of["crown_exponent"][kind]
        return wide * (0.6 + 0.4 * trees.vigour)

    def seeds(self, count: int, shares: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Positions and species of ``count`` seeds; species are drawn by ``shares``, by default those of the mix.

        Seeds fall around mature trees of their species, more of them around large crowns; some come from far away.
        """
        rng, trees = self.rng, self.trees
        species = rng.choice(len(self.kinds), count, p=self.shares if shares is None else shares).astype(np.int32)
        position = rng.random((count, 2)) * np.array(self.size)
        mature = trees.stage > self.of["maturity"][trees.species]
        # in each step few trees have a good year
        crop = self.crown_radius() ** 2 * rng.lognormal(0.0, 3.0, len(mature))
        near = rng.random(count) > _SEED_RAIN
        for kind in range(len(self.kinds)):
            bearing = np.flatnonzero(mature & (trees.species == kind))
            own = np.flatnonzero(near & (species == kind))
            if not len(bearing) or not len(own):
                continue
            parent = bearing[rng.choice(len(bearing), len(own), p=crop[bearing] / crop[bearing].sum())]
            # 2Dt kernel with p = 1: P(r < R) = R^2 / (u + R^2), whose median is sqrt(u)
            u = rng.random(len(own))
            r = np.minimum(self.of["dispersal"][kind] * np.sqrt(u / (1.0 - u)), 500.0)
            turn = rng.random(len(own)) * 2.0 * math.pi
            position[own] = trees.position[parent] + r[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        return self.wrap(position), species

    def present(self) -> np.ndarray:
        """Number of stems of each species."""
        return np.bincount(self.trees.species, minlength=len(self.kinds))

    def scarcity(self) -> np.ndarray:
        """Requested share of each species divided by its share of the stems, in [0.1, 10]."""
        present = self.present() / max(len(self.trees.species), 1)
        return np.clip(self.shares / np.maximum(present, 1.0e-6), 0.1, 10.0)

    def wanted(self, count: int, possible: np.ndarray) -> np.ndarray:
        """Number of each ``possible`` species among ``count`` new stems: those that are scarcest get the most."""
        lack = np.where(
            possible, np.maximum(self.shares * (len(self.trees.species) + count) - self.present(), 0.0), 0.0
        )
        if lack.sum() <= 0.0:
            lack = np.where(possible, self.shares, 0.0)
        ends = np.rint(np.cumsum(lack) / lack.sum() * count).astype(int)
        return np.diff(ends, prepend=0)

    def wrap(self, position: np.ndarray) -> np.ndarray:
        """Wrap positions into the field."""
        size = np.array(self.size)
        position = np.mod(position, size)
        return np.where(position >= size, 0.0, position)  # mod of a tiny negative number rounds up to the size itself

    def establish(self, count: int) -> None:
        """Plant up to ``count`` saplings of breast height: of many seeds those with light, a suitable site and room.

        :meth:`wanted` gives the number of each species. Where a species finds no room, others take its place.
        """
        possible = np.ones(len(self.kinds), dtype=bool)
        for _ in range(30):
            if count <= 0:
                return
            wanted = self.wanted(count, possible)
            position, species = self.seeds(6 * count + 64, wanted / count)
            light, clear = self.light(position)
            # saplings of shade-tolerant species need 2 % of the light, others up to 37 %
            need = 0.35 * (1.0 - self.of["shade_tolerance"][species]) + 0.02
            site = self.suitability(position, species)
            chance = site / self.mean_site[species] * np.clip((light - need) / (1.0 - need), 0.01, 1.0) * clear
            # Exponential race: the order of arrival draws without replacement, with weights ``chance``.
            rank = np.argsort(self.rng.exponential(size=len(chance)) / np.maximum(chance, 1.0e-12), kind="stable")
            rank = rank[chance[rank] > 1.0e-6]
            rank = rank[_rank_within_kind(species[rank]) < 2 * wanted[species[rank]]]
            position, species, site = position[rank], species[rank], site[rank]
            # of two seeds within 0.4 m the later one in the ranking goes
            pairs, _ = _pairs(position, self.size, 0.4)
            alone = np.ones(len(rank), dtype=bool)
            alone[pairs.max(axis=1)] = False
            chosen = np.flatnonzero(alone)
            chosen = chosen[_rank_within_kind(species[chosen]) < wanted[species[chosen]]]
            self.plant(position[chosen], species[chosen], site[chosen])
            count -= len(chosen)
            possible &= (wanted == 0) | (np.bincount(species[chosen], minlength=len(wanted)) > 0)
            possible |= not possible.any()  # none found room: try all of them once more, with other seeds

    def plant(self, position: np.ndarray, species: np.ndarray, site: np.ndarray) -> None:
        """Add trees of breast height at positions of suitability ``site``."""
        stage = self.sapling_age[species] * np.ones(len(species))
        height = self.by_species("height_at", species, stage)
        diameter = self.by_species("diameter_at", species, height)
        age = stage + self.rng.random(len(species)) * 2.0
        self.trees.add(
            position=position, species=species, age=age, stage=stage, height=height, diameter=diameter, site=site,
            vigour=np.full(len(species), 0.5),
        )  # fmt: skip

    def by_species(self, method: str, species: np.ndarray, argument: np.ndarray) -> np.ndarray:
        """Result of ``method`` of each tree's traits for its ``argument``."""
        result = np.zeros(len(species))
        for kind, traits in enumerate(self.kinds):
            own = species == kind
            result[own] = getattr(traits, method)(argument[own])
        return result

    def compete(self) -> tuple[np.ndarray, np.ndarray]:
        """Update the vigour of all trees; return pairs of neighbours and their distances [m]."""
        trees = self.trees
        pairs, distance = _pairs(trees.position, self.size, self.reach)
        index = _hegyi(pairs, distance, trees.diameter + _SAPLING)
        trees.vigour = np.maximum(trees.site / (1.0 + index / self.endures[trees.species]), 0.01)
        return pairs, distance

    def advance(self, years: float, stems: int, fresh: int) -> None:
        """Advance by a step: growth, deaths, and new trees up to ``stems``, at least ``fresh`` if there is room."""
        trees = self.trees
        pairs, distance = self.compete()
        # Growth: a tree moves along the height curve of its species, more slowly the less vigour it has.
        trees.stage = trees.stage + years * np.minimum(1.25 * trees.vigour, 1.0)
        height = self.by_species("height_at", trees.species, trees.stage)
        thicker = self.by_species("diameter_at", trees.species, height)
        thicker -= self.by_species("diameter_at", trees.species, trees.height)
        # crowded trees grow slender
        trees.diameter = trees.diameter + (0.5 + 0.6 * trees.vigour) * thicker
        trees.height = height
        # Death by age: one in fifty reaches the longevity, as in Botkin et al. 1972, J. Ecol. 60. There the hazard is
        # constant, here it rises with the square of the age (Weibull's law), which is our choice.
        # Death by storms: the same hazard for all.
        ends = self.of["longevity"][trees.species]
        hazard = 3.9 * (((trees.age + years) / ends) ** 3 - (trees.age / ends) ** 3) + _STORMS * years
        alive = self.rng.random(len(hazard)) > 1.0 - np.exp(-hazard)
        trees.age = trees.age + years
        # Of two trunks that touch, the thinner one dies.
        i, j = pairs[distance < 0.5 * trees.diameter[pairs].sum(axis=1) + _TRUNK_GAP].T
        alive[np.where(trees.diameter[i] < trees.diameter[j], i, j)] = False
        trees.keep(alive)
        # Death by suppression: an exponential race in which weak trees are fast.
        excess = len(trees.age) - max(stems - fresh, 0)
        if excess > 0:
            race = (
                self.rng.exponential(size=len(trees.age)) * np.exp(8.0 * trees.vigour) * self.scarcity()[trees.species]
            )
            alive = np.ones(len(race), dtype=bool)
            alive[np.argsort(race, kind="stable")[:excess]] = False
            trees.keep(alive)
        self.establish(stems - len(trees.age))
