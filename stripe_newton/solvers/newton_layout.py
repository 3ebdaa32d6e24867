# SPDX-License-Identifier: Apache-2.0
"""Newton layout: where a Newton model has the joints and controls of MuJoCo's, as constants of the fused step."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import mujoco
import newton
import numpy as np

from .topology import joint_sizes

__all__ = ["NewtonLayout"]

_SOURCES = ("FROM_NOTHING", "FROM_POSITIONS", "FROM_VELOCITIES", "FROM_CONTROLS")
"""Sources of an actuator's control: targets of positions or velocities, or controls given directly."""


@dataclass(frozen=True)
class NewtonLayout:
    """Indices of a world's joints and controls in Newton's arrays, in which one world follows another."""

    sizes: dict[str, int]
    """Numbers of a world in Newton's arrays."""
    tables: dict[str, tuple[int, ...]]
    """Of each of MuJoCo's joints Newton's joint and its first coordinate and degree of freedom, within the world, and
    of each coordinate and degree of freedom Newton's; of each body the other's, -1 for the world; the fixed joints that
    hold mocap bodies; of each actuator what its control is, where that is, and the degree of freedom whose reference is
    added."""

    @classmethod
    def of(cls, solver: newton.solvers.SolverMuJoCo) -> NewtonLayout | None:
        """The layout of a solver's model, None where worlds differ in it or it has what the fused step has no case for.

        That is a mocap body that a joint moves, a body of all worlds beside others, and an actuator of a ball joint.
        The solver's bodies are all those of Newton.
        """
        model, data = solver.model, solver.mjw_data
        axis = solver.mjc_actuator_to_target_q_axis_idx
        if solver._kinematic_weld_eq is not None or (axis is not None and (axis.numpy() >= 0).any()):
            return None
        bodies = solver.mjc_body_to_newton.numpy()
        worlds = int(data.nworld)
        # Bodies of all worlds fall with a gravity of their own, if there are several.
        is_global = (model.body_world.numpy()[bodies[bodies >= 0]] < 0).any()
        if model.joint_count == 0 or (is_global and len(model.gravity) > 1):
            return None
        joints, fixed, own = _joints(solver, worlds), _fixed(solver, worlds), _bodies(bodies, worlds)
        if joints is None or fixed is None or own is None:
            return None
        control = model.control()
        direct = getattr(getattr(control, "mujoco", None), "ctrl", None)
        sizes = {
            "NEWTON_JOINTS": model.joint_count // worlds,
            "NEWTON_BODIES": model.body_count // worlds,
            "NEWTON_COORDS": model.joint_coord_count // worlds,
            "NEWTON_DOFS": model.joint_dof_count // worlds,
            "NEWTON_TARGETS": control.joint_target_q.size // worlds,
            "NEWTON_CONTROLS": 0 if direct is None else direct.size // worlds,
            "NEWTON_FIXED": len(fixed["fixed_joint"]),
            "KINEMATIC": int(newton.BodyFlags.KINEMATIC),
            **{name: i for i, name in enumerate(_SOURCES)},
        }
        controls = _controls(solver, sizes)
        places = joints["newton_coord"], joints["newton_dof"]
        sizes["NEWTON_IN_ORDER"] = int(all(p == tuple(range(len(p))) for p in places))
        sizes["CONTROLS_TOGETHER"] = _source_of_all(controls)
        return cls(sizes, joints | own | fixed | controls)


def _joints(solver: newton.solvers.SolverMuJoCo, worlds: int) -> dict[str, tuple[int, ...]] | None:
    model, own = solver.model, solver.mj_model
    count = model.joint_count // worlds
    starts = [_uniform(a.numpy(), worlds) for a in (model.joint_q_start, model.joint_qd_start)]
    types = model.joint_type.numpy().reshape(worlds, count)
    if starts[0] is None or starts[1] is None or (types != types[0]).any():
        return None
    dims, q_start = model.joint_dof_dim.numpy().sum(axis=1), solver.mj_q_start.numpy()
    found: dict[int, tuple[int, int, int]] = {}  # by MuJoCo's first coordinate
    for joint in range(count):
        first = int(q_start[joint])
        if first < 0:
            continue
        place = joint, int(starts[0][joint]), int(starts[1][joint])
        if types[0, joint] in (newton.JointType.FREE, newton.JointType.BALL):
            found[first] = place
        elif types[0, joint] == newton.JointType.DISTANCE:
            return None
        else:
            found |= {first + i: (joint, place[1] + i, place[2] + i) for i in range(int(dims[joint]))}
    if not all(int(q) in found for q in own.jnt_qposadr):
        return None
    columns = np.array([found[int(q)] for q in own.jnt_qposadr], dtype=int).reshape(-1, 3).T
    free = own.jnt_type == mujoco.mjtJoint.mjJNT_FREE
    if (types[0][columns[0]][free] != newton.JointType.FREE).any():
        return None
    coords, dofs = (
        [int(first) + k for first, size in zip(columns[kind], sizes, strict=True) for k in range(size)]
        for kind, sizes in zip((1, 2), zip(*joint_sizes(own), strict=True), strict=True)
    )
    tables = {n: _ints(c) for n, c in zip(("newton_joint", "newton_q", "newton_v"), columns, strict=True)}
    return tables | {"newton_coord": _ints(coords), "newton_dof": _ints(dofs)}


def _bodies(bodies: np.ndarray, worlds: int) -> dict[str, tuple[int, ...]] | None:
    """Bodies of the first world, None unless those of the others are the same within them.

    Args:
        bodies: Newton's body of each body of MuJoCo's, -1 for none, shape ``(worlds, bodies)``.
        worlds: Number of worlds.
    """
    count = int(np.sum(bodies >= 0)) // worlds
    first = np.where(bodies >= 0, bodies - count * np.arange(worlds)[:, None], -1)
    if (first != first[0]).any() or not np.array_equal(np.sort(first[0][first[0] >= 0]), np.arange(count)):
        return None
    return {"newton_body": _ints(first[0]), "mujoco_body": _ints(np.argsort(first[0])[-count:] if count else ())}


def _fixed(solver: newton.solvers.SolverMuJoCo, worlds: int) -> dict[str, tuple[int, ...]] | None:
    """Fixed joints that hold a mocap body; None if other joints have one."""
    mocap = np.full(0, -1) if solver._jnt_mocap is None else solver._jnt_mocap.numpy()
    joints = np.flatnonzero(mocap >= 0)
    types = solver.model.joint_type.numpy().reshape(worlds, -1)
    if (types[:, joints] != newton.JointType.FIXED).any():
        return None
    return {"fixed_joint": _ints(joints), "fixed_mocap": _ints(mocap[joints])}


def _uniform(starts: np.ndarray, worlds: int) -> np.ndarray | None:
    """Starts of the first world, None unless those of the others are the same within them."""
    total, rows = int(starts[-1]), starts[:-1].reshape(worlds, -1)
    offsets = np.arange(worlds)[:, None] * (total // worlds)
    return rows[0] if total % worlds == 0 and np.array_equal(rows, rows[0] + offsets) else None


def _controls(solver: newton.solvers.SolverMuJoCo, sizes: dict[str, int]) -> dict[str, tuple[int, ...]]:
    """Tables of the actuators, as ``apply_mjc_control_kernel`` of Newton reads its own."""
    if solver.mjc_actuator_ctrl_source is None or solver.mjc_actuator_to_newton_idx is None:
        return dict.fromkeys(("control_source", "control_index", "control_dof"), ())
    direct = int(newton.solvers.SolverMuJoCo.CtrlSource.CTRL_DIRECT)
    arrays = (
        solver.mjc_actuator_ctrl_source, solver.mjc_actuator_to_newton_idx, solver.mjc_actuator_to_newton_target_q_idx
    )  # fmt: skip
    rows = []
    for source, index, target in zip(*(a.numpy().tolist() for a in arrays), strict=True):
        if source == direct:
            row = ("FROM_CONTROLS" if index < sizes["NEWTON_CONTROLS"] else "FROM_NOTHING", index, 0)
        elif index >= 0:
            row = ("FROM_POSITIONS" if target >= 0 else "FROM_NOTHING", target, index)
        else:
            row = ("FROM_NOTHING", 0, 0) if index == -1 else ("FROM_VELOCITIES", -(index + 2), 0)
        rows.append((_SOURCES.index(row[0]), *row[1:]))
    columns = np.array(rows, dtype=int).reshape(-1, 3).T
    return {n: _ints(c) for n, c in zip(("control_source", "control_index", "control_dof"), columns, strict=True)}


def _source_of_all(controls: dict[str, tuple[int, ...]]) -> int:
    """The source of all controls, if they are targets that lie there one after another, else ``FROM_NOTHING``."""
    sources, places = set(controls["control_source"]), controls["control_index"]
    targets = _SOURCES.index("FROM_POSITIONS"), _SOURCES.index("FROM_VELOCITIES")
    in_order = bool(places) and places == tuple(range(places[0], places[0] + len(places)))
    return sources.pop() if in_order and len(sources) == 1 and sources <= set(targets) else 0


def _ints(values: Iterable[int]) -> tuple[int, ...]:
    return tuple(int(v) for v in values)
