# SPDX-License-Identifier: Apache-2.0
"""Limb form: a robot as a hub with limbs, for a form of the fused step in which a lane computes a limb."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import mujoco
import numpy as np

from .contact_pairs import ContactPair, is_searched
from .topology import dof_couplings, dofs_of_body, turned_size

__all__ = ["LimbForm", "why_no_limbs"]

_MOST_LIMBS = 8
_MOST_DOFS = 10, 8
"""Degrees of freedom of the hub, whose system all lanes solve, and of a limb."""
_MOST_PAIRS = 64
"""Pairs of geoms of a limb, which its lane looks at one after another."""
_MOST_STILLS = 8
"""Pairs of a limb with primitives that do not move, up to which its lane is fast enough."""
_MOST_GROUNDS = 2
"""Height fields and meshes whose poses are kept in the state of a world."""
_MOST_SEARCHES, _MOST_LISTED = 28, 128
"""Searches that the lanes of a warp do at a time, and touches that they list: up to 34 and 70 in a furnished flat.

With so many, a multiprocessor that has room for two blocks of quadrupeds keeps 60 KB of its memory as a cache, where a
lane's contacts are.
"""
_MOST_COLUMNS = 10
"""Degrees of freedom of hub and limb for which a lane of a GPU has registers."""
_HITS = {
    "PLANE_SPHERE": 1, "PLANE_CAPSULE": 2, "PLANE_BOX": 4, "PLANE_CYLINDER": 4,
    "SPHERE_SPHERE": 1, "SPHERE_CAPSULE": 1, "SPHERE_BOX": 1, "CAPSULE_CAPSULE": 2, "CAPSULE_BOX": 2, "BOX_BOX": 8,
    "FIELD_SPHERE": 4, "FIELD_HIGH_END": 2, "FIELD_LOW_END": 2, "FIELD_AXIS": 2, "FIELD_BOX": 4, "FIELD_CYLINDER": 4,
    "MESH_SPHERE": 4, "MESH_HIGH_END": 2, "MESH_LOW_END": 2, "MESH_AXIS": 2, "MESH_BOX": 4,
    **{f"MESH_CORNER_{i}": 2 for i in range(8)},
}  # fmt: skip
"""Routines of pairs that it has, and how many contacts each finds at most."""


@dataclass(frozen=True)
class LimbForm:
    """A model as a hub with limbs: chains of bodies that hang on the hub, and touch nothing that moves."""

    model: mujoco.MjModel
    hub: tuple[int, ...]
    """Bodies of the hub, parents before children. It may have no degrees of freedom."""
    limbs: tuple[tuple[int, ...], ...]
    """Degrees of freedom of each limb, from the hub outwards."""
    pairs: tuple[tuple[int, ...], ...]
    """Numbers of the pairs of geoms that each limb looks at; those of the hub are shared out."""
    most_hits: int
    """Contacts that the pairs of a limb can have at most."""
    losses: bool
    """Whether joints have friction loss."""
    planes: tuple[int, ...]
    """Planes that geoms may touch."""
    grounds: tuple[int, ...]
    """Height fields and meshes that they may touch, if these are few."""
    other_grounds: bool
    """Whether they may touch other things: shapes that do not move, height fields."""
    stills: int
    """Most pairs of a limb with primitives that do not move, but for planes."""
    fields: bool
    """Whether geoms may touch height fields."""

    @classmethod
    def of(cls, model: mujoco.MjModel, pairs: Sequence[ContactPair], losses: bool = False) -> LimbForm | None:
        """The form of a model, None where it has none, see :func:`why_no_limbs`.

        Args:
            model: The compiled model.
            pairs: The pairs of geoms that may touch, as the kernel has them.
            losses: Whether joints have friction loss, in any world.
        """
        if why_no_limbs(model, pairs):
            return None
        hub, limbs = _divide(model)
        shares = _share_pairs(model, pairs, limbs)
        most = max(sum(_HITS[pairs[p].kind] for p in share) for share in shares)
        planes = tuple(sorted({pair.geom1 for pair in pairs if _is_plane(pair)}))
        grounds = tuple(sorted({pair.geom1 for pair in pairs if is_searched(pair)}))
        stills = max(sum(not _is_plane(pairs[p]) and not is_searched(pairs[p]) for p in share) for share in shares)
        fields = any(pair.kind.startswith("FIELD") for pair in pairs)
        return cls(model, tuple(hub), tuple(map(tuple, limbs)), tuple(map(tuple, shares)), most, losses, planes,
                   grounds if len(grounds) <= _MOST_GROUNDS else (), not all(map(_is_plane, pairs)), stills,
                   fields)  # fmt: skip

    @property
    def slots(self) -> int:
        """The limbs, up to a power of two."""
        return 1 << (len(self.limbs) - 1).bit_length()

    @property
    def hub_dofs(self) -> list[int]:
        """Degrees of freedom of the hub."""
        return _dofs_within(self.model, self.hub)

    @property
    def limb_dofs(self) -> int:
        """Degrees of freedom of the longest limb."""
        return max(map(len, self.limbs))

    @property
    def suits_gpu(self) -> bool:
        """Whether it is faster on a GPU than the general form.

        A lane has the registers for few degrees of freedom, and looks alone at the pairs of its limb with shapes that
        do not move. On height fields the general form is as fast.
        """
        few = len(self.hub_dofs) + self.limb_dofs <= _MOST_COLUMNS
        return few and len(self.limbs) > 1 and self.stills <= _MOST_STILLS and not self.fields

    @property
    def world_size(self) -> int:
        """Numbers of four bytes in ``World`` of limb_world.h, of which the source asserts that they are no fewer."""
        model, dofs, hub = self.model, max(1, len(self.hub_dofs)), max(1, len(self.hub))
        size = model.nq + 4 * model.nv + max(1, model.nu) + turned_size(model) + 2
        size += 3 * len(set(model.body_rootid.tolist()))
        size += max(7 * model.nbody + 6 * dofs + 12 * hub, 5 * model.nv + model.nq)
        links = (9 if self.losses else 6) * dofs + 11 * (hub + self.slots * self.limb_dofs)
        size += max(links + 6 * max(1, len(self.planes)) + 12 * len(self.grounds), 6 * model.nbody)
        return size + 1 + size % 2

    @staticmethod
    def searches_size(pairs: Sequence[ContactPair]) -> int:
        """Numbers of four bytes in ``WarpSearches`` of limb_search.h; the source asserts that they are enough.

        Args:
            pairs: The pairs of geoms that may touch, as the kernel has them.
        """
        if not any(map(is_searched, pairs)):
            return 0
        touch = 8 if any(pair.kind.startswith("MESH") for pair in pairs) else 7
        return -(-(_MOST_SEARCHES * (21 + 4 * touch + 5) + 64 + _MOST_LISTED + 64 + 2) // 4) * 4

    def sizes(self, max_contacts: int) -> dict[str, int]:
        """Sizes that the source relies on.

        Args:
            max_contacts: Room for contacts in a world.
        """
        model, hub_dofs = self.model, self.hub_dofs
        free = bool(hub_dofs) and model.jnt_type[model.dof_jntid[hub_dofs[0]]] == mujoco.mjtJoint.mjJNT_FREE
        moves_all = all(set(hub_dofs) <= set(dofs_of_body(model, self._parent(limb))) for limb in self.limbs)
        chain = all(set(hub_dofs[:h]) <= set(_ancestors(model, d)) for h, d in enumerate(hub_dofs))
        return {
            "NSLOTS": self.slots, "LIMB_DOFS": self.limb_dofs, "HUB_DOFS": len(hub_dofs), "HUB_BODIES": len(self.hub),
            "NSTATIC": len(_static_bodies(model)), "HUB_IS_FREE": int(free), "HUB_IS_CHAIN": int(chain),
            "ALL_HUB": int(moves_all), "LIMB_CONTACTS": min(self.most_hits, max_contacts), "LOSSES": int(self.losses),
            "NPLANES": len(self.planes), "NGROUNDS": len(self.grounds), "MORE_THAN_PLANES": int(self.other_grounds),
            "MOST_SEARCHES": _MOST_SEARCHES, "MOST_LISTED": _MOST_LISTED,
        }  # fmt: skip

    def tables(self, pairs: Sequence[ContactPair]) -> dict[str, Iterable[int]]:
        """Tables that the source relies on, of which those of limbs have a row for each slot.

        Args:
            pairs: The pairs of geoms that may touch, as the kernel has them.
        """
        model, hub, dofs = self.model, list(self.hub), self.hub_dofs
        limbs = [*self.limbs, *([()] * (self.slots - len(self.limbs)))]
        parents = [self._parent(limb or self.limbs[0]) for limb in limbs]
        places = [limb[d] if d < len(limb) else -1 for limb in limbs for d in range(self.limb_dofs)]
        welds = [[] if d < 0 else list(_welded_to(model, int(model.dof_bodyid[d]))) for d in places]
        welds = [w if d >= 0 and _is_last(model, d) else [] for w, d in zip(welds, places, strict=True)]
        shares = [*self.pairs, *([()] * (self.slots - len(self.limbs)))]
        return {
            "static_body": _static_bodies(model),
            "hub_body": hub,
            "hub_parent": [hub.index(p) if (p := int(model.body_parentid[b])) in hub else -1 for b in hub],
            "hub_limbs": [int(b in parents) for b in hub],
            "hub_dof": dofs,
            "hub_dof_link": [hub.index(int(model.dof_bodyid[d])) for d in dofs],
            "limb_parent": parents,
            "limb_link": [hub.index(p) if p in hub else -1 for p in parents],
            "limb_size": [len(limb) for limb in limbs],
            "limb_dof": [max(d, 0) for d in places],
            "weld_start": np.cumsum([0, *map(len, welds)]),
            "weld": [b for group in welds for b in group],
            "limb_pair_start": np.cumsum([0, *map(len, shares)]),
            "limb_pair": [p for share in shares for p in share],
            **(_geom_tables(model, pairs, shares) if any(map(is_searched, pairs)) else {}),
            "plane": list(self.planes),
            "ground": list(self.grounds),
            "pair_ground": [self.grounds.index(pair.geom1) if pair.geom1 in self.grounds else 0 for pair in pairs],
            "pair_plane": [self.planes.index(pair.geom1) if _is_plane(pair) else 0 for pair in pairs],
            "ends_body": [int(d >= 0 and _is_last(model, d)) for d in places],
        }

    def _parent(self, limb: Sequence[int]) -> int:
        """The body that a limb hangs on."""
        return int(self.model.body_parentid[self.model.dof_bodyid[limb[0]]])


def why_no_limbs(model: mujoco.MjModel, pairs: Sequence[ContactPair]) -> str:
    """Reason why a model has no such form of the step; empty if it has one."""
    return next(_reasons(model, pairs), "")


def _reasons(model: mujoco.MjModel, pairs: Sequence[ContactPair]) -> Iterator[str]:
    moving = {int(model.body_rootid[b]) for b in range(model.nbody) if _moves(model, b)}
    if len(moving) != 1:
        yield "more than one thing moves"
    if np.any(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL):
        yield "it has a ball joint"
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if any(model.body_jntnum[model.jnt_bodyid[j]] > 1 for j in free):
        yield "joints follow a free joint in the same body"
    if model.neq:
        yield "it has equalities"
    if model.opt.cone != mujoco.mjtCone.mjCONE_PYRAMIDAL:
        yield "its friction cones are elliptic"
    if any(j != i for i, group in enumerate(dof_couplings(model)) for j, _, _ in group) or np.any(
        model.actuator_trntype != mujoco.mjtTrn.mjTRN_JOINT
    ):
        yield "it has a tendon with an actuator"
    limited = model.jnt_limited.astype(bool)
    if np.any(limited & (model.jnt_range[:, 1] - model.jnt_range[:, 0] <= 2 * model.jnt_margin)):
        yield "both limits of a joint may act at a time"
    for pair in pairs:
        if sum(_moves(model, int(model.geom_bodyid[g])) for g in (pair.geom1, pair.geom2)) != 1:
            yield "parts of it may touch each other"
        if pair.kind not in _HITS:
            yield "it touches other things than primitives, height fields and static meshes"
        if pair.dim not in (1, 3):
            yield "contacts have torsional or rolling friction"
    hub, limbs = _divide(model)
    if not 1 <= len(limbs) <= _MOST_LIMBS:
        yield f"it has {len(limbs)} limbs"
    sizes = len(_dofs_within(model, hub)), max(map(len, limbs), default=0)
    if any(size > most for size, most in zip(sizes, _MOST_DOFS, strict=True)):
        yield f"its hub and longest limb have {sizes[0]} and {sizes[1]} degrees of freedom"
    if max(map(len, _share_pairs(model, pairs, limbs)), default=0) > _MOST_PAIRS:
        yield "a limb has too many shapes"


def _divide(model: mujoco.MjModel) -> tuple[list[int], list[list[int]]]:
    """Bodies of the hub, and degrees of freedom of the limbs.

    The hub is the root and what lies between it and the last body from which several moving bodies branch. What is
    welded to a body is part of it.
    """
    bodies = [b for b in range(1, model.nbody) if _moves(model, b)]
    links = [b for b in bodies if model.body_dofnum[b]]
    children: dict[int, list[int]] = {b: [] for b in [*links, 0]}
    for b in links:
        children[_link_of(model, int(model.body_parentid[b]))].append(b)
    branching = {b for b in children if len(children[b]) > 1}
    hub_links = {_link_of(model, a) for b in branching for a in _path(model, b)} - {0}
    free = {b for b in links if model.jnt_type[model.body_jntadr[b]] == mujoco.mjtJoint.mjJNT_FREE}
    starts = [b for b in links if _link_of(model, int(model.body_parentid[b])) in hub_links | {0}]
    if not hub_links and (free or all(model.body_parentid[b] == 0 for b in starts)):
        hub_links |= set(starts)  # what has the origin of its tree is part of the hub
    hub_links |= free
    limbs = []
    for b in links:
        if b in hub_links or _link_of(model, int(model.body_parentid[b])) not in hub_links | {0}:
            continue
        limb: list[int] = []
        at: int | None = b
        while at is not None:
            first = int(model.body_dofadr[at])
            limb += range(first, first + int(model.body_dofnum[at]))
            at = next(iter(children[at]), None)
        limbs.append(limb)
    return [b for b in bodies if _link_of(model, b) in hub_links], limbs


def _share_pairs(
    model: mujoco.MjModel, pairs: Sequence[ContactPair], limbs: Sequence[Sequence[int]]
) -> list[list[int]]:
    """Pairs of each limb. One of the hub goes to a limb that has least to do."""
    shares: list[list[int]] = [[] for _ in limbs]
    if not limbs:
        return shares
    of_hub = []
    for p, pair in enumerate(pairs):
        body = next(
            int(model.geom_bodyid[g]) for g in (pair.geom2, pair.geom1) if _moves(model, int(model.geom_bodyid[g]))
        )
        own = set(dofs_of_body(model, body))
        limb = next((i for i, dofs in enumerate(limbs) if own & set(dofs)), None)
        if limb is None:
            of_hub.append(p)
        else:
            shares[limb].append(p)
    for p in of_hub:
        min(shares, key=lambda share: sum(_HITS.get(pairs[i].kind, 1) for i in share)).append(p)
    if all(map(_is_plane, pairs)):
        return shares

    def order(p: int) -> tuple[int, bool, int, int]:
        moving, other = _moving_first(model, pairs[p])
        return moving, is_searched(pairs[p]), other, p

    # Those of a geom, and its parts on a ground, one after another, so that it is placed once.
    return [sorted(share, key=order) for share in shares]


def _geom_tables(
    model: mujoco.MjModel, pairs: Sequence[ContactPair], shares: Sequence[Sequence[int]]
) -> dict[str, Iterable[int]]:
    """Tables of the geoms of each slot, for lanes that search together: see limb_search.h.

    They are the geoms that move; the first of the pairs of each, and the first that is searched; and for each pair how
    many parts on the same ground there are from it on.
    """
    start, geoms, first, searched = [0], list[int](), list[int](), list[int]()
    parts: list[int] = []
    for share in shares:
        for geom, group in groupby(share, key=lambda p: _moving_first(model, pairs[p])[0]):
            own = [pairs[p] for p in group]
            geoms.append(geom)
            first.append(len(parts))
            searched.append(len(parts) + sum(not is_searched(pair) for pair in own))
            grounds = [(pair.geom1, pair.mesh) if is_searched(pair) else None for pair in own]
            parts += [grounds[i:].count(ground) for i, ground in enumerate(grounds)]
        start.append(len(geoms))
    return {
        "limb_geom_start": start,
        "limb_geom": geoms,
        "limb_geom_pair": [*first, len(parts)],
        "limb_geom_search": searched,
        "limb_parts": parts,
    }


def _moving_first(model: mujoco.MjModel, pair: ContactPair) -> tuple[int, int]:
    """The geom of a pair that moves, then the other one."""
    one, other = pair.geom1, pair.geom2
    return (one, other) if _moves(model, int(model.geom_bodyid[one])) else (other, one)


def _is_plane(pair: ContactPair) -> bool:
    return pair.kind.startswith("PLANE")


def _link_of(model: mujoco.MjModel, body: int) -> int:
    """The body with joints that moves another one, 0 if none does. One that the caller places does not move here."""
    while body > 0 and not model.body_dofnum[body]:
        body = int(model.body_parentid[body])
    return body


def _moves(model: mujoco.MjModel, body: int) -> bool:
    return _link_of(model, body) > 0


def _static_bodies(model: mujoco.MjModel) -> list[int]:
    return [b for b in range(1, model.nbody) if not _moves(model, b)]


def _dofs_within(model: mujoco.MjModel, bodies: Sequence[int]) -> list[int]:
    return [
        d
        for b in bodies
        for d in range(int(model.body_dofadr[b]), int(model.body_dofadr[b]) + int(model.body_dofnum[b]))
    ]


def _ancestors(model: mujoco.MjModel, dof: int) -> Iterator[int]:
    while dof >= 0:
        yield dof
        dof = int(model.dof_parentid[dof])


def _path(model: mujoco.MjModel, body: int) -> Iterator[int]:
    """A body and those above it, without the world."""
    while body > 0:
        yield body
        body = int(model.body_parentid[body])


def _welded_to(model: mujoco.MjModel, link: int) -> Iterator[int]:
    """Bodies that are fixed to one that joints move, parents before children."""
    return (b for b in range(1, model.nbody) if b != link and _link_of(model, b) == link)


def _is_last(model: mujoco.MjModel, dof: int) -> bool:
    """Whether a degree of freedom is the last of its body."""
    body = int(model.dof_bodyid[dof])
    return dof == int(model.body_dofadr[body]) + int(model.body_dofnum[body]) - 1
