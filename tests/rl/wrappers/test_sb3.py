# SPDX-License-Identifier: Apache-2.0
"""Training with Stable-Baselines3: the example of docs/learners.md, and checks by its own tools."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
import torch
from gymnasium import spaces

from tests.helpers.cart_env import CartCfg, CartEnv
from tests.helpers.learner_examples import cartpole, mean_return, one_thread, random_return, run_example

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO, SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor

from stripe_newton.rl.wrappers.sb3 import Sb3VecEnvWrapper
from tests.helpers.sb3_cartpole import SHORT, N, push, wrapped


@pytest.fixture(autouse=True)
def threads():
    with one_thread():
        yield


def test_the_example_learns():
    names = run_example("Stable-Baselines3")
    before = random_return()
    assert before < 30.0
    act = names["agent"].policy._predict
    with torch.no_grad():
        after = mean_return(lambda obs: act(obs, deterministic=True))
    assert after > before + 120.0
    assert names["mean_return"] == pytest.approx(after, rel=0.2)  # evaluate_policy's, of other starts


# -- a step


def test_steps_are_those_of_the_environment():
    changes = {"episode_length_s": SHORT / 60.0, "max_cart_pos": 0.3, "initial_pole_angle": 0.0}
    env, twin = wrapped(**changes), cartpole(**changes)  # which draw nothing when they are reset
    env.seed(3)
    obs, (expected, _) = env.reset(), twin.reset(seed=3)
    kept = []
    for step in range(30):
        np.testing.assert_array_equal(obs, expected["policy"].numpy())
        obs, rewards, dones, infos = env.step(5.0 * push(step))
        expected, *given, _ = twin.step(torch.from_numpy(5.0 * push(step)))
        np.testing.assert_array_equal(rewards, given[0].numpy())
        np.testing.assert_array_equal(dones, (given[1] | given[2]).numpy())
        assert [i["TimeLimit.truncated"] for i in infos] == (given[2] & ~given[1]).tolist()
        assert [bool(d) for d in dones] == ["terminal_observation" in i for i in infos]
        assert (obs.dtype, rewards.dtype, dones.dtype) == (np.float32, np.float32, np.bool_)
        kept.append((obs, obs.copy(), rewards, rewards.copy()))
    assert all((a == b).all() and (c == d).all() for a, b, c, d in kept)  # nobody writes into what was handed out
    assert obs.flags.writeable


def test_one_copy_from_the_device(monkeypatch, device):
    env, copies = wrapped(device=device), []
    env.reset()
    to_host = torch.Tensor.cpu
    monkeypatch.setattr(torch.Tensor, "cpu", lambda self: copies.append(self) or to_host(self))
    for step in range(SHORT):
        env.step(push(step))
    assert Counter(c.dtype for c in copies) == {torch.uint8: SHORT}


def test_the_terminal_observation_is_where_the_episode_would_have_gone_on():
    env, twin = wrapped(), cartpole(episode_length_s=5.0)
    env.seed(3)
    env.reset()
    twin.reset(seed=3)
    for step in range(SHORT):
        obs, _, dones, infos = env.step(push(step))
        expected, *_ = twin.step(torch.from_numpy(push(step)))
    assert dones.all()
    last = np.stack([info["terminal_observation"] for info in infos])
    np.testing.assert_array_equal(last, expected["policy"].numpy())
    assert (last != obs).any(axis=1).all()


def spied(env: Sb3VecEnvWrapper) -> list[list[dict]]:
    """Infos of the steps that an environment takes from now on."""
    seen, step_wait = [], env.step_wait

    def spy():
        values = step_wait()
        seen.append(values[3])
        return values

    env.step_wait = spy
    return seen


def test_episodes_as_vec_monitor_counts_them():
    inner = wrapped(max_cart_pos=0.3)
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        env = VecMonitor(inner)
    seen, lengths = spied(inner), []
    env.reset()
    for step in range(40):
        *_, infos = env.step(5.0 * push(step))
        for own, counted in zip(seen[-1], infos, strict=True):
            assert ("episode" in own) == ("episode" in counted)
            if "episode" in own:
                assert own["episode"]["l"] == counted["episode"]["l"]
                assert own["episode"]["r"] == pytest.approx(counted["episode"]["r"], rel=1e-5)
                lengths.append(own["episode"]["l"])
    assert env.episode_count == len(lengths) > N
    assert max(lengths) == SHORT > min(lengths)


# -- learners


class Rewards(BaseCallback):
    """Keeps what a rollout is made of."""

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        self.rewards, self.actions = (self.model.rollout_buffer.__dict__[k].copy() for k in ("rewards", "actions"))


@pytest.mark.parametrize("finite", [False, True])
def test_a_time_out_is_worth_what_the_last_observation_is(finite):
    """PPO's rewards against an environment that is stepped by hand, with a value that can be worked out."""
    changes = {"episode_length_s": 0.2, "max_cart_pos": 0.5, "initial_pole_angle": 0.0, "compute_final_obs": True}
    twin = cartpole(**changes)  # which draws nothing when it is reset
    env = Sb3VecEnvWrapper(cartpole(is_finite_horizon=finite, **changes))
    agent = PPO("MlpPolicy", env, n_steps=26, batch_size=26, n_epochs=1, gamma=0.9, device="cpu", seed=7)
    agent.policy.predict_values = lambda obs: obs.sum(dim=-1, keepdim=True)
    kept = Rewards()
    agent.learn(26 * N, callback=kept)
    twin.reset(seed=7)
    ends = [0, 0]
    for rewards, actions in zip(kept.rewards, kept.actions, strict=True):
        _, reward, terminated, truncated, extras = twin.step(torch.from_numpy(actions))
        late = truncated & ~terminated
        if late.any() and not finite:
            reward = reward + 0.9 * extras["final_obs"]["policy"].sum(dim=-1) * late
        np.testing.assert_allclose(rewards, reward.numpy(), rtol=1e-5, atol=1e-6)
        ends[0] += int(terminated.sum())
        ends[1] += int(late.sum())
    assert min(ends) > 0


def test_the_same_seed_learns_the_same():
    def learned(seed):
        env = wrapped(8)
        agent = PPO("MlpPolicy", env, n_steps=16, batch_size=64, n_epochs=2, device="cpu", seed=seed)
        agent.learn(2 * 16 * 8)
        return torch.cat([p.detach().flatten() for p in agent.policy.parameters()])

    one, two, other = learned(1), learned(1), learned(2)
    assert torch.equal(one, two)
    assert not torch.equal(one, other)


def test_an_off_policy_learner_stores_last_observations():
    env = wrapped(clip_actions=2.0, max_cart_pos=0.3)
    seen = spied(env)
    agent = SAC("MlpPolicy", env, learning_starts=20 * N, buffer_size=40 * N, batch_size=16, device="cpu", seed=1)
    agent.learn(30 * N)
    buffer = agent.replay_buffer
    assert np.abs(buffer.actions).max() <= 1.0  # of the bounds
    late = 0
    for step in range(29):
        for i, info in enumerate(seen[step]):
            follows = info.get("terminal_observation", buffer.observations[step + 1, i])
            np.testing.assert_array_equal(buffer.next_observations[step, i], follows)
            assert buffer.dones[step, i] == ("terminal_observation" in info)
            assert buffer.timeouts[step, i] == info["TimeLimit.truncated"]
            late += info["TimeLimit.truncated"]
    assert 0 < late < buffer.dones.sum()
    assert all(torch.isfinite(p).all() for p in agent.policy.parameters())


class ThreeWays(CartEnv):
    """Pushes left, not or right."""

    def _pre_physics_step(self, actions):
        assert actions.dtype == torch.int64
        self.actions = actions[:, None] - 1.0


def test_discrete_actions():
    env = Sb3VecEnvWrapper(ThreeWays(CartCfg().replace(action_space={3}, compute_final_obs=True)))
    assert env.action_space == spaces.Discrete(3)
    agent = PPO("MlpPolicy", env, n_steps=8, batch_size=16, n_epochs=1, device="cpu", seed=1)
    agent.learn(8 * N)
    assert set(env.unwrapped.actions.unique().tolist()) <= {-1.0, 0.0, 1.0}
    with pytest.raises(ValueError, match="must be None: the actions are Discrete"):
        Sb3VecEnvWrapper(env.env, clip_actions=1.0)
