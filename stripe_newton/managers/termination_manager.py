# SPDX-License-Identifier: Apache-2.0
"""When an episode ends."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
import warp as wp

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Eager, Item, Section, bind_term

from .context import ManagerContext
from .manager_base import ManagerBase, is_warp_term

__all__ = ["TerminationManager", "TerminationTermCfg"]


@configclass
class TerminationTermCfg:
    """One reason for an episode to end."""

    func: Callable[..., Any] = MISSING
    """Warp function ``(env, ...) -> bool``, or torch function ``(env, **params)`` that returns bool ``(num_envs,)``."""
    params: dict[str, Any] = {}
    """Its further arguments."""
    time_out: bool = False
    """Whether it cuts the episode off (truncated) rather than ends it (terminated)."""


class TerminationManager(ManagerBase):
    """Computes ``terminated``, ``truncated`` and their union ``reset``, and counts the causes."""

    name = "terminations"

    def __init__(self, cfg: Any, context: ManagerContext):
        super().__init__(cfg, context)
        self._terms: dict[str, TerminationTermCfg] = self.terms(cfg, TerminationTermCfg)
        context.termination_names = list(self._terms)
        self.nonfinite = context.array("nonfinite", wp.bool)
        context.scope.name("nonfinite", self.nonfinite)

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    @property
    def terminated(self) -> torch.Tensor:
        """Environments that ended in failure or success, bool, shape ``(num_envs,)``."""
        return self.context.torch(self.context.episode.terminated)

    @property
    def time_outs(self) -> torch.Tensor:
        """Environments that were cut off, bool, shape ``(num_envs,)``."""
        return self.context.torch(self.context.episode.truncated)

    @property
    def dones(self) -> torch.Tensor:
        """Environments that ended either way, bool, shape ``(num_envs,)``."""
        return self.context.torch(self.context.reset)

    def get_term(self, name: str) -> torch.Tensor:
        """What a term said in the last step, bool, shape ``(num_envs,)``."""
        return self.context.torch(self.context.episode.term_terminated)[:, self.active_terms.index(name)]

    def compute(self) -> list[Item]:
        """Items that evaluate the terms on the state after the physics."""
        eager: list[Item] = []
        body = ["terminated = wp.bool(nonfinite[env])", "truncated = wp.bool(False)"]
        for index, (name, term) in enumerate(self._terms.items()):
            if not is_warp_term(term.func):
                eager.append(Eager("terminations", self._torch(index, term), f"torch term '{name}'", [name]))
                value = f"episode.term_terminated[env, {index}]"
            else:
                call = bind_term(self.context, term.func, term.params, f"{self.name}.{name}", "termination")
                if call is None:
                    continue
                body.append(f"term_{index} = {call.expression()}  # {name}")
                body.append(f"episode.term_terminated[env, {index}] = term_{index}")
                value = f"term_{index}"
            which = "truncated" if term.time_out else "terminated"
            body.append(f"{which} = {which} or {value}")
        body += [
            "episode.terminated[env] = terminated",
            "episode.truncated[env] = truncated",
            "reset[env] = terminated or truncated",
            "moved[env] = terminated or truncated",
        ]
        return [*eager, Section("terminations", body, self.active_terms)]

    def reset(self) -> list[Item]:
        """Items that log what ended the episodes."""
        lines = []
        for index, name in enumerate(self._terms):
            value = f"wp.where(episode.term_terminated[env, {index}], 1.0, 0.0)"
            lines.append(self.context.log.line(f"Episode_Termination/{name}", value, "count"))
        lines.append(
            self.context.log.line("Episode_Termination/non_finite", "wp.where(nonfinite[env], 1.0, 0.0)", "count")
        )
        return [Section("terminations_log", lines, where_reset=True)]

    def _torch(self, index: int, term: TerminationTermCfg) -> Callable[[], None]:
        call = self.torch_term(term.func, term.params)
        out = self.context.torch(self.context.episode.term_terminated)

        def evaluate() -> None:
            out[:, index] = call()

        return evaluate

    def __str__(self) -> str:
        rows = [(i, n, "truncated" if t.time_out else "terminated") for i, (n, t) in enumerate(self._terms.items())]
        return self.table("Termination terms", ("Index", "Name", "Ends as"), rows)
