# SPDX-License-Identifier: Apache-2.0
"""Reach: kinematics of the arm against published lengths, commanded poses, rewards from the raw state."""

from __future__ import annotations

import importlib.util
import math
import sys

import gymnasium
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import stripe_tasks  # noqa: F401
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.rl import OnPolicyRunner, RslRlVecEnvWrapper, ZeroPolicy, evaluate
from tests.helpers.checkout import ROOT, TOOLS
from tests.helpers.small_scenes import numpy
from tests.helpers.small_tasks import small_cfg

TASK = "Stripe-Reach-v0"
N = 4
FLANGE = -1
UR5E = [(0.0, 0.1625, 90), (-0.425, 0.0, 0), (-0.3922, 0.0, 0), (0.0, 0.1333, 90), (0.0, 0.0997, -90), (0.0, 0.0996, 0)]
"""Denavit-Hartenberg parameters of the UR5e: a, d [m], alpha [deg]."""


@pytest.fixture(scope="module")
def shared():
    return gymnasium.make_vec(TASK, cfg=small_cfg(TASK))


@pytest.fixture
def env(shared):
    shared.reset(seed=1)
    return shared


def robot(env):
    return env.scene["robot"]


def pose_at(env, joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position of the flange in the base's frame and its rotation vector, at joint positions of shape (N, 6)."""
    robot(env).write_joint_state_to_sim(torch.tensor(joints, dtype=torch.float32), torch.zeros(N, 6))
    env.sim.forward()
    data = robot(env).data
    pos = numpy(data.body_pos_w[:, FLANGE] - env.scene.env_origins)
    return pos, numpy(data.body_quat_w[:, FLANGE])


def denavit_hartenberg(joints: np.ndarray) -> np.ndarray:
    """Position of the UR5e's flange in its base, whose x and y point the other way."""
    frame = np.eye(4)
    for angle, (a, d, alpha) in zip(joints, UR5E, strict=True):
        step = np.eye(4)
        step[:3, :3] = (Rotation.from_euler("z", angle) * Rotation.from_euler("x", alpha, degrees=True)).as_matrix()
        step[:3, 3] = a * math.cos(angle), a * math.sin(angle), d
        frame = frame @ step
    return frame[:3, 3] * [-1.0, -1.0, 1.0]


def command(env) -> np.ndarray:
    return numpy(env.command_manager.get_command("ee_pose")).astype(float)


def errors(env) -> tuple[np.ndarray, np.ndarray]:
    """Distance and angle between flange and command, from the poses of the bodies."""
    pose, data = command(env), robot(env).data
    pos = numpy(data.body_pos_w[:, FLANGE] - env.scene.env_origins)
    turn = Rotation.from_quat(pose[:, 3:]).inv() * Rotation.from_quat(numpy(data.body_quat_w[:, FLANGE]))
    return np.linalg.norm(pos - pose[:, :3], axis=-1), turn.magnitude()


# -- the arm


def test_the_flange_is_where_the_published_lengths_say(env):
    joints = np.random.default_rng(0).uniform(-math.pi, math.pi, (N, 6))
    expected = np.stack([denavit_hartenberg(q) for q in joints])
    np.testing.assert_allclose(pose_at(env, joints)[0], expected, atol=2e-6)


def test_masses_limits_and_drives(env):
    data = robot(env).data
    np.testing.assert_allclose(numpy(data.body_mass)[0, 1:], [3.761, 8.058, 2.846, 1.37, 1.3, 0.365], rtol=1e-6)
    np.testing.assert_allclose(numpy(data.joint_effort_limits)[0], [150.0, 150.0, 150.0, 28.0, 28.0, 28.0])
    limits = numpy(data.joint_pos_limits)[0]
    np.testing.assert_allclose(limits[:, 1], [2 * math.pi, 2 * math.pi, math.pi, *[2 * math.pi] * 3], rtol=1e-5)
    np.testing.assert_allclose(limits[:, 0], -limits[:, 1])
    assert robot(env).is_fixed_base


def test_in_the_default_pose_the_flange_faces_down(env):
    default = numpy(robot(env).data.default_joint_pos)
    pos, quat = pose_at(env, default)
    np.testing.assert_allclose(Rotation.from_quat(quat).apply([0.0, 1.0, 0.0]), [[0.0, 0.0, -1.0]] * N, atol=2e-3)
    ranges = env.cfg.commands.ee_pose.ranges
    for value, bounds in zip(pos[0], (ranges.pos_x, ranges.pos_y, ranges.pos_z), strict=True):
        assert bounds[0] < value < bounds[1]


def test_the_file_is_what_the_tool_writes(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(TOOLS / "authoring")
    spec = importlib.util.spec_from_file_location("author_arm", TOOLS / "authoring" / "author_arm.py")
    tool = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "author_arm", tool)
    spec.loader.exec_module(tool)
    tool.author(tmp_path / "arm.usda")
    assert (tmp_path / "arm.usda").read_bytes() == (ROOT / "tasks/stripe_tasks/assets/arm.usda").read_bytes()


# -- the task


def test_random_actions_stay_finite(env):
    generator = torch.Generator().manual_seed(0)
    for _ in range(100):
        obs, reward, terminated, _, extras = env.step(4.0 * torch.rand(N, 6, generator=generator) - 2.0)
        assert obs["policy"].shape == (N, 25)
        assert torch.isfinite(obs["policy"]).all()
        assert torch.isfinite(reward).all()
        assert not terminated.any()
        assert all(math.isfinite(float(v)) for v in extras["log"].values())


def test_commands_lie_in_their_ranges_and_face_down(env):
    seen = []
    for k in range(6):
        env.reset(seed=k)
        seen.append(command(env))
    pose, ranges = np.concatenate(seen), env.cfg.commands.ee_pose.ranges
    for column, bounds in zip(pose.T, (ranges.pos_x, ranges.pos_y, ranges.pos_z), strict=False):
        assert bounds[0] <= column.min() < column.max() <= bounds[1]
    np.testing.assert_allclose(Rotation.from_quat(pose[:, 3:]).apply([0, 1, 0]), [[0, 0, -1]] * len(pose), atol=1e-5)
    assert len(np.unique(pose[:, 0])) == len(pose)
    assert (np.linalg.norm(pose[:, :3] - [0.0, 0.0, 0.1625], axis=-1) < 0.8).all()  # within reach


def test_rewards_and_observations_from_the_raw_state(env):
    generator = torch.Generator().manual_seed(1)
    last = np.zeros((N, 6))
    for _ in range(12):
        action = 2.0 * torch.rand(N, 6, generator=generator) - 1.0
        obs, reward, *_ = env.step(action)
        distance, angle = errors(env)
        speed = numpy(robot(env).data.joint_vel).astype(float)
        rate = ((numpy(action) - last) ** 2).sum(-1)
        total = -0.2 * distance + 0.1 * (1.0 - np.tanh(distance / 0.1)) - 0.1 * angle - 1e-4 * rate
        total -= 1e-4 * (speed**2).sum(-1)
        np.testing.assert_allclose(numpy(reward), total / 30.0, rtol=1e-3, atol=2e-5)
        joints = numpy(robot(env).data.joint_pos - robot(env).data.default_joint_pos)
        np.testing.assert_allclose(numpy(obs["policy"])[:, :6], joints, atol=0.0101)
        np.testing.assert_allclose(numpy(obs["policy"])[:, 12:19], command(env), atol=1e-6)
        np.testing.assert_allclose(numpy(obs["policy"])[:, 19:], numpy(action), atol=1e-6)
        last = numpy(action)


def test_holding_the_commanded_pose_gives_a_small_error_and_the_highest_reward(env):
    default = numpy(robot(env).data.default_joint_pos)
    offsets = np.array([[0.0, 0, 0, 0, 0, 0], [0.3, 0, 0, 0, 0, 0], [0, 0.25, -0.3, 0, 0, 0], [0, 0, 0, 0, 0, 1.0]])
    pos, quat = pose_at(env, default)
    env.command_manager.get_command("ee_pose")[:] = torch.tensor(np.concatenate((pos, quat), -1), dtype=torch.float32)
    for _ in range(60):
        reward = env.step(torch.tensor(offsets / 0.5, dtype=torch.float32))[1]
    distance, angle = errors(env)
    assert distance[0] < 0.02  # the weight of the arm bends its drives by that much
    assert angle[0] < 0.03
    assert (np.maximum(distance, angle)[1:] > 0.1).all()
    assert (reward[0] > reward[1:] + 0.002).all()


def test_the_marker_is_at_the_commanded_pose(env):
    for _ in range(2):
        marker = env.scene["goal"].data
        np.testing.assert_allclose(numpy(marker.root_pos_w - env.scene.env_origins), command(env)[:, :3], atol=1e-6)
        turn = Rotation.from_quat(numpy(marker.root_quat_w)).inv() * Rotation.from_quat(command(env)[:, 3:])
        assert turn.magnitude().max() < 1e-4
        env.step(torch.zeros(N, 6))


def test_the_curriculum_raises_the_weights_of_smoothness(env):
    parameters = env.context.parameters
    assert parameters["rewards.action_rate.weight"] == pytest.approx(-1e-4)
    state = env.get_state()
    env.context.step.fill_(4500)
    env.step(torch.zeros(N, 6))
    env.step(torch.zeros(N, 6))
    assert parameters["rewards.action_rate.weight"] == pytest.approx(-0.005)
    assert parameters["rewards.joint_vel.weight"] == pytest.approx(-0.001)
    env.set_state(state)
    assert parameters["rewards.action_rate.weight"] == pytest.approx(-1e-4)


def test_no_part_of_a_step_needs_the_host(env):
    text = env.describe()
    assert "goal marker" in text
    assert "torch" not in text
    assert "host" not in text


def test_rsl_rl_trains_it(tmp_path):
    agent = load_cfg(TASK, "agent")
    agent.num_steps_per_env = 8
    assert OnPolicyRunner(RslRlVecEnvWrapper(make_env(TASK, small_cfg(TASK, 8))), agent, tmp_path / "run").learn(2)


@pytest.mark.slow
def test_it_learns_to_reach():
    torch.manual_seed(1)
    env = RslRlVecEnvWrapper(make_env(TASK, small_cfg(TASK, 256)))
    agent = load_cfg(TASK, "agent")
    before = evaluate(env, ZeroPolicy(env), 256, seed=1)
    runner = OnPolicyRunner(env, agent, None)
    assert runner.learn(150)
    after = evaluate(env, runner.get_inference_policy(), 256, seed=1)
    assert after.mean_return > before.mean_return + 0.5
