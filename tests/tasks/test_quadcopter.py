# SPDX-License-Identifier: Apache-2.0
"""Quadcopter: mass and looks, hovering and turning, observations and rewards from the raw state."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import stripe_tasks  # noqa: F401
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.rl import OnPolicyRunner, RandomPolicy, RslRlVecEnvWrapper, ZeroPolicy, evaluate
from tests.helpers.small_scenes import numpy
from tests.helpers.small_tasks import small_cfg

TASK = "Stripe-Quadcopter-Direct-v0"
N = 4
MASS, INERTIA, G = 0.028, (1.657171e-5, 1.6655602e-5, 2.9261652e-5), 9.81
HOVER = 2.0 / 1.9 - 1.0
"""Action whose thrust is the weight."""


@pytest.fixture(scope="module")
def shared():
    return gymnasium.make_vec(TASK, cfg=small_cfg(TASK))


@pytest.fixture
def env(shared):
    shared.reset(seed=1)
    return shared


def fly(env, thrust: float, moments: tuple[float, float, float] = (0.0, 0.0, 0.0)):
    return env.step(torch.tensor([[thrust, *moments]]).repeat(N, 1))


def goals(env) -> np.ndarray:
    """Goals in the world, shape (N, 3)."""
    return numpy(env.scene.env_origins) + env._goal.numpy()[:, :3]


def raw(env) -> tuple[np.ndarray, Rotation, np.ndarray, np.ndarray]:
    """Position, orientation, velocity and angular velocity in the world, as the solver has them."""
    q, v = (x.numpy().astype(float).reshape(N, -1) for x in (env.sim.state.joint_q, env.sim.state.joint_qd))
    return q[:, :3], Rotation.from_quat(q[:, 3:7]), v[:, :3], v[:, 3:6]


def test_it_is_a_crazyflie(env):
    model, robot = env.sim.model, env.robot
    assert (robot.num_joints, robot.body_names, robot.is_fixed_base) == (0, ["body"], False)
    np.testing.assert_allclose(numpy(robot.data.body_mass), MASS, rtol=1e-6)
    np.testing.assert_allclose(np.diag(model.body_inertia.numpy()[robot.layout.bodies[0]]), INERTIA, rtol=1e-5)
    np.testing.assert_array_equal(model.body_com.numpy()[robot.layout.bodies[0]], 0.0)
    rotors, world = {}, model.shape_world.numpy()
    for i, label in enumerate(model.shape_label):
        if world[i] == 0 and "/propeller_" in label:
            pose, vertices = model.shape_transform.numpy()[i], np.asarray(model.shape_source[i].vertices)
            rotors[label] = (Rotation.from_quat(pose[3:]).apply(vertices) + pose[:3]).mean(0)
    assert len(rotors) == 4
    for label, point in rotors.items():
        np.testing.assert_allclose(np.abs(point[:2]), 0.0297, atol=1e-3)  # 84 mm from rotor to rotor across
        assert point[2] > 0.005  # above the centre of mass
        assert (point[0] > 0.0) == ("front" in label)


def test_random_actions_stay_finite(env):
    generator = torch.Generator().manual_seed(0)
    ends = 0
    for _ in range(100):
        obs, reward, terminated, truncated, extras = env.step(4.0 * torch.rand(N, 4, generator=generator) - 2.0)
        assert obs["policy"].shape == (N, 12)
        assert torch.isfinite(obs["policy"]).all()
        assert torch.isfinite(reward).all()
        assert math.isfinite(extras["log"]["Metrics/distance_to_goal"])
        ends += int((terminated | truncated).sum())
    assert ends > 0


def test_thrust_that_equals_the_weight_holds_the_height(env):
    for _ in range(100):
        _, _, terminated, _, _ = fly(env, HOVER)
    pos, rot, vel, _ = raw(env)
    assert not terminated.any()
    np.testing.assert_allclose(pos[:, 2], 0.5, atol=1e-4)
    np.testing.assert_allclose(vel, 0.0, atol=1e-4)
    np.testing.assert_allclose(rot.magnitude(), 0.0, atol=1e-6)


@pytest.mark.parametrize(("thrust", "acceleration"), [(1.0, 0.9 * G), (-1.0, -G), (5.0, 0.9 * G), (0.0, -0.05 * G)])
def test_thrust(env, thrust, acceleration):
    for _ in range(5):
        fly(env, thrust)
    np.testing.assert_allclose(raw(env)[2][:, 2], 0.1 * acceleration, rtol=1e-3)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_moments_turn_about_the_axes_of_the_body(env, axis):
    moments = [0.0, 0.0, 0.0]
    moments[axis] = 0.1
    for _ in range(2):
        fly(env, HOVER, tuple(moments))
    expected = np.zeros(3)
    expected[axis] = 0.04 * 0.1 * 0.01 / INERTIA[axis]
    np.testing.assert_allclose(raw(env)[3], np.tile(expected, (N, 1)), rtol=2e-3, atol=1e-3)


def test_thrust_tilts_with_the_body(env):
    tilt = Rotation.from_rotvec([0.0, 0.3, 0.0])
    pose = torch.cat((env.robot.data.root_pos_w, torch.tensor(tilt.as_quat(), dtype=torch.float32).repeat(N, 1)), -1)
    env.robot.write_root_pose_to_sim(pose)
    env.sim.forward()
    fly(env, 1.0)
    expected = 0.02 * (1.9 * G * tilt.apply([0.0, 0.0, 1.0]) - [0.0, 0.0, G])
    np.testing.assert_allclose(raw(env)[2], np.tile(expected, (N, 1)), rtol=1e-3, atol=1e-5)


def test_observations_and_rewards(env):
    generator = torch.Generator().manual_seed(3)
    spread, compared = torch.tensor([0.3, 0.02, 0.02, 0.02]), 0
    for _ in range(30):
        goal = goals(env)
        action = spread * (2.0 * torch.rand(N, 4, generator=generator) - 1.0)
        obs, reward, terminated, truncated, _ = env.step(action)
        pos, rot, vel, ang = raw(env)
        distance = np.linalg.norm(goal - pos, axis=-1)
        going = ~(terminated | truncated).numpy()
        expected = 0.02 * (-0.05 * (vel**2).sum(-1) - 0.01 * (ang**2).sum(-1) + 15.0 * (1.0 - np.tanh(distance / 0.8)))
        np.testing.assert_allclose(numpy(reward)[going], expected[going], rtol=1e-4, atol=1e-5)
        columns = (vel, ang, np.tile([0.0, 0.0, -1.0], (N, 1)), goals(env) - pos)
        expected = np.concatenate([rot.inv().apply(c) for c in columns], -1)
        np.testing.assert_allclose(numpy(obs["policy"]), expected, rtol=1e-4, atol=1e-4)
        compared += going.sum()
    assert compared > 60


def test_the_reward_is_highest_at_rest_at_the_goal(env):
    pose = torch.zeros(N, 7)
    pose[:, :3], pose[:, 6] = torch.tensor(goals(env)), 1.0
    pose[1, 0] += 0.3
    velocity = torch.zeros(N, 6)
    velocity[2, 0], velocity[3, 5] = 1.0, 5.0
    env.robot.write_root_pose_to_sim(pose)
    env.robot.write_root_velocity_to_sim(velocity)
    reward = fly(env, HOVER)[1]
    assert reward[0] == pytest.approx(0.3, abs=1e-4)
    assert (reward[1:] < reward[0] - 1e-3).all()


def test_episodes_end_too_low_too_high_and_in_time(env):
    pose = env.robot.data.root_pose_w.clone()
    pose[:, 2] = torch.tensor([0.09, 2.01, 1.0, 0.2])
    env.robot.write_root_pose_to_sim(pose)
    env.episode_length_buf = torch.tensor([0, 0, env.max_episode_length - 1, 0])
    *_, terminated, truncated, _ = fly(env, HOVER)
    assert terminated.tolist() == [True, True, False, False]
    assert truncated.tolist() == [False, False, True, False]
    np.testing.assert_allclose(raw(env)[0][:3, 2], 0.5)


def test_goals_and_their_markers(env):
    goal, marker = goals(env), env.scene["goal"]
    assert len(np.unique(goal[:, 0])) == N
    local = env._goal.numpy()[:, :3]
    assert (np.abs(local[:, :2]) <= 2.0).all()
    assert ((local[:, 2] >= 0.5) & (local[:, 2] <= 1.5)).all()
    np.testing.assert_allclose(numpy(marker.data.root_pos_w), goal, atol=1e-6)
    env.episode_length_buf = torch.tensor([env.max_episode_length - 1, 0, 0, 0])
    fly(env, HOVER)
    after = goals(env)
    assert np.abs(after - goal).max(-1).tolist() == [pytest.approx(np.abs(after - goal)[0].max()), 0.0, 0.0, 0.0]
    assert np.abs(after - goal)[0].max() > 0.0
    np.testing.assert_allclose(numpy(marker.data.root_pos_w), after, atol=1e-6)
    fly(env, HOVER)
    np.testing.assert_allclose(numpy(marker.data.root_pos_w), after, atol=1e-6)


def test_what_it_does_does_not_depend_on_the_number_of_environments(env):
    fewer = make_env(TASK, small_cfg(TASK, 2))
    fewer.reset(seed=1)
    for k in range(4):
        action = torch.full((N, 4), 0.1 * k)
        one, two = env.step(action)[0]["policy"], fewer.step(action[:2])[0]["policy"]
        torch.testing.assert_close(one[:2, :9], two[:, :9], atol=0.0, rtol=0.0)


def test_state_goes_on_where_it_stopped(env):
    fly(env, 0.2, (0.01, 0.0, 0.02))
    state = env.get_state()
    expected = [fly(env, 0.1, (0.0, 0.01, 0.0))[0]["policy"] for _ in range(3)]
    other = make_env(TASK, small_cfg(TASK))
    other.set_state(state)
    for values in expected:
        assert torch.equal(fly(other, 0.1, (0.0, 0.01, 0.0))[0]["policy"], values)


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
def test_it_learns_to_fly_to_the_goal():
    torch.manual_seed(1)
    env = RslRlVecEnvWrapper(make_env(TASK, small_cfg(TASK, 256)))
    agent = load_cfg(TASK, "agent")
    before = max(evaluate(env, policy, 256, seed=1).mean_return for policy in (RandomPolicy(env), ZeroPolicy(env)))
    runner = OnPolicyRunner(env, agent, None)
    assert runner.learn(120)
    after = evaluate(env, runner.get_inference_policy(), 256, seed=1)
    assert after.mean_return > before + 50.0
