# SPDX-License-Identifier: Apache-2.0
"""Operational space actions: efforts against MuJoCo's dynamics in float64, an arm in the loop, errors of configs."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.controllers import OperationalSpaceControllerCfg
from stripe_newton.envs import mdp
from tests.helpers.arm_env import DOWN, GOALS, arm_env, run
from tests.helpers.inverse_kinematics_world import FLANGE, OFFSET, TROLLEY, World, action, frames_of
from tests.helpers.small_scenes import mjcf_robot, numpy

LOOSE = {"motors": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=0.0, damping=0.0)}
Action = mdp.OperationalSpaceControllerActionCfg


@configclass
class ScalarFirstAction(Action):
    """Takes quaternions (w, x, y, z)."""

    scalar_first = True


def osc(body: str = FLANGE, kind: type = Action, control: dict[str, Any] | None = None, **fields: Any) -> Any:
    """The config of an action on all joints."""
    controller = OperationalSpaceControllerCfg(**{"target_types": ["pose_abs"], **(control or {})})
    return kind(joint_names=[".*"], body_name=body, body_offset=OFFSET, controller_cfg=controller, **fields)


# -- efforts

GAINS = {"motion_stiffness_task": [90.0, 80.0, 70.0, 60.0, 50.0, 40.0], "motion_damping_ratio_task": 0.7}


BASE = '<body name="base"><freejoint/><inertial pos="0.05 0.02 0.1" mass="3" diaginertia=".05 .06 .07"/>'


class Expected:
    """Kinematics and dynamics of the frame in an environment, by MuJoCo, in the root's frame."""

    def __init__(self, world: World, env: int, first: int, body: int):
        point, matrix, jacobian = world.mujoco(env, body, np.array(OFFSET.pos))
        data = world.robot.data
        root = Rotation.from_quat(numpy(data.root_quat_w[env]).astype(float)).inv()
        self.pos = root.apply(point - numpy(data.root_pos_w[env]))
        self.turn = root * Rotation.from_matrix(matrix) * Rotation.from_quat(OFFSET.rot)
        self.jacobian = np.concatenate([root.as_matrix() @ part for part in (jacobian[:3], jacobian[3:])])
        model, state = world.model, mujoco.MjData(world.model)
        if first:
            pose = numpy(data.root_state_w[env, :7])
            state.qpos[:3], state.qpos[3:7] = pose[:3], pose[[6, 3, 4, 5]]
        state.qpos[first + (first > 0) :] = numpy(data.joint_pos[env])
        mujoco.mj_forward(model, state)  # at rest, where the bias is gravity
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, state, full)
        self.mass, self.gravity = full[first:, first:], state.qfrc_bias[first:]

    def inertia(self) -> np.ndarray:
        return np.linalg.inv(self.jacobian @ np.linalg.solve(self.mass, self.jacobian.T))

    def acceleration(self, pos: np.ndarray, turn: Rotation, speed: np.ndarray) -> np.ndarray:
        stiffness = np.array(GAINS["motion_stiffness_task"])
        damping = 2.0 * np.sqrt(stiffness) * GAINS["motion_damping_ratio_task"]
        error = np.concatenate([pos - self.pos, (turn * self.turn.inv()).as_rotvec()])
        return stiffness * error - damping * (self.jacobian @ speed)


@pytest.mark.parametrize("floating", [False, True], ids=["fixed", "floating"])
def test_efforts_are_those_of_the_formula(tmp_path, floating):
    """With null space, decoupling, gravity; the root is turned, and moves if it floats."""
    base = BASE if floating else BASE.replace("<freejoint/>", "")
    text = TROLLEY.replace("<worldbody>", f"<worldbody>{base}").replace("</worldbody>", "</body></worldbody>")
    robot = mjcf_robot(tmp_path, text, fix_base=None)
    world = World(robot, action("rod"), tmp_path)
    world.scatter(turn_root=floating)
    asset = world.robot
    speed = world.rng.normal(size=(4, asset.num_joints))
    asset.write_joint_state_to_sim(asset.data.joint_pos.clone(), torch.tensor(speed, dtype=torch.float32))
    if floating:
        asset.write_root_velocity_to_sim(torch.tensor(world.rng.normal(size=(4, 6)), dtype=torch.float32))
    world.scene.sim.forward()

    control = {
        **GAINS,
        "inertial_dynamics_decoupling": True,
        "gravity_compensation": True,
        "nullspace_control": "position",
        "nullspace_stiffness": 5.0,
    }
    cfg = osc("rod", control=control, nullspace_joint_pos_target="default", position_scale=0.5)
    env = SimpleNamespace(scene=world.scene, num_envs=4, device="cpu", context=world.context, step_dt=0.02)
    term = cfg.class_type(cfg, env)
    goal, turn = world.rng.normal(size=(4, 3)), Rotation.random(4, random_state=1)
    actions = np.concatenate([2.0 * goal, 3.0 * turn.as_quat()], axis=-1)  # any length
    term.process_actions(torch.tensor(actions, dtype=torch.float32))
    term.apply_actions()

    found, body = numpy(asset.data.joint_effort_target), asset.body_names.index("rod")
    home = numpy(asset.data.default_joint_pos).astype(float)
    for i in range(4):
        e = Expected(world, i, 6 if floating else 0, body)
        wrench = e.inertia() @ e.acceleration(goal[i], turn[i], speed[i])
        posture = e.mass @ (5.0 * (home[i] - numpy(asset.data.joint_pos[i])) - 2.0 * math.sqrt(5.0) * speed[i])
        free = np.eye(len(posture)) - e.jacobian.T @ e.inertia() @ np.linalg.solve(e.mass, e.jacobian.T).T
        expected = e.jacobian.T @ wrench + e.gravity + free @ posture
        np.testing.assert_allclose(found[i], expected, rtol=2e-3, atol=2e-3 * np.abs(expected).max())


# -- in the loop


@pytest.mark.parametrize("kind", [Action, ScalarFirstAction], ids=["xyzw", "wxyz"])
def test_arm_takes_a_commanded_pose_under_gravity(kind):
    """Stiffness comes with the command, scaled and within its limits."""
    control = {
        "impedance_mode": "variable_kp",
        "inertial_dynamics_decoupling": True,
        "gravity_compensation": True,
        "motion_stiffness_limits_task": (20.0, 150.0),
    }
    env = arm_env(osc(kind=kind, control=control, stiffness_scale=100.0), turned=1.0, weightless=False, drives=LOOSE)
    quat = DOWN.as_quat()[:, [3, 0, 1, 2]] if kind is ScalarFirstAction else DOWN.as_quat()
    gains = np.tile([[1.0], [0.01], [9.0]], (1, 6))
    run(env, np.concatenate([GOALS, 2.0 * quat, gains], axis=-1))
    pos, turn = frames_of(env, OFFSET)
    assert np.linalg.norm(pos - GOALS, axis=-1).max() < 2e-3
    assert np.rad2deg((DOWN.inv() * turn).magnitude()).max() < 0.3
    term = env.action_manager.get_term("arm")
    np.testing.assert_allclose(numpy(term.processed_actions[:, 7]), [100.0, 20.0, 150.0])
    np.testing.assert_allclose(numpy(term.raw_actions[:, 7:]), gains, rtol=1e-6)
    env.close()


def test_without_rotation_the_body_keeps_its_orientation():
    env = arm_env(osc(control={"inertial_dynamics_decoupling": True}), drives=LOOSE)
    pos, before = frames_of(env, OFFSET)
    run(env, np.concatenate([pos, np.zeros((3, 4))], axis=-1), 0.5)
    after, turn = frames_of(env, OFFSET)
    np.testing.assert_allclose(after, pos, atol=1e-3)
    assert np.rad2deg((before.inv() * turn).magnitude()).max() < 0.1
    env.close()


# -- what is refused


@pytest.mark.parametrize(
    ("term", "text"),
    [
        (osc(nullspace_joint_pos_target="zero"), "nullspace_joint_pos_target: is 'zero' with nullspace_control 'none'"),
        (osc(nullspace_joint_pos_target="home"), "nullspace_joint_pos_target: is 'home', must be one of"),
        (osc(control={"contact_wrench_stiffness_task": 0.1}), "contact_sensor: is missing"),
    ],
)
def test_contradictions_of_a_config_are_told(term, text):
    with pytest.raises(ConfigError, match=text):
        arm_env(term)


@pytest.mark.parametrize(
    ("term", "text"),
    [
        (osc("wrist_.*_link"), "body_name 'wrist_.*_link' matches wrist_1_link, wrist_2_link"),
        (osc(task_frame="ground"), "task_frame: 'ground' is a .*, must be a BoundAsset"),
    ],
)
def test_names_that_are_not_there_are_told(term, text):
    with pytest.raises(RuntimeError, match=text):
        arm_env(term)
