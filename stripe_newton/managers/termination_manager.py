# SPDX-License-Identifier: Apache-2.0
"""Termination manager: terms that end an episode, by failure, success or time limit.

The section that it generates for a time limit::

    terminated = wp.bool(nonfinite[env])
    truncated = wp.bool(False)
    term_0 = time_out(env, episode)  # time_out
    episode.term_terminated[env, 0] = term_0
    truncated = truncated or term_0
    episode.terminated[env] = terminated
    episode.truncated[env] = truncated
    reset[env] = terminated or truncated
    moved[env] = terminated or truncated
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import torch

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Code, HostFunction, Item, Section, bind_term, code

from .context import ManagerContext
from .manager_base import is_warp_term
from .term_manager import TermManager

__all__ = ["TerminationManager", "TerminationManagerCfg", "TerminationTermCfg"]


@configclass
class TerminationTermCfg:
    """Config of a termination term: a condition that ends an episode."""

    MAY_BE_NONE: ClassVar[bool] = True

    func: Callable[..., object] = MISSING
    """Warp function ``(env, ...) -> bool``, or torch function ``(env, **params)`` that returns bool ``(num_envs,)``."""
    params: dict[str, Any] = {}
    """Further arguments of the function."""
    time_out: bool = False
    """The term truncates the episode, as a time limit does, rather than terminates it."""


@configclass
class TerminationManagerCfg:
    """Config of the termination manager: a field for each term.

    Subclass it, or name them: ``TerminationManagerCfg(NAME=TerminationTermCfg(...))``.
    """

    OPEN: ClassVar[tuple[type, ...]] = (TerminationTermCfg,)


class TerminationManager(TermManager[TerminationTermCfg]):
    """Computes ``terminated``, ``truncated`` and their union ``reset``, and counts the causes."""

    name = "terminations"
    FIXED = ("time_out",)

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context, TerminationTermCfg)
        context.termination_names = list(self._terms)

    @property
    def terminated(self) -> torch.Tensor:
        """Environments that ended in failure or success, bool, shape ``(num_envs,)``."""
        return self.context.torch(self.context.episode.terminated)

    @property
    def time_outs(self) -> torch.Tensor:
        """Environments that were truncated, bool, shape ``(num_envs,)``."""
        return self.context.torch(self.context.episode.truncated)

    @property
    def dones(self) -> torch.Tensor:
        """Environments that ended either way, bool, shape ``(num_envs,)``."""
        return self.context.reset_mask.tensor

    def get_term(self, name: str) -> torch.Tensor:
        """Values of a term in the last step, bool, shape ``(num_envs,)``."""
        return self.context.torch(self.context.episode.term_terminated)[:, self.active_terms.index(name)]

    # -- between steps

    def compute(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Terminated and truncated by the present state, bool, shape ``(num_envs,)`` each. Nothing is reset."""
        with self._outside.computed("terminations", self.compute_items, self.instance_states()):
            return self.terminated.clone(), self.time_outs.clone()

    # -- items

    def compute_items(self) -> list[Item]:
        """Items that evaluate the terms on the state after the physics."""
        line, eager = self.context.code, list[Item]()
        body = [line("terminated = wp.bool({nonfinite}[env])"), line("truncated = wp.bool(False)")]
        for index, (name, term) in enumerate(self._terms.items()):
            value = self._value(index, name, term, body, eager)
            if value is not None:
                which = "truncated" if term.time_out else "terminated"
                body.append(code("{} = {} or {}", which, which, value))
        body += [
            line("{episode.terminated}[env] = terminated"),
            line("{episode.truncated}[env] = truncated"),
            line("{reset}[env] = terminated or truncated"),
            line("{moved}[env] = terminated or truncated"),
        ]
        return [*eager, Section("terminations", body, self.active_terms)]

    def _value(
        self, index: int, name: str, term: TerminationTermCfg, body: list[Code], eager: list[Item]
    ) -> Code | None:
        """Source code of a term's value; None after problems. Its computation is added to ``body`` or ``eager``."""
        kept = self.context.code("{episode.term_terminated}[env, {}]", index)
        if not is_warp_term(term.func):
            eager.append(HostFunction("terminations", self._torch(index, name), f"torch term '{name}'", [name]))
            return kept
        call = bind_term(self.context, term.func, term.params, f"{self.name}.{name}", "termination")
        if call is None:
            return None
        value = code("term_{}", index)
        body += [code("{} = {}  # {}", value, call.expression(), name), code("{} = {}", kept, value)]
        return value

    def reset_items(self) -> list[Item]:
        """Items that log how often each term ended an episode."""
        log, line = self.context.log, self.context.code
        lines = []
        for index, name in enumerate(self._terms):
            value = line("wp.where({episode.term_terminated}[env, {}], 1.0, 0.0)", index)
            lines.append(log.line(f"Episode_Termination/{name}", value, "count"))
        lines.append(log.line("Episode_Termination/non_finite", line("wp.where({nonfinite}[env], 1.0, 0.0)"), "count"))
        return [Section("terminations_log", lines).only(self.context.is_reset)]

    def _torch(self, index: int, name: str) -> Callable[[], None]:
        call = self.call(name)
        out = self.context.torch(self.context.episode.term_terminated)

        def evaluate() -> None:
            out[:, index] = call.number_per_env(f"{self.name}.{name}")

        return evaluate

    def __str__(self) -> str:
        rows = [(i, n, "truncated" if t.time_out else "terminated") for i, (n, t) in enumerate(self._terms.items())]
        return self.table("Termination terms", ("Index", "Name", "Ends as"), rows)
