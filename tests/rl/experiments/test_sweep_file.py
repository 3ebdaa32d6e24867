# SPDX-License-Identifier: Apache-2.0
"""Sweep files: search spaces and settings, and what is said of bad ones."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("optuna")

from stripe_newton.cli.run_configs import Configs
from stripe_newton.cli.sweep_file import read_sweep_file
from stripe_newton.cli.user_error import UserError
from stripe_newton.rl.experiments.sweep_cfg import MedianPruning, Space, SweepCfg, words_of
from tests.helpers.fake_env import TASK, FakeCartCfg, FakeCartRunnerCfg
from tests.helpers.sweeps import GAMMA, LAM


def configs() -> Configs:
    env = FakeCartCfg()
    env.sim.device = "cpu"
    return Configs(env, FakeCartRunnerCfg())


def read(text: str) -> SweepCfg:
    path = Path("my.yaml")
    path.write_text(text, encoding="utf-8")
    return read_sweep_file(path, TASK, configs())[0]


def wrong(text: str) -> str:
    with pytest.raises(UserError) as caught:
        read(text)
    assert str(caught.value).startswith(("my.yaml: ", "--sweep my.yaml"))
    return str(caught.value)


def test_a_file_says_what_is_tried():
    cfg = read(
        """
        agent.algorithm.learning-rate: [1e-4, 1e-3, 0.01]
        --agent.algorithm.gamma: {low: 0.9, high: 0.999}
        agent.algorithm.entropy_coef: {low: 1e-4, high: 1e-2, log: true}
        agent.algorithm.num-learning-epochs: {low: 2, high: 8, step: 2}
        agent.actor.hidden-dims: [[32, 32], [64]]
        agent.algorithm.schedule: {choices: [fixed, adaptive]}
        env.push: -2 2
        seeds: [1, 2, 3]
        trials: 20
        max-iterations: 30
        num_envs: 8
        objective: Train/mean_episode_length
        last: 5
        maximize: false
        pruner: {startup-trials: 3, warmup_iterations: 7}
        """
    )
    assert cfg.spaces == {
        "agent.algorithm.learning-rate": Space(choices=(1e-4, 1e-3, 0.01)),
        "agent.algorithm.gamma": Space(low=0.9, high=0.999),
        "agent.algorithm.entropy-coef": Space(low=1e-4, high=1e-2, log=True),
        "agent.algorithm.num-learning-epochs": Space(low=2, high=8, step=2, integer=True),
        "agent.actor.hidden-dims": Space(choices=("32 32", "64")),
        "agent.algorithm.schedule": Space(choices=("fixed", "adaptive")),
        "env.push": Space(choices=("-2 2",)),
    }
    assert (cfg.seeds, cfg.trials, cfg.sampler, cfg.max_iterations, cfg.num_envs) == ((1, 2, 3), 20, "tpe", 30, 8)
    assert (cfg.objective, cfg.last, cfg.maximize) == ("Train/mean_episode_length", 5, False)
    assert cfg.pruner == MedianPruning(3, 7, 1)


def test_what_a_file_leaves_out():
    cfg = read(f"{GAMMA}: [0.9, 0.99]\n{LAM}: [0.9, 0.95, 1.0]")
    assert (cfg.sampler, cfg.trials, cfg.seeds) == ("grid", 6, (FakeCartRunnerCfg().seed,))
    assert (cfg.objective, cfg.maximize, cfg.pruner) == ("Train/mean_reward", True, None)
    assert cfg.max_iterations == FakeCartRunnerCfg().max_iterations
    assert read("seeds: [1, 2, 3, 4]").trials == 1


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("agent.algorithm.lerning-rate: [1e-3]", ["agent.algorithm.lerning-rate", "no such field", "learning-rate"]),
        ("agent.algorithm: [1]", ["agent.algorithm: is a group of fields", "agent.algorithm.gamma"]),
        ("agent.algorithm.gamma: [high]", ["agent.algorithm.gamma: 'high' does not fit", "0.99", "float"]),
        ("agent.algorithm.num-learning-epochs: [1.5]", ["num-learning-epochs: 1.5 does not fit", "int"]),
        (
            "agent.algorithm.gamma: [0.9, 1.5]",
            ["agent.algorithm.gamma: 1.5 is rejected", "must be a number from 0 to 1"],
        ),
        ("env.limit: [-1.0]", ["env.limit: -1.0 is rejected", "must be above 0"]),
        ("agent.algorithm.gamma: []", ["agent.algorithm.gamma: has no values", "give a list"]),
        ("agent.algorithm.gamma: [0.9, 0.9]", ["agent.algorithm.gamma: has values twice"]),
        ("agent.algorithm.gamma: {low: 0.9, high: 0.9}\ntrials: 2", ["gamma: the range from 0.9 to 0.9 is empty"]),
        ("agent.algorithm.gamma: {low: 0.0, high: 0.9, log: true}\ntrials: 2", ["low is 0.0, must be above 0"]),
        ("agent.algorithm.gamma: {low: 0.5}", ["low or high is missing"]),
        ("agent.algorithm.gamma: {low: 0.5, hihg: 0.9}", ["'hihg' is not known"]),
        ("agent.algorithm.gamma: {low: 0.5, high: 0.9, step: 2}\ntrials: 2", ["step is 2", "within the range"]),
        ("agent.algorithm.schedule: {low: fixed, high: adaptive}", ["schedule: a range needs numbers", "list"]),
        ("agent.algorithm.gamma: {low: 0.5, high: 0.9}", ["trials: is missing"]),
        ("agent.algorithm.gamma: {low: 0.5, high: 0.9}\nsampler: grid", ["gamma: is a range", "sampler: tpe"]),
        ("agent.algorithm.gamma: [0.9, 0.8]\ntrials: 3", ["trials: is 3, but the grid has 2"]),
        ("agent.seed: [1, 2]", ["agent.seed: use 'seeds'"]),
        ("env.sim.device: [cpu]", ["env.sim.device: use the option --device"]),
        ("seeds: 3", ["seeds: is 3, must be a list"]),
        ("seeds: [1, 1]", ["seeds: is [1, 1]", "different"]),
        ("trials: 0", ["trials: is 0", "at least 1"]),
        ("sampler: bayes", ["sampler: is 'bayes'", "grid, random, tpe"]),
        ("objective: Train/reward", ["objective: there is no column 'Train/reward'", "Train/mean_reward"]),
        ("objective: reward", ["objective: is 'reward', must be a column of metrics.csv"]),
        ("maximize: up", ["maximize: is 'up', must be true or false"]),
        ("pruner: hyperband", ["pruner: is 'hyperband'", "median"]),
        ("pruner: {startup_trials: -1}", ["pruner: startup_trials is -1"]),
        ("trails: 3", ["trails: is not known", "did you mean 'trials'"]),
        ("name: a/b", ["name: is 'a/b'"]),
        ("- 1", ["contains list"]),
        ("a: [", ["is not valid YAML"]),
        ("sampler: bayes\nseeds: []", ["sampler: ", "\nmy.yaml: seeds: "]),
    ],
)
def test_a_bad_file_gets_one_message_that_says_what_is_right(text, parts):
    message = wrong(text)
    assert not [part for part in parts if part not in message], message


def test_a_file_that_is_not_there():
    with pytest.raises(UserError, match=r"--sweep none\.yaml: does not exist; give a YAML file"):
        read_sweep_file(Path("none.yaml"), TASK, configs())


def test_reading_leaves_the_configs_as_they_are():
    given = configs()
    Path("my.yaml").write_text(f"{GAMMA}: [0.5]\nenv.limit: [7.0]", encoding="utf-8")
    read_sweep_file(Path("my.yaml"), TASK, given)
    assert given.agent.to_dict() == configs().agent.to_dict()
    assert given.env.to_dict() == configs().env.to_dict()


def test_rewards_of_a_task_with_managers_are_known():
    from stripe_newton.cli.tasks import load_cfg

    task = "Stripe-Cartpole-v0"
    Path("my.yaml").write_text("objective: Episode_Reward/alive", encoding="utf-8")
    both = Configs(load_cfg(task, "env"), load_cfg(task, "agent"))
    assert read_sweep_file(Path("my.yaml"), task, both)[0].objective == "Episode_Reward/alive"
    Path("my.yaml").write_text("objective: Episode_Reward/alife", encoding="utf-8")
    with pytest.raises(UserError, match=r"there are Episode_Reward/"):
        read_sweep_file(Path("my.yaml"), task, both)


def test_words_of_values():
    assert [words_of(value) for value in (1e-4, 3, True, "32 64", "'a b' c")] == [
        ["0.0001"],
        ["3"],
        ["True"],
        ["32", "64"],
        ["a b", "c"],
    ]
