# SPDX-License-Identifier: Apache-2.0
"""Multi-agent environments: inputs and outputs of a step, and errors."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.noise import ConstantNoiseCfg, NoiseModelCfg
from stripe_tasks.cart_double_pole.multi_agent import CartDoublePoleMARLEnv
from tests.helpers.marl_cart import AGENTS, N, Told, actions, config


@pytest.fixture(scope="module")
def shared():
    return Told(config(compute_final_obs=True))


@pytest.fixture
def env(shared):
    shared.reset(seed=3)
    shared.episode_length_buf = torch.zeros(N)
    return shared


# -- the parallel convention


def test_surface(env):
    assert env.agents == env.possible_agents == AGENTS
    assert (env.num_agents, env.max_num_agents, env.num_envs) == (2, 2, N)
    for agent in AGENTS:
        assert env.observation_space(agent).shape == (5,)
        assert env.action_space(agent).shape == (1,)
    assert env.state_space.shape == (10,)
    for name in ("reset", "step", "state", "render", "close"):
        assert callable(getattr(env, name))
    assert "_get_rewards" in env.describe()


def test_values_of_a_step(env):
    obs, infos = env.reset()
    assert list(obs) == AGENTS
    assert set(infos) == {*AGENTS, "log"}
    kept = [value.clone() for value in obs.values()]
    state = env.state()
    values = env.step(actions(env))
    for by_agent, dtype, shape in zip(
        values[:4], (torch.float32, torch.float32, torch.bool, torch.bool), ((N, 5), (N,), (N,), (N,)), strict=True
    ):
        assert list(by_agent) == AGENTS
        assert all((v.dtype, tuple(v.shape)) == (dtype, shape) for v in by_agent.values())
    assert all(torch.equal(old, value) for old, value in zip(kept, obs.values(), strict=True))  # nobody writes into it
    assert not torch.equal(obs["cart"], values[0]["cart"])
    assert torch.equal(env.state(), torch.cat([values[0][a] for a in AGENTS], -1))
    assert not torch.equal(env.state(), state)
    assert torch.equal(env.reward_buf, values[1]["cart"] + values[1]["pendulum"])
    assert env.episode_length_buf.tolist() == [1] * N


def test_the_order_in_which_agents_are_given_does_not_matter(env):
    given, start = actions(env), env.get_state()
    one = env.step(given)[0]
    env.set_state(start)
    other = env.step(dict(reversed(given.items())))[0]
    for agent in AGENTS:
        assert torch.equal(one[agent], other[agent])


def test_random_actions_stay_finite(env):
    ends = 0
    for step in range(100):
        obs, rewards, terminated, truncated, _ = env.step(actions(env, step, 3.0))
        for agent in AGENTS:
            assert torch.isfinite(obs[agent]).all()
            assert torch.isfinite(rewards[agent]).all()
        ends += int((terminated["cart"] | truncated["cart"]).sum())
    assert ends > 0


def test_episodes_end_when_all_agents_are_done(env):
    end, late = env.told["end"], env.told["late"]
    end["cart"][[0, 1, 3]] = True
    end["pendulum"][[1, 2]] = True
    late["pendulum"][3] = True
    _, _, terminated, truncated, infos = env.step(actions(env))
    assert terminated["cart"].tolist() == [True, True, False, True]
    assert terminated["pendulum"].tolist() == [False, True, True, False]
    assert truncated["pendulum"].tolist() == [False, False, False, True]
    assert env.reset_buf.tolist() == [False, True, False, True]
    assert env.reset_terminated.tolist() == [False, True, False, False]
    assert env.reset_time_outs.tolist() == [False, False, False, True]
    assert env.episode_length_buf.tolist() == [1, 0, 1, 0]
    for agent in AGENTS:
        assert infos[agent]["_final_obs"].tolist() == [False, True, False, True]
        same = (infos[agent]["final_obs"] == env.obs_dict[agent]).all(-1)
        assert same.tolist() == [True, False, True, False]
    assert "final_obs" not in env.step(actions(env))[-1]["cart"]


def test_a_broken_world_ends_for_all_agents_and_harms_no_other(env):
    env.robot.data.joint_pos[2, 0] = float("nan")
    obs, rewards, terminated, _, _ = env.step(actions(env))
    for agent in AGENTS:
        assert terminated[agent].tolist() == [False, False, True, False]
        assert rewards[agent][2] == 0.0
        assert torch.isfinite(obs[agent]).all()
    assert env.episode_length_buf.tolist() == [1, 1, 0, 1]


def test_state_goes_on_where_it_stopped(env):
    env.step(actions(env))
    state, generator = env.get_state(), torch.get_rng_state()
    assert ("efforts", "cart") in state["by_agent"]
    expected = [env.step(actions(env, k))[0] for k in range(3)]
    other = Told(config(compute_final_obs=True))
    other.set_state(state)
    torch.set_rng_state(generator)
    for k, values in enumerate(expected):
        got = other.step(actions(env, k))[0]
        assert all(torch.equal(got[a], values[a]) for a in AGENTS)


def test_noise_is_of_the_agents_that_ask_for_it(env):
    noise = NoiseModelCfg(noise_cfg=ConstantNoiseCfg(bias=2.0, operation="add"))
    noisy = Told(config(observation_noise_model={"pendulum": noise}, action_noise_model={"cart": noise}))
    noisy.set_state(env.get_state())
    given = {a: torch.full((N, 1), -1.5) for a in AGENTS}
    obs, other = noisy.step(given)[0], env.step({"cart": given["cart"] + 2.0, "pendulum": given["pendulum"]})[0]
    assert torch.equal(obs["cart"], other["cart"])
    assert torch.equal(obs["pendulum"], other["pendulum"] + 2.0)


# -- mistakes


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"pendulum": None}, "exactly cart, pendulum"),
        ({"arm": torch.zeros(N, 1)}, "exactly cart, pendulum"),
        ({"cart": torch.zeros(N, 2)}, r"'cart' have shape \(4, 2\), expected \(4, 1\)"),
        ({"cart": torch.full((N, 1), float("nan"))}, "'cart' are not finite"),
    ],
)
def test_wrong_actions_are_refused(env, changed, message):
    given = {a: v for a, v in (actions(env) | changed).items() if v is not None}
    with pytest.raises(ValueError, match=message):
        env.step(given)


def test_actions_that_are_not_finite_can_be_clamped():
    env = Told(config(nonfinite_actions="clamp"))
    env.reset()
    obs = env.step({"cart": torch.full((N, 1), float("nan")), "pendulum": torch.zeros(N, 1)})[0]
    assert torch.isfinite(obs["cart"]).all()
    assert env.efforts["cart"].tolist() == [[0.0]] * N


def test_all_problems_of_a_config_are_told_at_once():
    cfg = config(
        observation_spaces={"cart": 5}, action_spaces={"cart": 1, "pendulum": "one"}, state_space=-2,
        apply_action="often", observation_noise_model={"arm": None},
    )  # fmt: skip
    with pytest.raises(ConfigError) as error:
        cfg.validate()
    for path in ("observation_spaces", "action_spaces['pendulum']", "state_space", "apply_action", "observation_noise"):
        assert path in str(error.value), path
    with pytest.raises(ConfigError, match="possible_agents"):
        config(possible_agents=["cart", "cart"]).validate()


def test_hooks_that_return_something_else_are_told():
    class Short(CartDoublePoleMARLEnv):
        def _get_rewards(self):
            return {"cart": torch.zeros(self.num_envs)}

    env = Short(config(observation_spaces={"cart": 5, "pendulum": 4}, state_space=3))
    with pytest.raises(ConfigError, match=r"observation_spaces\['pendulum'\]: asks for shape \(4, 4\)"):
        env.reset()
    env = Short(config(state_space=3))
    with pytest.raises(ConfigError, match=r"state_space: asks for shape .* _get_states returned None"):
        env.reset()
    env = Short(config())
    env.reset()
    with pytest.raises(ValueError, match="_get_rewards: has cart, must be a dict of exactly cart, pendulum"):
        env.step(actions(env))
