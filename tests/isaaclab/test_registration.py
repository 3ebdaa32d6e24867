# SPDX-License-Identifier: Apache-2.0
"""Tasks that are registered as Isaac Lab does: adopted with their configs, the agent's translated."""

import sys
import types
from collections.abc import Iterator

import gymnasium
import pytest

from stripe_newton.cli.tasks import load_cfg, task_ids
from stripe_newton.isaaclab.registration import adopt_tasks
from stripe_newton.isaaclab.rl_configs import RslRlOnPolicyRunnerCfg, RslRlPpoActorCriticCfg, RslRlPpoAlgorithmCfg
from stripe_newton.rl import RslRlOnPolicyRunnerCfg as NativeRunnerCfg

TASK = "Isaac-Adopted-Test-v0"


def _agent() -> RslRlOnPolicyRunnerCfg:
    policy = RslRlPpoActorCriticCfg(init_noise_std=0.5, actor_hidden_dims=[4], critic_hidden_dims=[4], activation="elu")
    return RslRlOnPolicyRunnerCfg(
        num_steps_per_env=8,
        max_iterations=2,
        save_interval=1,
        experiment_name="adopted",
        policy=policy,
        algorithm=RslRlPpoAlgorithmCfg(),
    )


@pytest.fixture
def registered() -> Iterator[None]:
    module = types.ModuleType("adopted_test_task")
    module.Agent, module.EnvCfg = _agent, dict  # type: ignore[attr-defined]
    module.Env = lambda cfg, render_mode=None: (cfg, render_mode)  # type: ignore[attr-defined]
    sys.modules[module.__name__] = module
    gymnasium.register(
        id=TASK,
        entry_point="adopted_test_task:Env",
        kwargs={
            "env_cfg_entry_point": "adopted_test_task:EnvCfg",
            "rsl_rl_cfg_entry_point": "adopted_test_task:Agent",
            "skrl_cfg_entry_point": "adopted_test_task:skrl.yaml",
        },
    )
    yield
    del gymnasium.registry[TASK], sys.modules[module.__name__]


def test_tasks_are_adopted_once_with_their_configs(registered):
    assert adopt_tasks() == [TASK]
    assert adopt_tasks() == []
    assert TASK in task_ids()
    agent = load_cfg(TASK, "agent")
    assert isinstance(agent, NativeRunnerCfg)
    assert agent.num_steps_per_env == 8
    assert agent.actor.distribution_cfg.init_std == 0.5


def test_the_environment_is_made_without_configs_of_other_learners(registered):
    adopt_tasks()
    spec = gymnasium.spec(TASK)
    assert spec.vector_entry_point(**spec.kwargs, render_mode="rgb_array") == ({}, "rgb_array")
