# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics actions in the loop with the physics, and errors of configs."""

from __future__ import annotations

import math
import re

import newton
import numpy as np
import pytest
import torch

from stripe_newton.configclass import ConfigError
from tests.helpers.arm_env import DOWN, GOALS, arm_env, run
from tests.helpers.inverse_kinematics_world import (
    ARM,
    FLANGE,
    NONE,
    OFFSET,
    Action,
    Controller,
    World,
    action,
    frames_of,
)
from tests.helpers.small_scenes import mjcf_robot, numpy

# -- in the loop


@pytest.mark.parametrize("method", ["dls", "pinv", "svd"])
def test_arm_takes_a_commanded_pose(method):
    env = arm_env(action(method=method, body_offset=OFFSET), turned=1.0)
    run(env, np.concatenate([GOALS, DOWN.as_quat()], axis=-1))
    pos, turn = frames_of(env, OFFSET)
    assert np.linalg.norm(pos - GOALS, axis=-1).max() < 1e-3
    assert np.rad2deg((DOWN.inv() * turn).magnitude()).max() < 0.1
    env.close()


def test_gravity_leaves_what_the_drives_yield():
    """At rest the joints are off by effort over stiffness, and the body by what follows from that."""
    env = arm_env(action(method="pinv"), weightless=False)
    run(env, np.concatenate([GOALS, DOWN.as_quat()], axis=-1))
    data, (pos, turn) = env.scene["robot"].data, frames_of(env, NONE)
    error = np.concatenate([GOALS - pos, (DOWN * turn.inv()).as_rotvec()], axis=-1)
    assert np.linalg.norm(error[:, :3], axis=-1).max() < 0.015
    assert np.rad2deg(np.linalg.norm(error[:, 3:], axis=-1)).max() < 2.0
    assert np.linalg.norm(error[:, :3], axis=-1).min() > 0.002
    yielded = numpy(data.applied_torque) / numpy(data.joint_stiffness)
    jacobian = newton.eval_jacobian(env.sim.model, env.sim.state).numpy()[:, -6:]
    for i in range(3):
        arm = numpy(data.body_pos_w[i, -1] - data.body_com_pos_w[i, -1])
        linear = jacobian[i, :3] + np.cross(jacobian[i, 3:].T, arm).T
        np.testing.assert_allclose(np.concatenate([linear, jacobian[i, 3:]]) @ yielded[i], error[i], atol=3e-4)
    env.close()


def test_arm_takes_a_commanded_position():
    env = arm_env(action(command="position", method="pinv", ik_params={"k_val": 0.5}, scale=0.1))
    run(env, 10.0 * GOALS)
    assert np.linalg.norm(frames_of(env, NONE)[0] - GOALS, axis=-1).max() < 0.01
    env.close()


def test_relative_commands_go_the_way_they_say():
    """Rotations are about the frame's origin, shifts do not turn; axes are those of the root."""
    env = arm_env(action(relative=True, body_offset=OFFSET, scale=0.01), turned=-2.0)
    pos, turn = frames_of(env, OFFSET)
    told = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]])
    run(env, told, 1.0)
    run(env, np.zeros((3, 6)), 0.5)  # it comes to rest
    after, turned = frames_of(env, OFFSET)
    axis = (turned * turn.inv()).as_rotvec()
    shift = after - pos
    assert np.linalg.norm(shift[:2], axis=-1).max() < 0.005
    assert np.linalg.norm(axis[2]) < 0.2  # what joints that follow at different speeds add up to
    for found, index in ((axis[0], 2), (axis[1], 0), (shift[2], 1)):
        assert found[index] > 0.0
        assert np.linalg.norm(np.delete(found, index)) < 0.15 * found[index]
    env.close()


def test_relative_commands_move_by_what_they_say():
    """Drives without play: each step the body goes where its command says from where it was."""
    env = arm_env(action(relative=True, method="pinv"))
    data, told = env.scene["robot"].data, np.zeros((3, 6))
    told[0, :3], told[1, 3:], told[2] = [0.01, -0.02, 0.015], [0.0, 0.03, 0.05], [0.0, 0.01, 0.0, 0.02, 0.0, -0.02]
    pos, turn = frames_of(env, NONE)
    env.step(torch.tensor(told, dtype=torch.float32))
    env.scene["robot"].write_joint_state_to_sim(data.joint_pos_target.clone(), torch.zeros(3, 6))
    env.sim.forward()  # as if the drives had taken the last targets at once
    after, turned = frames_of(env, NONE)
    np.testing.assert_allclose(after - pos, told[:, :3], atol=1e-3)
    np.testing.assert_allclose((turned * turn.inv()).as_rotvec(), told[:, 3:], atol=2e-3)
    env.close()


def test_targets_follow_the_state_of_each_physics_step():
    """Two steps of one physics step each are one step of two, where the command is the same."""
    coarse, fine = arm_env(action()), arm_env(action(), decimation=1)
    command = torch.tensor(np.concatenate([GOALS, DOWN.as_quat()], axis=-1), dtype=torch.float32)
    for _ in range(5):
        coarse.step(command)
        fine.step(command)
        fine.step(command)
    for name in ("joint_pos_target", "joint_pos"):
        assert torch.equal(*(getattr(e.scene["robot"].data, name) for e in (coarse, fine)))
    assert "before each: arm" in coarse.describe()
    coarse.close()
    fine.close()


def test_environments_do_not_differ_by_where_they_stand():
    env = arm_env(action(), num_envs=5)
    run(env, np.tile(np.concatenate([GOALS[0], DOWN[0].as_quat()]), (5, 1)), 1.0)
    joints = numpy(env.scene["robot"].data.joint_pos)
    np.testing.assert_allclose(joints, np.tile(joints[0], (5, 1)), atol=1e-4)
    env.close()


# -- what is refused


@pytest.mark.parametrize(
    ("term", "text"),
    [
        (action("flange"), "actions.arm.body_name: .*'flange'"),
        (action("wrist_.*_link"), "actions.arm.body_name: .*more than one body.*wrist_1_link, wrist_2_link"),
        (action(joint_names=["elbo"]), "actions.arm.joint_names: .*'elbo'"),
        (action(asset_name="arm"), "actions.arm.asset_name: .*'arm'"),
        (
            action("shoulder_link", joint_names=["wrist_.*"]),
            "actions.arm.joint_names: none of wrist_1_joint, .* carries 'shoulder_link'; these do: shoulder_pan_joint",
        ),
        (action("base_link"), "actions.arm.joint_names: .* carries 'base_link'; these do: none"),
    ],
)
def test_names_that_are_not_there_are_one_clear_problem(term, text, tmp_path):
    problems = World(ARM, term, tmp_path, 2).problems
    assert len(problems) == 1, problems
    assert re.match(text, problems[0]), problems


def test_ball_joints_are_refused(tmp_path):
    ball = """<mujoco><worldbody><body name="base"><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
    <body name="bob"><joint name="socket" type="ball"/><inertial pos="0 0 -0.7" mass="2" diaginertia=".03 .03 .01"/>
    <body name="rod"><joint name="hinge"/><inertial pos="0 0 -0.7" mass="2" diaginertia=".03 .03 .01"/></body></body>
    </body></worldbody></mujoco>"""
    problems = World(mjcf_robot(tmp_path, ball), action("rod", joint_names=["hinge"]), tmp_path, 2).problems
    assert len(problems) == 1, problems
    assert "ball joint" in problems[0]


@pytest.mark.parametrize(
    ("cfg", "field"),
    [
        (action(command="twist"), "controller.command_type"),
        (action(method="lm"), "controller.ik_method"),
        (action(method="pinv", ik_params={"lambda_val": 0.1}), "controller.ik_params['lambda_val']"),
        (action(ik_params={"lambda_val": 0.0}), "controller.ik_params['lambda_val']"),
        (action(scale=[1.0, 1.0]), "scale"),
        (action(scale=math.inf), "scale"),
        (action(body_offset=Action.OffsetCfg(rot=(1.0, 1.0, 0.0, 0.0))), "body_offset.rot"),
        (action(body_offset=Action.OffsetCfg(pos=(1.0, 1.0))), "body_offset.pos"),
        (Action(controller=Controller(command_type="pose", ik_method="dls")), "body_name"),
        (Action(body_name=FLANGE), "controller"),
        (action(delay_min_lag=2), "delay_min_lag"),
    ],
)
def test_configs_that_make_no_sense_are_refused(cfg, field):
    with pytest.raises(ConfigError) as error:
        cfg.validate()
    assert len(error.value.problems) == 1, error.value
    assert f"{field}: " in str(error.value)
