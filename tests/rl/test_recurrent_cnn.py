# SPDX-License-Identifier: Apache-2.0
"""Recurrent network of pictures: steps one by one and PPO's padded trajectories give the same actions."""

from __future__ import annotations

import pytest
import torch
from rsl_rl.models import CNNModel
from rsl_rl.utils import split_and_pad_trajectories
from tensordict import TensorDict

from stripe_newton.rl.recurrent_cnn import RecurrentCNNModel

STEPS, ENVS = 7, 5
GROUPS = {"actor": ["flat", "left", "more", "right"]}


def observations() -> TensorDict:
    made = {"flat": (3,), "more": (2,), "left": (1, 12, 16), "right": (2, 10, 10)}
    parts = {name: torch.randn(STEPS, ENVS, *shape) for name, shape in made.items()}
    return TensorDict(parts, batch_size=[STEPS, ENVS])


def make(obs: TensorDict, kind: str, groups: dict[str, list[str]] = GROUPS) -> RecurrentCNNModel:
    cnn = {"output_channels": (4, 4), "kernel_size": 3, "stride": 2}
    return RecurrentCNNModel(
        obs[0], groups, "actor", 2, (8,), obs_normalization=True, cnn_cfg=cnn, rnn_type=kind, rnn_hidden_dim=6,
        rnn_num_layers=2,
    )  # fmt: skip


@pytest.mark.parametrize("kind", ["gru", "lstm"])
def test_trajectories_give_what_steps_give(kind):
    torch.manual_seed(0)
    obs = observations()
    model = make(obs, kind)
    dones = torch.rand(STEPS, ENVS) < 0.3
    assert dones.any()
    one_by_one, before = [], []
    with torch.no_grad():
        model(obs[0])  # so that there is a memory to begin with
        for step in range(STEPS):
            hidden = model.get_hidden_state()
            before.append([h.clone() for h in (hidden if kind == "lstm" else (hidden,))])
            one_by_one.append(model(obs[step]))
            model.reset(dones[step].float())
        padded, masks = split_and_pad_trajectories(obs, dones.float())
        # Where trajectories begin: the memory that is there, or none.
        starts = torch.cat([torch.ones(1, ENVS, dtype=torch.bool), dones[:-1]]).T
        hidden = [torch.stack(h, dim=0).permute(2, 0, 1, 3)[starts].transpose(0, 1).contiguous() for h in zip(*before)]
        batch = model(padded, masks, tuple(hidden) if kind == "lstm" else hidden[0])
    torch.testing.assert_close(batch, torch.stack(one_by_one), atol=1e-5, rtol=1e-4)


def test_the_memory_is_that_of_the_environment_and_pictures_count():
    torch.manual_seed(1)
    obs = observations()
    model = make(obs, "gru")
    with torch.no_grad():
        model(obs[0])
        model.reset(torch.tensor([0.0, 1.0, 0.0, 0.0, 0.0]))
        after = model(obs[1])
        model.reset()
        fresh = model(obs[1])
        assert torch.allclose(after[1], fresh[1], atol=1e-6)
        assert not torch.allclose(after[0], fresh[0], atol=1e-4)
        changed = obs[1].clone()
        changed["right"][2] += 1.0
        model.reset()
        other = model(changed)
    differs = (other - fresh).abs().amax(dim=1) > 1e-6
    assert differs.tolist() == [False, False, True, False, False]


def test_a_network_of_pictures_alone():
    obs = observations()
    model = make(obs, "gru", {"actor": ["left"]})
    assert isinstance(model, CNNModel)
    assert model(obs[0]).shape == (ENVS, 2)
