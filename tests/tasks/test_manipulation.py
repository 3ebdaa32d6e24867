# SPDX-License-Identifier: Apache-2.0
"""Manipulation tasks: terms against NumPy, the cabinet, success, the hand and its cube."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import stripe_tasks  # noqa: F401
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import Simulation, SimulationCfg
from stripe_tasks.manipulation.cabinet_model import CABINET_CFG, DEPTH, HANDLE, HEIGHT, TRAVEL
from tests.helpers.robot_files import robot_file
from tests.helpers.small_tasks import small_cfg

N = 4
POINT, TIP = np.array([0.0, 0.0, 0.1034]), np.array([0.0, 0.0, 0.046])


def make(task: str) -> Any:
    env = gymnasium.make_vec(task, cfg=small_cfg(task, N, seed=4))
    env.reset(seed=0)
    return env


def rewards(env: Any) -> dict[str, np.ndarray]:
    """Weighted rewards by term, of the present state."""
    values = env.reward_manager.compute_terms().numpy()
    return dict(zip(env.reward_manager.active_terms, values.T, strict=True))


def point_of(asset: Any, body: str, point: np.ndarray) -> np.ndarray:
    index = asset.find_bodies(body)[0][0]
    pose = asset.data.body_pose_w[:, index].numpy().astype(float)
    return pose[:, :3] + Rotation.from_quat(pose[:, 3:]).apply(point)


@pytest.fixture(scope="module")
def lift():
    robot_file("panda")
    env = make("Stripe-Lift-Cube-Panda-v0")
    yield env
    env.close()


@pytest.fixture(scope="module")
def cabinet():
    robot_file("panda")
    env = make("Stripe-Open-Cabinet-Panda-v0")
    yield env
    env.close()


# -- lift


def test_lift_rewards_are_those_of_numpy(lift):
    lift.reset(seed=1)
    cube, robot = lift.scene["object"], lift.scene["robot"]
    pose = cube.data.root_pose_w.clone()
    pose[1:, 2] += torch.tensor([0.01, 0.1, 0.3])  # the second is not lifted yet, the third is but not held
    pose[3, :3] = torch.as_tensor(point_of(robot, "hand", POINT)[3], dtype=torch.float32)
    pose[3, 2] += 0.01
    cube.write_root_pose_to_sim(pose)
    lift.sim.forward()
    found = rewards(lift)
    hand, at = point_of(robot, "hand", POINT), pose[:, :3].numpy().astype(float)
    held = np.linalg.norm(at - hand, axis=1) < 0.05
    lifted = held & (at[:, 2] > 0.04)
    assert held.tolist() == [False, False, False, True]
    assert lifted.tolist() == [False, False, False, True]
    np.testing.assert_allclose(
        found["reaching_object"], 1.0 - np.tanh(np.linalg.norm(at - hand, axis=1) / 0.1), atol=1e-5
    )
    np.testing.assert_allclose(found["lifting_object"], 15.0 * lifted)
    goal = lift.command_manager.get_command("object_pose")[:, :3].numpy() + lift.scene.env_origins.numpy()
    away = np.linalg.norm(goal - at, axis=1)
    for name, weight, std in (("object_goal_tracking", 16.0, 0.3), ("object_goal_tracking_fine_grained", 5.0, 0.05)):
        np.testing.assert_allclose(found[name], weight * lifted * (1.0 - np.tanh(away / std)), atol=1e-4)
    observed = lift.observation_manager.compute()["policy"].numpy()
    np.testing.assert_allclose(observed[:, 18:21], at - lift.scene.env_origins.numpy(), atol=1e-5)


def test_success_of_lifting_is_a_cube_at_its_goal(lift):
    lift.reset(seed=2)
    goal = lift.command_manager.get_command("object_pose")[:, :3] + lift.scene.env_origins
    cube = lift.scene["object"]
    pose = cube.data.root_pose_w.clone()
    pose[::2, :3] = goal[::2]
    cube.write_root_pose_to_sim(pose)
    lift.step(torch.zeros(N, 8))
    assert lift.success.tolist() == [True, False, True, False]


def test_hulls_of_the_robot_are_in_one_launch(lift, cabinet):
    """With the ground, the cube and the cabinet."""
    for env in (lift, cabinet):
        assert "all physics steps of a step in one launch" in env.describe()


def test_gripper_closes_on_a_cube_and_holds_it(lift):
    """A cube between the fingers, which close: it does not fall for half a second."""
    lift.reset(seed=3)
    robot, cube = lift.scene["robot"], lift.scene["object"]
    lift.step(torch.cat((torch.zeros(N, 7), torch.ones(N, 1)), dim=1))
    pose = cube.data.root_pose_w.clone()
    hand = robot.data.body_pose_w[:, robot.find_bodies("hand")[0][0]]
    pose[:, :3] = torch.as_tensor(point_of(robot, "hand", POINT), dtype=torch.float32)
    pose[:, 3:] = hand[:, 3:]
    cube.write_root_pose_to_sim(pose)
    cube.write_root_velocity_to_sim(torch.zeros(N, 6))
    for _ in range(25):
        lift.step(torch.cat((torch.zeros(N, 7), -torch.ones(N, 1)), dim=1))
    # The soft arm sags, and the cube with it.
    away = cube.data.root_pos_w.numpy() - point_of(robot, "hand", POINT)
    assert np.linalg.norm(away, axis=1).max() < 0.03


def test_lift_by_camera_sees_the_cube_in_its_picture_alone():
    robot_file("panda")
    env = make("Stripe-Lift-Cube-Panda-Camera-v0")
    obs, _ = env.reset(seed=1)
    assert obs["policy"].shape == (N, 33)
    assert obs["critic"].shape == (N, 36)
    assert obs["picture"].shape == (N, 3, 64, 64)
    cube = env.scene["object"]
    cube_colors = obs["picture"].clone()
    assert (cube_colors[0] - cube_colors[1]).abs().max() > 0.05, "light and colours differ"
    pose = cube.data.root_pose_w.clone()
    pose[:, 0] -= 50.0  # out of sight
    cube.write_root_pose_to_sim(pose)
    obs, *_ = env.step(torch.zeros(N, 8))
    red = (cube_colors[:, 0] - cube_colors[:, 2]).flatten(1).amax(dim=1)
    without = (obs["picture"][:, 0] - obs["picture"][:, 2]).flatten(1).amax(dim=1)
    assert (red > without + 0.1).all(), (red, without)
    env.close()


# -- cabinet


def test_drawers_open_towards_the_front_with_their_handles():
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=2, env_spacing=3.0), Simulation(SimulationCfg(device="cpu")))
    scene.builder.build_robot("cabinet", CABINET_CFG)
    scene.build()
    asset = scene["cabinet"]
    assert asset.joint_names == ["drawer_bottom_joint", "drawer_top_joint"]
    np.testing.assert_allclose(asset.data.joint_pos_limits[0].numpy(), [[0.0, TRAVEL]] * 2, atol=1e-6)
    shut = point_of(asset, "drawer_top", np.array(HANDLE))
    np.testing.assert_allclose(shut[:, 2], 0.1 + 0.75 * HEIGHT, atol=1e-5)
    assert (shut[:, 0] - scene.env_origins[:, 0].numpy() < 1.05 - 0.5 * DEPTH).all()
    asset.write_joint_state_to_sim(torch.tensor([[0.0, 0.3]] * 2), torch.zeros(2, 2))
    scene.sim.forward()
    np.testing.assert_allclose(point_of(asset, "drawer_top", np.array(HANDLE)) - shut, [[-0.3, 0, 0]] * 2, atol=1e-5)
    time = 0.0
    while time < 0.5:
        scene.sim.step()
        time += scene.sim.cfg.dt
    # 3 kg on a spring of 10 N/m with a damper of 1 N s/m, from rest.
    decay, rate = 1.0 / 6.0, np.sqrt(10.0 / 3.0 - 1.0 / 36.0)
    expected = 0.3 * np.exp(-decay * time) * (np.cos(rate * time) + decay / rate * np.sin(rate * time))
    np.testing.assert_allclose(asset.data.joint_pos.numpy(), [[0.0, expected]] * 2, atol=0.01)


def test_cabinet_rewards_are_those_of_numpy(cabinet):
    cabinet.reset(seed=1)
    robot, drawers = cabinet.scene["robot"], cabinet.scene["cabinet"]
    joints = drawers.data.joint_pos.clone()
    joints[:, 1] = torch.tensor([0.0, 0.05, 0.25, 0.35])
    drawers.write_joint_state_to_sim(joints, torch.zeros_like(joints))
    bent = robot.data.joint_pos.clone()
    bent[:, 7:] = torch.tensor([[0.04, 0.04], [0.02, 0.03], [0.0, 0.01], [0.01, 0.02]])
    robot.write_joint_state_to_sim(bent, torch.zeros_like(bent))
    cabinet.sim.forward()
    found = rewards(cabinet)
    handle, hand = point_of(drawers, "drawer_top", np.array(HANDLE)), point_of(robot, "hand", POINT)
    away = np.linalg.norm(handle - hand, axis=1)
    near = (1.0 / (1.0 + away**2)) ** 2 * np.where(away <= 0.2, 2.0, 1.0)
    np.testing.assert_allclose(found["approach_ee_handle"], 2.0 * near, atol=1e-5)
    tips = np.stack([point_of(robot, f"{side}_finger", TIP)[:, 2] for side in ("left", "right")], axis=1)
    around = (tips - handle[:, 2:]).prod(axis=1) < 0.0
    q = joints[:, 1].numpy()
    stages = 0.5 * (q > 0.01) + around * (1.0 * (q > 0.2) + 1.0 * (q > 0.3))
    np.testing.assert_allclose(found["open_drawer_bonus"], 7.5 * (around + 1.0) * q, atol=1e-5)
    np.testing.assert_allclose(found["multi_stage_open_drawer"], stages, atol=1e-5)
    np.testing.assert_allclose(found["align_grasp_around_handle"], 0.125 * around)
    lacking = (0.04 - np.abs(tips - handle[:, 2:])).sum(axis=1)
    np.testing.assert_allclose(found["approach_gripper_handle"], 5.0 * around * lacking, atol=1e-5)
    turn = Rotation.from_quat(robot.data.body_pose_w[:, robot.find_bodies("hand")[0][0], 3:].numpy())
    z, y = turn.apply([0.0, 0.0, 1.0])[:, 0], turn.apply([0.0, 1.0, 0.0])[:, 2]
    np.testing.assert_allclose(found["align_ee_handle"], 0.5 * 0.5 * (z * np.abs(z) + y**2), atol=1e-5)
    cabinet.step(torch.zeros(N, 8))
    assert cabinet.success.tolist() == [False, False, False, True]


# -- reach


@pytest.mark.parametrize(
    ("form", "actions"),
    [pytest.param("", 7, marks=pytest.mark.slow), pytest.param("-IK-Rel", 6, marks=pytest.mark.slow), ("-OSC", 13)],
)
def test_reach_runs_with_each_kind_of_action(form, actions):
    robot_file("panda")
    env = make(f"Stripe-Reach-Panda{form}-v0")
    assert env.single_action_space.shape == (actions,)
    still = torch.zeros(N, actions)
    hand = env.scene["robot"].find_bodies("hand")[0][0]
    if form == "-OSC":  # the pose that the hand has, with some stiffness
        pose = env.scene["robot"].data.body_pose_w[:, hand].clone()
        pose[:, :3] -= env.scene.env_origins
        still[:, :7], still[:, 7:] = pose, 1.0
    before = env.scene["robot"].data.body_pos_w[:, hand].clone()
    for _ in range(10):
        obs, reward, *_ = env.step(still)
    assert torch.isfinite(obs["policy"]).all()
    assert torch.isfinite(reward).all()
    if form:  # an action that asks for the present pose keeps it
        assert (env.scene["robot"].data.body_pos_w[:, hand] - before).norm(dim=1).max() < 0.03
    pose = env.scene["robot"].data.body_pose_w[:, hand].clone()
    pose[:, :3] -= env.scene.env_origins
    # Within 2 cm and 0.2 rad of the commanded pose: the hand's own, and one shifted, two turned about the vertical.
    pose[1, 0] += 0.03
    for row, angle in ((2, 0.12), (3, 0.3)):
        turn = Rotation.from_rotvec([0.0, 0.0, angle]) * Rotation.from_quat(pose[row, 3:].numpy())
        pose[row, 3:] = torch.as_tensor(turn.as_quat(), dtype=torch.float32)
    env.command_manager.get_command("ee_pose")[:] = pose
    if form == "-OSC":
        env.step(still)
        assert env.success.tolist() == [True, False, True, False]
    env.close()


# -- hand


@pytest.fixture(scope="module")
def hand():
    robot_file("allegro")
    env = make("Stripe-Repose-Cube-Allegro-Direct-v0")
    yield env
    env.close()


def test_hand_keeps_the_cube_and_all_runs_in_one_launch(hand):
    hand.reset(seed=0)
    assert "all physics steps of a step in one launch" in hand.describe()
    lower, upper = (hand.robot.data.joint_pos_limits[..., k] for k in (0, 1))
    still = 2.0 * (hand.robot.data.default_joint_pos - lower) / (upper - lower) - 1.0
    for _ in range(20):
        _, _, terminated, _, _ = hand.step(still)
        assert not terminated.any()
    assert (hand.object.data.root_pos_w[:, 2] > 0.5).all()
    torch.testing.assert_close(hand.robot.data.joint_pos_target, hand.robot.data.default_joint_pos, atol=1e-5, rtol=0)


def test_rewards_and_observations_of_the_hand_are_those_of_numpy(hand):
    hand.reset(seed=1)
    actions = 2.0 * torch.rand(N, 16, generator=torch.Generator().manual_seed(0)) - 1.0
    goals = hand._goal.rot.numpy().astype(float).copy()
    obs, reward, *_ = hand.step(actions)
    cube, robot = hand.object.data, hand.robot.data
    at = cube.root_pos_w.numpy() - hand.scene.env_origins.numpy()
    turn = Rotation.from_quat(cube.root_quat_w.numpy()) * Rotation.from_quat(goals).inv()
    distance, angle = np.linalg.norm(at - [0.02, 0.0, 0.55], axis=1), turn.magnitude()
    assert (angle > 0.2).all()
    expected = -10.0 * distance + 1.0 / (angle + 0.1) - 0.0002 * (actions.numpy() ** 2).sum(axis=1)
    np.testing.assert_allclose(reward.numpy(), expected, atol=1e-4)
    found = obs["policy"].numpy()
    lower, upper = (robot.joint_pos_limits[..., k].numpy() for k in (0, 1))
    joints = (2.0 * robot.joint_pos.numpy() - lower - upper) / (upper - lower)
    tips = [hand.robot.find_bodies(f"{finger}_tip")[0][0] for finger in ("ff", "mf", "rf", "th")]
    pose, vel = robot.body_pose_w[:, tips].numpy(), robot.body_vel_w[:, tips].numpy()
    parts = [
        joints, 0.2 * robot.joint_vel.numpy(), at, cube.root_quat_w.numpy(), cube.root_lin_vel_w.numpy(),
        0.2 * cube.root_ang_vel_w.numpy(), np.tile([0.02, 0.0, 0.55], (N, 1)), goals, turn.as_quat(),
        (pose[..., :3] - hand.scene.env_origins.numpy()[:, None]).reshape(N, -1), pose[..., 3:].reshape(N, -1),
        vel.reshape(N, -1), actions.numpy(),
    ]  # fmt: skip
    sign = np.sign((found[:, 52:56] * parts[8]).sum(axis=1, keepdims=True))
    parts[8] = parts[8] * sign
    np.testing.assert_allclose(found, np.concatenate(parts, axis=1), atol=2e-4)


def test_a_goal_that_is_reached_is_counted_and_drawn_anew(hand):
    hand.reset(seed=2)
    before = hand._goal.rot.numpy().copy()
    rot = hand.object.data.root_quat_w.numpy().copy()
    goals = before.copy()
    goals[1] = rot[1]  # the second cube is turned as it should be
    hand._goal.rot.assign(goals)
    _, reward, *_ = hand.step(torch.zeros(N, 16))
    assert hand._goal.successes.numpy().tolist() == [0.0, 1.0, 0.0, 0.0]
    assert reward[1] > 240.0 > 20.0 > reward[0]
    changed = np.abs(hand._goal.rot.numpy() - goals).max(axis=1) > 1e-6
    assert changed.tolist() == [False, True, False, False]
