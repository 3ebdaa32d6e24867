# SPDX-License-Identifier: Apache-2.0
"""Examples of docs/learners.md, run as they stand, and an independent measure of what they learn."""

from __future__ import annotations

import re
from contextlib import contextmanager
from typing import Any

import gymnasium
import pytest
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.rl import RslRlVecEnvWrapper, evaluate
from stripe_tasks.cartpole import CartpoleEnvCfg
from tests.helpers.checkout import ROOT

PAGE = ROOT / "docs" / "learners.md"
TASK = "Stripe-Cartpole-Direct-v0"


def cartpole_cfg(num_envs: int = 4, device: str = "cpu", **changes: Any) -> CartpoleEnvCfg:
    cfg = CartpoleEnvCfg().replace(**changes)
    cfg.sim.device, cfg.scene.num_envs = device, num_envs
    return cfg


def cartpole(num_envs: int = 4, device: str = "cpu", **changes: Any) -> Any:
    return gymnasium.make_vec(TASK, cfg=cartpole_cfg(num_envs, device, **changes))


@contextmanager
def one_thread():
    """The same sums on every machine, and no slower for networks of this size."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def blocks(heading: str | None = None) -> list[str]:
    """The Python blocks of the page, or of one of its sections."""
    text = PAGE.read_text(encoding="utf-8")
    if heading is not None:
        text = text.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"^```python\n(.*?)^```", text, re.S | re.M)


def run_example(heading: str) -> dict[str, Any]:
    """Run the blocks under a heading on the CPU; return the names that they define."""
    names: dict[str, Any] = {"__name__": "example"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("stripe_newton.sim.simulation_parts.resolve_device", lambda name: "cpu")
        for block in blocks(heading):
            exec(compile(block, str(PAGE), "exec"), names)
    return names


class Acting:
    """A function of the observations (num_envs, 4) as a policy that ``evaluate`` takes."""

    def __init__(self, act):
        self.act = act

    def __call__(self, obs):
        return self.act(obs["policy"])

    def reset(self, dones=None):
        pass


def mean_return(act) -> float:
    """Mean return of 64 episodes of whole length, whose starts are the same in every call."""
    env = RslRlVecEnvWrapper(cartpole(64))
    found = evaluate(env, Acting(act), 64, seed=123).mean_return
    env.close()
    return found


def random_return() -> float:
    """The return of actions drawn from a unit Gaussian."""
    generator = torch.Generator().manual_seed(0)
    return mean_return(lambda obs: torch.randn(len(obs), 1, generator=generator))
