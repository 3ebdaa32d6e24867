# SPDX-License-Identifier: Apache-2.0
"""Contact pairs: pairs of geoms that may touch, and the routines of the fused step that find their contacts."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import numpy as np

from .hulls import suits_hulls

__all__ = [
    "MESH_KINDS", "ROUTINES", "RULES", "ContactPair", "contact_pairs", "is_curved", "is_of_hulls", "is_searched",
    "listed_pairs", "parts_of", "work_of",
]  # fmt: skip

_G = mujoco.mjtGeom
KINDS = {
    (_G.mjGEOM_PLANE, _G.mjGEOM_SPHERE): "PLANE_SPHERE",
    (_G.mjGEOM_PLANE, _G.mjGEOM_CAPSULE): "PLANE_CAPSULE",
    (_G.mjGEOM_PLANE, _G.mjGEOM_BOX): "PLANE_BOX",
    (_G.mjGEOM_PLANE, _G.mjGEOM_CYLINDER): "PLANE_CYLINDER",
    (_G.mjGEOM_SPHERE, _G.mjGEOM_SPHERE): "SPHERE_SPHERE",
    (_G.mjGEOM_SPHERE, _G.mjGEOM_CAPSULE): "SPHERE_CAPSULE",
    (_G.mjGEOM_SPHERE, _G.mjGEOM_BOX): "SPHERE_BOX",
    (_G.mjGEOM_CAPSULE, _G.mjGEOM_CAPSULE): "CAPSULE_CAPSULE",
    (_G.mjGEOM_CAPSULE, _G.mjGEOM_BOX): "CAPSULE_BOX",
    (_G.mjGEOM_BOX, _G.mjGEOM_BOX): "BOX_BOX",
    (_G.mjGEOM_PLANE, _G.mjGEOM_ELLIPSOID): "PLANE_ELLIPSOID",
    (_G.mjGEOM_SPHERE, _G.mjGEOM_ELLIPSOID): "SPHERE_ELLIPSOID",
    (_G.mjGEOM_SPHERE, _G.mjGEOM_CYLINDER): "SPHERE_CYLINDER",
    (_G.mjGEOM_CAPSULE, _G.mjGEOM_ELLIPSOID): "CAPSULE_ELLIPSOID",
    (_G.mjGEOM_CAPSULE, _G.mjGEOM_CYLINDER): "CAPSULE_CYLINDER",
    (_G.mjGEOM_ELLIPSOID, _G.mjGEOM_ELLIPSOID): "ELLIPSOID_ELLIPSOID",
    (_G.mjGEOM_ELLIPSOID, _G.mjGEOM_CYLINDER): "ELLIPSOID_CYLINDER",
    (_G.mjGEOM_ELLIPSOID, _G.mjGEOM_BOX): "ELLIPSOID_BOX",
    (_G.mjGEOM_CYLINDER, _G.mjGEOM_CYLINDER): "CYLINDER_CYLINDER",
    (_G.mjGEOM_CYLINDER, _G.mjGEOM_BOX): "CYLINDER_BOX",
    (_G.mjGEOM_PLANE, _G.mjGEOM_MESH): "PLANE_HULL",
    (_G.mjGEOM_SPHERE, _G.mjGEOM_MESH): "SPHERE_HULL",
    (_G.mjGEOM_CAPSULE, _G.mjGEOM_MESH): "CAPSULE_HULL",
    (_G.mjGEOM_ELLIPSOID, _G.mjGEOM_MESH): "ELLIPSOID_HULL",
    (_G.mjGEOM_CYLINDER, _G.mjGEOM_MESH): "CYLINDER_HULL",
    (_G.mjGEOM_BOX, _G.mjGEOM_MESH): "BOX_HULL",
    (_G.mjGEOM_MESH, _G.mjGEOM_MESH): "HULL_HULL",
    (_G.mjGEOM_HFIELD, _G.mjGEOM_SPHERE): "FIELD_SPHERE",
    (_G.mjGEOM_HFIELD, _G.mjGEOM_CAPSULE): "FIELD_CAPSULE",
    (_G.mjGEOM_HFIELD, _G.mjGEOM_CYLINDER): "FIELD_CYLINDER",
    (_G.mjGEOM_HFIELD, _G.mjGEOM_BOX): "FIELD_BOX",
}
"""Pairs of geom types that the fused step finds contacts of: those of meshes by their hulls, with height fields by
triangles."""

MESH_KINDS = {_G.mjGEOM_SPHERE: "MESH_SPHERE", _G.mjGEOM_CAPSULE: "MESH_CAPSULE", _G.mjGEOM_BOX: "MESH_BOX"}
"""Pairs of static meshes with a geom of a type of which it finds contacts with their triangles."""

_CAPSULE = "HIGH_END", "LOW_END", "AXIS"
_PARTS = {
    "FIELD": {"SPHERE": ("SPHERE",), "CAPSULE": _CAPSULE, "BOX": ("BOX",), "CYLINDER": ("CYLINDER",)},
    "MESH": {"SPHERE": ("SPHERE",), "CAPSULE": _CAPSULE, "BOX": ("BOX", *(f"CORNER_{i}" for i in range(8)))},
}
"""Routines of a geom on triangles, of which lanes run each: of a capsule two ends and the axis between."""
_SEARCHES = [f"{ground}_{part}" for ground, geoms in _PARTS.items() for parts in geoms.values() for part in parts]
"""The order that ground.h relies on."""
ROUTINES = [kind for kind in KINDS.values() if not kind.startswith("FIELD")] + _SEARCHES

RULES = ("OF_BOTH", "OF_FIRST", "OF_SECOND", "OF_PAIR")
"""Source of the parameters of a contact: both geoms, the one of higher priority, or a pair that the model names."""


@dataclass(frozen=True)
class ContactPair:
    """Two geoms that may touch, with the parameters of their contacts."""

    geom1: int
    geom2: int
    kind: str
    """Name of the routine; empty where there is none."""
    dim: int
    rule: str
    """Source of the parameters of its contacts, one of :data:`RULES`."""
    explicit: int = -1
    """Pair of the model whose parameters they are; -1 for none."""
    mesh: int = 0
    """Number of the meshes of which ``geom1`` is one, of a pair with static meshes."""


def listed_pairs(model: mujoco.MjModel, geoms: np.ndarray, explicit: np.ndarray) -> Iterable[ContactPair]:
    """Pairs of a list of MuJoCo Warp.

    Args:
        model: The compiled model.
        geoms: The geoms, shape ``(pairs, 2)``.
        explicit: The pair of the model whose parameters each has, -1 for none, shape ``(pairs,)``.
    """
    for (g1, g2), pair in zip(geoms.tolist(), explicit.tolist(), strict=True):
        yield _pair(model, g1, g2, pair if pair >= 0 else None)


def contact_pairs(model: mujoco.MjModel) -> Iterable[ContactPair]:
    """Pairs of geoms that may touch, in the order in which MuJoCo goes over them: by bodies, then by geoms."""
    explicit = {tuple(sorted((int(model.pair_geom1[i]), int(model.pair_geom2[i])))): i for i in range(model.npair)}
    excluded = set(model.exclude_signature.tolist())
    for i in range(model.npair):
        yield _pair(model, int(model.pair_geom1[i]), int(model.pair_geom2[i]), i)
    for b1 in range(model.nbody):
        for b2 in range(b1 + 1, model.nbody):
            if (b1 << 16) + b2 in excluded or not _may_touch(model, b1, b2):
                continue
            for g1 in _geoms(model, b1):
                for g2 in _geoms(model, b2):
                    types = model.geom_contype, model.geom_conaffinity
                    touches = (types[0][g1] & types[1][g2]) or (types[0][g2] & types[1][g1])
                    if touches and tuple(sorted((g1, g2))) not in explicit:
                        yield _pair(model, g1, g2, None)


def _geoms(model: mujoco.MjModel, body: int) -> range:
    return range(int(model.body_geomadr[body]), int(model.body_geomadr[body]) + int(model.body_geomnum[body]))


def _may_touch(model: mujoco.MjModel, b1: int, b2: int) -> bool:
    """MuJoCo's filter: not within a body or one welded to it, nor with the parent unless that is the world."""
    w1, w2 = int(model.body_weldid[b1]), int(model.body_weldid[b2])
    if w1 == w2:
        return False
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_FILTERPARENT:
        return True
    p1, p2 = (int(model.body_weldid[model.body_parentid[w]]) for w in (w1, w2))
    return not (w1 and w2 and (w1 == p2 or w2 == p1))


def _pair(model: mujoco.MjModel, g1: int, g2: int, explicit: int | None) -> ContactPair:
    if model.geom_type[g1] > model.geom_type[g2]:
        g1, g2 = g2, g1
    kind = KINDS.get((int(model.geom_type[g1]), int(model.geom_type[g2])), "")
    margin = model.geom_margin[[g1, g2]].sum() if explicit is None else model.pair_margin[explicit]
    if is_of_hulls(kind) and not suits_hulls(model, kind, g1, g2, float(margin)):
        kind = ""
    if explicit is not None:
        return ContactPair(g1, g2, kind, int(model.pair_dim[explicit]), "OF_PAIR", explicit)
    first, second = int(model.geom_priority[g1]), int(model.geom_priority[g2])
    if first != second:
        chosen = g1 if first > second else g2
        return ContactPair(g1, g2, kind, int(model.geom_condim[chosen]), "OF_FIRST" if chosen == g1 else "OF_SECOND")
    return ContactPair(g1, g2, kind, int(max(model.geom_condim[g1], model.geom_condim[g2])), "OF_BOTH")


_LONG = ("CAPSULE_BOX", "BOX_BOX")
"""Routines that take long where two geoms are near, beside those of curved geoms."""


def work_of(pair: ContactPair) -> int:
    """Kind of work that a pair takes: the order of pairs."""
    if pair.kind.startswith("MESH"):
        return 6 if "CORNER" in pair.kind else 7 if pair.kind in ("MESH_AXIS", "MESH_BOX") else 5
    if is_searched(pair):
        return 4
    return (
        2 + (pair.kind != "PLANE_HULL") if is_of_hulls(pair.kind) else int(pair.kind in _LONG or is_curved(pair.kind))
    )


def is_curved(kind: str) -> bool:
    """Whether the contacts of a kind of pairs are found by curved.h."""
    if kind == "PLANE_CYLINDER" or kind.startswith("FIELD"):
        return False
    return kind == "CAPSULE_HULL" or "CYLINDER" in kind or "ELLIPSOID" in kind


def is_of_hulls(kind: str) -> bool:
    """Whether a kind of pairs is one of hulls."""
    return kind.endswith("HULL")


def is_searched(pair: ContactPair) -> bool:
    """Whether contacts of a pair are searched among the triangles of a height field or of meshes."""
    return pair.kind.startswith(tuple(_PARTS))


def parts_of(kind: str) -> tuple[str, ...]:
    """Routines that find the contacts of a pair of a kind."""
    ground, _, geom = kind.partition("_")
    return tuple(f"{ground}_{part}" for part in _PARTS[ground][geom]) if ground in _PARTS else (kind,)
