# SPDX-License-Identifier: Apache-2.0
"""Training with skrl through its wrapper for Isaac Lab's interface."""

from __future__ import annotations

import gymnasium
import pytest
import torch

from stripe_newton.envs import multi_agent_to_single_agent
from tests.helpers.learner_examples import cartpole, mean_return, one_thread, random_return, run_example
from tests.helpers.marl_cart import Told, config

pytest.importorskip("skrl")

from skrl.agents.torch.ppo import PPO, PPO_CFG
from skrl.envs.wrappers.torch import wrap_env
from skrl.envs.wrappers.torch.isaaclab_envs import IsaacLabMultiAgentWrapper, IsaacLabWrapper
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer, SequentialTrainerCfg
from skrl.utils import set_seed
from skrl.utils.runner.torch import Runner

from stripe_newton.rl.wrappers.skrl import SkrlVecEnvWrapper, use_final_observations

GAMMA = 0.9
QUIET = {"headless": True, "disable_progressbar": True, "close_environment_at_exit": False}


@pytest.fixture(autouse=True)
def threads():
    with one_thread():
        yield


def mean_action(agent):
    """Actions of the agent without noise, for observations."""

    def act(obs):
        return agent.act(obs, None, timestep=0, timesteps=0)[1]["mean_actions"]

    return act


def test_the_example_learns():
    agent = run_example("skrl")["runner"].agent
    before = random_return()
    assert before < 30.0
    assert mean_return(mean_action(agent)) > before + 80.0


# -- the wrapper


def test_it_is_the_wrapper_that_skrl_has():
    env = cartpole()
    set_seed(3)
    wrapped = SkrlVecEnvWrapper(env)
    assert type(wrapped) is IsaacLabWrapper
    assert (wrapped.num_envs, wrapped.num_agents, str(wrapped.device)) == (4, 1, "cpu")
    assert wrapped.observation_space == env.single_observation_space["policy"]
    assert wrapped.action_space == env.single_action_space
    assert wrapped.state_space is None
    obs, _ = wrapped.reset()
    again, _ = wrap_env(env, wrapper="isaaclab-single-agent", verbose=False).reset()
    assert torch.equal(obs, again)
    assert torch.equal(obs, env.reset(seed=3)[0]["policy"])
    values = wrapped.step(torch.zeros(4, 1))
    assert [tuple(v.shape) for v in values[:4]] == [(4, 4), (4, 1), (4, 1), (4, 1)]
    with pytest.raises(ValueError, match="Unknown wrapper type"):
        wrap_env(env, verbose=False)  # "auto": why there is something to say which


def test_the_critic_group_is_the_state():
    single = multi_agent_to_single_agent(Told(config()))
    wrapped = SkrlVecEnvWrapper(single)
    assert type(wrapped) is IsaacLabWrapper
    assert wrapped.state_space.shape == (10,)
    obs, _ = wrapped.reset()
    assert torch.equal(wrapped.state(), obs)
    obs, *_ = wrapped.step(torch.zeros(4, 2))
    assert torch.equal(wrapped.state(), obs)


def test_what_does_not_fit_is_refused():
    env = cartpole()
    with pytest.raises(ValueError, match="'isaaclab' or 'isaaclab-single-agent' for CartpoleEnv"):
        SkrlVecEnvWrapper(env, wrapper="isaaclab-multi-agent")
    with pytest.raises(ValueError, match="ml_framework is 'jax'"):
        SkrlVecEnvWrapper(env, ml_framework="jax")


# -- the end of an episode


class Policy(GaussianMixin, Model):
    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.layer, self.log_std = torch.nn.Linear(4, 1), torch.nn.Parameter(torch.zeros(1))

    def compute(self, inputs, role):
        return self.layer(inputs["observations"]), {"log_std": self.log_std}


class SumOfObservations(DeterministicMixin, Model):
    """A value that can be worked out by hand."""

    def __init__(self, **spaces):
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.one = torch.nn.Parameter(torch.ones(1))

    def compute(self, inputs, role):
        return self.one * inputs["observations"].sum(dim=-1, keepdim=True), {}


@pytest.mark.parametrize("final", [True, False])
def test_a_time_out_is_worth_what_the_last_observation_is(final):
    """Against an environment that is stepped by hand; without the adapter it is worth what the next episode is."""
    set_seed(7)
    changes = {"episode_length_s": 0.2, "max_cart_pos": 0.5, "initial_pole_angle": 0.0, "compute_final_obs": True}
    env, twin = SkrlVecEnvWrapper(cartpole(**changes)), cartpole(**changes)  # which draw nothing when they are reset
    spaces = {"observation_space": env.observation_space, "action_space": env.action_space, "device": env.device}
    memory = RandomMemory(memory_size=26, num_envs=4, device=env.device)
    cfg = PPO_CFG(
        rollouts=99,
        discount_factor=GAMMA,
        time_limit_bootstrap=True,
        experiment={"write_interval": 0, "checkpoint_interval": 0},
    )
    models = {"policy": Policy(**spaces), "value": SumOfObservations(**spaces)}
    agent = PPO(models=models, memory=memory, cfg=cfg, **spaces)
    if final:
        use_final_observations(agent)
    trainer = SequentialTrainerCfg(timesteps=26, **QUIET)
    SequentialTrainer(env=env, agents=agent, cfg=trainer).train()

    twin.reset(seed=7)
    ends = [0, 0]
    for step, actions in enumerate(memory.get_tensor_by_name("actions")):
        groups, reward, terminated, truncated, extras = twin.step(actions)
        last = extras["final_obs"]["policy"] if final and "final_obs" in extras else groups["policy"]
        expected = reward + GAMMA * last.sum(dim=-1) * truncated
        torch.testing.assert_close(memory.get_tensor_by_name("rewards")[step][:, 0], expected)
        ends[0] += int(terminated.sum())
        ends[1] += int(truncated.sum())
    assert min(ends) > 0


def test_final_observations_are_for_one_agent():
    class Several:
        possible_agents = ("a", "b")

    with pytest.raises(ValueError, match=r"Several is one of skrl\.multi_agents"):
        use_final_observations(Several())


# -- several agents


def test_several_agents_learn():
    env = SkrlVecEnvWrapper(gymnasium.make_vec("Stripe-CartDoublePole-MARL-Direct-v0", cfg=config(64)))
    assert type(env) is IsaacLabMultiAgentWrapper
    network = {"name": "net", "layers": [32, 32], "activations": "elu"}
    policy = {"class": "GaussianMixin", "network": [network | {"input": "OBSERVATIONS"}], "output": "ACTIONS"}
    value = {"class": "DeterministicMixin", "network": [network | {"input": "STATES"}], "output": "ONE"}
    agent = {
        "class": "MAPPO",
        "rollouts": 32,
        "mini_batches": 4,
        "learning_rate": 2e-3,
        "learning_rate_scheduler": "KLAdaptiveLR",
        "learning_rate_scheduler_kwargs": {"kl_threshold": 0.016},
        "discount_factor": 0.98,
        "value_clip": 0.0,
        "experiment": {"write_interval": 0, "checkpoint_interval": 0},
    }
    cfg = {
        "seed": 1,
        "models": {"separate": True, "policy": policy, "value": value},
        "memory": {"class": "RandomMemory", "memory_size": -1},
        "agent": agent,
        "trainer": {"class": "SequentialTrainer", "timesteps": 8 * 32, "environment_info": "log"} | QUIET,
    }

    def alive() -> float:
        """Mean of the first 100 steps that no pole has fallen in."""
        obs, _ = env.unwrapped.reset(seed=5)
        up, count = torch.ones(64, dtype=torch.bool), torch.zeros(64)
        with torch.no_grad():
            for _ in range(100):
                policies = {a: runner.agent.models[a]["policy"] for a in obs}
                actions = {a: policies[a].compute({"observations": obs[a]}, "policy")[0] for a in obs}
                obs, *_ = env.unwrapped.step(actions)
                up &= ~env.unwrapped.reset_buf
                count += up
        return float(count.mean())

    runner = Runner(env, cfg)
    before = alive()
    runner.run("train")
    assert before < 50.0
    assert alive() > before + 35.0
