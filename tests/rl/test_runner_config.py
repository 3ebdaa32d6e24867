# SPDX-License-Identifier: Apache-2.0
"""Runner configs: defaults, and all problems at once."""

from __future__ import annotations

import subprocess
import sys

import pytest

from stripe_newton.configclass import ConfigError
from stripe_newton.rl import (
    OnPolicyRunner,
    RslRlOnPolicyRunnerCfg,
)
from tests.helpers.checkout import ROOT
from tests.helpers.fake_env import FakeCartRunnerCfg
from tests.helpers.fake_runner import make_env


def test_default_config_is_what_rsl_rl_takes():
    agent = RslRlOnPolicyRunnerCfg()
    agent.validate()
    runner = OnPolicyRunner(make_env(), agent)
    assert [layer.out_features for layer in runner.alg.actor.mlp if hasattr(layer, "out_features")] == [256, 128, 64, 1]
    assert runner.alg.learning_rate == agent.algorithm.learning_rate


def test_all_problems_of_a_config_at_once():
    agent = RslRlOnPolicyRunnerCfg(max_iterations=0)
    agent.algorithm.gamma = 1.5
    agent.algorithm.schedule = "cosine"
    agent.actor.activation = "relux"
    agent.actor.distribution_cfg.init_std = float("nan")
    agent.critic.hidden_dims = (8, 0)
    with pytest.raises(ConfigError) as caught:
        agent.validate()
    paths = {problem.split(":")[0] for problem in caught.value.problems}
    assert paths == {
        "max_iterations",
        "algorithm.gamma",
        "algorithm.schedule",
        "actor.activation",
        "actor.distribution_cfg.init_std",
        "critic.hidden_dims",
    }


def test_an_adaptive_rate_begins_within_its_bound():
    agent = RslRlOnPolicyRunnerCfg()
    agent.algorithm.learning_rate, agent.algorithm.max_learning_rate = 5.0e-3, 1.0e-3
    with pytest.raises(ConfigError, match=r"learning_rate: is 0\.005, above max_learning_rate, 0\.001"):
        agent.validate()
    agent.algorithm.schedule = "fixed"
    agent.validate()


def test_problems_beside_an_environment():
    agent = FakeCartRunnerCfg(num_steps_per_env=1)
    agent.obs_groups = {"actor": ["policy", "camera"], "critic": ["policy"]}
    agent.algorithm.num_mini_batches = 9
    with pytest.raises(ConfigError) as caught:
        OnPolicyRunner(make_env(), agent)
    message = "obs_groups.actor: 'camera' is not an observation group; the environment has policy, critic"
    assert message in str(caught.value)
    assert "algorithm.num_mini_batches: is 9, but there are 8 samples" in str(caught.value)


def test_configs_import_no_torch():
    code = "import stripe_newton.rl, sys; assert not {'torch', 'rsl_rl', 'warp'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
