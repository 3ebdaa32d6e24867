# SPDX-License-Identifier: Apache-2.0
"""Pair division: the pairs of geoms whose contacts the fused step finds, and the kinds of pairs that it leaves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from mujoco_warp._src.types import BroadphaseType, ContactType

from .contact_pairs import ContactPair, contact_pairs, is_of_hulls, listed_pairs
from .pair_list import remove_geom_pairs
from .static_triangles import StaticTriangles

if TYPE_CHECKING:
    from .solver_fused import SolverFused

__all__ = ["PairDivision"]

_MOST_PAIRS = 4096
"""Pairs of geoms that the kernel looks at in each step; of more, MuJoCo Warp sorts the geoms along an axis."""
_MOST_HULL_PAIRS = 1024
"""Pairs of hulls that the kernel looks at; more, as of bodies in many convex parts, are left to MuJoCo Warp."""


@dataclass
class PairDivision:
    """Division of a model's pairs of geoms between the kernel and collision detection by others."""

    pairs: list[ContactPair] = field(default_factory=list)
    """Pairs whose contacts the kernel finds; those of static meshes stand for groups of them."""
    external_kinds: list[str] = field(default_factory=list)
    """Kinds of pairs whose contacts others find."""
    hull_kinds: list[str] = field(default_factory=list)
    """Kinds of pairs with a static mesh of which the kernel does not find contacts with triangles."""
    statics: StaticTriangles | None = None
    """Static meshes whose triangles the kernel looks at."""

    @classmethod
    def of(cls, solver: SolverFused) -> PairDivision:
        """Divide the pairs of a solver. Those that the kernel takes are taken from MuJoCo Warp's list.

        Args:
            solver: The solver, before its first step.
        """
        cpu, model = solver.mj_model, solver.mjw_model
        if cpu.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
            return cls()
        if not solver.uses_mujoco_contacts:
            contact = solver.mjw_data.contact
            contact.type.fill_(int(ContactType.CONSTRAINT))  # Newton's are for the solver
            contact.geomcollisionid.zero_()
            return cls(external_kinds=["all pairs, through Newton's collision detection"])
        # Above some number of geoms MuJoCo Warp has no list to take pairs from.
        is_listed = model.opt.broadphase == BroadphaseType.NXN
        listed = _listed(solver) if is_listed else list(contact_pairs(cpu))
        made = cls(listed)
        if solver.static_triangles:
            made._group_meshes(solver)
        finds = _routine_test(solver, made.pairs)
        rest = [pair for pair in made.pairs if not finds(pair)]
        made.external_kinds = sorted({_types(cpu, pair) for pair in rest})
        if model.callback.contactfilter:
            made.external_kinds.append("what its contact filter adds")
        if not is_listed and (made.external_kinds or len(made.pairs) > _MOST_PAIRS):
            return cls([], ["all pairs of its many geoms"], made.hull_kinds, made.statics)
        if is_listed and len(rest) < len(listed):
            kept = {(p.geom1, p.geom2) for p in rest} | {(p.geom2, p.geom1) for p in rest}
            remove_geom_pairs(model, np.array([(p.geom1, p.geom2) not in kept for p in listed], dtype=bool))
        made.pairs = [pair for pair in made.pairs if finds(pair)]
        return made

    def _group_meshes(self, solver: SolverFused) -> None:
        """Replace pairs of static meshes by pairs of groups of them."""
        shapes = solver.mjc_geom_to_newton_shape.numpy()[0]
        self.statics = StaticTriangles(solver.mj_model, solver.model, shapes, self.pairs, solver.stand_ins)
        self.hull_kinds = sorted({_types(solver.mj_model, pair) for pair in self.statics.unsupported})
        self.pairs = self.statics.pairs


def _listed(solver: SolverFused) -> list[ContactPair]:
    """The pairs in MuJoCo Warp's list."""
    geoms, explicit = solver.mjw_model.nxn_geom_pair_filtered.numpy(), solver.mjw_model.nxn_pairid_filtered.numpy()
    return list(listed_pairs(solver.mj_model, geoms, explicit[:, 0]))


def _routine_test(solver: SolverFused, pairs: Sequence[ContactPair]) -> Callable[[ContactPair], bool]:
    """Test of whether the kernel has a routine for a pair, and is to use it.

    Args:
        solver: The solver.
        pairs: All pairs.
    """
    few_hulls = sum(is_of_hulls(pair.kind) for pair in pairs) <= _MOST_HULL_PAIRS
    meshes = solver.mjw_model.geom_dataid.numpy()
    varied = set(np.flatnonzero((meshes != meshes[0]).any(axis=0)).tolist())  # the kernel has one mesh of each geom

    def finds(pair: ContactPair) -> bool:
        if is_of_hulls(pair.kind):
            return few_hulls and not varied & {pair.geom1, pair.geom2}
        return bool(pair.kind) and (solver.triangles or not pair.kind.startswith("FIELD"))

    return finds


def _types(model: mujoco.MjModel, pair: ContactPair) -> str:
    types = (mujoco.mjtGeom(model.geom_type[g]).name for g in (pair.geom1, pair.geom2))
    return " and ".join(name.removeprefix("mjGEOM_").lower() for name in types)
