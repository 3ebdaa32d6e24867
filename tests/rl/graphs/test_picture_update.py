# SPDX-License-Identifier: Apache-2.0
"""Updates of networks that see pictures, their convolutions in the form of a GPU, against rsl_rl's PPO."""

from __future__ import annotations

import copy

import pytest
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import CNNModel, MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from stripe_newton.rl.graphs import picture_layers
from stripe_newton.rl.graphs.picture_layers import PictureForm
from stripe_newton.rl.graphs.ppo import GraphPPO

STEPS, ENVS = 4, 8
NATURE = {"output_channels": (8, 16, 16), "kernel_size": (8, 4, 3), "stride": (4, 2, 1)}
NORMAL = {"class_name": "rsl_rl.modules.distribution:GaussianDistribution", "init_std": 1.0}


def observations(seed: int, device: str) -> TensorDict:
    torch.manual_seed(seed)
    parts = {"picture": torch.rand(STEPS + 1, ENVS, 3, 40, 40) - 0.5, "state": torch.randn(STEPS + 1, ENVS, 4)}
    return TensorDict(parts, batch_size=[STEPS + 1, ENVS]).to(device)


def made(kind: type[PPO], critic_sees: str, device: str) -> PPO:
    obs = observations(0, device)[0]
    groups = {"actor": ["picture"], "critic": [critic_sees]}
    torch.manual_seed(1)
    actor = CNNModel(obs, groups, "actor", 2, (16,), distribution_cfg=dict(NORMAL), cnn_cfg=dict(NATURE))
    if critic_sees == "state":
        critic: MLPModel = MLPModel(obs, groups, "critic", 1, (16,), obs_normalization=True)
    else:
        critic = CNNModel(obs, groups, "critic", 1, (16,), cnn_cfg=dict(NATURE))
    storage = RolloutStorage("rl", ENVS, STEPS, obs, [2], device)
    return kind(actor, critic, storage, num_learning_epochs=2, learning_rate=1.0e-3, device=device)


def learn(algorithm: PPO, seed: int, device: str) -> None:
    """A rollout by rsl_rl's own methods, and its update."""
    obs = observations(seed, device)
    with torch.inference_mode():
        for step in range(STEPS):
            algorithm.act(obs[step])
            rewards = obs["picture"][step + 1, :, 0, :8].mean((1, 2)) + algorithm.transition.actions[:, 0]
            algorithm.process_env_step(obs[step + 1], rewards, obs["state"][step, :, 0] > 1.5, {})
        algorithm.compute_returns(obs[STEPS])
    # The policy is not quite that of the rollout: for a KL divergence of 0 the schedule would go by roundings.
    for parameter in algorithm.actor.parameters():
        parameter.data += 0.01 * torch.randn_like(parameter)
    algorithm.update()


def parameters(algorithm: PPO) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for m in (algorithm.actor, algorithm.critic) for p in m.parameters()])


@pytest.mark.parametrize("critic_sees", ["picture", "state"])
def test_updates_are_those_of_rsl_rl(critic_sees, device, monkeypatch):
    monkeypatch.setattr(picture_layers, "fast_form", lambda device: PictureForm(blocks=True, channels_last=True))
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)
    ours, theirs = (made(kind, critic_sees, device) for kind in (GraphPPO, PPO))
    assert not ours.why_no_update_graph
    # On a GPU the first update is eager, the second records graphs, and the third replays them.
    for seed in range(1, 3 if device == "cpu" else 5):
        # From the checkpoint that ours writes, so that roundings of an update do not grow in the next one.
        theirs.load(copy.deepcopy(ours.save()), None, True)
        theirs.learning_rate = ours.learning_rate
        start = parameters(theirs)
        for algorithm in (ours, theirs):
            learn(algorithm, seed, device)
        assert ours.learning_rate == pytest.approx(theirs.learning_rate, rel=1.0e-9)
        way, difference = parameters(theirs) - start, parameters(ours) - parameters(theirs)
        assert way.norm() > 0.01
        assert difference.norm() < 1.0e-3 * way.norm()
