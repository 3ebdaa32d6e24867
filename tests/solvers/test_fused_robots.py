# SPDX-License-Identifier: Apache-2.0
"""The fused step of robots against MuJoCo's C in double precision, in recorded states of all kinds.

Robots of this repository are those of the tasks. Files of others are found by `robot_files.py`: Go2, ANYmal C, Panda
and the hands need MENAGERIE_ROOT.
"""

from __future__ import annotations

import copy
import functools
import importlib
import re

import mujoco
import numpy as np
import pytest

from stripe_newton.assets import AssetBaseCfg
from stripe_newton.sim import GroundPlaneCfg, MuJoCoSolverCfg
from stripe_newton.solvers import why_unsupported
from stripe_newton.solvers.contact_pairs import contact_pairs
from tests.helpers.fused_step import Robot, compare
from tests.helpers.robot_files import robot_file
from tests.helpers.small_scenes import make_scene, sim_cfg

OWN = {
    "cartpole": "stripe_tasks.robots:CARTPOLE_CFG",
    "cart_double_pole": "stripe_tasks.robots:CART_DOUBLE_POLE_CFG",
    "ant": "stripe_tasks.robots:ANT_CFG",
    "humanoid": "stripe_tasks.robots:HUMANOID_CFG",
    "humanoid_position": "stripe_tasks.robots:HUMANOID_POSITION_CFG",
    "quadruped": "stripe_tasks.robots:QUADRUPED_CFG",
    "arm": "stripe_tasks.reach.arm:ARM_CFG",
    "crazyflie": "stripe_tasks.quadcopter.crazyflie:CRAZYFLIE_CFG",
}
"""Configs of the robots of this repository."""

CROUCH = {".*_thigh_joint": 0.9, ".*_calf_joint": -1.8}
OTHERS: dict[str, dict[str, float]] = {
    "go1": CROUCH,
    "go2": CROUCH,
    "anymal_c": {".F_HFE": 0.4, ".F_KFE": -0.8, ".H_HFE": -0.4, ".H_KFE": 0.8},
    "g1": {".*_hip_pitch_joint": -0.3, ".*_knee_joint": 0.6, ".*_ankle_pitch_joint": -0.3},
    "panda": {},
    "allegro": {},
    "shadow_hand": {},
}
"""Robots of others, with the joints of their standing pose if they have no keyframe."""

HELD = {
    "panda": (mujoco.mjtGeom.mjGEOM_CAPSULE, [0.025, 0.03, 0]),
    "allegro": (mujoco.mjtGeom.mjGEOM_SPHERE, [0.035, 0, 0]),
    "shadow_hand": (mujoco.mjtGeom.mjGEOM_CAPSULE, [0.025, 0.04, 0]),
}
"""Type and size of the free geom that a hand grasps."""
GRIP = {"allegro": 1.5, "shadow_hand": 1.5}
"""Targets that close a hand; the gripper's range ends where its fingers touch each other."""
ARMATURE = 0.005
"""Least reflected inertia of motors [kg m^2]: mjlab's configs of Go1 and G1 have 0.004 to 0.025, their files none.
Without it inertias of G1 differ by five orders, and in single precision velocities have errors of 3e-6, as those of
MuJoCo Warp have."""
RIM = {
    "crazyflie": "MuJoCo chooses points on the rim of an upright cylinder by rounding",
    "anymal_c": "MuJoCo counts an end of a cylinder's edge twice in one of a hundred states",
}
"""Robots that take MuJoCo's contacts although the kernel has routines for all of them, and why."""

SINGLE = {"humanoid": (3e-6, 1e-4), "crazyflie": (1e-6, 2e-3)}
"""Bounds of the median and the 99th percentile of errors in single precision, where 1e-6 and 1e-4 are missed. The
humanoid lies and stands on weak springs: 1e-6 after a step and 2e-6 after four; MuJoCo Warp has 7e-7 after a step. The
quadcopter rests at speeds below 1e-3, beside which rounding is large."""


@functools.cache
def load(name: str) -> Robot:
    """A robot on a plane, or a hand in the air; the test is skipped if its file is missing or it is not supported."""
    robot = own_robot(OWN[name]) if name in OWN else robot_of_others(name)
    reason = why_unsupported(robot.model)
    if reason:
        pytest.skip(f"the fused step does not support {name}: {reason}")
    return robot


def own_robot(path: str) -> Robot:
    """A robot of the tasks, as Newton compiles it."""
    module, _, name = path.partition(":")
    robot = getattr(importlib.import_module(module), name).replace(prim_path="{ENV_REGEX_NS}/Robot")
    ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    solver = MuJoCoSolverCfg(njmax=300, nconmax=100)
    scene = make_scene({"ground": ground, "robot": robot}, num_envs=1, sim=sim_cfg(dt=0.005, solver=solver))
    return Robot(scene.sim.solver.mj_model, scene.sim.solver.mjw_data.qpos.numpy()[0].astype(float))


def robot_of_others(name: str) -> Robot:
    """A robot of a file. Joints get motors with servos of 10 Hz if it has no actuators."""
    spec = mujoco.MjSpec.from_file(str(robot_file(name)))
    model = spec.compile()
    home = home_pose(model, OTHERS[name])
    moving = np.flatnonzero(model.jnt_type != mujoco.mjtJoint.mjJNT_FREE)
    for key in list(spec.keys):  # they would not fit with an object
        spec.delete(key)
    if not model.nu:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        for j in moving:
            name_of_joint, dof = model.joint(j).name, model.jnt_dofadr[j]
            spec.joint(name_of_joint).armature = max(ARMATURE, model.dof_armature[dof])
            servo = spec.add_actuator(target=name_of_joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            servo.set_to_position(kp=(model.dof_M0[dof] + ARMATURE) * (2.0 * np.pi * 10.0) ** 2, dampratio=1.0)
    if name not in GRIP:
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    if name in HELD:
        kind, size = HELD[name]
        held = spec.worldbody.add_body(name="object", pos=palm(model, home))
        held.add_freejoint()
        held.add_geom(type=kind, size=size, mass=0.1)
        home = np.append(home, [*held.pos, 1.0, 0.0, 0.0, 0.0])
    return Robot(spec.compile(), home, GRIP.get(name, 0.0))


def home_pose(model: mujoco.MjModel, posture: dict[str, float]) -> np.ndarray:
    """The first keyframe, or the pose of the file with the joints of a posture, within their ranges."""
    home = model.key_qpos[0].copy() if model.nkey else model.qpos0.copy()
    for j in np.flatnonzero(model.jnt_type != mujoco.mjtJoint.mjJNT_FREE):
        a = int(model.jnt_qposadr[j])
        home[a] = next((v for n, v in posture.items() if re.fullmatch(n, model.joint(j).name)), home[a])
        if model.jnt_limited[j]:
            home[a] = np.clip(home[a], *model.jnt_range[j])
    return home


def palm(model: mujoco.MjModel, home: np.ndarray) -> np.ndarray:
    """Middle of the last links: of a gripper at home, of a hand half closed."""
    data = mujoco.MjData(model)
    data.qpos[:] = home if model.nkey else model.jnt_range.mean(axis=1)
    mujoco.mj_kinematics(model, data)
    last = [b for b in range(model.nbody) if b not in model.body_parentid]
    return data.geom_xpos[np.isin(model.geom_bodyid, last) & (model.geom_contype > 0)].mean(axis=0)


def why_given_contacts(name: str) -> str:
    """Reason why the kernel takes MuJoCo's contacts of a robot; empty if it finds them itself."""
    model = load(name).model
    for pair in contact_pairs(model):
        if not pair.kind:
            types = (mujoco.mjtGeom(model.geom_type[g]).name for g in (pair.geom1, pair.geom2))
            return f"the kernel has no routine for {' and '.join(types)}"
    return RIM.get(name, "")


def check(name: str, count: int, double: bool, steps: int = 1, limbs: bool = False) -> None:
    robot = load(name)
    states = [state for motion in robot.record(count).values() for state in motion]
    assert len(states) >= count
    given = bool(why_given_contacts(name))
    found = compare(robot.model, double=double, given_contacts=given, states=states, steps=steps, limbs=limbs)
    # In single precision a contact that begins within 1e-7 m may begin a step sooner or later.
    assert np.mean(found.rows != found.expected_rows) <= (0.0 if double else 0.01)
    median, p99 = (1e-12, 1e-8) if double else SINGLE.get(name, (1e-6, 1e-4))
    assert np.median(found.error) < median
    assert np.quantile(found.error, 0.99) < p99
    if len(found.force_error) and not limbs:  # forces of stiff rows are differences: they have some digits less
        assert np.median(found.force_error) < (1e-12 if double else 1e-4)


@pytest.mark.parametrize("name", [*OWN, *OTHERS])
@pytest.mark.parametrize("double", [True, False], ids=["double", "single"])
def test_a_step_is_that_of_mujoco(name, double):
    check(name, 200, double)


@pytest.mark.parametrize("double", [True, False], ids=["double", "single"])
def test_elliptic_cones_with_torsion_and_rolling(double):
    """Feet as mjlab's Go1 has them, standing, sliding and in the air."""
    robot = load("go1")
    model = copy.copy(robot.model)
    model.opt.cone, model.opt.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
    feet = model.geom_type == mujoco.mjtGeom.mjGEOM_SPHERE
    model.geom_condim[feet], model.geom_priority[feet] = 6, 1
    model.geom_friction[feet] = 1.0, 0.02, 0.005
    model.geom_solref[feet] = 0.01, 1.0
    states = [state for motion in Robot(model, robot.home).record(200).values() for state in motion]
    found = compare(model, double=double, states=states)
    assert found.rows.max() >= 24
    assert np.mean(found.rows != found.expected_rows) <= (0.0 if double else 0.01)
    assert np.median(found.error) < (1e-12 if double else 1e-6)
    assert np.quantile(found.error, 0.99) < (1e-8 if double else 1e-4)
    assert np.median(found.force_error) < (1e-12 if double else 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*OWN, *OTHERS])
@pytest.mark.parametrize("double", [True, False], ids=["double", "single"])
@pytest.mark.parametrize("steps", [1, 4], ids=["one step", "a control step"])
def test_thousands_of_steps_are_those_of_mujoco(name, double, steps):
    reason = why_given_contacts(name)
    if reason and steps > 1:
        pytest.skip(f"contacts of {name} are those of MuJoCo, for one step: {reason}")
    check(name, 2000, double, steps)


LIMBED = ["ant", "humanoid", "quadruped"]
"""Robots that are a hub with limbs, whose parts do not touch each other."""


@pytest.mark.parametrize("name", LIMBED)
@pytest.mark.parametrize("double", [True, False], ids=["double", "single"])
def test_a_step_by_limbs_is_that_of_mujoco(name, double):
    check(name, 200, double, limbs=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", LIMBED)
@pytest.mark.parametrize("double", [True, False], ids=["double", "single"])
@pytest.mark.parametrize("steps", [1, 4], ids=["one step", "a control step"])
def test_thousands_of_steps_by_limbs(name, double, steps):
    check(name, 2000, double, steps, limbs=True)
