# SPDX-License-Identifier: Apache-2.0
"""Reward manager: the weighted sum of reward terms.

The section that it generates for a term ``alive`` of a cart-pole; the weight is read from memory, so that a change
needs no compilation::

    weight_0 = parameters[5]
    sum_0 = reward_sums[env, 0]
    scale = parameters[4]
    value_0 = wp.float32(0.0)
    if weight_0 != 0.0:
        value_0 = weight_0 * is_alive(env, episode)  # alive
    reward_terms[env, 0] = value_0
    reward_sums[env, 0] = sum_0 + value_0 * scale
    reward[env] = wp.where(nonfinite[env], 0.0, (value_0) * scale)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any, ClassVar

import torch
import warp as wp

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Code, HostFunction, Item, Section, bind_term, block, code
from stripe_newton.value_types import AnyFloat

from .context import ManagerContext
from .manager_base import is_warp_term
from .term_manager import TermManager

__all__ = ["RewardManager", "RewardManagerCfg", "RewardTermCfg"]


@configclass
class RewardTermCfg:
    """Config of a reward term."""

    MAY_BE_NONE: ClassVar[bool] = True

    func: Callable[..., object] = MISSING
    """Warp function ``(env, ...) -> float``, or torch function ``(env, **params)`` that returns ``(num_envs,)``."""
    params: dict[str, Any] = {}
    """Further arguments of the function."""
    weight: float = MISSING
    """Factor; a term of weight 0 is not evaluated."""
    clip: tuple[AnyFloat, AnyFloat] | None = None
    """Bounds of the term's value, before the weight."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.weight is not MISSING and not math.isfinite(self.weight):
            yield "weight", f"is {self.weight}, must be finite"
        if self.clip is not None and not self.clip[0] <= self.clip[1]:
            yield "clip", f"is {self.clip}, must be (low, high) with low <= high"


@configclass
class RewardManagerCfg:
    """Config of the reward manager: a field for each term.

    Subclass it, or name them: ``RewardManagerCfg(NAME=RewardTermCfg(...))``.
    """

    OPEN: ClassVar[tuple[type, ...]] = (RewardTermCfg,)


class RewardManager(TermManager[RewardTermCfg]):
    """Weighted sum of terms, times the time step if ``scale_by_dt``; keeps the sum of each over the episode."""

    name = "rewards"

    def __init__(self, cfg: object, context: ManagerContext, scale_by_dt: bool = True):
        super().__init__(cfg, context, RewardTermCfg)
        self._dt = context.step_dt if scale_by_dt else 1.0
        self._sums = context.array("rewards.sums", float, len(self._terms))
        self._values = context.array("rewards.values", float, len(self._terms))
        self._sums_name = context.scope.name("reward_sums", self._sums)
        self._values_name = context.scope.name("reward_terms", self._values)

    @property
    def episode_sums(self) -> dict[str, torch.Tensor]:
        """Sum of each weighted term over the episode so far, shape ``(num_envs,)``."""
        sums = self.context.torch(self._sums)
        return {name: sums[:, i] for i, name in enumerate(self._terms)}

    @property
    def step_reward(self) -> torch.Tensor:
        """Weighted terms of the last step, per second where they are scaled by dt, shape ``(num_envs, num_terms)``."""
        return self.context.torch(self._values)

    # -- between steps

    def compute(self) -> torch.Tensor:
        """Reward of the present state, float, shape ``(num_envs,)``. Sums of the episode and states of terms stay.

        Terms about ends of episodes read those of the last step.
        """
        with self._computed():
            return self.context.torch(self.context.reward).clone()

    def compute_terms(self) -> torch.Tensor:
        """Weighted terms of the present state, as :attr:`step_reward` has them, shape ``(num_envs, num_terms)``.

        Where rewards are scaled by the time step, these are not yet.
        """
        with self._computed():
            return self.step_reward.clone()

    def _computed(self) -> AbstractContextManager[None]:
        return self._outside.computed("rewards", self.compute_items, self.instance_states())

    # -- items

    def compute_items(self) -> list[Item]:
        """Items that evaluate the terms on the state after the physics."""
        scale = self.context.parameters.add("rewards.dt", self._dt, float)
        body, eager = list[Code](), list[Item]()
        values, begins, ends = list[Code](), list[Code](), list[Code]()
        for index, (name, term) in enumerate(self._terms.items()):
            weight = self.context.parameters.add(f"rewards.{name}.weight", term.weight, float)
            value = self._value(index, name, term, eager)
            if value is None:
                continue
            weighted = code("value_{}", index)
            body += _weighted(index, name, value)
            values.append(weighted)
            sum_ = code("{}[env, {}]", self._sums_name, index)
            begins += [code("weight_{} = {}", index, weight), code("sum_{} = {}", index, sum_)]
            ends += [
                code("{}[env, {}] = {}", self._values_name, index, weighted),
                code("{} = sum_{} + {} * scale", sum_, index, weighted),
            ]
        # All loads come first, all stores last. A store between two terms would stall the loads of the second, as the
        # compiler cannot know that they do not overlap. "+=" would be an atomic operation.
        body = [*begins, code("scale = {}", scale), *body, *ends]
        total = code(" + ".join(["{}"] * len(values)) or "0.0", *values)
        body.append(self.context.code("{reward}[env] = wp.where({nonfinite}[env], 0.0, ({}) * scale)", total))
        return [*eager, Section("rewards", body, self.active_terms)]

    def _value(self, index: int, name: str, term: RewardTermCfg, eager: list[Item]) -> Code | None:
        """Source code of a term's value before its weight; None after problems. A torch term is added to ``eager``."""
        if is_warp_term(term.func):
            call = bind_term(self.context, term.func, term.params, f"rewards.{name}", "reward")
            if call is None:
                return None
            value = call.expression()
        else:
            eager.append(HostFunction("rewards", self._torch(index, name), f"torch term '{name}'", [name]))
            value = code("{}[env, {}]", self._values_name, index)
        if term.clip is None:
            return value
        clip = self.context.parameters.add(f"rewards.{name}.clip", term.clip, wp.vec2)
        return code("wp.clamp({value}, ({clip})[0], ({clip})[1])", value=value, clip=clip)

    def reset_items(self) -> list[Item]:
        """Items that log the sums, divided by the longest duration of an episode, and clear them."""
        per_second = self.context.parameters.add("rewards.per_second", 1.0 / self.context.max_episode_length_s, float)
        begins, ends = [code("per_second = {}", per_second)], list[Code]()
        for index, name in enumerate(self._terms):
            sum_ = code("{}[env, {}]", self._sums_name, index)
            begins.append(code("sum_{} = {}", index, sum_))  # all loads first, as above
            ends.append(self.context.log.line(f"Episode_Reward/{name}", code("sum_{} * per_second", index)))
            ends.append(code("{} = 0.0", sum_))
        return [Section("rewards_log", [*begins, *ends]).only(self.context.is_reset)] if ends else []

    def _torch(self, index: int, name: str) -> Callable[[], None]:
        call = self.call(name)

        def evaluate() -> None:
            self.step_reward[:, index] = call.number_per_env(f"{self.name}.{name}")

        return evaluate

    def __str__(self) -> str:
        rows = [(i, n, t.weight) for i, (n, t) in enumerate(self._terms.items())]
        return self.table("Reward terms", ("Index", "Name", "Weight"), rows)


def _weighted(index: int, name: str, value: Code) -> list[Code]:
    """Lines that evaluate a term and multiply it by its weight, unless that is zero."""
    evaluate = code("value_{} = weight_{} * {}  # {}", index, index, value, name)
    return [
        code("value_{} = wp.float32(0.0)", index),
        *block(code("if weight_{} != 0.0:", index), [evaluate]),
    ]
