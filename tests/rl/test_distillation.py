# SPDX-License-Identifier: Apache-2.0
"""Distillation: a student learns from a teacher that was trained before."""

import random

import numpy as np
import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.rl import (
    CheckpointError,
    DistillationRunner,
    OnPolicyRunner,
    RslRlDistillationAlgorithmCfg,
    RslRlDistillationRunnerCfg,
    RslRlMLPModelCfg,
    RslRlRNNModelCfg,
    RslRlVecEnvWrapper,
    export_policy,
)
from tests.helpers.fake_env import FakeCartCfg, FakeCartEnv, FakeCartRunnerCfg

normal = RslRlMLPModelCfg.GaussianDistributionCfg


def make_env() -> RslRlVecEnvWrapper:
    cfg = FakeCartCfg(seed=3)
    cfg.sim.device = "cpu"
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    torch.manual_seed(1)
    return RslRlVecEnvWrapper(FakeCartEnv(cfg, "rgb_array"))


def cfg_of(teacher: str = "", student=None) -> RslRlDistillationRunnerCfg:
    return RslRlDistillationRunnerCfg(
        num_steps_per_env=20,
        save_interval=5,
        student=student or RslRlMLPModelCfg(hidden_dims=(16,), distribution_cfg=normal(init_std=0.1)),
        teacher=FakeCartRunnerCfg().actor,
        obs_groups={"student": ["policy"], "teacher": FakeCartRunnerCfg().obs_groups["actor"]},
        algorithm=RslRlDistillationAlgorithmCfg(gradient_length=10, learning_rate=3.0e-3, num_learning_epochs=2),
        teacher_checkpoint=teacher,
    )


@pytest.fixture(scope="module")
def teacher(tmp_path_factory):
    folder = tmp_path_factory.mktemp("teacher")
    runner = OnPolicyRunner(make_env(), FakeCartRunnerCfg(), folder)
    runner.learn(15)
    return folder


def apart(runner: DistillationRunner) -> float:
    """Root mean square of the difference of their actions on states of the cart."""
    env = make_env()
    with torch.inference_mode():
        obs = env.reset(seed=7)
        obs["policy"].uniform_(-1.0, 1.0)
        return float((runner.alg.student(obs) - runner.alg.teacher(obs)).pow(2).mean().sqrt())


def test_the_student_learns_what_the_teacher_does(tmp_path, teacher):
    runner = DistillationRunner(make_env(), cfg_of(str(teacher)), tmp_path)
    trained = OnPolicyRunner(make_env(), FakeCartRunnerCfg())
    trained.load(next((teacher / "checkpoints").glob("model_14.pt")))
    for name, value in trained.alg.actor.state_dict().items():
        torch.testing.assert_close(runner.alg.teacher.state_dict()[name], value)
    before = apart(runner)
    assert set(runner.no_graphs) == {"rollout", "update"}
    assert runner.learn(30)
    assert apart(runner) < 0.25 * before
    files = export_policy(runner, tmp_path / "exported")
    assert all(path.exists() for path in (tmp_path / "exported").glob("policy.*"))
    assert files is not None


@pytest.mark.parametrize("memory", [False, True])
def test_a_resumed_distillation_equals_an_uninterrupted_one(tmp_path, teacher, memory):
    student = RslRlRNNModelCfg(hidden_dims=(8,), rnn_hidden_dim=6, distribution_cfg=normal()) if memory else None
    whole = DistillationRunner(make_env(), cfg_of(str(teacher), student), tmp_path / "whole")
    whole.learn(6)
    first = DistillationRunner(make_env(), cfg_of(str(teacher), student), tmp_path / "first")
    first.learn(3)
    second = DistillationRunner(make_env(), cfg_of("", student), tmp_path / "first")
    second.resume(tmp_path / "first" / "checkpoints" / "model_2.pt")
    assert second.iterations_done == 3
    second.learn(3)
    for name, value in whole.alg.student.state_dict().items():
        assert torch.equal(second.alg.student.state_dict()[name], value), name


def test_errors(tmp_path, teacher):
    with pytest.raises(CheckpointError, match="teacher_checkpoint: is empty"):
        DistillationRunner(make_env(), cfg_of()).learn(1)
    with pytest.raises(CheckpointError, match=r"nowhere: does not exist"):
        DistillationRunner(make_env(), cfg_of(str(tmp_path / "nowhere")))
    other = cfg_of(str(teacher))
    other.teacher.hidden_dims = (3,)
    with pytest.raises(CheckpointError, match="has other networks or observations"):
        DistillationRunner(make_env(), other)
    with pytest.raises(ConfigError) as raised:
        DistillationRunner(make_env(), cfg_of().replace(obs_groups={"student": ["pixels"], "teacher": ["policy"]}))
    assert "obs_groups.student: 'pixels' is not an observation group" in str(raised.value)
    bad = RslRlDistillationAlgorithmCfg(loss_type="l1", gradient_length=0, max_grad_norm=-1.0)
    with pytest.raises(ConfigError) as raised:
        bad.validate()
    assert len(raised.value.problems) == 3
