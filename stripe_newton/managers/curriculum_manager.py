# SPDX-License-Identifier: Apache-2.0
"""Curriculum manager: terms that change a task as training goes on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import torch
import warp as wp

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Code, Eager, Item, Section, bind_term, resolve_entities, single_thread

from .context import ManagerContext
from .manager_base import ManagerBase, is_warp_term
from .terrain_checks import check_terrain

__all__ = ["CurriculumManager", "CurriculumTermCfg"]


@configclass
class CurriculumTermCfg:
    """One thing that changes as training goes on."""

    func: Callable[..., object] = MISSING
    """Warp function ``(env, ...) -> float`` of an environment whose episode ended, or Warp function without ``env``
    that one thread runs in every step, or torch function ``(env, env_ids, **params)`` that returns a number, a dict of
    numbers or None."""
    params: dict[str, Any] = {}
    """Its further arguments."""


class CurriculumManager(ManagerBase):
    """Runs curriculum terms and logs what they return as ``Curriculum/<term>``.

    A term that begins with ``env`` runs where episodes ended, before the reset, but not where the world was no longer
    finite; the mean over those environments is logged. One without runs once a step, at the end, and takes effect from
    the next step on. Its argument ``memory: wp.array[float]`` is one number of its own that lasts, NaN at first.
    """

    name: ClassVar[str] = "curriculum"

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context)
        self._terms = self.terms(cfg, CurriculumTermCfg)

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    # -- items

    def compute(self) -> list[Item]:
        """Items that run the terms of environments, and torch terms, where episodes ended."""
        items: list[Item] = []
        for name, term in self._terms.items():
            if not is_warp_term(term.func):
                items.append(Eager("curriculum", self._torch(name, term), f"torch term '{name}'", [name]))
                continue
            value = self._value(name, term, term.func) if _is_per_env(term.func) else None
            if value is not None:
                line = self.context.log.line(f"Curriculum/{name}", value, "mean")
                items.append(Section("curriculum", [line], [name]).only(self.context.is_reset))
        return items

    def update(self) -> list[Item]:
        """The item that runs the terms without ``env``, one thread.

        It goes to the end of the step, before the log is finished. Ask for it after all other managers' items, so that
        every parameter exists.
        """
        body, names = list[Code](), list[str]()
        for name, term in self._terms.items():
            if not is_warp_term(term.func) or _is_per_env(term.func):
                continue
            value = self._value(name, term, term.func)
            if value is not None:
                body.append(self.context.log.line(f"Curriculum/{name}", value, "last"))
                names.append(name)
        return [single_thread(self.context.scope, self.context.device, "curriculum", body, names)] if names else []

    # -- parts of them

    def _value(self, name: str, term: CurriculumTermCfg, func: wp.Function) -> Code | None:
        """Source of a Warp term's value; None after problems."""
        context, where, fixed = self.context, f"{self.name}.{name}", dict[str, Code]()
        check_terrain(context, where, func)
        if "memory" in func.input_types and "memory" not in term.params and not _is_per_env(func):
            memory = context.shared(f"{where}.memory", float, 1, fill=math.nan)
            fixed["memory"] = context.scope.name(f"{self.name}_{name}_memory", memory)
        call = bind_term(context, func, term.params, where, "curriculum", fixed)
        return None if call is None else call.expression()

    def _torch(self, name: str, term: CurriculumTermCfg) -> Callable[[], None]:
        context = self.context
        params = resolve_entities(term.params, context.scene.__getitem__)

        def run() -> None:
            env_ids = context.reset_mask.indices()
            if not len(env_ids):
                return
            value = term.func(context.owner, env_ids, **params)
            if isinstance(value, Mapping):
                for key, part in value.items():
                    self._log(f"Curriculum/{name}/{key}", part)
            elif value is not None:
                self._log(f"Curriculum/{name}", value)

        return run

    def _log(self, key: str, value: object) -> None:
        """Hand out a value from now on. It bypasses the sums: the graph that finishes them may not know the key."""
        log = self.context.log
        index = log.add(key, "last")
        self.context.torch(log.values)[index] = torch.as_tensor(value)

    def __str__(self) -> str:
        rows = []
        for name, term in self._terms.items():
            if not is_warp_term(term.func):
                rows.append((name, "torch", "when episodes end"))
            else:
                rows.append((name, "Warp", "where an episode ends" if _is_per_env(term.func) else "in every step"))
        return self.table("Curriculum terms", ("Name", "Kind", "When"), rows)


def _is_per_env(func: wp.Function) -> bool:
    return "env" in func.input_types
