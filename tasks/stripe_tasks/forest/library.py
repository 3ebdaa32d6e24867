# SPDX-License-Identifier: Apache-2.0
"""Library of the forest's meshes: a few of each kind and size, made once and shared by all instances."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from stripe_newton.specifications import DynamicMesh

from .deadwood import branch, fallen_trunk, stump
from .stones import rock
from .traits import SPECIES
from .trees import tree
from .undergrowth import bush, fern, grass

__all__ = ["LOGS", "ROCK_RADIUS", "TREE_HEIGHTS", "kinds", "tree_choice", "tree_meshes"]

TREE_HEIGHTS = (2.0, 4.5, 9.0, 16.0, 25.0)
"""Heights for which each species has meshes [m]; a tree is one of the nearest height, scaled."""
TREES_EACH = 3
"""Meshes of each species and height."""
ROCK_RADIUS = 0.5
"""Radius of the meshes of rocks [m]; rocks of other sizes are scaled."""
LOGS = ((3.0, 0.10), (4.5, 0.14), (6.5, 0.19))
"""Length and radius of fallen trunks [m]."""
BRANCHES = ((1.2, 0.018), (1.8, 0.025), (2.5, 0.04))
"""Length and radius of branches on the ground [m]."""
_SEED = 20_000


@lru_cache(maxsize=1)
def tree_meshes() -> dict[str, list[list[DynamicMesh]]]:
    """Meshes by species, then by the index of ``TREE_HEIGHTS``."""
    made: dict[str, list[list[DynamicMesh]]] = {}
    for number, (species, traits) in enumerate(SPECIES.items()):
        made[species] = []
        for size, height in enumerate(TREE_HEIGHTS):
            diameter = float(traits.diameter_at(np.array(height)))
            crown = traits.crown_scale * diameter**traits.crown_exponent
            row = []
            for variant in range(TREES_EACH):
                rng = np.random.default_rng([_SEED, number, size, variant])
                row.append(tree(f"{species}_{size}_{variant}", species, height, 0.5 * diameter, crown, rng))
            made[species].append(row)
    return made


def tree_choice(height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For trees of given heights [m]: index into ``TREE_HEIGHTS`` and scale of the mesh, shapes ``(N,)``."""
    sizes = np.log(np.array(TREE_HEIGHTS))
    which = np.abs(np.log(height)[:, None] - sizes).argmin(axis=1)
    return which, height / np.array(TREE_HEIGHTS)[which]


@lru_cache(maxsize=1)
def kinds() -> dict[str, list[DynamicMesh]]:
    """Meshes of everything but trees, by kind."""

    def some(kind: str, count: int, make: Callable[[str, np.random.Generator], DynamicMesh]) -> list[DynamicMesh]:
        return [make(f"{kind}_{i}", np.random.default_rng([_SEED, len(kind), ord(kind[0]), i])) for i in range(count)]

    logs, branches = len(LOGS), len(BRANCHES)
    return {
        "rock": some("rock", 8, lambda n, r: rock(n, ROCK_RADIUS, r, flatness=r.uniform(0.45, 0.8))),
        "stump": some("stump", 4, lambda n, r: stump(n, r.uniform(0.12, 0.28), r.uniform(0.25, 0.55), r)),
        "log": some("log", 2 * logs, lambda n, r: fallen_trunk(n, *LOGS[int(n[4:]) % logs], r)),
        "branch": some("branch", 2 * branches, lambda n, r: branch(n, *BRANCHES[int(n[7:]) % branches], r)),
        "bush": some("bush", 5, lambda n, r: bush(n, r.uniform(0.6, 1.3), r.uniform(0.4, 0.8), r)),
        "fern": some("fern", 5, lambda n, r: fern(n, r.uniform(0.35, 0.65), r)),
        "grass": some("grass", 6, lambda n, r: grass(n, r.uniform(0.12, 0.22), r.uniform(0.18, 0.4), r)),
    }
