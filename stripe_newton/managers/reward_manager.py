# SPDX-License-Identifier: Apache-2.0
"""What is worth how much."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import torch
import warp as wp

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Eager, Item, Section, bind_term

from .context import ManagerContext
from .manager_base import ManagerBase, is_warp_term

__all__ = ["RewardManager", "RewardTermCfg"]


@configclass
class RewardTermCfg:
    """One reward or cost."""

    func: Callable[..., Any] = MISSING
    """Warp function ``(env, ...) -> float``, or torch function ``(env, **params)`` that returns ``(num_envs,)``."""
    params: dict[str, Any] = {}
    """Its further arguments."""
    weight: float = MISSING
    """Factor on it; a term whose weight is zero is not evaluated."""
    clip: tuple[float, float] | None = None
    """Bounds of the term's value, before the weight."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.weight is not MISSING and not math.isfinite(self.weight):
            yield "weight", f"is {self.weight}, must be finite"
        if self.clip is not None and not self.clip[0] <= self.clip[1]:
            yield "clip", f"is {self.clip}, must be (low, high) with low <= high"


class RewardManager(ManagerBase):
    """Sums ``weight * term``, times the time step if ``scale_by_dt``; keeps each term's sum over the episode."""

    name = "rewards"

    def __init__(self, cfg: Any, context: ManagerContext, scale_by_dt: bool = True):
        super().__init__(cfg, context)
        self._terms: dict[str, RewardTermCfg] = self.terms(cfg, RewardTermCfg)
        self._dt = context.step_dt if scale_by_dt else 1.0
        self._sums = context.array("rewards.sums", float, len(self._terms))
        self._steps = context.array("rewards.values", float, len(self._terms))
        self._sums_name = context.scope.name("reward_sums", self._sums)
        self._steps_name = context.scope.name("reward_terms", self._steps)

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    @property
    def episode_sums(self) -> dict[str, torch.Tensor]:
        """Sum of each weighted term over the episode so far, shape ``(num_envs,)``."""
        sums = self.context.torch(self._sums)
        return {name: sums[:, i] for i, name in enumerate(self._terms)}

    @property
    def step_reward(self) -> torch.Tensor:
        """Weighted terms of the last step, per second where they are scaled by dt, shape ``(num_envs, num_terms)``."""
        return self.context.torch(self._steps)

    def compute(self) -> list[Item]:
        """Items that evaluate the terms on the state after the physics."""
        parameters, body, eager = self.context.parameters, list[str](), list[Item]()
        values, ends = list[str](), list[str]()
        scale = parameters.add("rewards.dt", self._dt, float)
        for index, (name, term) in enumerate(self._terms.items()):
            weight = parameters.add(f"rewards.{name}.weight", term.weight, float)
            step = f"{self._steps_name}[env, {index}]"
            if not is_warp_term(term.func):
                eager.append(Eager("rewards", self._torch(index, term), f"torch term '{name}'", [name]))
                value = step
            else:
                call = bind_term(self.context, term.func, term.params, f"rewards.{name}", "reward")
                if call is None:
                    continue
                value = call.expression()
            if term.clip is not None:
                clip = parameters.add(f"rewards.{name}.clip", term.clip, wp.vec2)
                value = f"wp.clamp({value}, ({clip})[0], ({clip})[1])"
            body += [
                f"value_{index} = wp.float32(0.0)",
                f"weight_{index} = {weight}",
                f"if weight_{index} != 0.0:",
                f"    value_{index} = weight_{index} * {value}  # {name}",
            ]
            values.append(f"value_{index}")
            ends += [f"{step} = value_{index}", f"{self._sums_name}[env, {index}] += value_{index} * scale"]
        body += [f"scale = {scale}", *ends]  # written last: a write in between would hold the reads after it up
        total = f"({' + '.join(values) or '0.0'}) * scale"
        body.append(f"reward[env] = wp.where(nonfinite[env], 0.0, {total})")
        return [*eager, Section("rewards", body, self.active_terms)]

    def reset(self) -> list[Item]:
        """Items that log the sums, per second of the longest episode, and clear them."""
        per_second = self.context.parameters.add("rewards.per_second", 1.0 / self.context.max_episode_length_s, float)
        lines = []
        for index, name in enumerate(self._terms):
            sum_ = f"{self._sums_name}[env, {index}]"
            lines.append(self.context.log.line(f"Episode_Reward/{name}", f"{sum_} * {per_second}"))
            lines.append(f"{sum_} = 0.0")
        return [Section("rewards_log", lines, where_reset=True)] if lines else []

    def _torch(self, index: int, term: RewardTermCfg) -> Callable[[], None]:
        call = self.torch_term(term.func, term.params)

        def evaluate() -> None:
            self.step_reward[:, index] = call()

        return evaluate

    def __str__(self) -> str:
        rows = [(i, n, t.weight) for i, (n, t) in enumerate(self._terms.items())]
        return self.table("Reward terms", ("Index", "Name", "Weight"), rows)
