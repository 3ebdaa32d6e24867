# SPDX-License-Identifier: Apache-2.0
"""Push ball: initial states, rewards from the raw state, the goal's reward, contact."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest
import torch
import warp as wp

import stripe_tasks  # noqa: F401
from stripe_kernels.data import ArticulationData
from stripe_kernels.mdp.objects import ObjectPoolData
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.rl import OnPolicyRunner, RslRlVecEnvWrapper
from stripe_tasks.push_ball.terms import robot_velocity_toward_push
from tests.helpers.small_scenes import numpy
from tests.helpers.small_tasks import small_cfg

TASK = "Stripe-PushBall-Ant-v0"
N = 4
RADIUS, REACHED, BEHIND = 0.25, 0.35, 0.5


@pytest.fixture(scope="module")
def shared():
    return gymnasium.make_vec(TASK, cfg=small_cfg(TASK))


@pytest.fixture
def env(shared):
    shared.reset(seed=1)
    return shared


def pool(env):
    return env.object_manager["balls"]


def places(env) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ball, goal and ant in the environments' frames, shape (N, 3) each."""
    origins = numpy(env.scene.env_origins).astype(float)
    return numpy(pool(env).positions)[:, 0] - origins, numpy(pool(env).target)[:, 0, :3].astype(float), \
        numpy(env.scene["robot"].data.root_pos_w) - origins  # fmt: skip


def put_ball(env, position: np.ndarray, velocity=(0.0, 0.0, 0.0)) -> None:
    """Move the balls, in the environments' frames, and let the bodies follow."""
    pool(env).pose[:, 0, :3] = torch.tensor(position, dtype=torch.float32) + env.scene.env_origins
    pool(env).vel[:, 0] = torch.tensor([*velocity, 0.0, 0.0, 0.0])
    env.sim.forward()


def rest(env):
    return env.step(torch.zeros(N, 8))


# -- the term of its own


@wp.kernel(enable_backward=False)
def measure(pool: ObjectPoolData, robot: ArticulationData, distance: float, out: wp.array[float]) -> None:
    env = wp.tid()
    out[env] = robot_velocity_toward_push(env, pool, robot, distance)


def test_robot_velocity_toward_push():
    count, draw = 16, np.random.default_rng(0)
    numbers = {n: draw.normal(size=(count, 3)) for n in ("ball", "goal", "ant", "origin", "velocity")}
    objects, robot = ObjectPoolData(), ArticulationData()

    def poses(points: np.ndarray) -> wp.array:
        return np.concatenate((points, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))), -1).astype(np.float32)

    objects.pose = wp.array(poses(numbers["ball"])[:, None], dtype=wp.transform, device="cpu")
    objects.target_pose = wp.array(poses(numbers["goal"])[:, None], dtype=wp.transform, device="cpu")
    objects.env_origin = wp.array(numbers["origin"], dtype=wp.vec3, device="cpu")
    objects.active = wp.array([[k != 3] for k in range(count)], dtype=wp.bool, device="cpu")
    robot.root_pose = wp.array(poses(numbers["ant"]), dtype=wp.transform, device="cpu")
    twist = np.concatenate((numbers["velocity"], draw.normal(size=(count, 3))), -1)
    robot.root_vel = wp.array(twist, dtype=wp.spatial_vector, device="cpu")
    out = wp.zeros(count, dtype=float, device="cpu")
    wp.launch(measure, dim=count, inputs=[objects, robot, BEHIND], outputs=[out], device="cpu")
    flat = [1.0, 1.0, 0.0]
    way = (numbers["goal"] + numbers["origin"] - numbers["ball"]) * flat
    way /= np.linalg.norm(way, axis=-1, keepdims=True)
    to_push = (numbers["ball"] - BEHIND * way - numbers["ant"]) * flat
    to_push /= np.linalg.norm(to_push, axis=-1, keepdims=True)
    expected = (numbers["velocity"] * to_push).sum(-1)
    expected[3] = 0.0
    np.testing.assert_allclose(out.numpy(), expected, atol=2e-6)


# -- the task


def test_random_actions_stay_finite(env):
    generator = torch.Generator().manual_seed(0)
    for _ in range(100):
        obs, reward, _, _, extras = env.step(4.0 * torch.rand(N, 8, generator=generator) - 2.0)
        assert obs["policy"].shape == (N, 43)
        assert torch.isfinite(obs["policy"]).all()
        assert torch.isfinite(reward).all()
        assert all(math.isfinite(float(v)) for v in extras["log"].values())


def test_at_the_start_ball_and_goal_lie_ahead(env):
    seen = []
    for seed in range(5):
        env.reset(seed=seed)
        assert pool(env).active.all()
        seen.append(places(env))
    ball, goal, ant = (np.concatenate(x) for x in zip(*seen, strict=True))
    for points, x, y in ((ball, (1.4, 2.0), (-0.6, 0.6)), (goal, (3.2, 4.2), (-0.8, 0.8))):
        assert x[0] <= points[:, 0].min() < points[:, 0].max() <= x[1]
        assert y[0] <= points[:, 1].min() < points[:, 1].max() <= y[1]
        np.testing.assert_allclose(points[:, 2], RADIUS, atol=1e-6)
    assert (np.linalg.norm((ball - ant)[:, :2], axis=-1) > 1.3).all()
    marker = numpy(env.scene["goal"].data.root_pos_w - env.scene.env_origins)
    np.testing.assert_allclose(marker, seen[-1][1], atol=1e-5)


def test_a_ball_that_nobody_touches_stays(env):
    before = places(env)[0]
    for _ in range(30):
        rest(env)
    np.testing.assert_allclose(places(env)[0], before, atol=0.005)


def test_a_rolling_ball_slows_down(env):
    put_ball(env, places(env)[0], (0.8, 0.0, 0.0))
    pool(env).vel[:, 0, 4] = 0.8 / RADIUS
    start, speeds = places(env)[0], []
    for _ in range(40):
        rest(env)
        speeds.append(numpy(pool(env).vel)[:, 0, 0])
    slowing = (speeds[4] - speeds[34]) * 60.0 / 30.0
    np.testing.assert_allclose(slowing, 9.81 * 0.02 / (1.4 * RADIUS), rtol=0.15)
    assert (places(env)[0][:, 0] > start[:, 0] + 0.3).all()


def test_the_ant_moves_the_ball_that_it_runs_into(env):
    ant = places(env)[2]
    put_ball(env, ant * [1.0, 1.0, 0.0] + [1.1, 0.0, RADIUS])
    env.scene["robot"].data.root_vel_w[:, 0] = 5.0
    start = places(env)[0]
    for _ in range(30):
        rest(env)
    assert (places(env)[0][:, 0] > start[:, 0] + 0.05).all()


def test_rewards_from_the_raw_state(env):
    generator, compared = torch.Generator().manual_seed(2), 0
    put_ball(env, places(env)[0], (0.7, 0.2, 0.0))
    for _ in range(15):
        action = 2.0 * torch.rand(N, 8, generator=generator) - 1.0
        obs, reward, terminated, truncated, _ = env.step(action)
        ball, goal, ant = places(env)
        going = ~(terminated | truncated).numpy()
        way, ball_vel = goal - ball, numpy(pool(env).vel)[:, 0, :3].astype(float)
        distance = np.linalg.norm(way, axis=-1)
        total = 2.0 * (ball_vel * way).sum(-1) / distance + 0.5 * (1.0 - np.tanh(distance))
        flat = way * [1.0, 1.0, 0.0]
        push = ball - BEHIND * flat / np.linalg.norm(flat, axis=-1, keepdims=True) - ant
        push *= [1.0, 1.0, 0.0]
        velocity = numpy(env.scene["robot"].data.root_lin_vel_w).astype(float)
        total += (velocity * push).sum(-1) / np.linalg.norm(push, axis=-1)
        upright = -numpy(env.scene["robot"].data.projected_gravity_b)[:, 2] > 0.93
        total += 0.5 + 0.1 * upright - 0.005 * (numpy(action).astype(float) ** 2).sum(-1)
        np.testing.assert_allclose(numpy(reward)[going], total[going], rtol=1e-3, atol=2e-3)
        inverse = -numpy(env.scene["robot"].data.root_pos_w) + numpy(pool(env).positions)[:, 0]
        np.testing.assert_allclose(
            np.linalg.norm(numpy(obs["policy"])[:, 26:29], axis=-1), np.linalg.norm(inverse, axis=-1), rtol=1e-4
        )
        compared += going.sum()
    assert compared > 40


def test_the_ball_at_the_goal_ends_the_episode_with_the_goals_reward(env):
    ball, goal, _ = places(env)
    ball[:2] = goal[:2] + [[0.2, 0.0, 0.0], [0.5, 0.0, 0.0]]
    put_ball(env, ball)
    _, reward, terminated, truncated, extras = rest(env)
    assert terminated.tolist() == [True, False, False, False]
    assert not truncated.any()
    assert env.success.tolist() == [True, False, False, False]
    assert reward[0] == pytest.approx(200.5, abs=1.0)
    assert (reward[1:].abs() < 5.0).all()
    assert extras["log"]["Episode_Termination/goal_reached"] == 1.0
    assert places(env)[0][0, 0] <= 2.0  # a new ball


def test_a_lost_ball_ends_the_episode(env):
    ball = places(env)[0]
    ball[1, 1], ball[2, 0] = 4.5, 6.5
    put_ball(env, ball)
    _, reward, terminated, *_ = rest(env)
    assert terminated.tolist() == [False, True, True, False]
    assert not env.success.any()
    assert (reward[1:3] < -1.0).all()


def test_no_part_of_a_step_needs_the_host(env):
    text = env.describe()
    assert "goal marker" in text
    assert "torch" not in text
    assert "host" not in text


def test_rsl_rl_trains_it(tmp_path):
    agent = load_cfg(TASK, "agent")
    agent.num_steps_per_env = 8
    assert OnPolicyRunner(RslRlVecEnvWrapper(make_env(TASK, small_cfg(TASK, 8))), agent, tmp_path / "run").learn(2)
