# SPDX-License-Identifier: Apache-2.0
"""Batched distillation: the parameters, losses and memory after updates, against rsl_rl's own algorithm."""

from __future__ import annotations

import copy

import pytest
import torch
from rsl_rl.algorithms import Distillation
from rsl_rl.models import CNNModel, MLPModel, RNNModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from stripe_newton.rl.batched_distillation import BatchedDistillation
from stripe_newton.rl.recurrent_cnn import RecurrentCNNModel

STEPS, ENVS, ACTIONS = 12, 7, 3
CNN = {"output_channels": (4, 4), "kernel_size": 3, "stride": 2}


def observations() -> TensorDict:
    parts = {"flat": torch.randn(ENVS, 5), "picture": torch.rand(ENVS, 1, 12, 16), "all": torch.randn(ENVS, 6)}
    return TensorDict(parts, batch_size=[ENVS])


def students() -> dict[str, tuple[MLPModel, list[str]]]:
    obs, memory = observations(), {"rnn_hidden_dim": 6, "rnn_num_layers": 2}
    flat, both = {"student": ["flat"]}, {"student": ["flat", "picture"]}
    rest = ("student", ACTIONS, (8,))
    noise = {"class_name": "GaussianDistribution", "init_std": 0.3}
    return {
        "mlp": MLPModel(obs, flat, *rest, obs_normalization=True, distribution_cfg=dict(noise)),
        "cnn": CNNModel(obs, both, *rest, cnn_cfg=CNN),
        "lstm": RNNModel(obs, flat, *rest, rnn_type="lstm", obs_normalization=True, **memory),
        "gru of pictures": RecurrentCNNModel(
            obs,
            both,
            *rest,
            obs_normalization=True,
            cnn_cfg=CNN,
            rnn_type="gru",
            distribution_cfg=dict(noise),
            **memory,
        ),
    }


def make(kind: type[Distillation], student: MLPModel, **options) -> Distillation:
    obs = observations()
    torch.manual_seed(2)
    teacher = MLPModel(obs, {"teacher": ["all"]}, "teacher", ACTIONS, (8,))
    storage = RolloutStorage("distillation", ENVS, STEPS, obs, [ACTIONS])
    settings = {"gradient_length": 4, "learning_rate": 3.0e-3, "max_grad_norm": 0.5} | options
    return kind(copy.deepcopy(student), teacher, storage, **settings)


def rollout(algorithm: Distillation, seed: int) -> None:
    """Steps in which the student acts; episodes end at random."""
    torch.manual_seed(seed)
    with torch.no_grad():
        for _ in range(STEPS):
            algorithm.act(observations())
            dones = (torch.rand(ENVS) < 0.25).to(torch.uint8)
            algorithm.process_env_step(observations(), torch.zeros(ENVS), dones, {})


@pytest.mark.parametrize("name", ["mlp", "cnn", "lstm", "gru of pictures"])
@pytest.mark.parametrize("options", [{}, {"num_learning_epochs": 2, "loss_type": "huber"}], ids=str)
def test_updates_are_those_of_rsl_rl(name, options):
    torch.manual_seed(1)
    student = students()[name]
    ours, theirs = (make(kind, student, **options) for kind in (BatchedDistillation, Distillation))
    assert ours.why_not_batched == ""
    for seed in range(3):
        losses = []
        for algorithm in (ours, theirs):
            rollout(algorithm, seed)
            losses.append(algorithm.update()["behavior"])
        assert losses[0] == pytest.approx(losses[1], rel=1.0e-4)
    moved = 0.0
    for (key, value), (_, other), (_, before) in zip(
        *(m.state_dict().items() for m in (ours.student, theirs.student, student)), strict=True
    ):
        torch.testing.assert_close(value, other, rtol=1.0e-3, atol=2.0e-5, msg=lambda m, k=key: f"{k}: {m}")
        moved = max(moved, float((value - before).abs().max()))
    assert moved > 1.0e-3
    if student.is_recurrent:
        for mine, other in zip(ours.student.get_hidden_state(), theirs.student.get_hidden_state(), strict=True):
            torch.testing.assert_close(mine, other.detach(), rtol=1.0e-3, atol=1.0e-5)


def test_what_cannot_be_batched_is_left_to_rsl_rl():
    torch.manual_seed(1)
    student = students()["mlp"]
    odd = make(BatchedDistillation, student, gradient_length=5)
    assert odd.why_not_batched == "gradient_length does not divide num_steps_per_env"
    rollout(odd, 0)
    assert odd.update()["behavior"] > 0.0
