# SPDX-License-Identifier: Apache-2.0
"""Evaluation of a policy over a given number of episodes."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass, field
from typing import Any

import torch

from .policies import Policy
from .vec_env import RslRlVecEnvWrapper

__all__ = ["EvalResult", "evaluate"]


@dataclass
class EvalResult:
    """What a policy reached."""

    task: str
    """Name of the task."""
    episodes: int
    """Number of episodes."""
    mean_return: float
    """Mean over episodes of the sum of rewards."""
    mean_length: float
    """Mean over episodes of the number of steps."""
    max_length: int
    """Steps after which the clock ends an episode."""
    terminated_rate: float
    """Share of episodes that something else than the clock ended, such as a fall."""
    success_rate: float | None = None
    """Share of episodes whose last step was a success; None if the task does not say what success is."""
    metrics: dict[str, float] = field(default_factory=dict)
    """Means of what the environment logs as ``Metrics/NAME`` in the steps in which these episodes end, by name."""

    def to_dict(self) -> dict[str, Any]:
        """The fields by name, without a success rate that is None."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@torch.inference_mode()
def evaluate(
    env: RslRlVecEnvWrapper, policy: Policy, episodes: int, *, task: str = "", seed: int | None = None
) -> EvalResult:
    """Run exactly ``episodes`` episodes and average over them.

    Each environment gives its first ``episodes / num_envs`` episodes, one more for the first few if that is no whole
    number. Taking whichever episodes end first would favour short ones.

    Args:
        env: the wrapped environment; it is reset first.
        policy: what chooses the actions; rsl_rl's networks act without noise here.
        episodes: how many episodes, at least 1.
        task: name to put into the result.
        seed: seed of the reset.

    Raises:
        ValueError: if ``episodes`` is below 1.
        RuntimeError: if an episode goes on for more than twice ``env.max_episode_length`` steps.
    """
    if episodes < 1:
        raise ValueError(f"episodes is {episodes}, must be at least 1")
    quota = torch.full((env.num_envs,), episodes // env.num_envs, device=env.device)
    quota[: episodes % env.num_envs] += 1
    count = torch.zeros_like(quota)
    steps = torch.zeros_like(quota)
    returns = torch.zeros(env.num_envs, dtype=torch.float64, device=env.device)
    total_steps, total_return, successes, terminated = 0, 0.0, 0, 0
    metrics: dict[str, float] = defaultdict(float)
    has_success = hasattr(env.unwrapped, "success")

    obs = env.reset(seed=seed)
    policy.reset()
    while bool((count < quota).any()):
        obs, rewards, dones, extras = env.step(policy(obs))
        policy.reset(dones)
        steps += 1
        returns += rewards
        ended = dones.bool()
        counted = ended & (count < quota)
        if bool(counted.any()):
            total_steps += int(steps[counted].sum())
            total_return += float(returns[counted].sum())
            terminated += int((counted & ~extras["time_outs"].bool()).sum())
            for name, value in extras.get("log", {}).items():
                if name.startswith("Metrics/"):
                    metrics[name.removeprefix("Metrics/")] += float(value) * int(counted.sum()) / episodes
            if has_success:
                successes += int(env.unwrapped.success[counted].sum())
        elif int(steps.max()) > 2 * env.max_episode_length:
            raise RuntimeError(
                f"an episode is longer than {int(steps.max()) - 1} steps, twice max_episode_length: does it ever end?"
            )
        count += counted
        steps[ended] = 0
        returns[ended] = 0.0
    return EvalResult(
        task=task,
        episodes=episodes,
        mean_return=total_return / episodes,
        mean_length=total_steps / episodes,
        max_length=int(env.max_episode_length),
        terminated_rate=terminated / episodes,
        metrics=dict(metrics),
        success_rate=successes / episodes if has_success else None,
    )
