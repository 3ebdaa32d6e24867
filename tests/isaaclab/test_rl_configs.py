# SPDX-License-Identifier: Apache-2.0
"""Configs of rsl_rl as Isaac Lab 2.3 writes them: the numbers after their translation."""

from typing import Any

import pytest

from stripe_newton.configclass import ConfigError
from stripe_newton.isaaclab.rl_configs import (
    RslRlOnPolicyRunnerCfg,
    RslRlPpoActorCriticCfg,
    RslRlPpoActorCriticRecurrentCfg,
    RslRlPpoAlgorithmCfg,
)
from stripe_newton.rl import RslRlRNNModelCfg

POLICY = {"init_noise_std": 0.7, "actor_hidden_dims": [32, 16], "critic_hidden_dims": [8], "activation": "relu"}


def _run(policy: Any = None, **fields: Any) -> RslRlOnPolicyRunnerCfg:
    return RslRlOnPolicyRunnerCfg(
        **{"num_steps_per_env": 16, "max_iterations": 150, "save_interval": 50, "experiment_name": "cartpole"} | fields,
        policy=policy or RslRlPpoActorCriticCfg(**POLICY),
        algorithm=RslRlPpoAlgorithmCfg(entropy_coef=0.004, learning_rate=2e-3),
    )


def test_one_policy_becomes_an_actor_and_a_critic():
    cfg = _run(clip_actions=5.0, obs_groups={"policy": ["policy"], "critic": ["policy", "extra"]}).to_native()
    cfg.validate()
    assert (cfg.num_steps_per_env, cfg.max_iterations, cfg.save_interval, cfg.clip_actions) == (16, 150, 50, 5.0)
    assert cfg.obs_groups == {"actor": ["policy"], "critic": ["policy", "extra"]}
    assert tuple(cfg.actor.hidden_dims) == (32, 16)
    assert tuple(cfg.critic.hidden_dims) == (8,)
    assert cfg.actor.activation == cfg.critic.activation == "relu"
    assert cfg.actor.distribution_cfg.init_std == 0.7
    assert cfg.critic.distribution_cfg is None
    assert (cfg.algorithm.entropy_coef, cfg.algorithm.learning_rate) == (0.004, 2e-3)


def test_the_critics_groups_are_left_to_the_learner_unless_they_are_named():
    assert _run().to_native().obs_groups == {"actor": ["policy"]}


def test_normalisation_of_either_kind_is_kept():
    cfg = _run(RslRlPpoActorCriticCfg(**POLICY, critic_obs_normalization=True)).to_native()
    assert (cfg.actor.obs_normalization, cfg.critic.obs_normalization) == (False, True)
    cfg = _run(empirical_normalization=True).to_native()
    assert (cfg.actor.obs_normalization, cfg.critic.obs_normalization) == (True, True)


def test_recurrent_networks():
    cfg = _run(RslRlPpoActorCriticRecurrentCfg(**POLICY, rnn_type="gru", rnn_hidden_dim=12, rnn_num_layers=2))
    for network in (cfg.to_native().actor, cfg.to_native().critic):
        assert isinstance(network, RslRlRNNModelCfg)
        assert (network.rnn_type, network.rnn_hidden_dim, network.rnn_num_layers) == ("gru", 12, 2)


def test_what_cannot_be_translated_is_said():
    with pytest.raises(ConfigError, match="logger: is 'neptune'"):
        _run(logger="neptune").to_native()
    with pytest.raises(ConfigError, match=r"policy\.activation: has no value"):
        _run(RslRlPpoActorCriticCfg(init_noise_std=1.0)).to_native()
