# SPDX-License-Identifier: Apache-2.0
"""Evaluation of policies: episodes are counted without bias, and it ends."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.rl import (
    RandomPolicy,
    RslRlVecEnvWrapper,
    ZeroPolicy,
    evaluate,
)
from tests.helpers.fake_env import FakeCartCfg, FakeCartEnv
from tests.helpers.fake_runner import make_env, make_runner, rnn_cfg


class ScriptedEnv(FakeCartEnv):
    """Episodes of fixed lengths: 2 in environment 0 and 10 in all others; a step is worth 1."""

    def step(self, action):
        self._length += 1
        lengths = torch.full((self.num_envs,), 10)
        lengths[0] = 2
        done = self._length >= lengths
        self.success = done & (lengths == 2)
        self._length[done] = 0
        log = {"Metrics/length": lengths[done].float().mean(), "Episode_Reward/x": torch.tensor(3.0)}
        early = done & (lengths == 2)
        return self._observe(), torch.ones(self.num_envs), early, done & ~early, {"log": log}


def scripted_env(num_envs: int) -> RslRlVecEnvWrapper:
    cfg = FakeCartCfg()
    cfg.sim.device, cfg.scene.num_envs = "cpu", num_envs
    return RslRlVecEnvWrapper(ScriptedEnv(cfg))


def test_evaluate_does_not_favour_short_episodes():
    env = scripted_env(4)
    result = evaluate(env, ZeroPolicy(env), 4, task="scripted")
    assert result.to_dict() == {
        "task": "scripted",
        "episodes": 4,
        "mean_return": 8.0,  # (2 + 3 * 10) / 4; the first four episodes to end would give (4 * 2) / 4
        "mean_length": 8.0,
        "max_length": 30,
        "terminated_rate": 0.25,
        "success_rate": 0.25,
        "metrics": {"length": 6.5},  # (2 + 3 * 8) / 4: what else ended in the same step is in its mean
    }
    assert evaluate(env, ZeroPolicy(env), 5).mean_length == (2 + 2 + 30) / 5
    assert evaluate(env, ZeroPolicy(env), 2).mean_length == 6.0


def test_evaluate_counts_the_time_limit_of_a_task_with_a_finite_horizon():
    env = make_env(limit=1e9, episode_length_s=1.0, is_finite_horizon=True)
    result = evaluate(env, ZeroPolicy(env), env.num_envs)
    assert (result.mean_length, result.terminated_rate) == (env.max_episode_length, 0.0)


def test_evaluate_ends_when_episodes_do_not(monkeypatch):
    env = make_env(limit=1e9, episode_length_s=1.0)
    monkeypatch.setattr(env.unwrapped, "max_episode_length", 10**9)
    env.max_episode_length = 10
    with pytest.raises(RuntimeError, match="does it ever end"):
        evaluate(env, ZeroPolicy(env), 1)
    with pytest.raises(ValueError, match="at least 1"):
        evaluate(env, ZeroPolicy(env), 0)


def test_evaluate_tells_a_policy_with_a_memory_which_episodes_ended():
    env = scripted_env(3)
    told = []

    class Recorder(ZeroPolicy):
        def reset(self, dones=None):
            told.append(None if dones is None else dones.tolist())

    evaluate(env, Recorder(env), 3)
    assert told[:3] == [None, [0, 0, 0], [1, 0, 0]]
    assert told[-1] == [1, 1, 1]

    runner = make_runner(None, rnn_cfg())
    policy = runner.get_inference_policy()
    first = evaluate(runner.env, policy, 16, seed=5)
    assert evaluate(runner.env, policy, 16, seed=5) == first


def test_random_policy_stays_within_the_action_space():
    env = make_env(num_envs=200)
    env.unwrapped.single_action_space.low[:], env.unwrapped.single_action_space.high[:] = 2.0, 3.0
    actions = RandomPolicy(env)(env.get_observations())
    assert actions.shape == (200, 1)
    assert 2.0 <= actions.min() < 2.1 < 2.9 < actions.max() <= 3.0
