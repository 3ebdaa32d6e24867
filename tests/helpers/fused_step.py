# SPDX-License-Identifier: Apache-2.0
"""The fused step beside MuJoCo's C: recorded states of a model, and the velocities of both after a step."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
import warp as wp

from stripe_newton.solvers.hulls import HullTables
from stripe_newton.solvers.limb_form import why_no_limbs
from stripe_newton.solvers.model_tables import PARAMETERS, ModelTables
from stripe_newton.solvers.step_kernel import BODY_SIZE, CONTACTS, STATE, KernelOptions, step_kernel

MAX_ROWS, MAX_CONTACTS, CONTACT_SIZE = 600, 150, 31
CONTACT_SIZES = dict(zip(CONTACTS, (3, 9, 5, 1, 1, 2, 10, 1), strict=True))
"""Numbers of the fields of a contact; it has up to ten rows."""
State = dict[str, np.ndarray]


@dataclass
class Comparison:
    """Results of a step in many states."""

    error: np.ndarray
    """Relative errors of the velocities, shape ``(n,)``."""
    force_error: np.ndarray
    """Relative errors of the forces of all constraint rows in the last step, in the states with as many rows and any
    force, shape ``(m,)``. Forces are sorted, as contacts of some geoms come last in the fused step."""
    rows: np.ndarray
    """Constraint rows of the fused step."""
    expected_rows: np.ndarray
    """Constraint rows of MuJoCo."""
    acceleration_error: np.ndarray
    """Relative errors of the accelerations of all bodies in the last step, shape ``(n,)``."""
    wrench_error: np.ndarray
    """Errors of the wrenches that bodies receive through their joints, in that step, relative to these and the wrenches
    from outside, shape ``(n,)``."""
    contacts: list[np.ndarray]
    """Contacts of the fused step in each state, in order: geoms, distance, point and frame, ``(contacts, 15)``."""
    expected_contacts: list[np.ndarray]
    """Contacts of MuJoCo that act, those nearer than their margin."""


def record(model: mujoco.MjModel, count: int, seed: int = 0) -> list[dict[str, np.ndarray]]:
    """States of a model that was kicked, driven and pushed at random."""
    rng, data, states = np.random.default_rng(seed), mujoco.MjData(model), []
    while len(states) < count:
        mujoco.mj_resetData(model, data)
        data.qvel[:] = rng.normal(size=model.nv) * rng.random()
        for step in range(60):
            if step % 10 == 0:
                data.ctrl[:] = rng.uniform(-1.0, 1.0, model.nu)
            data.qfrc_applied[:] = 0.1 * rng.normal(size=model.nv)
            data.xfrc_applied[1:] = rng.normal(size=(model.nbody - 1, 6))
            if rng.random() < 0.3:
                states.append({name: getattr(data, name).copy() for name in STATE})
            mujoco.mj_step(model, data)
    return states[:count]


@dataclass(frozen=True)
class Motion:
    """How a robot starts and is driven, before and while states of it are recorded."""

    pose: str = "home"
    """Pose it starts in, up to noise: ``"home"``, ``"random"``, ``"folded"`` (touching itself), ``"limits"``."""
    height: float = 0.0
    """Height of a floating base above that at which it touches the ground [m]."""
    turned: bool = False
    """Whether a floating base starts in a random orientation, spinning."""
    wait: float = 0.0
    """Time before states are recorded [s]."""
    drive: float = 0.3
    """Amplitude of the smooth targets of actuators; 1 is half of their range."""
    grip: bool = False
    """Whether a hand closes."""


MOTIONS = {
    "standing": Motion(drive=0.05, wait=0.3),
    "walking": Motion(drive=0.25, wait=0.1),
    "airborne": Motion("random", height=1.5, turned=True),
    "fallen": Motion("home", height=0.1, turned=True, wait=1.0, drive=0.2),
    "at limits": Motion("limits"),
    "folded": Motion("folded"),
    "grasping": Motion(wait=0.15, drive=0.2, grip=True),
}
_RECORDED = 0.15
"""Time over which the states of a motion are recorded [s]."""


@dataclass(frozen=True)
class Robot:
    """A robot in its scene: on a plane, or a hand with a free body ``object``."""

    model: mujoco.MjModel
    home: np.ndarray
    """Coordinates of its standing pose. The height of a floating base does not matter."""
    grip: float = 0.0
    """Target of all actuators of a closed hand, beyond home; 1 is half of their range."""

    @property
    def motions(self) -> list[str]:
        """Motions that make sense for it, keys of :data:`MOTIONS`."""
        left_out = set() if self.object_joint >= 0 else {"grasping"}
        left_out |= set() if len(self.bases) else {"airborne", "fallen"}
        left_out |= set() if len(self.limited) else {"at limits"}
        left_out |= set() if self.model.njnt - len(self.bases) else {"folded"}
        return [name for name in MOTIONS if name not in left_out]

    @property
    def object_joint(self) -> int:
        """The joint of the body ``object``, or -1."""
        body = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_BODY, "object")
        return -1 if body < 0 else int(self.model.body_jntadr[body])

    @property
    def bases(self) -> np.ndarray:
        """Joints of floating bases."""
        free = np.flatnonzero(self.model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
        return free[free != self.object_joint]

    @property
    def limited(self) -> np.ndarray:
        """Joints that have limits."""
        return np.flatnonzero(self.model.jnt_limited * (self.model.jnt_type != mujoco.mjtJoint.mjJNT_FREE))

    def record(self, count: int, seed: int = 0) -> dict[str, list[State]]:
        """About ``count`` states in all, of each motion as many."""
        rng, each = np.random.default_rng(seed), -(-count // len(self.motions))
        return {name: self._record(MOTIONS[name], each, rng) for name in self.motions}

    def _record(self, motion: Motion, count: int, rng: np.random.Generator) -> list[State]:
        states, data, dt = [], mujoco.MjData(self.model), self.model.opt.timestep
        starts = min(count, 5 + count // 10)
        wait, steps = int(motion.wait / dt), max(int(_RECORDED / dt), -(-count // starts))
        while len(states) < count:
            self._start(motion, data, rng)
            drive = self._drive(motion, rng)
            chosen = wait + rng.choice(steps, -(-count // starts), replace=False)
            for step in range(wait + steps):
                data.ctrl[:], data.qfrc_applied[:], data.xfrc_applied[:] = drive(step * dt)
                if step in chosen:
                    states.append({name: getattr(data, name).copy() for name in STATE})
                mujoco.mj_step(self.model, data)
                if any(warning.number for warning in data.warning):
                    break  # it was reset
        return states[:count]

    def _start(self, motion: Motion, data: mujoco.MjData, rng: np.random.Generator) -> None:
        mujoco.mj_resetData(self.model, data)
        for _ in range(20):
            data.qpos[:], data.qvel[:] = self._pose(motion, rng), rng.normal(size=self.model.nv) * 0.1
            self._place(motion, data)
            if motion.pose != "folded" or any(min(self.model.geom_bodyid[c.geom]) > 0 for c in data.contact):
                return

    def _pose(self, motion: Motion, rng: np.random.Generator) -> np.ndarray:
        model, q = self.model, self.home.copy()
        joints = model.jnt_qposadr[self.limited]
        low, high = model.jnt_range[self.limited].T
        if motion.pose in ("random", "folded"):
            q[joints] = rng.uniform(low, high)
        elif motion.pose == "limits":
            end = np.where(rng.random(len(low)) < 0.5, low, high)
            near = rng.random(len(low)) < 0.6
            q[joints[near]] = (end + 0.02 * rng.normal(size=len(low)))[near]
        else:
            q[joints] += 0.01 * rng.normal(size=len(low))
        for base in self.bases:
            turn = slice(model.jnt_qposadr[base] + 3, model.jnt_qposadr[base] + 7)
            q[turn] = rng.normal(size=4) if motion.turned else q[turn] + 0.01 * rng.normal(size=4)
            q[turn] /= np.linalg.norm(q[turn])
        return q

    def _place(self, motion: Motion, data: mujoco.MjData) -> None:
        """Lower floating bases until they touch the ground, raise them by the height, spin those that are turned."""
        for base in self.bases:
            z, v = int(self.model.jnt_qposadr[base]) + 2, int(self.model.jnt_dofadr[base])
            low, high = -1.0, 4.0
            while high - low > 1e-3:
                data.qpos[z] = 0.5 * (low + high)
                mujoco.mj_fwdPosition(self.model, data)
                touches = any(min(self.model.geom_bodyid[c.geom]) == 0 for c in data.contact)
                low, high = (data.qpos[z], high) if touches else (low, data.qpos[z])
            data.qpos[z] += motion.height
            data.qvel[v : v + 6] *= 20.0 if motion.turned else 1.0
        mujoco.mj_forward(self.model, data)

    def _drive(self, motion: Motion, rng: np.random.Generator) -> Callable[[float], tuple[np.ndarray, ...]]:
        """Controls, forces of joints and forces on bodies as functions of time. Joints without actuators are pushed."""
        model = self.model
        centre, half = self._controls()
        if motion.grip:
            centre = centre + self.grip * rng.uniform(0.7, 1.2) * half
        pushed = 20.0 * (model.jnt_type[model.dof_jntid] != mujoco.mjtJoint.mjJNT_FREE) * (model.nu == 0)
        rate, phase = rng.uniform(3.0, 20.0, model.nu + model.nv), rng.uniform(0.0, 6.3, model.nu + model.nv)
        inertia = np.concatenate([np.repeat(model.body_mass[:, None], 3, axis=1), model.body_inertia], axis=1)
        wrench = motion.drive * 10.0 * inertia * rng.normal(size=inertia.shape)

        def drive(time: float) -> tuple[np.ndarray, ...]:
            wave = motion.drive * np.sin(rate * time + phase)
            return centre + half * wave[: model.nu], pushed * model.dof_M0 * wave[model.nu :], wrench

        return drive

    def _controls(self) -> tuple[np.ndarray, np.ndarray]:
        """Controls that hold the robot at home, and half of the ranges of controls."""
        model = self.model
        centre, half = np.zeros(model.nu), np.ones(model.nu)
        for u in range(model.nu):
            joint = int(model.actuator_trnid[u, 0])
            servo = model.actuator_trntype[u] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_biasprm[u, 1] < 0
            if model.actuator_ctrllimited[u]:
                centre[u], half[u] = np.mean(model.actuator_ctrlrange[u]), np.ptp(model.actuator_ctrlrange[u]) / 2
            elif servo and model.jnt_limited[joint]:
                half[u] = np.ptp(model.jnt_range[joint]) / 2
            if servo:
                centre[u] = self.home[model.jnt_qposadr[joint]]
        return centre, half


def compare(
    model: mujoco.MjModel,
    count: int = 200,
    double: bool = True,
    given_contacts: bool = False,
    states: list[State] | None = None,
    steps: int = 1,
    limbs: bool = False,
) -> Comparison:
    """Steps of the fused kernel on the CPU, and of MuJoCo in double precision, from the same states.

    Args:
        model: The model. MuJoCo's solver goes on until nothing improves.
        count: Number of states to record.
        double: Whether the kernel computes in double precision.
        given_contacts: Whether the kernel takes MuJoCo's contacts, of the first step, rather than find its own.
        states: Recorded states; default: those of :func:`record`. They may have ``eq_active`` and poses of mocap
            bodies, too.
        steps: Time steps. The rows are those of the last one.
        limbs: Whether the kernel has the form for a hub with limbs, which has no contacts, rows and accelerations to
            compare.
    """
    model = copy.copy(model)
    model.opt.tolerance, model.opt.ls_tolerance = 0.0, 1e-12
    model.opt.iterations = model.opt.ls_iterations = 100
    states, data = states or record(model, count), mujoco.MjData(model)
    count = len(states)
    velocities, rows = np.zeros((count, model.nv)), np.zeros(count, dtype=int)
    forces, expected = np.zeros((count, MAX_ROWS)), []
    (accelerations, wrenches), sizes = np.zeros((2, count, model.nbody - 1, 6)), np.zeros(count)
    contacts, contact_counts = np.zeros((count, MAX_CONTACTS, CONTACT_SIZE)), np.zeros(count, dtype=np.int32)
    for i, state in enumerate(states):
        mujoco.mj_resetData(model, data)
        for name, value in state.items():
            getattr(data, name)[:] = value
        for _ in range(steps):
            before = data.qvel.copy()
            mujoco.mj_step(model, data)
        velocities[i], rows[i] = data.qvel, data.nefc
        accelerations[i], wrenches[i] = body_results(model, data, before)
        sizes[i] = np.linalg.norm(wrenches[i]) + np.linalg.norm(data.cfrc_ext)
        active = [c for c in data.contact if not c.exclude and c.efc_address >= 0]
        expected.append(np.array([_numbers(model, c)[_PLACE] for c in active]).reshape(-1, 15))
        forces[i, : data.nefc] = data.efc_force
        contact_counts[i] = len(active) if given_contacts else 0
        for k in range(contact_counts[i]):
            contacts[i, k] = _numbers(model, active[k])
    tolerance = 1e-15 if double else 1e-6
    options = KernelOptions(
        double=double, tolerance=tolerance, given_contacts=given_contacts, accelerations=not limbs, contacts=not limbs
    )
    losses = bool(np.any(model.dof_frictionloss))
    tables = ModelTables.of(model, MAX_ROWS, MAX_CONTACTS, limbs=limbs, losses=losses)
    assert not limbs or tables.limbs is not None, why_no_limbs(model, tables.pairs)
    kernel = step_kernel(dataclasses.replace(tables, pairs=()) if given_contacts else tables, options)
    dtype = wp.float64 if double else wp.float32
    arrays = {name: np.stack([s[name] for s in states]).reshape(count, -1) for name in STATE} | {"contacts": contacts}
    held = {name: wp.array(value.ravel(), dtype=dtype, device="cpu") for name, value in arrays.items()}
    arguments = kernel.arguments()
    for name, value in arrays.items():
        setattr(arguments, name, held[name].ptr or 0)
        setattr(arguments, f"{name}_stride", value[0].size)
    for name, field in PARAMETERS.items():
        owner, _, leaf = field.rpartition(".")
        value = np.atleast_1d(getattr({"": model, "opt": model.opt, "data": data}[owner], leaf))
        held[field] = wp.array(value.astype(float).ravel(), dtype=dtype, device="cpu")
        setattr(arguments, name, held[field].ptr or 0)  # all worlds share it: the stride stays 0
        if owner == "data" and leaf in states[0]:
            held[field] = wp.array(np.stack([s[leaf] for s in states]).ravel(), dtype=dtype, device="cpu")
            setattr(arguments, name, held[field].ptr or 0)
            setattr(arguments, f"{name}_stride", value.size)
    none = np.zeros(count, dtype=np.int32)
    for name, values in {"nefc": none, "solver_niter": none, "overflow": none, "contact_count": contact_counts}.items():
        held[name] = wp.array(values, dtype=int, device="cpu")
        setattr(arguments, name, held[name].ptr)
        if name != "contact_count":
            setattr(arguments, f"{name}_stride", 1)
    hulls = HullTables(model, tables.pairs, "cpu", double)
    arguments.hulls = hulls.array.ptr
    held["qfrc_actuator"] = wp.zeros(count * model.nv, dtype=dtype, device="cpu")
    arguments.qfrc_actuator, arguments.qfrc_actuator_stride = held["qfrc_actuator"].ptr or 0, model.nv
    for name, size in {"xpos": 3 * model.nbody, "xquat": 4 * model.nbody, "efc_force": MAX_ROWS}.items():
        held[name] = wp.zeros(count * size, dtype=dtype, device="cpu")
        setattr(arguments, name, held[name].ptr)
        setattr(arguments, f"{name}_stride", size)
    for name, size in CONTACT_SIZES.items():
        whole = name in ("dim", "geom", "efc_address", "worldid")
        held[name] = wp.zeros(count * MAX_CONTACTS * size, dtype=int if whole else dtype, device="cpu")
        setattr(arguments, f"contact_{name}", held[name].ptr)
    bodies = np.arange(-1, model.nbody - 1)[None] + (model.nbody - 1) * np.arange(count)[:, None]
    bodies[:, 0] = -1  # Newton has no body for the world
    held["newton_body"] = wp.array(bodies.ravel(), dtype=int, device="cpu")
    held["bodies"] = wp.zeros(count * BODY_SIZE * model.nbody, dtype=dtype, device="cpu")
    arguments.bodies_stride = BODY_SIZE * model.nbody
    for name in ("body_qdd", "body_parent_f"):
        held[name] = wp.zeros(accelerations.size, dtype=dtype, device="cpu")
    active = np.array([s.get("eq_active", model.eq_active0) for s in states], dtype=np.uint8)
    held["eq_active"] = wp.array(active.ravel(), dtype=wp.uint8, device="cpu")
    for name in ("eq_active", "newton_body", "bodies", "body_qdd", "body_parent_f"):
        setattr(arguments, name, held[name].ptr or 0)
    kernel.launch(arguments, count, "cpu", steps)
    found = held["qvel"].numpy().reshape(count, -1)
    error = np.linalg.norm(found - velocities, axis=1) / np.linalg.norm(velocities, axis=1)
    nefc, forces = held["nefc"].numpy(), np.sort(forces)
    found_forces = np.sort(held["efc_force"].numpy().reshape(count, -1))
    size = np.linalg.norm(forces, axis=1)
    compared = (nefc == rows) & (size > 0.0)
    off = np.linalg.norm(found_forces - forces, axis=1)[compared] / size[compared]
    accelerated, wrench = (held[name].numpy().reshape(count, -1) for name in ("body_qdd", "body_parent_f"))
    acceleration_error = np.linalg.norm(accelerated - accelerations.reshape(count, -1), axis=1)
    acceleration_error /= np.linalg.norm(accelerations, axis=(1, 2))
    wrench_error = np.linalg.norm(wrench - wrenches.reshape(count, -1), axis=1) / sizes
    return Comparison(
        error, off, nefc, rows, acceleration_error, wrench_error, _written_contacts(held, count), expected
    )


def body_results(model: mujoco.MjModel, data: mujoco.MjData, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Accelerations of bodies and the wrenches of their joints in the last step of MuJoCo, as Newton has them.

    Args:
        model: The model.
        data: Its data after a step, which is lost.
        before: Velocities before that step.

    Returns:
        (acceleration of the centre of mass, angular acceleration), and (force, torque about the centre of mass) that
        each body receives from its parent, in the world, shape ``(nbody - 1, 6)``.
    """
    data.qvel[:] = before  # the other results are those at the start of the step
    mujoco.mj_rnePostConstraint(model, data)
    accelerations, wrenches = np.zeros((2, model.nbody - 1, 6))
    for b in range(1, model.nbody):
        # Spatial quantities (angular, linear) of a tree are about its centre of mass.
        offset = data.xipos[b] - data.subtree_com[model.body_rootid[b]]
        spin, velocity = data.cvel[b, :3], data.cvel[b, 3:] - np.cross(offset, data.cvel[b, :3])
        turning, acceleration = data.cacc[b, :3], data.cacc[b, 3:] - np.cross(offset, data.cacc[b, :3])
        accelerations[b - 1] = [*(acceleration + np.cross(spin, velocity) + model.opt.gravity), *turning]
        torque, force = data.cfrc_int[b, :3], data.cfrc_int[b, 3:]
        wrenches[b - 1] = [*force, *(torque - np.cross(offset, force))]
    return accelerations, wrenches


_PLACE = [29, 30, *range(13)]
"""Geoms, distance, point and frame in :func:`_numbers`."""


def _written_contacts(held: dict[str, wp.array], count: int) -> list[np.ndarray]:
    """Contacts that the fused step wrote, as in :class:`Comparison`."""
    names = "geom", "dist", "pos", "frame"
    places = np.concatenate([held[n].numpy().reshape(count, MAX_CONTACTS, CONTACT_SIZES[n]) for n in names], axis=2)
    return [found[found[:, 0] >= 0] for found in places]


def _numbers(model: mujoco.MjModel, contact: mujoco.MjContact) -> np.ndarray:
    """A contact as constraints.h takes it."""
    parts = [contact.dist], contact.pos, contact.frame, contact.friction, contact.solref, contact.solreffriction
    return np.concatenate([*parts, contact.solimp, [contact.includemargin, contact.dim, contact.geom1, contact.geom2]])
