# SPDX-License-Identifier: Apache-2.0
"""Model tables: sizes, topology and options of a MuJoCo model as constants of the fused step."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from .constant_tables import ConstantTables

__all__ = ["PARAMETERS", "ContactPair", "ModelTables", "contact_pairs", "listed_pairs"]

PARAMETERS: dict[str, str] = {
    "timestep": "opt.timestep",
    "gravity": "opt.gravity",
    "mass": "body_mass",
    "inertia": "body_inertia",
    "com": "body_ipos",
    "inertia_quat": "body_iquat",
    "body_pos": "body_pos",
    "body_quat": "body_quat",
    "gravcomp": "body_gravcomp",
    "weight": "body_invweight0",
    "armature": "dof_armature",
    "damping": "dof_damping",
    "loss": "dof_frictionloss",
    "dof_weight": "dof_invweight0",
    "solref_loss": "dof_solref",
    "solimp_loss": "dof_solimp",
    "stiffness": "jnt_stiffness",
    "joint_pos": "jnt_pos",
    "joint_axis": "jnt_axis",
    "range": "jnt_range",
    "limit_margin": "jnt_margin",
    "solref_limit": "jnt_solref",
    "solimp_limit": "jnt_solimp",
    "joint_force": "jnt_actfrcrange",
    "spring": "qpos_spring",
    "qpos0": "qpos0",
    "gain": "actuator_gainprm",
    "bias": "actuator_biasprm",
    "gear": "actuator_gear",
    "ctrl_range": "actuator_ctrlrange",
    "force_range": "actuator_forcerange",
    "geom_pos": "geom_pos",
    "geom_quat": "geom_quat",
    "geom_size": "geom_size",
    "geom_friction": "geom_friction",
    "geom_margin": "geom_margin",
    "geom_solmix": "geom_solmix",
    "geom_solref": "geom_solref",
    "geom_solimp": "geom_solimp",
    "pair_margin": "pair_margin",
    "pair_solref": "pair_solref",
    "pair_solreffriction": "pair_solreffriction",
    "pair_solimp": "pair_solimp",
    "pair_friction": "pair_friction",
    "geom_xpos": "data.geom_xpos",
    "geom_xmat": "data.geom_xmat",
    "mocap_pos": "data.mocap_pos",
    "mocap_quat": "data.mocap_quat",
    "equality": "eq_data",
    "solref_equality": "eq_solref",
    "solimp_equality": "eq_solimp",
    "site_pos": "site_pos",
    "site_quat": "site_quat",
}
"""Parameters that may differ from world to world: name in the source, and field of MuJoCo's model (or of its options or
data)."""

_EQUALITY_ROWS = {mujoco.mjtEq.mjEQ_CONNECT: 3, mujoco.mjtEq.mjEQ_WELD: 6}
"""Rows of equalities of bodies."""

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
    (_G.mjGEOM_HFIELD, _G.mjGEOM_SPHERE): "FIELD_SPHERE",
    (_G.mjGEOM_HFIELD, _G.mjGEOM_CAPSULE): "FIELD_CAPSULE",
    (_G.mjGEOM_HFIELD, _G.mjGEOM_BOX): "FIELD_BOX",
}
"""Pairs of geom types that the fused step finds contacts of; those with height fields by their triangles."""

MESH_KINDS = {_G.mjGEOM_SPHERE: "MESH_SPHERE", _G.mjGEOM_CAPSULE: "MESH_CAPSULE", _G.mjGEOM_BOX: "MESH_BOX"}
"""Pairs of static meshes with a geom of a type of which it finds contacts with their triangles."""

_CAPSULE = "HIGH_END", "LOW_END", "AXIS"
_PARTS = {
    "FIELD": {"SPHERE": ("SPHERE",), "CAPSULE": _CAPSULE, "BOX": ("BOX",)},
    "MESH": {"SPHERE": ("SPHERE",), "CAPSULE": _CAPSULE, "BOX": ("BOX", *(f"CORNER_{i}" for i in range(8)))},
}
"""Routines of a geom on triangles, of which lanes run each: of a capsule two ends and the axis between."""
_SEARCHES = [f"{ground}_{part}" for ground, geoms in _PARTS.items() for parts in geoms.values() for part in parts]
"""The order that collision.h relies on."""
_ROUTINES = [kind for kind in KINDS.values() if not kind.startswith("FIELD")] + _SEARCHES

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
    if explicit is not None:
        return ContactPair(g1, g2, kind, int(model.pair_dim[explicit]), "OF_PAIR", explicit)
    first, second = int(model.geom_priority[g1]), int(model.geom_priority[g2])
    if first != second:
        chosen = g1 if first > second else g2
        return ContactPair(g1, g2, kind, int(model.geom_condim[chosen]), "OF_FIRST" if chosen == g1 else "OF_SECOND")
    return ContactPair(g1, g2, kind, int(max(model.geom_condim[g1], model.geom_condim[g2])), "OF_BOTH")


@dataclass(frozen=True)
class ModelTables:
    """Constants of the fused step for one model."""

    model: mujoco.MjModel
    pairs: tuple[ContactPair, ...]
    """Pairs whose contacts the kernel finds."""
    max_rows: int
    """Room for constraint rows in a world."""
    max_contacts: int
    """Room for contacts in a world."""

    @classmethod
    def of(
        cls, model: mujoco.MjModel, max_rows: int, max_contacts: int, pairs: Iterable[ContactPair] | None = None
    ) -> ModelTables:
        """The constants of a model, with the pairs given, or all of it, that the kernel has a routine for.

        Raises:
            ValueError: if there is no room for the rows of the equalities that are active at the start.
        """
        least = sum(size for size, active in zip(_equality_sizes(model), model.eq_active0, strict=True) if active)
        if max_rows < least:
            raise ValueError(f"njmax is {max_rows}, must be {least} or more: the equalities have as many rows")
        pairs = contact_pairs(model) if pairs is None else pairs
        parts = (dataclasses.replace(p, kind=kind) for p in pairs if p.kind for kind in _parts(p.kind))
        # Those with height fields and meshes come last: their contacts are searched for together. Before them come
        # pairs that need long if they are near. Lanes so do the same.
        in_order = sorted(parts, key=_work)
        return cls(model, tuple(in_order), max_rows, max_contacts)

    @property
    def elliptic(self) -> bool:
        """Whether friction cones are elliptic."""
        return bool(self.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC)

    @property
    def has_searches(self) -> bool:
        """Whether the kernel finds contacts with height fields or meshes."""
        return any(_is_searched(p) for p in self.pairs)

    def searches(self, rows: int) -> int:
        """Searches for contacts with height fields and meshes that there is room for where rows will be.

        Args:
            rows: Constraint rows that lie in the state of a world.
        """
        room = max(self._forces_size, rows * self.row_size - 7 * self.model.nbody - 2) - self._geoms_size - 1
        return min(32, max(1, room // self._search_size))

    @property
    def _forces_size(self) -> int:
        """Numbers of what is needed until the forces are known, see ``World``."""
        return 28 * self.model.nbody + 6 * self.model.nv + max(self.model.nu, 1)

    @property
    def _geoms_size(self) -> int:
        """Numbers for the places of geoms."""
        return 12 * len(_used_geoms(self.pairs)) if _places_geoms(self.pairs) else 1

    @property
    def _search_size(self) -> int:
        """Numbers of four bytes of a search, as in search.h."""
        fields = any(p.kind.startswith("FIELD") for p in self.pairs)
        boxes = any(p.kind.endswith("_BOX") for p in self.pairs if _is_searched(p))
        return 48 + 12 * fields + 12 * boxes + 14 * self.has_meshes

    @property
    def has_meshes(self) -> bool:
        """Whether the kernel finds contacts with triangles of meshes."""
        return any(p.kind.startswith("MESH") for p in self.pairs)

    @property
    def row_size(self) -> int:
        """Numbers of a constraint row, as in constraints.h."""
        return 4 * (-(-(self.model.nv + 7) // 4) | 1)

    @property
    def contact_size(self) -> int:
        """Numbers of a contact, as in constraints.h."""
        return 25 + self.has_meshes + (3 + 8 * -(-self.model.nv // 4) if self.elliptic else 0)

    def source(self, rows: int, contacts: int) -> str:
        """The constants as C++ source.

        Args:
            rows: Constraint rows that lie in the state of a world; those beyond lie in its spill memory.
            contacts: Contacts that do.
        """
        model, pairs = self.model, self.pairs
        room = {
            "MAX_ROWS": self.max_rows, "MAX_CONTACTS": self.max_contacts, "SHARED_ROWS": rows,
            "SHARED_CONTACTS": contacts, "SPILL": self.spill_size(rows, contacts),
            "MAX_HITS": 8 if any(p.kind == "BOX_BOX" for p in pairs) else 4,
        }  # fmt: skip
        lines = [
            f"#define {name} {value}" for name, value in (_sizes(model, pairs) | _options(model, pairs) | room).items()
        ]
        lines += ["namespace fused {", self.constants.source(), "}"]
        return "\n".join(lines) + "\n"

    @cached_property
    def constants(self) -> ConstantTables:
        """The tables of the topology."""
        model, pairs = self.model, self.pairs
        integers = _tree_tables(model) | _equality_tables(model) | _actuator_tables(model) | _pair_tables(model, pairs)
        moving = {"body_dofs": [sum(1 << i for i in _dofs(model, b)) for b in range(model.nbody)]}
        return ConstantTables(integers | moving, _coefficients(model))

    def world_size(self, rows: int, contacts: int, in_registers: bool) -> int:
        """Numbers of four bytes in ``World`` of dynamics.h, of which the source asserts that they are no fewer."""
        model = self.model
        nb, nv, nu = model.nbody, model.nv, max(model.nu, 1)
        matrices = (nv if in_registers else 2 * nv) * self.row_of_matrix(in_registers)
        kept = model.nq + 7 * nv + 3 * len(_trees(model)) + 6 * nv + matrices + nu
        kept += _ATTACHMENT_SIZE * len(_attachments(model))
        found = self._geoms_size + 1 + (self.searches(rows) * self._search_size if self.has_searches else 0)
        shared = max(7 * nb + 1 + max(self._forces_size, found) + 1, rows * self.row_size)
        return kept + shared + contacts * self.contact_size + 25  # with the pointer, and alignments

    def row_of_matrix(self, in_registers: bool) -> int:
        """Numbers from one row of a matrix to the next.

        Lanes that read a column, or fours of a row each, are not to share a bank of the shared memory.
        """
        nv = self.model.nv
        return 4 * (-(-nv // 4) | 1) if in_registers else nv | 1

    def spill_size(self, rows: int, contacts: int) -> int:
        """Numbers of a world for rows and contacts beyond those of its state."""
        return (self.max_rows - rows) * self.row_size + (self.max_contacts - contacts) * self.contact_size


_ATTACHMENT_SIZE = 24
"""Numbers of an attachment, as in world.h."""
_LONG = ("CAPSULE_BOX", "BOX_BOX")
"""Routines that take long where two geoms are near."""


def _work(pair: ContactPair) -> int:
    """Kind of work that a pair takes: the order of pairs."""
    if pair.kind.startswith("MESH"):
        return 4 if "CORNER" in pair.kind else 5 if pair.kind in ("MESH_AXIS", "MESH_BOX") else 3
    return 2 if _is_searched(pair) else int(pair.kind in _LONG)


def _is_searched(pair: ContactPair) -> bool:
    return pair.kind.startswith(tuple(_PARTS))


def _parts(kind: str) -> tuple[str, ...]:
    """Routines that find the contacts of a pair of a kind."""
    ground, _, geom = kind.partition("_")
    return tuple(f"{ground}_{part}" for part in _PARTS[ground][geom]) if ground in _PARTS else (kind,)


def _sizes(model: mujoco.MjModel, pairs: Sequence[ContactPair]) -> dict[str, object]:
    couples = sum(len(list(_ancestors(model, i))) for i in range(model.nv))
    return {
        "NB": model.nbody, "NQ": model.nq, "NV": model.nv, "NJ": model.njnt, "NU": max(model.nu, 1),
        "ACTUATORS": model.nu, "NEQ": model.neq, "EQUALITY_DATA": mujoco.mjNEQDATA,
        "NATTACHMENTS": len(_attachments(model)), "NFREE": len(_free_alone(model)), "NLEVELS": len(_levels(model)),
        "NPAIRS": couples, "NCONTACT_PAIRS": len(pairs), "NGEOMS": len(_used_geoms(pairs)),
        "NALLGEOMS": model.ngeom, "NMOCAP": model.nmocap,
        "NBALLS": int(np.sum(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL)),
        "HAS_FIELDS": int(any(p.kind.startswith("FIELD") for p in pairs)),
        "HAS_MESHES": int(any(p.kind.startswith("MESH") for p in pairs)),
        "HAS_SEARCHES": int(any(map(_is_searched, pairs))),
        "FIRST_SEARCHED_PAIR": sum(not _is_searched(p) for p in pairs),
        "NADDRESSES": _addresses(model), "GEOMS_PLACED": int(_places_geoms(pairs)), "NTREES": len(_trees(model)),
    }  # fmt: skip


def _options(model: mujoco.MjModel, pairs: Sequence[ContactPair]) -> dict[str, object]:
    opt = model.opt
    return {
        "FREE": 0, "BALL": 1, "SLIDE": 2, "HINGE": 3, **{name: i for i, name in enumerate(RULES)},
        **{name: i for i, name in enumerate(_ROUTINES)},
        **{f"HAS_{name}": int(any(p.kind == name for p in pairs)) for name in _ROUTINES},
        "SEARCHES_BOXES": int(any(p.kind in ("FIELD_BOX", "MESH_BOX") for p in pairs)),
        "ELLIPTIC_CONES": int(opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC),
        "IMPLICIT": int(opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
        "REFSAFE": int(not opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE),
        "COUPLED": int(any(j != i for i, group in enumerate(_couplings(model)) for j, _, _ in group)),
        "IMPRATIO": f"((real){opt.impratio!r})", "MEAN_INERTIA": f"((real){model.stat.meaninertia!r})",
    }  # fmt: skip


def _tree_tables(model: mujoco.MjModel) -> dict[str, Iterable[int]]:
    levels, trees = _levels(model), _trees(model)
    children = [[c for c in range(1, model.nbody) if model.body_parentid[c] == b] for b in range(model.nbody)]
    # Of each level the bodies above it that have children in it; none above the second one.
    parents = [[], [], *([b for b in level if children[b]] for level in levels[1:-1])]
    pairs = [(i, j) for i in range(model.nv) for j in _ancestors(model, i)]
    return {
        "level_start": np.cumsum([0, *map(len, levels)]),
        "level_body": [b for level in levels for b in level],
        "level_parent_start": np.cumsum([0, *map(len, parents)]),
        "level_parent": [b for level in parents for b in level],
        "child_start": np.cumsum([0, *(len(children[b]) for level in parents for b in level)]),
        "child": [c for level in parents for b in level for c in children[b]],
        "body_tree": [trees.index(int(r)) for r in model.body_rootid],
        "body_parent": model.body_parentid,
        "body_mocap": model.body_mocapid,
        "body_joint": np.maximum(model.body_jntadr, 0),
        "body_joints": model.body_jntnum,
        "free_body": _free_alone(model),
        "joint_type": model.jnt_type,
        "joint_q": model.jnt_qposadr,
        "joint_v": model.jnt_dofadr,
        "joint_limited": model.jnt_limited,
        "joint_force_limited": model.jnt_actfrclimited,
        "dof_body": model.dof_bodyid,
        "dof_joint": model.dof_jntid,
        "pair_dof": [i for i, _ in pairs],
        "pair_ancestor": [j for _, j in pairs],
    }


def _equality_tables(model: mujoco.MjModel) -> dict[str, Iterable[int]]:
    attachments = _attachments(model)
    objects = [(int(model.eq_obj1id[e]), int(model.eq_obj2id[e])) for e in range(model.neq)]
    of_sites = model.eq_objtype == mujoco.mjtObj.mjOBJ_SITE
    return {
        "equality_joint": [j for pair in objects for j in pair],
        "equality_size": _equality_sizes(model),
        "equality_attachment": [attachments.index(e) if e in attachments else -1 for e in range(model.neq)],
        "attached_equality": attachments,
        "attached_body": [b for e in attachments for b in _equality_bodies(model, e)],
        "attached_site": [o if of_sites[e] else -1 for e in attachments for o in objects[e]],
    }


def _actuator_tables(model: mujoco.MjModel) -> dict[str, Iterable[int]]:
    moments, by_dof, couplings = _moments(model), _actuators_by_dof(model), _couplings(model)
    return {
        "actuator_start": np.cumsum([0, *map(len, moments)]),
        "actuator_dof": [d for moment in moments for d, _ in moment],
        "dof_actuator_start": np.cumsum([0, *map(len, by_dof)]),
        "dof_actuator": [u for group in by_dof for u, _ in group],
        "coupling_start": np.cumsum([0, *map(len, couplings)]),
        "coupling_dof": [d for group in couplings for d, _, _ in group],
        "coupling_actuator": [u for group in couplings for _, u, _ in group],
        "actuator_ctrl_limited": model.actuator_ctrllimited,
        "actuator_force_limited": model.actuator_forcelimited,
    }


def _pair_tables(model: mujoco.MjModel, pairs: Sequence[ContactPair]) -> dict[str, Iterable[int]]:
    used = _used_geoms(pairs)
    meshes = {"contact_mesh": [p.mesh for p in pairs]} if any(p.kind.startswith("MESH") for p in pairs) else {}
    return meshes | {
        "geom_body": model.geom_bodyid,
        "geom_field": model.geom_dataid,
        "field_start": model.hfield_adr,
        "field_rows": model.hfield_nrow,
        "field_cols": model.hfield_ncol,
        "used_geom": used,
        "contact_geoms": [used.index(g) for p in pairs for g in (p.geom1, p.geom2)],
        "contact_geom1": [p.geom1 for p in pairs],
        "contact_geom2": [p.geom2 for p in pairs],
        "contact_dim": [p.dim for p in pairs],
        "contact_rule": [RULES.index(p.rule) for p in pairs],
        "contact_explicit": [p.explicit for p in pairs],
        "contact_kind": [_ROUTINES.index(p.kind) for p in pairs],
    }


def _coefficients(model: mujoco.MjModel) -> dict[str, list[float]]:
    return {
        "actuator_coefficient": [c for moment in _moments(model) for _, c in moment],
        "dof_coefficient": [c for group in _actuators_by_dof(model) for _, c in group],
        "coupling_factor": [c for group in _couplings(model) for _, _, c in group],
    }


def _moments(model: mujoco.MjModel) -> list[list[tuple[int, float]]]:
    return [list(_moment(model, u)) for u in range(model.nu)]


def _equality_bodies(model: mujoco.MjModel, equality: int) -> tuple[int, int]:
    """The two bodies of an equality that is not one of joints."""
    first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        return int(model.site_bodyid[first]), int(model.site_bodyid[second])
    return first, second


def _equality_sizes(model: mujoco.MjModel) -> list[int]:
    """Rows of each equality while it is active: MuJoCo leaves out those of bodies that cannot move."""
    sizes = []
    for e, kind in enumerate(model.eq_type.tolist()):
        rows = _EQUALITY_ROWS.get(kind, 1)
        moves = rows == 1 or any(list(_dofs(model, b)) for b in _equality_bodies(model, e))
        sizes.append(rows if moves else 0)
    return sizes


def _attachments(model: mujoco.MjModel) -> list[int]:
    """Equalities that attach a body, or a site of it, to another one."""
    return [e for e, size in enumerate(_equality_sizes(model)) if size > 1]


def _actuators_by_dof(model: mujoco.MjModel) -> list[list[tuple[int, float]]]:
    """Of each degree of freedom the actuators that act on it, with their coefficients."""
    moments = _moments(model)
    return [[(u, c) for u in range(model.nu) for d, c in moments[u] if d == i] for i in range(model.nv)]


def _couplings(model: mujoco.MjModel) -> list[list[tuple[int, int, float]]]:
    """Of each degree of freedom those that actuators couple it with, itself and ancestors: degree, actuator, factor.

    Others that a tendon couples are left out, as MuJoCo's implicitfast leaves them out.
    """
    moments, by_dof = _moments(model), _actuators_by_dof(model)
    return [
        [(j, u, c * other) for u, c in by_dof[i] for j, other in moments[u] if j in set(_ancestors(model, i))]
        for i in range(model.nv)
    ]


def _levels(model: mujoco.MjModel) -> list[list[int]]:
    depth = [0] * model.nbody
    for b in range(1, model.nbody):
        depth[b] = depth[model.body_parentid[b]] + 1
    return [[b for b in range(model.nbody) if depth[b] == level] for level in range(max(depth) + 1)]


def _ancestors(model: mujoco.MjModel, dof: int) -> Iterable[int]:
    while dof >= 0:
        yield dof
        dof = int(model.dof_parentid[dof])


def _dofs(model: mujoco.MjModel, body: int) -> Iterable[int]:
    """Degrees of freedom that move a body."""
    while body > 0:
        first = int(model.body_dofadr[body])
        yield from range(first, first + int(model.body_dofnum[body]))
        body = int(model.body_parentid[body])


def _trees(model: mujoco.MjModel) -> list[int]:
    """The world, and the bodies that stand in it: each is the root of a tree."""
    return sorted({int(root) for root in model.body_rootid})


def _used_geoms(pairs: Sequence[ContactPair]) -> list[int]:
    return sorted({g for pair in pairs for g in (pair.geom1, pair.geom2)})


def _addresses(model: mujoco.MjModel) -> int:
    """Places for the rows of a contact in MuJoCo Warp's data: those of a pyramid of the largest dimension."""
    dims = [*model.geom_condim.tolist(), *model.pair_dim.tolist()]
    return int(max(1, 2 * (max(dims, default=1) - 1)))


def _places_geoms(pairs: Sequence[ContactPair]) -> bool:
    """Whether all geoms are placed before pairs are looked at: it pays where a geom is in several."""
    return len({(p.geom1, p.geom2) for p in pairs}) > 1.5 * len(_used_geoms(pairs))


def _free_alone(model: mujoco.MjModel) -> list[int]:
    """Bodies that float, and below which nothing can move."""
    return [b for b in range(1, model.nbody) if _is_free_alone(model, b)]


def _is_free_alone(model: mujoco.MjModel, body: int) -> bool:
    joint, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if count != 1 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return False
    return int(model.tree_dofnum[model.dof_treeid[model.jnt_dofadr[joint]]]) == 6


def _moment(model: mujoco.MjModel, actuator: int) -> Iterable[tuple[int, float]]:
    """Degrees of freedom on which an actuator acts, with their coefficients but for its gear."""
    target = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        yield int(model.jnt_dofadr[target]), 1.0
        return
    first = int(model.tendon_adr[target])
    for wrap in range(first, first + int(model.tendon_num[target])):
        yield int(model.jnt_dofadr[model.wrap_objid[wrap]]), float(model.wrap_prm[wrap])
