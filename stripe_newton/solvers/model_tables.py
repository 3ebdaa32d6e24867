# SPDX-License-Identifier: Apache-2.0
"""Model tables: sizes, topology and options of a MuJoCo model as constants of the fused step."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

from . import wrench_form
from .constant_tables import ConstantTables
from .contact_pairs import (
    ROUTINES,
    RULES,
    ContactPair,
    contact_pairs,
    is_curved,
    is_of_hulls,
    is_searched,
    parts_of,
    work_of,
)
from .hulls import CAP_SIDES, hull_numbers, sides_of_pairs
from .limb_form import LimbForm
from .newton_layout import NewtonLayout
from .topology import (
    actuator_moments,
    actuators_by_dof,
    attached_equalities,
    body_levels,
    dof_ancestors,
    dof_couplings,
    dofs_of_body,
    equality_bodies,
    equality_sizes,
    free_bodies,
    joint_sizes,
    tree_roots,
    turned_size,
    turned_starts,
)

__all__ = ["PARAMETERS", "TOUCHES", "ModelTables"]

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
    limbs: LimbForm | None = None
    """The model as a hub with limbs, where the step has that form."""
    newton: NewtonLayout | None = None
    """Where Newton has joints, bodies and controls, if the step reads and writes Newton's state."""

    @classmethod
    def of(
        cls,
        model: mujoco.MjModel,
        max_rows: int,
        max_contacts: int,
        pairs: Iterable[ContactPair] | None = None,
        limbs: bool = False,
        losses: bool = False,
        newton: NewtonLayout | None = None,
    ) -> ModelTables:
        """The constants of a model, with the pairs given, or all of it, that the kernel has a routine for.

        Args:
            model: The compiled model.
            max_rows: Room for constraint rows in a world.
            max_contacts: Room for contacts in a world.
            pairs: The pairs of geoms.
            limbs: Whether the step may have the form for a hub with limbs, where the model is one.
            losses: Whether joints have friction loss, in any world.
            newton: Where Newton has joints, bodies and controls, if the step reads and writes its state.

        Raises:
            ValueError: if there is no room for the rows of the equalities that are active at the start.
        """
        least = sum(size for size, active in zip(equality_sizes(model), model.eq_active0, strict=True) if active)
        if max_rows < least:
            raise ValueError(f"njmax is {max_rows}, must be {least} or more: the equalities have as many rows")
        pairs = contact_pairs(model) if pairs is None else pairs
        parts = (dataclasses.replace(p, kind=kind) for p in pairs if p.kind for kind in parts_of(p.kind))
        # Those with height fields and meshes come last: their contacts are searched for together. Before them come
        # pairs that need long if they are near. Lanes so do the same.
        in_order = tuple(sorted(parts, key=work_of))
        form = LimbForm.of(model, in_order, losses) if limbs else None
        return cls(model, in_order, max_rows, max_contacts, form, newton)

    @property
    def elliptic(self) -> bool:
        """Whether friction cones are elliptic."""
        return bool(self.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC)

    @property
    def has_searches(self) -> bool:
        """Whether the kernel finds contacts with height fields or meshes."""
        return any(is_searched(p) for p in self.pairs)

    @property
    def wrench_rows(self) -> bool:
        """Whether constraint rows have no Jacobians."""
        return wrench_form.has_wrench_rows(self.model)

    def searches(self, rows: int) -> int:
        """Searches for contacts with height fields and meshes that there is room for where rows will be.

        Args:
            rows: Constraint rows that lie in the state of a world.
        """
        room = max(self._forces_size, rows * self.row_size - 7 * self.model.nbody - 2) - self._geoms_size - 1
        return min(32, max(1, (room - self._listed_size) // self._search_size))

    @property
    def _forces_size(self) -> int:
        """Numbers of what is needed until the forces are known, see ``World``."""
        return 28 * self.model.nbody + 6 * self.model.nv + max(self.model.nu, 1)

    @property
    def _geoms_size(self) -> int:
        """Numbers for the places of geoms."""
        return (16 * len(_used_geoms(self.pairs)) + 3 if _places_geoms(self.pairs) else 3) + _NEAR_SIZE

    @property
    def _listed_size(self) -> int:
        """Numbers of four bytes for the geoms that are near their ground, their parts and what touches, at most."""
        near = len(_searched_geoms(self.pairs)) + sum(map(is_searched, self.pairs)) // 2
        return near + TOUCHES * (9 + self.has_meshes) + _PATCH_SIZE * len(_fields(self.pairs)) + 7

    @property
    def _search_size(self) -> int:
        """Numbers of four bytes of a search, as in search.h."""
        return 20 if self.has_meshes else 18

    @property
    def has_meshes(self) -> bool:
        """Whether the kernel finds contacts with triangles of meshes."""
        return any(p.kind.startswith("MESH") for p in self.pairs)

    @property
    def row_size(self) -> int:
        """Numbers of a constraint row, as in world.h."""
        return wrench_form.ROW_SIZE if self.wrench_rows else 4 * (-(-(self.model.nv + 7) // 4) | 1)

    @property
    def contact_size(self) -> int:
        """Numbers of a contact, as in constraints.h."""
        return 25 + self.has_meshes + (3 if self.elliptic else 0)

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
            "CONTACTS_AT": self._contacts_at(rows), "MAX_HITS": 8 if any(p.kind == "BOX_BOX" for p in pairs) else 4,
        }  # fmt: skip
        sizes = _sizes(model, pairs) | _options(model, pairs) | room | {"HAS_NEWTON": int(self.newton is not None)}
        sizes |= self.newton.sizes if self.newton is not None else {}
        sizes["WRENCH_ROWS"] = int(self.wrench_rows)
        if self.limbs is not None:
            sizes |= self.limbs.sizes(self.max_contacts) | {"GEOMS_PLACED": 0}
        lines = [f"#define {name} {value}" for name, value in sizes.items()]
        lines += ["namespace fused {", self.constants.source(), "}"]
        return "\n".join(lines) + "\n"

    @cached_property
    def constants(self) -> ConstantTables:
        """The tables of the topology."""
        model, pairs = self.model, self.pairs
        integers = _tree_tables(model) | _equality_tables(model) | _actuator_tables(model) | _pair_tables(model, pairs)
        if self.limbs is not None:
            integers |= self.limbs.tables(pairs)
        if self.newton is not None:
            integers |= self.newton.tables
        moving = {"body_dofs": [sum(1 << i for i in dofs_of_body(model, b)) for b in range(model.nbody)]}
        return ConstantTables(integers | moving, _coefficients(model))

    def world_size(self, rows: int, contacts: int, in_registers: bool) -> int:
        """Numbers of four bytes in ``World`` of dynamics.h, of which the source asserts that they are no fewer."""
        model = self.model
        nb, nv, nu = model.nbody, model.nv, max(model.nu, 1)
        matrices = (nv if in_registers else 2 * nv) * self.row_of_matrix(in_registers)
        kept = model.nq + 7 * nv + 3 * len(tree_roots(model)) + 6 * nv + matrices + nu + 2
        kept += _ATTACHMENT_SIZE * len(attached_equalities(model)) + wrench_form.STIFFNESS_SIZE * self.wrench_rows
        forces = 7 * nb + self._forces_size + 2
        if self.wrench_rows:
            shared = max(forces, self._contacts_at(rows) + contacts * self.contact_size) + 4
        else:
            shared = max(forces, self._found_size(rows), rows * self.row_size) + contacts * self.contact_size
        return kept + shared + 26  # with the pointer, and alignments

    def _found_size(self, rows: int) -> int:
        """Numbers of four bytes of what is needed until contacts are known."""
        found = 7 * self.model.nbody + self._geoms_size + 3
        if self.has_searches:
            found += self.searches(rows) * self._search_size + self._listed_size
        return found

    def _contacts_at(self, rows: int) -> int:
        """Numbers before the contacts of rows that have no Jacobians, in the memory of what is needed until then."""
        return max(self._found_size(rows) + 4, rows * self.row_size)

    def row_of_matrix(self, in_registers: bool) -> int:
        """Numbers from one row of a matrix to the next.

        Lanes that read a column, or fours of a row each, are not to share a bank of the shared memory.
        """
        nv = self.model.nv
        return 4 * (-(-nv // 4) | 1) if in_registers else nv | 1

    def spill_size(self, rows: int, contacts: int) -> int:
        """Numbers of a world for rows and contacts beyond those of its state."""
        return (self.max_rows - rows) * self.row_size + (self.max_contacts - contacts) * self.contact_size


_SHAPES = {
    mujoco.mjtGeom.mjGEOM_SPHERE: "BALL", mujoco.mjtGeom.mjGEOM_CAPSULE: "CAPSULE",
    mujoco.mjtGeom.mjGEOM_ELLIPSOID: "ELLIPSOID", mujoco.mjtGeom.mjGEOM_CYLINDER: "CYLINDER",
    mujoco.mjtGeom.mjGEOM_BOX: "BOX",
}  # fmt: skip
"""Shapes of geoms that balls are put around."""
_NEAR_FLAGS = {"ALWAYS_NEAR": 1 << 24, "IN_TREES": 1 << 25, "ON_PLANE": 1 << 26}
"""How a pair is tested: not at all, as its margin is its own; across trees; a plane and a ball."""
_NEAR_SIZE = 32
"""Numbers of four bytes of the list of pairs that may touch."""
TOUCHES = 24
"""Touches of a world's searches that there is room for; where there are more, the searches are finished in parts."""
_PATCH_SIZE = 14
"""Numbers of four bytes of a patch of a height field, as in search.h."""
_ATTACHMENT_SIZE = 24
"""Numbers of an attachment, as in world.h."""


def _sizes(model: mujoco.MjModel, pairs: Sequence[ContactPair]) -> dict[str, object]:
    couples = sum(len(list(dof_ancestors(model, i))) for i in range(model.nv))
    return {
        "NB": model.nbody, "NQ": model.nq, "NV": model.nv, "NJ": model.njnt, "NU": max(model.nu, 1),
        "ACTUATORS": model.nu, "NEQ": model.neq, "EQUALITY_DATA": mujoco.mjNEQDATA,
        "NATTACHMENTS": len(attached_equalities(model)), "NFREE": len(free_bodies(model)),
        "NLEVELS": len(body_levels(model)), "NPAIRS": couples, "NCONTACT_PAIRS": len(pairs),
        "NGEOMS": len(_used_geoms(pairs)),
        "NALLGEOMS": model.ngeom, "NMOCAP": model.nmocap,
        "NTURNED": turned_size(model),
        "NBALLS": int(np.sum(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL)),
        "HAS_FIELDS": int(any(p.kind.startswith("FIELD") for p in pairs)),
        "HAS_MESHES": int(any(p.kind.startswith("MESH") for p in pairs)),
        "HAS_SEARCHES": int(any(map(is_searched, pairs))),
        "HAS_HULLS": int(any(is_of_hulls(p.kind) for p in pairs)),
        "HAS_CURVED": int(any(is_curved(p.kind) for p in pairs)),
        "POLYGON_SIDES": max(1, sides_of_pairs(model, pairs), *(2 * CAP_SIDES * is_curved(p.kind) for p in pairs)),
        "FIRST_HULL_PAIR": sum(not is_searched(p) and not is_of_hulls(p.kind) for p in pairs),
        "FIRST_SEARCHED_PAIR": sum(not is_searched(p) for p in pairs),
        "NSEARCHED_GEOMS": len(_searched_geoms(pairs)),
        "NFIELDS": len(_fields(pairs)),
        "NADDRESSES": _addresses(model), "GEOMS_PLACED": int(_places_geoms(pairs)), "NTREES": len(tree_roots(model)),
    }  # fmt: skip


def _options(model: mujoco.MjModel, pairs: Sequence[ContactPair]) -> dict[str, object]:
    opt = model.opt
    return {
        "FREE": 0, "BALL": 1, "SLIDE": 2, "HINGE": 3, **{name: i for i, name in enumerate(RULES)},
        **{name: i for i, name in enumerate(ROUTINES)},
        **{f"{shape}_SHAPE": i + 1 for i, shape in enumerate((*_SHAPES.values(), "HULL"))}, **_NEAR_FLAGS,
        **{f"HAS_{name}": int(any(p.kind == name for p in pairs)) for name in ROUTINES},
        "SEARCHES_BOXES": int(any(p.kind in ("FIELD_BOX", "MESH_BOX") for p in pairs)),
        "ELLIPTIC_CONES": int(opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC),
        "IMPLICIT": int(opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST),
        "REFSAFE": int(not opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE),
        "COUPLED": int(any(j != i for i, group in enumerate(dof_couplings(model)) for j, _, _ in group)),
        "IMPRATIO": f"((real){opt.impratio!r})", "MEAN_INERTIA": f"((real){model.stat.meaninertia!r})",
    }  # fmt: skip


def _tree_tables(model: mujoco.MjModel) -> dict[str, Iterable[int]]:
    levels, trees = body_levels(model), tree_roots(model)
    children = [[c for c in range(1, model.nbody) if model.body_parentid[c] == b] for b in range(model.nbody)]
    # Of each level the bodies above it that have children in it; none above the second one.
    parents = [[], [], *([b for b in level if children[b]] for level in levels[1:-1])]
    pairs = [(i, j) for i in range(model.nv) for j in dof_ancestors(model, i)]
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
        "free_body": free_bodies(model),
        "joint_type": model.jnt_type,
        "joint_q": model.jnt_qposadr,
        "joint_v": model.jnt_dofadr,
        "joint_limited": model.jnt_limited,
        "joint_force_limited": model.jnt_actfrclimited,
        "dof_body": model.dof_bodyid,
        "dof_joint": model.dof_jntid,
        "coord_joint": [j for j, (size, _) in enumerate(joint_sizes(model)) for _ in range(size)],
        "turned_start": turned_starts(model),
        "pair_dof": [i for i, _ in pairs],
        "pair_ancestor": [j for _, j in pairs],
    }


def _equality_tables(model: mujoco.MjModel) -> dict[str, Iterable[int]]:
    attachments = attached_equalities(model)
    objects = [(int(model.eq_obj1id[e]), int(model.eq_obj2id[e])) for e in range(model.neq)]
    of_sites = model.eq_objtype == mujoco.mjtObj.mjOBJ_SITE
    return {
        "equality_joint": [j for pair in objects for j in pair],
        "equality_size": equality_sizes(model),
        "equality_attachment": [attachments.index(e) if e in attachments else -1 for e in range(model.neq)],
        "attached_equality": attachments,
        "attached_body": [b for e in attachments for b in equality_bodies(model, e)],
        "attached_site": [o if of_sites[e] else -1 for e in attachments for o in objects[e]],
    }


def _actuator_tables(model: mujoco.MjModel) -> dict[str, Iterable[int]]:
    moments, by_dof, couplings = actuator_moments(model), actuators_by_dof(model), dof_couplings(model)
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
    searched, fields, hulls = _searched_geoms(pairs), _fields(pairs), hull_numbers(model, pairs)
    if hulls:
        meshes["contact_hull"] = [hulls.get(int(model.geom_dataid[g]), 0) for p in pairs for g in (p.geom1, p.geom2)]
    return meshes | {
        "searched_geom": [list(searched).index(_on_ground(p)) for p in pairs if is_searched(p)],
        "searched_geom_pair": list(searched.values()),
        "ground_geom": fields,
        "ground_number": [fields.index(p.geom1) if p.geom1 in fields else 0 for p in pairs] if len(fields) > 1 else [],
        "geom_body": model.geom_bodyid,
        "geom_field": model.geom_dataid,
        "field_start": model.hfield_adr,
        "field_rows": model.hfield_nrow,
        "field_cols": model.hfield_ncol,
        "used_geom": used,
        "near_test": [_near_test(model, used, p) for p in pairs] if _places_geoms(pairs) else [],
        "geom_shape": [list(_SHAPES).index(t) + 1 if t in _SHAPES else 0 for t in model.geom_type[used].tolist()],
        "contact_geoms": [used.index(g) for p in pairs for g in (p.geom1, p.geom2)],
        "contact_geom1": [p.geom1 for p in pairs],
        "contact_geom2": [p.geom2 for p in pairs],
        "contact_dim": [p.dim for p in pairs],
        "contact_rule": [RULES.index(p.rule) for p in pairs],
        "contact_explicit": [p.explicit for p in pairs],
        "contact_kind": [ROUTINES.index(p.kind) for p in pairs],
    }


def _coefficients(model: mujoco.MjModel) -> dict[str, list[float]]:
    return {
        "actuator_coefficient": [c for moment in actuator_moments(model) for _, c in moment],
        "dof_coefficient": [c for group in actuators_by_dof(model) for _, c in group],
        "coupling_factor": [c for group in dof_couplings(model) for _, _, c in group],
    }


def _used_geoms(pairs: Sequence[ContactPair]) -> list[int]:
    return sorted({g for pair in pairs for g in (pair.geom1, pair.geom2)})


def _near_test(model: mujoco.MjModel, used: Sequence[int], pair: ContactPair) -> int:
    """Which balls around geoms tell whether a pair may touch, see ``may_touch`` of collision.h."""
    trees = model.body_rootid[model.geom_bodyid[[pair.geom1, pair.geom2]]]
    flags = {"ALWAYS_NEAR": pair.rule == "OF_PAIR", "IN_TREES": trees[0] != trees[1], "ON_PLANE": "PLANE" in pair.kind}
    flag = sum(_NEAR_FLAGS[name] for name, holds in flags.items() if holds)
    return used.index(pair.geom1) | used.index(pair.geom2) << 12 | flag


def _on_ground(pair: ContactPair) -> tuple[int, int, int]:
    """Height field or meshes, and geom, of a searched pair: the same for all parts of the geom."""
    return pair.geom1, pair.mesh, pair.geom2


def _searched_geoms(pairs: Sequence[ContactPair]) -> dict[tuple[int, int, int], int]:
    """Geoms with the ground that their contacts are searched on, and the first pair of each."""
    return {_on_ground(p): i for i, p in reversed(list(enumerate(pairs))) if is_searched(p)}


def _fields(pairs: Sequence[ContactPair]) -> list[int]:
    """Geoms that are height fields with searched contacts."""
    return sorted({p.geom1 for p in pairs if p.kind.startswith("FIELD")})


def _addresses(model: mujoco.MjModel) -> int:
    """Places for the rows of a contact in MuJoCo Warp's data: those of a pyramid of the largest dimension."""
    dims = [*model.geom_condim.tolist(), *model.pair_dim.tolist()]
    return int(max(1, 2 * (max(dims, default=1) - 1)))


def _places_geoms(pairs: Sequence[ContactPair]) -> bool:
    """Whether all geoms are placed before pairs are looked at: it pays where a geom is in several, and searches for
    touches of boxes rely on it."""
    searches_boxes = any(is_searched(p) and p.kind.endswith("_BOX") for p in pairs)
    return searches_boxes or len({(p.geom1, p.geom2) for p in pairs}) > 1.5 * len(_used_geoms(pairs))
