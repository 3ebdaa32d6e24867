# SPDX-License-Identifier: Apache-2.0
"""Outputs of a step of a direct environment: what was handed out stays as it was."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.helpers.cart_env import CartEnv, N, make, zeros


@pytest.fixture
def env():
    env = make()
    env.reset(seed=3)
    return env


def test_observations_are_never_overwritten(env):
    """Trap 1, with a hook that fills one buffer and keeps it."""
    kept = [env.reset()[0]["policy"]]
    copies = [kept[0].clone()]
    for _ in range(12):
        obs = env.step(torch.ones(N, 1))[0]["policy"]
        kept.append(obs)
        copies.append(obs.clone())
        env.buffer.zero_()
    assert all(torch.equal(a, b) for a, b in zip(kept, copies, strict=True))
    assert not torch.equal(kept[1], kept[2])


def test_observations_of_alternating_buffers_are_never_overwritten():
    class Env(CartEnv):
        def _get_observations(self):
            self.turn = 1 - getattr(self, "turn", 0)
            if not hasattr(self, "pair"):
                self.pair = [torch.zeros(N, 4), torch.zeros(N, 4)]
            self.pair[self.turn][:] = float(len(self.calls))
            self.calls.append("")
            return {"policy": self.pair[self.turn]}

    env = make(Env)
    kept = [env.reset()[0]["policy"]] + [env.step(zeros(env))[0]["policy"] for _ in range(5)]
    assert len({float(k[0, 0]) for k in kept}) == 6


def test_rewards_and_dones_are_never_overwritten():
    class Env(CartEnv):
        def _get_rewards(self):
            self.reward_sum = getattr(self, "reward_sum", torch.zeros(N))
            self.reward_sum += 1.0
            return self.reward_sum

    env = make(Env)
    env.reset()
    kept = [env.step(zeros(env))[1:4] for _ in range(12)]
    assert [float(r[0]) for r, _, _ in kept] == list(range(1, 13))
    assert [bool(t[0]) for _, _, t in kept] == [i == 9 for i in range(12)]


def test_the_log_is_new_in_every_step(env):
    """Trap 3: dict and tensors."""
    logs = [env.step(zeros(env))[4]["log"] for _ in range(3)]
    assert len({id(log) for log in logs}) == 3
    assert [float(log["count"]) for log in logs] == [1.0, 2.0, 3.0]


def test_episode_lengths_are_copied_in_place(env):
    """Trap 2: what others captured stays the buffer."""
    buffer = env.episode_length_buf
    given = torch.tensor([9, 1, 2, 3])
    env.episode_length_buf = given
    assert env.episode_length_buf is buffer
    given += 1
    assert buffer.tolist() == [9, 1, 2, 3]
    _, _, terminated, truncated, _ = env.step(zeros(env))
    assert truncated.tolist() == [True, False, False, False]
    assert not terminated.any()
    assert buffer.tolist() == [0, 2, 3, 4]
    env.episode_length_buf = torch.tensor([1, 2, 3, 4], dtype=torch.int32)
    assert buffer.dtype == torch.int64


def test_actions_are_copied_in(env):
    action = torch.ones(N, 1)
    env.step(action)
    action.zero_()
    assert env.actions.sum() == N


def test_terminated_and_truncated_are_told_apart(env):
    for _ in range(9):
        env.step(zeros(env))
    env.fail[1] = True
    _, _, terminated, truncated, _ = env.step(zeros(env))
    assert terminated.tolist() == [False, True, False, False]
    assert truncated.tolist() == [True] * N
    assert env.reset_buf.all()
    assert env.reset_terminated.tolist() == terminated.tolist()
    assert env.reset_time_outs.tolist() == truncated.tolist()


def test_final_observation_is_that_before_the_reset():
    env, plain = make(compute_final_obs=True, start=0.0), make(start=0.0)
    for e in (env, plain):
        e.reset(seed=5)
    for _ in range(9):
        extras = env.step(torch.ones(N, 1))[4]
        plain.step(torch.ones(N, 1))
        assert "final_obs" not in extras
    before = plain.joint_pos.clone()
    plain.cfg.episode_length_s = 100.0
    expected = plain.step(torch.ones(N, 1))[0]["policy"]
    obs, *_, extras = env.step(torch.ones(N, 1))
    assert torch.equal(extras["final_obs"]["policy"], expected)
    assert extras["_final_obs"].tolist() == [True] * N
    assert not torch.equal(obs["policy"], expected)
    assert not torch.equal(before, expected[:, :2])
    extras = env.step(torch.ones(N, 1))[4]
    assert "final_obs" not in extras


def test_reset_of_some_environments(env):
    for _ in range(3):
        env.step(torch.ones(N, 1))
    before = env.joint_pos.clone()
    obs, _ = env.reset(options={"reset_mask": np.array([True, False, False, True])})
    assert env.episode_length_buf.tolist() == [0, 3, 3, 0]
    assert torch.equal(env.joint_pos[1:3], before[1:3])
    assert not torch.equal(env.joint_pos[0], before[0])
    assert torch.equal(obs["policy"][:, :2], env.joint_pos)
