# SPDX-License-Identifier: Apache-2.0
"""Multi-agent environments as one agent and as PettingZoo's; the cart with two poles and two agents."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.envs import ParallelEnvView, multi_agent_to_single_agent
from stripe_newton.rl import OnPolicyRunner, RslRlVecEnvWrapper, ZeroPolicy, evaluate
from stripe_tasks.cart_double_pole.multi_agent import CartDoublePoleMARLEnv
from tests.helpers.marl_cart import AGENTS, N, Told, actions, config

TASK = "Stripe-CartDoublePole-MARL-Direct-v0"
SINGLE = "Stripe-CartDoublePole-Direct-v0"


@pytest.fixture(scope="module")
def shared():
    return Told(config(compute_final_obs=True))


@pytest.fixture
def env(shared):
    shared.reset(seed=3)
    shared.episode_length_buf = torch.zeros(N)
    return shared


# -- as others see it


def test_one_agent_in_the_place_of_all(env):
    view = multi_agent_to_single_agent(env)
    assert view.unwrapped is view
    assert view.single_observation_space["policy"].shape == (10,)
    assert view.single_observation_space["critic"].shape == (10,)
    assert view.action_space.shape == (N, 2)
    obs, extras = view.reset(seed=3)
    assert set(extras) == {"log"}
    given, start = actions(env), env.get_state()
    obs, reward, terminated, truncated, extras = view.step(torch.cat([given[a] for a in AGENTS], -1))
    env.set_state(start)
    values, rewards, *_ = env.step(given)
    assert torch.equal(obs["policy"], torch.cat([values[a] for a in AGENTS], -1))
    assert torch.equal(obs["critic"], obs["policy"])
    assert torch.equal(reward, rewards["cart"] + rewards["pendulum"])
    assert not (terminated | truncated).any()
    view.episode_length_buf = torch.full((N,), env.max_episode_length - 1)
    *_, terminated, truncated, extras = view.step(torch.zeros(N, 2))
    assert (terminated.any(), truncated.all()) == (False, True)
    assert extras["final_obs"]["policy"].shape == (N, 10)
    assert extras["_final_obs"].all()
    assert view.robot is env.robot
    with pytest.raises(ValueError, match=r"shape \(4, 1\), expected \(4, 2\)"):
        view.step(torch.zeros(N, 1))
    with pytest.raises(AttributeError):
        view.no_such_thing  # noqa: B018


def test_the_state_as_observation():
    class Angles(CartDoublePoleMARLEnv):
        def _get_states(self):
            return self.robot.data.joint_pos

    view = multi_agent_to_single_agent(Angles(config(state_space=3)), state_as_observation=True)
    obs, _ = view.reset()
    assert view.single_observation_space["policy"].shape == (3,)
    assert torch.equal(obs["policy"], view.robot.data.joint_pos)
    with pytest.raises(ValueError, match="state_space"):
        multi_agent_to_single_agent(Angles(config(state_space=0)), state_as_observation=True)


def test_one_environment_for_pettingzoo():
    view = ParallelEnvView(Told(config(1, compute_final_obs=True)))
    assert (view.agents, view.max_num_agents) == ([], 2)
    obs, infos = view.reset(seed=1)
    assert view.agents == list(obs) == list(infos) == AGENTS
    assert all(view.observation_space(a).contains(obs[a]) for a in AGENTS)
    view.env.told["end"]["pendulum"][0] = True
    obs, rewards, terminated, truncated, infos = view.step({a: np.zeros(1, np.float32) for a in AGENTS})
    assert terminated == {"cart": False, "pendulum": True}
    assert truncated == {"cart": False, "pendulum": False}
    assert all(isinstance(r, float) for r in rewards.values())
    assert (view.agents, view.num_agents) == (["cart"], 1)
    np.testing.assert_array_equal(view.state(), np.concatenate([obs[a] for a in AGENTS]))
    view.env.told["end"]["cart"][0] = True
    obs, *_ = view.step({"cart": np.zeros(1, np.float32)})
    assert list(obs) == ["cart"]
    assert view.agents == []
    np.testing.assert_array_equal(obs["cart"], view.env.extras["cart"]["final_obs"][0])
    with pytest.raises(ValueError, match=r"scene\.num_envs = 1"):
        ParallelEnvView(Told(config(2)))


# -- the task beside the one of a single agent


def test_the_task_is_that_of_one_agent_seen_by_two():
    cfg = load_cfg(SINGLE, "env")
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = "cpu", N, 1
    single = make_env(SINGLE, cfg)
    single.reset()
    both = gymnasium.make_vec(TASK, cfg=config())
    both.reset()
    for robot in (single.robot, both.robot):
        start = torch.tensor([[0.3, 0.1, -0.2], [-0.5, -0.3, 0.1], [0.0, 0.05, 0.4], [1.0, 0.2, 0.2]])
        robot.write_joint_state_to_sim(start, 0.5 * start.flip(0))
    generator = torch.Generator().manual_seed(2)
    for _ in range(20):
        push = 2.0 * torch.rand(N, 1, generator=generator) - 1.0
        one, reward, ended, _, _ = single.step(push)
        obs, rewards, terminated, _, _ = both.step({"cart": push, "pendulum": torch.zeros(N, 1)})
        going = ~ended
        assert torch.equal(ended, terminated["cart"])
        cart, pendulum = obs["cart"], obs["pendulum"]
        joined = torch.cat([cart[:, :4], pendulum[:, :2], cart[:, 4:], pendulum[:, 2:3]], -1)
        torch.testing.assert_close(joined[going], one["policy"][going], atol=0.0, rtol=0.0)
        torch.testing.assert_close(rewards["cart"] + rewards["pendulum"], reward + torch.where(going, 1.0, -2.0))
        lower = torch.atan2(obs["cart"][:, 2], obs["cart"][:, 3])
        expected = 1.0 - 0.02 * obs["cart"][:, 0] ** 2 - 0.5 * lower**2 - 0.002 * obs["cart"][:, 4].abs()
        torch.testing.assert_close(rewards["cart"][going], expected[going])
        if ended.any():
            break
    assert going.sum() >= 2


def test_the_pendulum_turns_the_upper_joint(env):
    still = torch.zeros(N, 1)
    pole, upper = env._lower, env._upper
    env.robot.write_joint_state_to_sim(torch.zeros(N, 3), torch.zeros(N, 3))
    env.step({"cart": still, "pendulum": torch.tensor([[1.0], [-1.0], [0.0], [5.0]])})
    vel = env.robot.data.joint_vel
    assert vel[0, upper] > 0.1
    assert vel[0, pole] < -0.1  # the lower pole takes the reaction
    torch.testing.assert_close(vel[1], -vel[0])
    torch.testing.assert_close(vel[3], vel[0])  # actions are clamped
    assert vel[2].abs().max() < 1e-6


def test_rsl_rl_trains_it(tmp_path):
    cfg, agent = load_cfg(TASK, "env"), load_cfg(TASK, "agent")
    cfg.sim.device, cfg.scene.num_envs, cfg.seed, agent.num_steps_per_env = "cpu", 8, 1, 8
    env = RslRlVecEnvWrapper(make_env(TASK, cfg))
    runner = OnPolicyRunner(env, agent, tmp_path / "run")
    assert runner.learn(2)
    assert env.num_actions == 2


@pytest.mark.slow
def test_both_agents_learn_to_balance():
    cfg, agent = load_cfg(TASK, "env"), load_cfg(TASK, "agent")
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = "cpu", 128, 1
    env = RslRlVecEnvWrapper(make_env(TASK, cfg))
    before = evaluate(env, ZeroPolicy(env), 128, seed=1)
    torch.manual_seed(1)
    runner = OnPolicyRunner(env, agent, None)
    assert runner.learn(60)
    after = evaluate(env, runner.get_inference_policy(), 128, seed=1)
    assert after.mean_length > 4.0 * before.mean_length
    assert after.mean_return > 4.0 * before.mean_return
