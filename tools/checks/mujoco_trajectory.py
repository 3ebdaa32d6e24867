# SPDX-License-Identifier: Apache-2.0
"""MuJoCo trajectory: the model made of an MJCF file and the one that MuJoCo makes, moved by the same controls."""

from __future__ import annotations

from typing import NamedTuple

import mujoco
import newton
import numpy as np

__all__ = ["Difference", "compare_trajectories"]

_HINGE, _SLIDE, _BALL, _FREE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("HINGE", "SLIDE", "BALL", "FREE")
)
_WIDTH = {_HINGE: 1, _SLIDE: 1, _BALL: 4, _FREE: 7}
_DOFS = {_HINGE: 1, _SLIDE: 1, _BALL: 3, _FREE: 6}
_Columns = tuple[np.ndarray, np.ndarray]


class Difference(NamedTuple):
    """Differences of two models over a motion."""

    at_start: float
    """Largest difference of a coordinate at the start [rad, m]."""
    acceleration: float
    """Largest difference of an acceleration in random states, as a share of the largest of the state."""
    at_end: float
    """Largest difference of a coordinate in the whole motion [rad, m]."""
    moved: float
    """Largest distance of a coordinate from its start in MuJoCo's own motion [rad, m]."""
    why_not: str = ""
    """Why the two cannot be compared."""


def compare_trajectories(solver: newton.solvers.SolverMuJoCo, path: str, steps: int = 200, seed: int = 0) -> Difference:
    """Move both models by MuJoCo's C library in double precision, with the same random controls.

    Time step, gravity, integrator and flags of the solver are those of the file in both: they are settings of a scene.
    So is whether a drive is limited by its own force range, ``MuJoCoSolverCfg(drive_limits=True)``, or by its joint's.

    Args:
        solver: Solver of one environment that holds the file alone.
        path: The file.
        steps: Number of time steps of the file.
        seed: Seed of the controls.
    """
    theirs = mujoco.MjModel.from_xml_path(path)
    model, warp = solver.model, solver.mjw_model
    if warp.opt.enableflags & int(mujoco.mjtEnableBit.mjENBL_SLEEP):
        return Difference(0.0, 0.0, 0.0, 0.0, "bodies sleep, which Newton lets them on a GPU alone")
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)
    ours = solver.mj_model
    # What the simulation writes onto its solver: the anchors of loops.
    equalities = warp.eq_data.numpy()[0]
    ours.eq_data[: len(equalities)] = equalities  # after them come the inactive welds of free roots
    if theirs.opt.solver == mujoco.mjtSolver.mjSOL_PGS:
        theirs.opt.solver = ours.opt.solver
    ours.opt.timestep, ours.opt.gravity[:] = theirs.opt.timestep, theirs.opt.gravity
    ours.opt.integrator = theirs.opt.integrator
    ours.opt.disableflags, ours.opt.enableflags = theirs.opt.disableflags, theirs.opt.enableflags
    if why_not := _why_not(ours, theirs):
        return Difference(0.0, 0.0, 0.0, 0.0, why_not)
    columns, dofs = _columns(ours, theirs, "qposadr", _WIDTH), _columns(ours, theirs, "dofadr", _DOFS)
    actuators = _actuators(ours, theirs)
    if actuators is None:
        return Difference(0.0, 0.0, 0.0, 0.0, f"{ours.nu} actuators of {theirs.nu}, or of others")
    # The control of a drive is a position of its joint, also where the file's is one of a motor before a gear.
    first, gears = theirs.actuator_gear[actuators, 0], np.ones(ours.nu)
    np.divide(ours.actuator_gear[:, 0], first, out=gears, where=first != 0.0)  # 0: a force of a site along another axis
    ours.actuator_forcelimited[:] = theirs.actuator_forcelimited[actuators]
    ours.actuator_forcerange[:] = theirs.actuator_forcerange[actuators]
    own, their = mujoco.MjData(ours), mujoco.MjData(theirs)
    solver._update_mjc_data(solver.mj_data, model, model.state())  # the coordinates of the start
    own.qpos[:] = solver.mj_data.qpos
    at_start = _largest(own.qpos[columns[0]] - their.qpos[columns[1]])
    start, controls, worst = their.qpos.copy(), _controls(theirs, steps, seed), 0.0
    for control in controls:
        their.ctrl[:] = control
        own.ctrl[:] = control[actuators] * gears
        mujoco.mj_step(theirs, their)
        mujoco.mj_step(ours, own)
        worst = max(worst, _largest(own.qpos[columns[0]] - their.qpos[columns[1]]))
    moved = _largest(their.qpos - start)
    return Difference(
        at_start, _accelerations(own, their, columns, dofs, controls, actuators, gears, seed), worst, moved
    )


def _accelerations(
    own: mujoco.MjData,
    their: mujoco.MjData,
    columns: _Columns,
    dofs: _Columns,
    controls: np.ndarray,
    actuators: list[int],
    gears: np.ndarray,
    seed: int,
) -> float:
    """See :attr:`Difference.acceleration`: twenty states within the limits of the joints."""
    random, model, worst = np.random.default_rng(seed), their.model, 0.0
    for _ in range(20):
        mujoco.mj_resetData(model, their)
        mujoco.mj_resetData(own.model, own)
        velocity = random.uniform(-1.0, 1.0, model.nv)
        mujoco.mj_integratePos(model, their.qpos, random.uniform(-0.5, 0.5, model.nv), 1.0)
        for joint in np.flatnonzero(model.jnt_limited):
            if model.jnt_type[joint] in (_HINGE, _SLIDE):
                at = model.jnt_qposadr[joint]
                low, high = model.jnt_range[joint]
                inside = 0.01 * (high - low)  # at the very limit rounding decides whether it holds
                their.qpos[at] = np.clip(their.qpos[at], low + inside, high - inside)
        control = controls[random.integers(len(controls))]
        their.ctrl[:], own.ctrl[:] = control, control[actuators] * gears
        their.qvel[:] = velocity
        own.qpos[columns[0]], own.qvel[dofs[0]] = their.qpos[columns[1]], velocity[dofs[1]]
        mujoco.mj_forward(model, their)
        mujoco.mj_forward(own.model, own)
        difference = _largest(own.qacc[dofs[0]] - their.qacc[dofs[1]])
        worst = max(worst, difference / (1.0 + _largest(their.qacc)))
    return worst


def _largest(values: np.ndarray) -> float:
    return float(np.abs(values).max(initial=0.0))


def _why_not(ours: mujoco.MjModel, theirs: mujoco.MjModel) -> str:
    for name, what in (("nbody", "bodies"), ("nq", "coordinates"), ("nv", "degrees of freedom"), ("na", "activations")):
        one, two = getattr(ours, name), getattr(theirs, name)
        if one != two:
            return f"{one} {what}, {two} of the file"
    return ""


def _joints(model: mujoco.MjModel, body: int) -> list[int]:
    """Joints of a body as Newton sorts them: slides come before hinges."""
    joints = list(range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]))
    return sorted(joints, key=lambda j: model.jnt_type[j] == _HINGE)


def _joint_pairs(ours: mujoco.MjModel, theirs: mujoco.MjModel) -> list[tuple[int, int]]:
    """Joints of both, which have the same bodies in the same order."""
    return [
        pair for body in range(ours.nbody) for pair in zip(_joints(ours, body), _joints(theirs, body), strict=False)
    ]


def _columns(ours: mujoco.MjModel, theirs: mujoco.MjModel, address: str, width: dict[int, int]) -> _Columns:
    """Addresses of the same coordinates, or velocities, in both."""
    first, second = getattr(ours, f"jnt_{address}"), getattr(theirs, f"jnt_{address}")
    found = [
        (first[one] + k, second[two] + k)
        for one, two in _joint_pairs(ours, theirs)
        for k in range(width[int(theirs.jnt_type[two])])
    ]
    return np.array([a for a, _ in found], dtype=int), np.array([b for _, b in found], dtype=int)


def _actuators(ours: mujoco.MjModel, theirs: mujoco.MjModel) -> list[int] | None:
    """The file's actuator for each of ours: by what it acts on, in order; None if they are not the same."""
    of_joint = dict(_joint_pairs(ours, theirs))
    waiting: dict[tuple[int, int], list[int]] = {}
    for a in range(theirs.nu):
        waiting.setdefault((int(theirs.actuator_trntype[a]), int(theirs.actuator_trnid[a, 0])), []).append(a)
    found = []
    on_joints = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    for a in range(ours.nu):
        kind, target = int(ours.actuator_trntype[a]), int(ours.actuator_trnid[a, 0])
        rows = waiting.get((kind, of_joint.get(target, -1) if kind in on_joints else target))
        if not rows:
            return None
        found.append(rows.pop(0))
    return found if len(found) == theirs.nu else None


def _controls(model: mujoco.MjModel, steps: int, seed: int) -> np.ndarray:
    """Sines of random frequency and phase within the control ranges, shape ``(steps, nu)``."""
    random = np.random.default_rng(seed)
    limited = model.actuator_ctrllimited.astype(bool)
    low = np.where(limited, model.actuator_ctrlrange[:, 0], -0.3)
    high = np.where(limited, model.actuator_ctrlrange[:, 1], 0.3)
    turns, phase = random.uniform(0.5, 2.0, model.nu), random.uniform(0.0, 2.0 * np.pi, model.nu)
    seconds = np.arange(steps)[:, None] * model.opt.timestep
    return 0.5 * (low + high) + 0.3 * (high - low) * np.sin(2.0 * np.pi * turns * seconds + phase)
