# SPDX-License-Identifier: Apache-2.0
"""Growth of a stand: an individual-based, distance-dependent model, from seedlings to the trees that are left.

In steps of a few years, trees age and grow, more slowly among larger neighbours (index of Hegyi 1974, in Growth models
for tree and stand simulation). They die of age, of trunks that touch, and of suppression. They shed seeds around
themselves (kernel of Clark et al. 1999, Ecology 80), which come up where light, moisture and slope suit them.

Two things are imposed on the model: the number of stems, which follows a curve to the requested number, and the shares
of the species. New trees are of the species that bring the shares nearest to the requested mix, and among crowded trees
those of scarce species die less often. Which trees die and where new ones stand is up to the model: short-lived species
of the open are then many young trees in gaps, with a smaller share of the wood. Distances wrap around the field, so
that stands look the same up to the edges.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from stripe_newton.configclass import configclass

from .darts import check_map, check_size
from .stand_model import StandModel, competition_index
from .traits import SPECIES, SpeciesTraits

__all__ = ["SPECIES", "GrowthCfg", "SpeciesTraits", "Stand", "competition_index", "grow"]

_INGROWTH = 0.05  # share of the stems that are new in five years
_START = 0.8  # stems at the start, as a share of those at the end


@configclass
class GrowthCfg:
    """Stand to grow: its field, number of stems, age and species."""

    size: tuple[float, float] = (256.0, 256.0)
    """Extent of the field [m]."""
    density: float | None = 600.0
    """Stems per hectare at the end, counting those that reach breast height."""
    count: int | None = None
    """Stems at the end; overrides ``density``."""
    years: float = 120.0
    """Years from the first trees to the final stand; the oldest trees are some years older."""
    step: float = 5.0
    """Length of a step [years]."""
    mix: dict[str, float] = {"spruce": 0.3, "pine": 0.15, "beech": 0.3, "birch": 0.15, "oak": 0.1}
    """Share of each species among the stems, as far as there are sites that suit it."""
    seed: int = 0
    """Seed of the random numbers."""

    @property
    def stems(self) -> int:
        """Requested number of stems."""
        per_square_metre = (self.density or 0.0) / 1.0e4
        return self.count if self.count is not None else round(per_square_metre * self.size[0] * self.size[1])

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from self._stem_problems()
        if not 0.5 <= self.step <= 20.0:
            yield "step", f"is {self.step}, must be in [0.5, 20] years"
        if not 5.0 <= self.years <= 2000.0:
            yield "years", f"is {self.years}, must be in [5, 2000]"
        shares = list(self.mix.values())
        if not shares or not all(math.isfinite(s) and s >= 0.0 for s in shares) or sum(shares) <= 0.0:
            yield "mix", f"is {self.mix}, must give shares of 0 or more, one of them positive"

    def _stem_problems(self) -> Iterator[tuple[str, str]]:
        """Problems of the field and of the number of stems on it: the first one, as each needs those before solved."""
        if len(self.size) != 2 or not all(math.isfinite(s) and s >= 5.0 for s in self.size):
            yield "size", f"is {self.size}, must be two lengths of 5 m or more"
        elif self.count is None and self.density is None:
            yield "density", "is None, must be given [stems per hectare] where count is not"
        elif not (self.count is not None or 0.0 <= (self.density or 0.0) < math.inf):
            yield "density", f"is {self.density}, must be 0 or more [stems per hectare]"
        elif not 0 <= self.stems <= self.size[0] * self.size[1]:
            name = "density" if self.count is None else "count"
            yield name, f"asks for {self.stems} stems, must be 0 or more and at most one per square metre"


@dataclass(frozen=True, eq=False)
class Stand:
    """Trees of a field that have reached breast height.

    Attributes:
        size: Extent of the field [m].
        species_names: Names of the species, indexed by ``species``.
        position: ``(N, 2)`` [m], the field centred on the origin.
        species: Index of the species, int32 ``(N,)``.
        age: ``(N,)`` [years].
        height: ``(N,)`` [m].
        trunk_radius: ``(N,)``, at breast height [m].
        crown_radius: ``(N,)`` [m].
        vigour: ``(N,)``, growth relative to a tree without neighbours on a good site, in (0, 1].
    """

    size: tuple[float, float]
    species_names: tuple[str, ...]
    position: np.ndarray
    species: np.ndarray
    age: np.ndarray
    height: np.ndarray
    trunk_radius: np.ndarray
    crown_radius: np.ndarray
    vigour: np.ndarray

    def __len__(self) -> int:
        return len(self.position)

    @property
    def density(self) -> float:
        """Stems per hectare."""
        return 1.0e4 * len(self) / (self.size[0] * self.size[1])

    @property
    def basal_area(self) -> float:
        """Cross-section of all trunks at breast height per area [m^2/ha]."""
        return 1.0e4 * math.pi * float((self.trunk_radius**2).sum()) / (self.size[0] * self.size[1])


def _checked_range(name: str, values: np.ndarray, highest: float) -> np.ndarray:
    """Return a map; raise a ValueError if a value lies outside of [0, ``highest``]."""
    checked = check_map(name, values)
    if checked.min() < 0.0 or checked.max() > highest:
        raise ValueError(f"{name} is in [{checked.min():.3g}, {checked.max():.3g}], must be in [0, {highest:.3g}]")
    return checked


def grow(
    cfg: GrowthCfg,
    moisture: np.ndarray | None = None,
    slope: np.ndarray | None = None,
    species: Mapping[str, SpeciesTraits] = SPECIES,
) -> Stand:
    """Grow a stand.

    Args:
        cfg: Stand to grow.
        moisture: Map of soil moisture in [0, 1], ``(rows, cols)``; ``None`` suits all species.
        slope: Map of the ground's slope [rad], ``(rows, cols)``; ``None`` means level ground.
        species: Traits by the names that ``cfg.mix`` uses.

    Raises:
        ConfigError: For a bad config.
        ValueError: For bad maps, a species of no known traits or that no place suits, or when not all stems fit.
    """
    cfg.validate()
    unknown = sorted(set(cfg.mix) - set(species))
    if unknown:
        raise ValueError(f"GrowthCfg.mix: no species {', '.join(map(repr, unknown))}; known are {', '.join(species)}")
    maps = {}
    for name, values, highest in (("moisture", moisture, 1.0), ("slope", slope, 0.5 * math.pi)):
        if values is not None:
            maps[name] = _checked_range(name, values, highest)
    # a species without a share must not be refused for want of sites
    names = tuple(name for name, share in cfg.mix.items() if share > 0.0)
    shares = np.array([cfg.mix[name] for name in names]) / sum(cfg.mix.values())
    model = StandModel(check_size(cfg.size), {n: species[n] for n in names}, shares, cfg.stems, maps, cfg.seed)
    steps = max(1, round(cfg.years / cfg.step))
    years = cfg.years / steps
    fresh = min(0.5, _INGROWTH * years / 5.0)
    model.establish(round(_START * cfg.stems))
    for k in range(1, steps + 1):  # the number of stems is reached after a quarter of the time
        stems = round(cfg.stems * min(1.0, _START + 4.0 * (1.0 - _START) * k / steps))
        model.advance(years, stems, round(fresh * cfg.stems))
    model.compete()
    trees = model.trees
    if len(trees.age) < cfg.stems:
        raise ValueError(
            f"only {len(trees.age)} of {cfg.stems} stems fit into {cfg.size[0]:g} x {cfg.size[1]:g} m; ask for fewer"
        )
    return Stand(
        size=model.size,
        species_names=names,
        position=trees.position - 0.5 * np.array(model.size),
        species=trees.species,
        age=trees.age,
        height=trees.height,
        trunk_radius=0.5 * trees.diameter,
        crown_radius=model.crown_radius(),
        vigour=trees.vigour,
    )
