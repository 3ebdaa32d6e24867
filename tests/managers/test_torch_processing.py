# SPDX-License-Identifier: Apache-2.0
"""Modifiers and noise of observations that are a user's torch functions and classes."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from stripe_kernels import mdp
from stripe_newton.configclass import configclass
from stripe_newton.managers import ModifierBase, ModifierCfg
from stripe_newton.managers import ObservationTermCfg as Term
from stripe_newton.noise import NoiseCfg, NoiseModel, NoiseModelCfg
from tests.helpers.manager_world import ObservationWorld, observation_group

JOINTS = 8


class Sum(ModifierBase):
    """Sum over the episode."""

    def __init__(self, cfg: Any, data_dim: tuple[int, ...], device: str):
        super().__init__(cfg, data_dim, device)
        self.total = torch.zeros(data_dim, device=device)

    def reset(self, env_ids: Any = None) -> None:
        self.total[slice(None) if env_ids is None else env_ids] = 0.0

    def __call__(self, data: torch.Tensor, factor: float) -> torch.Tensor:
        self.total += factor * data
        return self.total


def shifted(data: torch.Tensor, value: float) -> torch.Tensor:
    return data + value


class Counted(NoiseModel):
    """Noise that says how many resets an environment has seen."""

    def __init__(self, noise_model_cfg: Any, num_envs: int, device: str):
        super().__init__(noise_model_cfg, num_envs, device)
        self.resets = torch.zeros(num_envs, 1, device=device)

    def reset(self, env_ids: Any = None) -> None:
        self.resets[env_ids] += 1.0

    def __call__(self, data: torch.Tensor) -> torch.Tensor:
        return data + 100.0 * self.resets


@configclass
class CountedCfg(NoiseModelCfg):
    class_type: type = Counted
    noise_cfg: NoiseCfg = NoiseCfg()


def doubled(data: torch.Tensor, cfg: NoiseCfg) -> torch.Tensor:
    return 2.0 * data


def test_modifiers_noise_clip_scale_and_history_in_this_order():
    modifiers = [ModifierCfg(func=Sum, params={"factor": 3.0}), ModifierCfg(func=shifted, params={"value": 1.0})]
    term = Term(mdp.joint_pos, modifiers=modifiers, noise=NoiseCfg(func=doubled), clip=(-9.0, 19.0), scale=0.5)
    terms = {"a": term.replace(history_length=2), "b": Term(mdp.joint_pos)}
    groups = {"policy": observation_group(terms, enable_corruption=True), "clean": observation_group({"a": term})}
    world = ObservationWorld(groups)
    world.reset(0, 1, 2, 3)
    draw = np.random.default_rng(0)
    total, history = np.zeros((4, JOINTS)), np.zeros((4, 2, JOINTS))
    for step in range(4):
        q = draw.normal(size=(4, JOINTS)).astype(np.float32)
        world.step(q)
        fresh = (step == 0) | ((np.arange(4) == 1) & (step == 2))
        total = np.where((np.arange(4) == 1)[:, None] & (step == 2), 0.0, total) + 3.0 * q
        clean = 0.5 * np.clip(total + 1.0, -9.0, 19.0)
        noisy = 0.5 * np.clip(2.0 * (total + 1.0), -9.0, 19.0)
        history = np.where(fresh[:, None, None], noisy[:, None], np.stack([history[:, 1], noisy], axis=1))
        np.testing.assert_allclose(world["policy"][:, : 2 * JOINTS], history.reshape(4, -1), atol=1e-5)
        np.testing.assert_allclose(world["policy"][:, 2 * JOINTS :], q, atol=1e-6)
        np.testing.assert_allclose(world["clean"], clean, atol=1e-5)
        if step == 1:
            world.reset(1)
            for instance in world.manager._instances.values():
                instance.reset(torch.tensor([1]))


def test_a_noise_model_of_the_user_sees_resets():
    group = observation_group({"a": Term(mdp.joint_pos, noise=CountedCfg())}, enable_corruption=True)
    world = ObservationWorld({"policy": group})
    items = world.manager.reset_instance_items()
    assert [item.terms for item in items] == [["Counted"]]
    world.context.reset_mask.choose(torch.tensor([True, False, True, False]))
    items[0].function()
    world.step(np.zeros((4, JOINTS)))
    np.testing.assert_array_equal(world["policy"][:, 0], [100.0, 0.0, 100.0, 0.0])
