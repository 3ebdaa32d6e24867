# SPDX-License-Identifier: Apache-2.0
"""DirectRLEnv under gymnasium's wrappers and under rsl_rl's."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.wrappers.vector import ClipAction, DictInfoToList, RecordEpisodeStatistics, RescaleAction

import stripe_tasks  # noqa: F401
from stripe_newton.rl.wrappers.rsl_rl import RslRlVecEnvWrapper
from stripe_tasks.cartpole import CartpoleEnvCfg

N = 4
TASK = "Stripe-Cartpole-Direct-v0"


# -- gymnasium and rsl_rl


def cartpole_cfg(**changes) -> CartpoleEnvCfg:
    cfg = CartpoleEnvCfg().replace(episode_length_s=0.2, **changes)
    cfg.sim.device, cfg.scene.num_envs = "cpu", N
    return cfg


def test_make_says_that_environments_are_vectors():
    with pytest.raises(
        gymnasium.error.Error, match=rf"'{TASK}' is always a vector .* call gymnasium.make_vec\('{TASK}'"
    ):
        gymnasium.make(TASK)


def test_make_vec():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stripe_newton.sim.simulation_parts.resolve_device", lambda name: "cpu")
        env = gymnasium.make_vec(TASK, num_envs=3)
        assert (env.num_envs, env.device, env.spec.id) == (3, "cpu", TASK)
        obs, _ = env.reset(seed=1)
        assert obs["policy"].shape == (3, 4)
        env.close()
    cfg = cartpole_cfg()
    assert gymnasium.make_vec(TASK, cfg=cfg).num_envs == N
    assert gymnasium.make_vec(TASK, cfg=cfg, num_envs=2).num_envs == 2
    assert cfg.scene.num_envs == N
    assert gymnasium.make_vec(TASK, cfg=cfg, render_mode="rgb_array").render_mode == "rgb_array"
    with pytest.raises(TypeError, match="unexpected arguments: speed"):
        gymnasium.make_vec(TASK, cfg=cfg, speed=1)


def numpy_env(**changes):
    from gymnasium.wrappers.vector.array_conversion import ArrayConversion

    return ArrayConversion(gymnasium.make_vec(TASK, cfg=cartpole_cfg(**changes)), env_xp=torch, target_xp=np)


def test_episode_statistics_of_gymnasium():
    env = RecordEpisodeStatistics(numpy_env())
    obs, _ = env.reset(seed=1)
    assert isinstance(obs["policy"], np.ndarray)
    returns = np.zeros(N)
    for _ in range(12):
        obs, reward, terminated, truncated, info = env.step(np.zeros((N, 1), dtype=np.float32))
        assert isinstance(reward, np.ndarray)
        assert terminated.dtype == truncated.dtype == np.bool_
        returns += reward
    assert truncated.all()
    assert env.episode_count == N
    assert list(env.length_queue) == [12] * N
    np.testing.assert_allclose(sorted(env.return_queue), sorted(returns), rtol=1e-5)
    assert info["_episode"].all()


def test_other_wrappers_of_gymnasium():
    box = gymnasium.spaces.Box(-1.0, 1.0, (1,))
    env = ClipAction(
        RescaleAction(
            numpy_env(compute_final_obs=True, action_space=box),
            np.full(1, -2.0, np.float32),
            np.full(1, 2.0, np.float32),
        )
    )
    env.reset(seed=1)
    for _ in range(12):
        obs, *_, info = env.step(np.full((N, 1), 9.0, dtype=np.float32))
    assert obs["policy"].shape == (N, 4)
    assert info["final_obs"]["policy"].shape == (N, 4)


def test_numpy_to_torch_wrapper_of_gymnasium():
    from gymnasium.wrappers.vector.numpy_to_torch import NumpyToTorch

    env = NumpyToTorch(numpy_env())
    obs, _ = env.reset(seed=1)
    assert isinstance(obs["policy"], torch.Tensor)
    obs, reward, *_ = env.step(torch.zeros(N, 1))
    assert isinstance(reward, torch.Tensor)


def test_the_rsl_rl_wrapper():
    env = gymnasium.make_vec(TASK, cfg=cartpole_cfg())
    wrapped = RslRlVecEnvWrapper(env, clip_actions=1.0)
    assert (wrapped.num_envs, wrapped.num_actions, wrapped.max_episode_length) == (N, 1, 12)
    obs = wrapped.get_observations()
    assert obs["policy"].shape == (N, 4)
    wrapped.episode_length_buf = torch.tensor([11, 0, 0, 0])
    obs, _, dones, extras = wrapped.step(torch.full((N, 1), 50.0))
    assert dones.tolist() == [1, 0, 0, 0]
    assert extras["time_outs"].tolist() == [True, False, False, False]
    assert env.actions.abs().max() == 100.0
    state = wrapped.get_state()
    with torch.inference_mode():
        expected = [wrapped.step(torch.zeros(N, 1))[0]["policy"] for _ in range(3)]
        wrapped.set_state(state)
        got = [wrapped.step(torch.zeros(N, 1))[0]["policy"] for _ in range(3)]
    assert all(torch.equal(a, b) for a, b in zip(expected, got, strict=True))
    env.reset()


# -- a GPU


@pytest.mark.gpu
def test_a_step_on_the_gpu_is_one_graph_and_equals_eager_stepping():
    def run(graph: bool):
        cfg = cartpole_cfg(apply_action="step")
        cfg.sim.device, cfg.sim.use_cuda_graph = "cuda:0", graph
        env = gymnasium.make_vec(TASK, cfg=cfg)
        env.reset(seed=1)
        out = [env.step(torch.full((N, 1), 0.1 * k, device="cuda:0"))[0]["policy"] for k in range(30)]
        return env, torch.stack(out)

    (env, one), (_, two), (_, three) = run(True), run(False), run(True)
    assert list(env.sim._graphs) == [2]
    assert torch.equal(one, two)
    assert torch.equal(one, three)  # and a second environment on the same GPU


def test_info_as_a_list():
    env = DictInfoToList(numpy_env())
    env.reset(seed=1)
    try:
        *_, infos = env.step(np.zeros((N, 1), dtype=np.float32))
    finally:
        env.close()
    assert len(infos) == N
