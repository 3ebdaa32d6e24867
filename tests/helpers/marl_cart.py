# SPDX-License-Identifier: Apache-2.0
"""Cart with two poles and two agents, whose episodes end when a test says so."""

from __future__ import annotations

import torch

from stripe_tasks.cart_double_pole.multi_agent import CartDoublePoleMARLEnv, CartDoublePoleMARLEnvCfg

AGENTS = ["cart", "pendulum"]
N = 4


class Told(CartDoublePoleMARLEnv):
    """Also ends for an agent where the test says."""

    def __init__(self, cfg, render_mode=None, **kwargs):
        super().__init__(cfg, render_mode, **kwargs)
        flags = torch.zeros(2, len(AGENTS), self.num_envs, dtype=torch.bool)
        self.told = {kind: dict(zip(AGENTS, flags[k], strict=True)) for k, kind in enumerate(("end", "late"))}

    def _get_dones(self):
        ended, late = super()._get_dones()
        told = self.told
        return {a: ended[a] | told["end"][a] for a in AGENTS}, {a: late[a] | told["late"][a] for a in AGENTS}

    def _reset_idx(self, env_ids):
        super()._reset_idx(env_ids)
        for agents in getattr(self, "told", {}).values():
            for flags in agents.values():
                flags[:] = False


def config(num_envs: int = N, **changes) -> CartDoublePoleMARLEnvCfg:
    cfg = CartDoublePoleMARLEnvCfg().replace(seed=5, **changes)
    cfg.sim.device, cfg.scene.num_envs = "cpu", num_envs
    return cfg


def actions(env, seed: int = 0, scale: float = 1.0) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return {a: scale * (2.0 * torch.rand(env.num_envs, 1, generator=generator) - 1.0) for a in AGENTS}
