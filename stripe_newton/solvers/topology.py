# SPDX-License-Identifier: Apache-2.0
"""Topology: which bodies, degrees of freedom, actuators and equalities of a MuJoCo model belong together."""

from __future__ import annotations

from collections.abc import Iterable

import mujoco

__all__ = [
    "actuator_moments",
    "actuators_by_dof",
    "attached_equalities",
    "body_levels",
    "dof_ancestors",
    "dof_couplings",
    "dofs_of_body",
    "equality_bodies",
    "equality_sizes",
    "free_bodies",
    "joint_sizes",
    "tree_roots",
    "turned_size",
    "turned_starts",
]

_EQUALITY_ROWS = {mujoco.mjtEq.mjEQ_CONNECT: 3, mujoco.mjtEq.mjEQ_WELD: 6}
"""Rows of equalities of bodies."""


def actuator_moments(model: mujoco.MjModel) -> list[list[tuple[int, float]]]:
    """For each actuator the degrees of freedom on which it acts, with their coefficients."""
    return [list(_actuator_moment(model, u)) for u in range(model.nu)]


def equality_bodies(model: mujoco.MjModel, equality: int) -> tuple[int, int]:
    """The two bodies of an equality that is not one of joints."""
    first, second = int(model.eq_obj1id[equality]), int(model.eq_obj2id[equality])
    if model.eq_objtype[equality] == mujoco.mjtObj.mjOBJ_SITE:
        return int(model.site_bodyid[first]), int(model.site_bodyid[second])
    return first, second


def equality_sizes(model: mujoco.MjModel) -> list[int]:
    """Rows of each equality while it is active: MuJoCo leaves out those of bodies that cannot move."""
    sizes = []
    for e, kind in enumerate(model.eq_type.tolist()):
        rows = _EQUALITY_ROWS.get(kind, 1)
        moves = rows == 1 or any(list(dofs_of_body(model, b)) for b in equality_bodies(model, e))
        sizes.append(rows if moves else 0)
    return sizes


def attached_equalities(model: mujoco.MjModel) -> list[int]:
    """Equalities that attach a body, or a site of it, to another one."""
    return [e for e, size in enumerate(equality_sizes(model)) if size > 1]


def actuators_by_dof(model: mujoco.MjModel) -> list[list[tuple[int, float]]]:
    """For each degree of freedom the actuators that act on it, with their coefficients."""
    moments = actuator_moments(model)
    return [[(u, c) for u in range(model.nu) for d, c in moments[u] if d == i] for i in range(model.nv)]


def dof_couplings(model: mujoco.MjModel) -> list[list[tuple[int, int, float]]]:
    """For each degree of freedom those that actuators couple it with, itself and ancestors: degree, actuator, factor.

    Others that a tendon couples are left out, as MuJoCo's implicitfast leaves them out.
    """
    moments, by_dof = actuator_moments(model), actuators_by_dof(model)
    return [
        [(j, u, c * other) for u, c in by_dof[i] for j, other in moments[u] if j in set(dof_ancestors(model, i))]
        for i in range(model.nv)
    ]


def body_levels(model: mujoco.MjModel) -> list[list[int]]:
    """Bodies by their distance from the world: the world, its children, their children, ..."""
    depth = [0] * model.nbody
    for b in range(1, model.nbody):
        depth[b] = depth[model.body_parentid[b]] + 1
    return [[b for b in range(model.nbody) if depth[b] == level] for level in range(max(depth) + 1)]


def dof_ancestors(model: mujoco.MjModel, dof: int) -> Iterable[int]:
    """A degree of freedom, and those above it, up to the root."""
    while dof >= 0:
        yield dof
        dof = int(model.dof_parentid[dof])


def dofs_of_body(model: mujoco.MjModel, body: int) -> Iterable[int]:
    """Degrees of freedom that move a body."""
    while body > 0:
        first = int(model.body_dofadr[body])
        yield from range(first, first + int(model.body_dofnum[body]))
        body = int(model.body_parentid[body])


def tree_roots(model: mujoco.MjModel) -> list[int]:
    """The world, and the bodies that stand in it: each is the root of a tree."""
    return sorted({int(root) for root in model.body_rootid})


def joint_sizes(model: mujoco.MjModel) -> list[tuple[int, int]]:
    """Coordinates and degrees of freedom of each joint."""
    kinds = mujoco.mjtJoint
    sizes = {kinds.mjJNT_FREE: (7, 6), kinds.mjJNT_BALL: (4, 3), kinds.mjJNT_SLIDE: (1, 1), kinds.mjJNT_HINGE: (1, 1)}
    return [sizes[kinds(kind)] for kind in model.jnt_type]


def turned_starts(model: mujoco.MjModel) -> list[int]:
    """Where free joints and balls, which Newton has in other axes, are among the numbers of those before a joint."""
    counts = [sum(size) if size[0] > 1 else 0 for size in joint_sizes(model)]
    return [sum(counts[:j]) for j in range(len(counts))]


def turned_size(model: mujoco.MjModel) -> int:
    """Coordinates and velocities of all free joints and balls; 1 if there are none."""
    return max(1, sum(sum(size) for size in joint_sizes(model) if size[0] > 1))


def free_bodies(model: mujoco.MjModel) -> list[int]:
    """Bodies that float, and below which nothing can move."""
    return [b for b in range(1, model.nbody) if _is_free_alone(model, b)]


def _is_free_alone(model: mujoco.MjModel, body: int) -> bool:
    joint, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
    if count != 1 or model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE:
        return False
    return int(model.tree_dofnum[model.dof_treeid[model.jnt_dofadr[joint]]]) == 6


def _actuator_moment(model: mujoco.MjModel, actuator: int) -> Iterable[tuple[int, float]]:
    """Degrees of freedom on which an actuator acts, with their coefficients but for its gear."""
    target = int(model.actuator_trnid[actuator, 0])
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        yield int(model.jnt_dofadr[target]), 1.0
        return
    first = int(model.tendon_adr[target])
    for wrap in range(first, first + int(model.tendon_num[target])):
        yield int(model.jnt_dofadr[model.wrap_objid[wrap]]), float(model.wrap_prm[wrap])
