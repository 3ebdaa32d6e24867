# SPDX-License-Identifier: Apache-2.0
"""Adapter for Stable-Baselines3: observations, bounds, seeds, attributes, errors."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from gymnasium.vector import VectorWrapper

from stripe_newton.envs import ManagerBasedRLEnv, multi_agent_to_single_agent
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg
from tests.helpers.cart_env import CartCfg, CartEnv
from tests.helpers.learner_examples import TASK, cartpole, cartpole_cfg, one_thread
from tests.helpers.marl_cart import Told, config

pytest.importorskip("stable_baselines3")

from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecCheckNan, VecExtractDictObs, VecFrameStack, VecNormalize

from stripe_newton.rl.wrappers.sb3 import Sb3VecEnvWrapper
from tests.helpers.sb3_cartpole import SHORT, N, push, wrapped


@pytest.fixture(autouse=True)
def threads():
    with one_thread():
        yield


# -- observations


class TwoGroups(CartEnv):
    def _get_observations(self):
        ids = torch.arange(N, dtype=torch.uint8)
        return {"policy": self.joint_pos, "wide": self.joint_vel.double(), "picture": ids[:, None].expand(N, 3)}


TWO_GROUPS = {
    "policy": 2,
    "wide": spaces.Box(-np.inf, np.inf, (2,), np.float64),
    "picture": spaces.Box(0, 255, (3,), np.uint8),
}


def test_several_groups_are_a_dict():
    env = Sb3VecEnvWrapper(
        TwoGroups(CartCfg().replace(observation_space=TWO_GROUPS, compute_final_obs=True)),
        ["picture", "policy", "wide"],
    )
    obs = env.reset()
    assert env.observation_space == spaces.Dict({k: env.env.single_observation_space[k] for k in obs})
    for _ in range(10):
        obs, _, dones, infos = env.step(np.ones((N, 1), dtype=np.float32))
        for name, dtype in (("policy", np.float32), ("wide", np.float64), ("picture", np.uint8)):
            assert obs[name].dtype == dtype
            assert env.observation_space[name].contains(obs[name][2])
        np.testing.assert_array_equal(obs["policy"], env.unwrapped.joint_pos.numpy())
        np.testing.assert_array_equal(obs["wide"], env.unwrapped.joint_vel.double().numpy())
        np.testing.assert_array_equal(obs["picture"], np.arange(N)[:, None] * [1, 1, 1])
    assert dones.all()
    assert env.observation_space.contains(infos[2]["terminal_observation"])
    assert infos[2]["terminal_observation"]["picture"].tolist() == [2, 2, 2]
    PPO("MultiInputPolicy", env, n_steps=8, batch_size=16, n_epochs=1, device="cpu").learn(8 * N)


def test_a_group_of_terms_that_are_not_joined():
    cfg = CartpoleManagerEnvCfg().replace(compute_final_obs=True, episode_length_s=SHORT / 60.0)
    cfg.sim.device, cfg.scene.num_envs = "cpu", N
    cfg.observations.policy.concatenate_terms = False
    env = Sb3VecEnvWrapper(ManagerBasedRLEnv(cfg))
    obs = env.reset()
    assert set(obs) == {"pole_pos", "pole_vel", "cart_pos", "cart_vel"}
    assert env.observation_space.contains({k: v[0] for k, v in obs.items()})
    for step in range(SHORT):
        before = obs
        obs, _, dones, infos = env.step(push(step))
    assert dones.all()
    last = np.stack([info["terminal_observation"]["cart_pos"] for info in infos])
    np.testing.assert_allclose(last, before["cart_pos"] + before["cart_vel"] / 60.0, atol=0.02)
    with pytest.raises(ValueError, match="'policy' is a dict itself"):
        Sb3VecEnvWrapper(env.env, ["policy"])


def test_several_agents_as_one():
    env = Sb3VecEnvWrapper(multi_agent_to_single_agent(Told(config(compute_final_obs=True))))
    assert (env.observation_space.shape, env.action_space.shape) == ((10,), (2,))
    env.reset()
    env.unwrapped.told["late"]["cart"][1] = env.unwrapped.told["late"]["pendulum"][1] = True
    _, _, dones, infos = env.step(np.zeros((N, 2), dtype=np.float32))
    assert dones.tolist() == [False, True, False, False]
    assert infos[1]["TimeLimit.truncated"]
    assert infos[1]["terminal_observation"].shape == (10,)
    both = Sb3VecEnvWrapper(env.env, ["policy", "critic"])
    env.unwrapped.told["late"]["cart"][1] = env.unwrapped.told["late"]["pendulum"][1] = True
    with pytest.raises(RuntimeError, match="'critic'"):
        both.step(np.zeros((N, 2), dtype=np.float32))


def test_other_wrappers_of_the_library():
    inner = wrapped(obs_group=["policy"])
    env = VecNormalize(VecCheckNan(VecFrameStack(VecExtractDictObs(inner, "policy"), 3), raise_exception=True))
    obs = env.reset()
    for step in range(SHORT):
        obs, _, dones, infos = env.step(push(step))
    assert obs.shape == (N, 12)
    assert dones.all()
    assert all(info["terminal_observation"].shape == (12,) for info in infos)
    assert np.abs(obs).max() <= env.clip_obs
    with pytest.raises(ValueError, match="not finite"):
        inner.step(np.full((N, 1), np.nan, dtype=np.float32))


def test_no_warning_of_evaluate_policy(recwarn):
    env = wrapped()
    agent = PPO("MlpPolicy", env, device="cpu", n_steps=8, batch_size=8)
    returns, lengths = evaluate_policy(agent, env, n_eval_episodes=5, return_episode_rewards=True)
    assert lengths == [SHORT] * 5
    assert all(0.0 < r < SHORT for r in returns)
    assert not [w for w in recwarn if "Monitor" in str(w.message)]


# -- actions, seeds, attributes


@pytest.mark.parametrize(
    ("space", "clip", "bounds"),
    [
        (1, None, (-100.0, 100.0)),
        (1, 2.5, (-2.5, 2.5)),
        (spaces.Box(-1.0, np.inf, (1,)), None, (-1.0, 100.0)),
        (spaces.Box(-1.0, 3.0, (1,)), None, (-1.0, 3.0)),
        (spaces.Box(-1.0, 3.0, (1,)), 2.0, (-1.0, 2.0)),
    ],
)
def test_bounds_of_the_actions(space, clip, bounds):
    env = wrapped(clip_actions=clip, action_space=space)
    assert (env.action_space.low.item(), env.action_space.high.item()) == bounds
    env.reset()
    for sign, bound in zip((-1.0, 1.0), bounds, strict=True):
        env.step(np.full((N, 1), sign * 1e3, dtype=np.float32))
        assert env.unwrapped.actions.unique().tolist() == [100.0 * bound]  # the task's scale


def test_seeds_and_options():
    env, twin = wrapped(), cartpole()
    expected = twin.reset(seed=5)[0]["policy"].numpy()
    assert env.seed(5)[0] == 5
    np.testing.assert_array_equal(env.reset(), expected)
    assert (env.reset() != expected)[:, 0].all()
    env.step(push(0))
    env.set_options({"reset_mask": torch.tensor([False, True, False, False])})
    env.reset()
    assert env.unwrapped.episode_length_buf.tolist() == [1, 0, 1, 1]
    for step in range(SHORT - 1):
        *_, dones, infos = env.step(push(step))
    assert dones.tolist() == [True, False, True, True]
    assert infos[0]["episode"]["l"] == SHORT
    *_, infos = env.step(push(0))
    assert infos[1]["episode"]["l"] == SHORT
    env.reset()  # of all again
    assert env.unwrapped.episode_length_buf.tolist() == [0] * N
    with pytest.raises(ValueError, match="one dict"):
        env.set_options([{}] * N)


def test_attributes_and_methods():
    env = Sb3VecEnvWrapper(VectorWrapper(wrapped().env))
    env.reset()
    env.set_attr("episode_length_buf", [7, 8], indices=[1, 3])
    assert env.unwrapped.episode_length_buf.tolist() == [0, 7, 0, 8]
    assert env.get_attr("episode_length_buf", [3, 0]) == [8, 0]
    assert env.get_attr("step_dt") == [pytest.approx(1.0 / 60.0)] * N
    assert env.has_attr("cfg")
    assert not env.has_attr("no_such_thing")
    env.set_attr("note", "all")
    assert env.get_attr("note", 2) == ["all"]
    with pytest.raises(ValueError, match=r"'note' is shared by all environments, cannot be set for \[0\] alone"):
        env.set_attr("note", "one", 0)
    assert env.env_method("seed", 4, indices=[0, 1]) == [4, 4]
    assert env.env_is_wrapped(VectorWrapper) == [True] * N
    assert env.env_is_wrapped(gymnasium.Wrapper, [0]) == [False]
    assert env.env_is_wrapped(Monitor, [0, 1]) == [True, True]  # as what it adds to infos is there
    env.step(push(0))
    assert env.get_attr("extras", 0)[0]["log"] is env.unwrapped.extras["log"]
    assert (env.render_mode, env.metadata["render_fps"]) == (None, 60)


def test_a_picture():
    cfg = cartpole_cfg(compute_final_obs=True)
    cfg.viewer.resolution = (64, 48)
    env = Sb3VecEnvWrapper(gymnasium.make_vec(TASK, cfg=cfg, render_mode="rgb_array"))
    env.reset()
    picture = env.render()
    assert (picture.shape, picture.dtype) == ((48, 64, 3), np.uint8)
    assert picture.std() > 0
    env.close()


def test_what_cannot_be_wrapped_is_refused():
    with pytest.raises(ValueError, match="compute_final_obs is False, must be True"):
        Sb3VecEnvWrapper(cartpole())
    with pytest.raises(ValueError, match="obs_group is 'pixels', must be of the groups policy"):
        wrapped(obs_group="pixels")
    with pytest.raises(ValueError, match=r"obs_group is \[\]"):
        wrapped(obs_group=[])
    with pytest.raises(ValueError, match=r"clip_actions is -1\.0, must be a finite number above 0"):
        wrapped(clip_actions=-1.0)
    with pytest.raises(ValueError, match=r"Told has several agents; wrap multi_agent_to_single_agent\(env\)"):
        Sb3VecEnvWrapper(Told(config(compute_final_obs=True)))
