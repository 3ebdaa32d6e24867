# SPDX-License-Identifier: Apache-2.0
"""Evaluation of a policy over a given number of episodes: return, length, success rate, metrics."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import asdict, dataclass, field

import torch

from stripe_newton.value_types import short

from .policies import Policy
from .torch_vector_env import Extras, success_of
from .wrappers.rsl_rl import RslRlVecEnvWrapper

__all__ = ["EvalResult", "evaluate"]


@dataclass
class EvalResult:
    """Means over the episodes of an evaluation."""

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
    """Share of episodes whose last step was a success; None if the task does not define success."""
    metrics: dict[str, float] = field(default_factory=dict)
    """Means of what the environment logs as ``Metrics/NAME`` in the steps in which these episodes end, by name."""

    def to_dict(self) -> dict[str, object]:
        """The fields by name, without a success rate that is None."""
        return {name: value for name, value in asdict(self).items() if value is not None}


@torch.inference_mode()
def evaluate(
    env: RslRlVecEnvWrapper, policy: Policy, episodes: int, *, task: str = "", seed: int | None = None
) -> EvalResult:
    """Run exactly ``episodes`` episodes and average over them.

    Each environment contributes its first ``episodes / num_envs`` episodes, the first few environments one more if
    that is no whole number. Counting whichever episodes end first would favour short ones.

    Args:
        env: The wrapped environment; it is reset first.
        policy: What chooses the actions; rsl_rl's networks act without exploration noise here.
        episodes: Number of episodes, at least 1.
        task: Name of the task for the result.
        seed: Seed of the reset.

    Raises:
        ValueError: if ``episodes`` is below 1.
        RuntimeError: if an episode goes on for more than twice ``env.max_episode_length`` steps.
    """
    if isinstance(episodes, bool) or not isinstance(episodes, int) or episodes < 1:
        raise ValueError(f"episodes: is {short(episodes)}, must be a whole number of at least 1")
    counter = _EpisodeCounter(env, episodes)
    obs = env.reset(seed=seed)
    policy.reset()
    while counter.is_open():
        obs, rewards, dones, extras = env.step(policy(obs))
        policy.reset(dones)
        counter.add(rewards, dones.bool(), extras)
    return counter.result(task)


class _EpisodeCounter:
    """Sums over the episodes that count, up to a quota for each environment."""

    def __init__(self, env: RslRlVecEnvWrapper, episodes: int):
        self._env, self._episodes = env, episodes
        self._quota = torch.full((env.num_envs,), episodes // env.num_envs, device=env.device)
        self._quota[: episodes % env.num_envs] += 1
        self._count = torch.zeros_like(self._quota)
        self._steps = torch.zeros_like(self._quota)
        # float64: sums of long episodes lose digits in float32.
        self._returns = torch.zeros(env.num_envs, dtype=torch.float64, device=env.device)
        self._total_steps, self._total_return, self._terminated = 0, 0.0, 0
        self._successes: int | None = None if success_of(env.unwrapped) is None else 0
        self._metrics: dict[str, float] = defaultdict(float)

    def is_open(self) -> bool:
        """Whether an environment has not reached its quota."""
        return bool((self._count < self._quota).any())

    def add(self, rewards: torch.Tensor, ended: torch.Tensor, extras: Extras) -> None:
        """Take a step into account: rewards and ends of episodes, both ``(num_envs,)``, and the step's extras.

        Raises:
            RuntimeError: if an episode does not end.
        """
        self._steps += 1
        self._returns += rewards
        counted = ended & (self._count < self._quota)
        if bool(counted.any()):
            self._add_ended(counted, extras)
        elif int(self._steps.max()) > 2 * self._env.max_episode_length:
            raise RuntimeError(
                f"an episode is longer than {int(self._steps.max()) - 1} steps, twice max_episode_length: "
                "does it ever end?"
            )
        self._count += counted
        # Also those that do not count any more: their next episodes go on.
        self._steps[ended] = 0
        self._returns[ended] = 0.0

    def _add_ended(self, counted: torch.Tensor, extras: Extras) -> None:
        number = int(counted.sum())
        self._total_steps += int(self._steps[counted].sum())
        self._total_return += float(self._returns[counted].sum())
        self._terminated += int((counted & ~self._timed_out(extras)).sum())
        for name, value in extras.get("log", {}).items():
            if name.startswith("Metrics/"):
                # The log is of a step, not of an episode, so it counts for each episode that ended in it.
                self._metrics[name.removeprefix("Metrics/")] += float(value) * number / self._episodes
        success = success_of(self._env.unwrapped)
        if success is not None:
            self._successes = (self._successes or 0) + int(success[counted].sum())

    def _timed_out(self, extras: Extras) -> torch.Tensor:
        """Whether the clock ended the episodes, ``(num_envs,)``."""
        # A task with a finite horizon hands out no time-outs.
        if "time_outs" in extras:
            return extras["time_outs"].bool()
        return self._steps >= int(self._env.max_episode_length)

    def result(self, task: str) -> EvalResult:
        """The means over all episodes."""
        return EvalResult(
            task=task,
            episodes=self._episodes,
            mean_return=self._total_return / self._episodes,
            mean_length=self._total_steps / self._episodes,
            max_length=int(self._env.max_episode_length),
            terminated_rate=self._terminated / self._episodes,
            metrics=dict(self._metrics),
            success_rate=None if self._successes is None else self._successes / self._episodes,
        )
