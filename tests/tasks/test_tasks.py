# SPDX-License-Identifier: Apache-2.0
"""Direct tasks: observations and rewards against float64 references from the raw state."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import stripe_tasks  # noqa: F401
from stripe_newton.configclass import resolve_name
from tests.helpers.small_scenes import numpy
from tests.helpers.small_tasks import small_cfg

IDS = [
    "Stripe-Ant-Direct-v0",
    "Stripe-CartDoublePole-Direct-v0",
    "Stripe-Cartpole-Direct-v0",
    "Stripe-Humanoid-Direct-v0",
]
RUNNERS = IDS[0], IDS[3]
N = 4


def make(task: str):
    return gymnasium.make_vec(task, cfg=small_cfg(task, N, seed=None))


@pytest.fixture(scope="module")
def envs():
    made = {}

    def get(task: str):
        if task not in made:
            made[task] = make(task)
        made[task].reset(seed=1)
        return made[task]

    return get


def raw(env) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions and velocities as the solver has them."""
    state = env.sim.state
    return state.joint_q.numpy().astype(float).reshape(N, -1), state.joint_qd.numpy().astype(float).reshape(N, -1)


def run(env, steps: int, scale: float = 1.0, seed: int = 0):
    """Random steps; yields actions and what the step returned."""
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        action = scale * (2.0 * torch.rand(N, env.single_action_space.shape[0], generator=generator) - 1.0)
        yield action, env.step(action)


@pytest.mark.parametrize("task", IDS)
def test_random_actions_stay_finite(envs, task):
    env, resets = envs(task), 0
    for _, (obs, reward, terminated, truncated, extras) in run(env, 80, 2.0):
        assert obs["policy"].shape == (N, env.single_observation_space["policy"].shape[0])
        assert torch.isfinite(obs["policy"]).all()
        assert torch.isfinite(reward).all()
        assert all(np.isfinite(float(v)) for v in extras["log"].values())
        resets += int((terminated | truncated).sum())
    assert resets > 0 or task in IDS[:2]
    assert np.isfinite(raw(env)[0]).all()


@pytest.mark.parametrize("task", IDS)
def test_configs_of_a_task_are_valid(task):
    kwargs = gymnasium.spec(task).kwargs
    resolve_name(kwargs["env_cfg_entry_point"])().validate()
    resolve_name(kwargs["rsl_rl_cfg_entry_point"])()


@pytest.mark.parametrize("task", IDS)
def test_state_of_a_task_goes_on_where_it_stopped(envs, task):
    """In an environment that has taken no step yet."""
    env = envs(task)
    for _ in run(env, 3, 0.3):
        pass
    state, generator = env.get_state(), torch.get_rng_state()
    expected = [step[0]["policy"] for _, step in run(env, 4, 0.3, 1)]
    other = make(task)
    other.set_state(state)
    torch.set_rng_state(generator)
    got = [step[0]["policy"] for _, step in run(other, 4, 0.3, 1)]
    for one, two in zip(expected, got, strict=True):
        torch.testing.assert_close(one, two, atol=0.0 if task not in RUNNERS else 1e-4, rtol=0.0)


def test_cartpole(envs):
    env = envs(IDS[2])
    cart, pole = (env.robot.find_joints(n)[0][0] for n in ("slider_to_cart", "cart_to_pole"))
    q, _ = raw(env)
    assert np.abs(q[:, pole]).max() <= math.pi / 4
    assert len(np.unique(q[:, pole])) == N
    for action, (obs, reward, terminated, truncated, _) in run(env, 25, 0.2):
        q, v = raw(env)
        expected = np.stack((q[:, pole], v[:, pole], q[:, cart], v[:, cart]), -1)
        np.testing.assert_allclose(numpy(obs["policy"]), expected, atol=1e-6)
        np.testing.assert_allclose(numpy(env.robot.data.joint_effort_target)[~numpy(terminated).astype(bool), cart],
                                   100.0 * numpy(action)[~numpy(terminated).astype(bool), 0], rtol=1e-5)  # fmt: skip
        going = ~terminated.numpy() & ~truncated.numpy()
        total = 1.0 - q[:, pole] ** 2 - 0.01 * np.abs(v[:, cart]) - 0.005 * np.abs(v[:, pole])
        np.testing.assert_allclose(numpy(reward)[going], total[going], atol=1e-5)
        assert (np.abs(q[going, pole]) <= math.pi / 2).all()


def test_cartpole_ends(envs):
    env = envs(IDS[2])
    env.joint_pos[:] = 0.0
    env.joint_pos[0, env._cart], env.joint_pos[1, env._pole], env.joint_pos[3, env._cart] = 3.5, 1.7, -2.9
    env.joint_vel[:] = 0.0
    *_, reward, terminated, truncated, _ = env.step(torch.zeros(N, 1))
    assert terminated.tolist() == [True, True, False, False]
    assert not truncated.any()
    assert reward[0] == pytest.approx(-2.0, abs=0.2)
    env.episode_length_buf = torch.tensor([299, 298, 0, 0])
    *_, terminated, truncated, _ = env.step(torch.zeros(N, 1))
    assert truncated.tolist() == [True, False, False, False]


def test_cart_with_two_poles(envs):
    env = envs(IDS[1])
    names = ["railCartJoint", "cartPoleJoint", "polePoleJoint"]
    cart, first, second = env.robot.find_joints(names, preserve_order=True)[0]
    cfg = env.cfg
    for _, (obs, reward, terminated, truncated, _) in run(env, 30):
        q, v = raw(env)
        a, b = q[:, first], q[:, first] + q[:, second]
        expected = np.stack(
            (
                q[:, cart],
                v[:, cart],
                np.sin(a),
                np.cos(a),
                np.sin(b),
                np.cos(b),
                v[:, first],
                v[:, first] + v[:, second],
            ),
            -1,
        )
        np.testing.assert_allclose(numpy(obs["policy"]), expected, atol=2e-6)
        going = ~terminated.numpy() & ~truncated.numpy()
        wrapped = [(x + np.pi) % (2 * np.pi) - np.pi for x in (a, b)]
        total = cfg.rew_alive + cfg.rew_angle * (wrapped[0] ** 2 + wrapped[1] ** 2) + cfg.rew_cart_pos * q[:, cart] ** 2
        total = total + cfg.rew_vel * (np.abs(v[:, first]) + np.abs(v[:, second]))
        np.testing.assert_allclose(numpy(reward)[going], total[going], atol=1e-5)


def test_poles_are_upright_at_zero(envs):
    """The angles are from the vertical: at zero the tip is as high as it can be."""
    env = envs(IDS[1])
    tip = env.robot.num_bodies - 1
    heights = []
    for angle in (0.0, 0.3, -0.3):
        env.robot.write_joint_state_to_sim(torch.tensor([[0.0, angle, 0.0]] * N), torch.zeros(N, 3))
        env.sim.forward()
        heights.append(float(env.robot.data.body_com_pos_w[0, tip, 2]))
    assert heights[0] > max(heights[1:])


def relations(env, q: np.ndarray) -> dict[str, np.ndarray]:
    """Pose of the torso relative to the target, in float64."""
    turn, origin = Rotation.from_quat(q[:, 3:7]), numpy(env.scene.env_origins)
    target = origin + [env.cfg.target_distance, 0.0, 0.0]
    to_target = (target - q[:, :3]) * [1.0, 1.0, 0.0]
    distance = np.linalg.norm(to_target, axis=-1)
    x, y, z, w = q[:, 3:7].T
    yaw = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return {
        "turn": turn,
        "potential": -distance / env.step_dt,
        "up": turn.apply([0.0, 0.0, 1.0])[:, 2],
        "heading": (turn.apply([1.0, 0.0, 0.0]) * to_target).sum(-1) / distance,
        "yaw": yaw,
        "roll": np.arctan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        "angle": np.arctan2(to_target[:, 1], to_target[:, 0]) - yaw,
    }


def circular(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Difference of angles."""
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("task", RUNNERS)
def test_runners(envs, task):
    env = envs(task)
    cfg, joints = env.cfg, env.robot.num_joints
    limits = numpy(env.robot.data.joint_pos_limits)
    gears = numpy(env._efforts)
    q, _ = raw(env)
    old = relations(env, q)["potential"]
    for action, (obs, reward, terminated, truncated, extras) in run(env, 25, 0.7):
        q, v = raw(env)
        now, going = relations(env, q), ~terminated.numpy() & ~truncated.numpy()
        scaled = 2.0 * (q[:, 7:] - limits[..., 0]) / (limits[..., 1] - limits[..., 0]) - 1.0
        got, inverse = numpy(obs["policy"]), now["turn"].inv()
        np.testing.assert_allclose(got[:, 0], q[:, 2], atol=1e-5)
        np.testing.assert_allclose(got[:, 1:4], inverse.apply(v[:, :3]), atol=2e-4)
        np.testing.assert_allclose(got[:, 4:7], inverse.apply(v[:, 3:6]) * cfg.ang_vel_scale, atol=2e-4)
        for column, name in ((7, "yaw"), (8, "roll"), (9, "angle")):
            assert circular(got[:, column], now[name]).max() < 1e-3, name
        np.testing.assert_allclose(got[:, 10], now["up"], atol=1e-4)
        np.testing.assert_allclose(got[:, 11], now["heading"], atol=1e-4)
        np.testing.assert_allclose(got[:, 12 : 12 + joints], scaled, atol=1e-4)
        np.testing.assert_allclose(
            got[:, 12 + joints : 12 + 2 * joints], v[:, 6:] * cfg.joint_vel_scale, atol=1e-3, rtol=1e-4
        )
        kept = np.where(going[:, None], np.clip(numpy(action), -1.0, 1.0), 0.0)
        np.testing.assert_allclose(got[:, 12 + 2 * joints :], kept, atol=1e-6)
        assert got.shape[1] == 12 + 3 * joints
        power = np.abs(kept * v[:, 6:] * cfg.joint_vel_scale * gears / gears.max()).sum(-1)
        total = (
            now["potential"] - old
            + cfg.alive_reward
            + cfg.heading_weight * np.minimum(now["heading"] / 0.8, 1.0)
            + cfg.up_weight * (now["up"] > 0.93)
            - cfg.actions_cost * (kept**2).sum(-1)
            - cfg.power_cost * power
            - cfg.at_limit_cost * (np.abs(scaled) > 0.98).sum(-1)
        )  # fmt: skip
        near = (np.abs(np.abs(scaled) - 0.98) < 1e-4).any(-1) | (np.abs(now["up"] - 0.93) < 1e-4)
        np.testing.assert_allclose(numpy(reward)[going & ~near], total[going & ~near], atol=1e-3)
        np.testing.assert_allclose(numpy(reward)[terminated.numpy()], cfg.death_cost)
        assert (q[going, 2] >= cfg.termination_height).all()
        old = now["potential"]
        assert "Episode_Reward/progress" in extras["log"]


@pytest.mark.parametrize("task", RUNNERS)
def test_a_runner_that_became_nan_recovers(envs, task):
    env = envs(task)
    for _ in run(env, 3):
        pass
    env.robot.data.joint_vel[1] = float("nan")
    env.reset(options={"reset_mask": torch.tensor([False, True, False, False])})
    for _, (obs, reward, *_) in run(env, 5):
        assert torch.isfinite(obs["policy"]).all()
        assert torch.isfinite(reward).all()


@pytest.mark.parametrize("task", RUNNERS)
def test_the_torque_of_an_action(envs, task):
    env = envs(task)
    action = torch.linspace(-1.5, 1.5, env.single_action_space.shape[0]).repeat(N, 1)
    env.step(action)
    expected = numpy(env._efforts) * np.clip(numpy(action), -1.0, 1.0)
    np.testing.assert_allclose(numpy(env.robot.data.joint_effort_target), expected, rtol=1e-5)
    assert {float(g) for g in env._efforts} == {
        cfg_gear * env.cfg.action_scale for cfg_gear in set(env.cfg.joint_gears.values())
    }
