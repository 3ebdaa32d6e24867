# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics actions in the loop with the physics, and errors of configs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

import newton
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.actuators import ActuatorCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_tasks.robot_scene import RobotSceneCfg
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


@configclass
class Policy(ObservationGroupCfg):
    """The joints."""

    joint_pos = ObservationTermCfg(func=mdp.joint_pos)


def arm_env(
    term: Any,
    num_envs: int = 3,
    turned: float = 0.0,
    decimation: int = 2,
    weightless: bool = True,
    drives: Mapping[str, ActuatorCfg] = ARM.actuators,
) -> ManagerBasedRLEnv:
    """The arm of the reach task at 60 Hz, in its default pose, its base turned about z, with motors that have inertia:
    without, the drives of the wrist swing about a target that is far off, whoever sets it."""
    robot = ARM.replace(actuators={group: drive.copy() for group, drive in drives.items()})
    for actuator in robot.actuators.values():
        actuator.armature = 0.1
    robot.init_state.rot = (0.0, 0.0, math.sin(0.5 * turned), math.cos(0.5 * turned))
    cfg = ManagerBasedRLEnvCfg(
        decimation=decimation,
        episode_length_s=100.0,
        sim=SimulationCfg(
            device="cpu",
            dt=1.0 / 60.0,
            gravity=(0.0, 0.0, 0.0 if weightless else -9.81),
            solver=MuJoCoSolverCfg(disable_contacts=True, drive_limits=True),
        ),
        scene=RobotSceneCfg(num_envs=num_envs, env_spacing=2.5, robot=robot),
        observations={"policy": Policy()},
        actions={"arm": term},
        rewards={"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)},
        terminations={"time_out": TerminationTermCfg(func=mdp.time_out, time_out=True)},
        events={"all": EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")},
    )
    env = ManagerBasedRLEnv(cfg)
    env.reset(seed=1)
    return env


def run(env: ManagerBasedRLEnv, command: np.ndarray, seconds: float = 3.0) -> None:
    command = torch.tensor(command, dtype=torch.float32)
    for _ in range(round(seconds / env.step_dt)):
        env.step(command)


GOALS = np.array([[0.45, -0.15, 0.25], [0.35, 0.2, 0.35], [0.5, 0.05, 0.15]])
DOWN = Rotation.from_euler("zyx", [[0.4, 0.0, -math.pi / 2], [-0.5, 0.1, -1.4], [0.2, -0.1, -math.pi / 2]])


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
