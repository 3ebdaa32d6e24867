# SPDX-License-Identifier: Apache-2.0
"""Getting up: rewards that grow from lying to standing, and a lift that comes after failures and goes after success."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import stripe_tasks  # noqa: F401
from stripe_newton.envs import ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.sim import SimulationCfg
from stripe_tasks.getup import assistance
from stripe_tasks.robot_scene import RobotSceneCfg
from stripe_tasks.robots import QUADRUPED_CFG
from stripe_tasks.success import SuccessEnv, SuccessManagerCfg
from tests.helpers.robot_files import robot_file
from tests.helpers.small_tasks import small_cfg

BOUNDS = {"least_height": 0.2, "largest_tilt": math.radians(20.0)}
FORCE = 30.0
POSES = {
    "on the head": (0.50, 180.0, {}),
    "lying": (0.10, -90.0, {}),
    "sitting": (0.10, 0.0, {"hip_pitch": -1.5}),
    "kneeling": (0.46, 0.0, {"knee": 1.5, "ankle_pitch": 0.5}),
    "standing": (0.76, 0.0, {}),
}
"""Height of the root [m], pitch [degrees] and joints that differ from the default pose [rad], the worst first."""


@pytest.fixture(scope="module")
def lifted():
    """Four quadrupeds that are lifted: episodes of five steps, two robots upright and two on their sides."""
    params = {"asset_cfg": SceneEntityCfg("robot", body_names="base"), **BOUNDS}
    cfg = ManagerBasedRLEnvCfg(
        decimation=4,
        episode_length_s=0.1,
        sim=SimulationCfg(dt=0.005, device="cpu"),
        scene=RobotSceneCfg(num_envs=4, env_spacing=3.0, robot=QUADRUPED_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")),
        observations={"policy": ObservationGroupCfg(level=ObservationTermCfg(func=assistance.assistance_level))},
        rewards={"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)},
        actions={"joint_pos": mdp.JointPositionActionCfg(joint_names=[".*"], use_default_offset=True)},
        events={"reset": EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")},
        terminations={"time_out": TerminationTermCfg(func=mdp.time_out, time_out=True)},
        managers={
            "assistance": assistance.AssistanceManagerCfg(
                body_name="base", largest_force=FORCE, change=0.5, least_seconds=0.05, **BOUNDS
            ),
            "success": SuccessManagerCfg(func=assistance.stands_unassisted, params=params),
        },
    )
    env = SuccessEnv(cfg)
    yield env
    env.close()


def run_episode(env: SuccessEnv, tilts: list[float]) -> np.ndarray:
    """An episode in which each robot is put down with a roll [degrees]; returns who was successful in the last step."""
    robot = env.scene["robot"]
    pose = robot.data.default_root_state[:, :7].clone()
    pose[:, :3] += env.scene.env_origins
    pose[:, 3:] = torch.tensor(
        Rotation.from_euler("x", np.array(tilts)[:, None], degrees=True).as_quat(), dtype=torch.float32
    )
    for _ in range(5):
        robot.write_root_pose_to_sim(pose)
        robot.write_root_velocity_to_sim(torch.zeros(4, 6))
        env.step(torch.zeros(4, 12))
    return env.success.numpy()


def test_a_lift_comes_after_failures_and_goes_after_successes(lifted):
    lifted.reset(seed=0)
    level = lifted.custom_managers["assistance"].data.level
    assert level.numpy().tolist() == [0.0] * 4  # the episode that an evaluation counts is without help
    assert run_episode(lifted, [0.0, 0.0, 90.0, 90.0]).tolist() == [True, True, False, False]
    assert level.numpy().tolist() == [0.0, 0.0, 0.5, 0.5]
    # It stands now, but not by itself; at its end the help is gone.
    assert run_episode(lifted, [0.0, 90.0, 0.0, 90.0]).tolist() == [True, False, False, False]
    assert level.numpy().tolist() == [0.0, 0.5, 0.0, 1.0]
    assert lifted.extras["log"]["Assistance/level"].item() == pytest.approx(0.25)
    assert lifted.extras["log"]["Assistance/stands"].item() == pytest.approx(0.5)


def test_the_lift_is_upwards_in_the_world_and_moves_the_robot(lifted):
    lifted.reset(seed=0)
    manager, robot = lifted.custom_managers["assistance"], lifted.scene["robot"]
    manager.data.level.zero_()
    pose = robot.data.default_root_state[:, :7].clone()
    pose[:, :3] += lifted.scene.env_origins + torch.tensor([0.0, 0.0, 1.0])
    tilt = Rotation.from_euler("xy", [70.0, 40.0], degrees=True).as_quat()
    pose[1::2, 3:] = torch.tensor(tilt, dtype=torch.float32)
    robot.write_root_pose_to_sim(pose)
    robot.write_root_velocity_to_sim(torch.zeros(4, 6))
    lifted.step(torch.zeros(4, 12))
    manager.data.level.assign([0.0, 0.0, 1.0, 1.0])
    lifted.step(torch.zeros(4, 12))
    # In the air, where nothing else acts but gravity: the centre of mass gains F t / m.
    mass = robot.native_data.default_mass.sum(dim=1)
    velocity = (robot.native_data.default_mass[..., None] * robot.data.body_lin_vel_w).sum(dim=1) / mass[:, None]
    gained = velocity[2:] - velocity[:2]
    expected = torch.tensor([0.0, 0.0, FORCE * 0.02 / float(mass[0])]).expand(2, 3)
    torch.testing.assert_close(gained, expected, atol=2e-3, rtol=0.02)


def test_an_episode_that_is_too_short_to_get_up_in_changes_nothing(lifted):
    lifted.reset(seed=0)
    level = lifted.custom_managers["assistance"].data.level
    level.zero_()
    lifted.step(torch.zeros(4, 12))
    lifted.reset(seed=0)
    assert level.numpy().tolist() == [0.0] * 4


def test_rewards_of_the_g1_grow_from_lying_to_standing():
    robot_file("g1")
    task = "Stripe-Getup-Flat-G1-v0"
    env = gymnasium.make_vec(task, cfg=small_cfg(task, len(POSES), seed=0))
    env.reset(seed=0)
    robot = env.scene["robot"]
    pose, joints = robot.data.default_root_state[:, :7].clone(), robot.data.default_joint_pos.clone()
    for i, (height, pitch, moved) in enumerate(POSES.values()):
        pose[i, 2] = height
        pose[i, 3:] = torch.tensor(Rotation.from_euler("y", pitch, degrees=True).as_quat())
        for k, name in enumerate(robot.joint_names):
            joints[i, k] = next((value for part, value in moved.items() if part in name), joints[i, k])
    pose[:, :3] += env.scene.env_origins
    robot.write_root_pose_to_sim(pose)
    robot.write_root_velocity_to_sim(torch.zeros(len(POSES), 6))
    robot.write_joint_state_to_sim(joints, torch.zeros_like(joints))
    env.step(torch.zeros(len(POSES), 29))
    assert env.success.tolist() == [False, False, False, False, True]
    values = env.reward_manager.compute_terms().sum(dim=1)
    assert (values.diff() > 0.1).all(), dict(zip(POSES, values.tolist(), strict=True))
    assert values[-1] > 1.5 * values[-2]  # standing is worth more than staying on the knees
    env.close()
