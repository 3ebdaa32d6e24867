# SPDX-License-Identifier: Apache-2.0
"""Direct tasks with torch hooks on a GPU, and what their steps return."""

from __future__ import annotations

from typing import Any

import gymnasium
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.cli.run_configs import load_configs

DEVICE = "cuda:0"
TASKS = ["Stripe-Cartpole-Direct-v0", "Stripe-Ant-Direct-v0", "Stripe-Humanoid-Direct-v0"]


def task_env(name: str, hooks_graph: Any, num_envs: int = 256, **changes: Any) -> Any:
    """A task with episodes of 2 s that end at different steps."""
    cfg = load_configs(name, None).env.replace(**changes)
    cfg.sim.device, cfg.scene.num_envs, cfg.seed, cfg.hooks_graph = DEVICE, num_envs, 1, hooks_graph
    cfg.episode_length_s = 2.0
    env = gymnasium.make_vec(name, cfg=cfg).unwrapped
    env.reset(seed=1)
    phases = torch.arange(num_envs, device=DEVICE) * 7 % env.max_episode_length
    env.episode_length_buf = phases
    return env


def results(env: Any, steps: int) -> list[dict[str, torch.Tensor]]:
    """All that some steps with random actions return."""
    generator = torch.Generator(device=DEVICE).manual_seed(0)
    actions = 2.0 * torch.rand(16, *env.action_space.shape, generator=generator, device=DEVICE) - 1.0
    torch.manual_seed(5)
    found = []
    for index in range(steps):
        obs, reward, terminated, truncated, extras = env.step(actions[index % 16])
        log = {k: torch.as_tensor(v).clone() for k, v in extras["log"].items()}
        found.append({**obs, "reward": reward, "terminated": terminated, "truncated": truncated, **log})
    return found
