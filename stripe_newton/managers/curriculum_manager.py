# SPDX-License-Identifier: Apache-2.0
"""Curriculum manager: terms that change a task in the course of training."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import warp as wp

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Code, HostFunction, Item, Section, bind_term, single_thread

from .context import ManagerContext
from .manager_base import is_warp_term
from .term_manager import TermManager
from .terrain_checks import check_terrain

__all__ = ["CurriculumManager", "CurriculumManagerCfg", "CurriculumTermCfg"]


@configclass
class CurriculumTermCfg:
    """Config of a curriculum term: a function that changes the task in the course of training."""

    MAY_BE_NONE: ClassVar[bool] = True

    func: Callable[..., object] = MISSING
    """Warp function ``(env, ...) -> float`` that runs for each environment whose episode ended, Warp function without
    ``env`` that one thread runs in every step, or torch function ``(env, env_ids, **params)`` that returns a number, a
    dict of numbers or None."""
    params: dict[str, Any] = {}
    """Further arguments of the function."""


@configclass
class CurriculumManagerCfg:
    """Config of the curriculum manager: a field for each term.

    Subclass it, or name them: ``CurriculumManagerCfg(NAME=CurriculumTermCfg(...))``.
    """

    OPEN: ClassVar[tuple[type, ...]] = (CurriculumTermCfg,)


class CurriculumManager(TermManager[CurriculumTermCfg]):
    """Runs curriculum terms and logs their results as ``Curriculum/<term>``.

    A term with the argument ``env`` runs for environments whose episode ended, before the reset, except where the world
    was not finite. The mean over these environments is logged. A term without ``env`` runs once at the end of a step
    and takes effect in the next. Its argument ``memory: wp.array[float]`` is one number that lasts, NaN at first.
    """

    name: ClassVar[str] = "curriculum"
    TORCH_ARGUMENTS = 1

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context, CurriculumTermCfg)

    # -- items

    def compute_items(self) -> list[Item]:
        """Items that run terms with ``env``, and torch terms, for environments whose episodes ended."""
        items: list[Item] = []
        for name, term in self._terms.items():
            if not is_warp_term(term.func):
                items.append(HostFunction("curriculum", self._torch(name), f"torch term '{name}'", [name]))
                continue
            value = self._value(name, term, term.func) if _is_per_env(term.func) else None
            if value is not None:
                line = self.context.log.line(f"Curriculum/{name}", value, "mean")
                items.append(Section("curriculum", [line], [name]).only(self.context.is_reset))
        return items

    def update_items(self) -> list[Item]:
        """The item that runs the terms without ``env`` in one thread.

        It belongs at the end of the step, before the log is finished. Make it after the items of all other managers, so
        that every parameter that a term may change exists.
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

    def _value(self, name: str, term: CurriculumTermCfg, func: wp.Function) -> Code | None:
        """Source of a Warp term's value; None after problems."""
        context, where, fixed = self.context, f"{self.name}.{name}", dict[str, Code]()
        check_terrain(context, where, func)
        if "memory" in func.input_types and "memory" not in term.params and not _is_per_env(func):
            memory = context.shared(f"{where}.memory", float, 1, fill=math.nan)
            fixed["memory"] = context.scope.name(f"{self.name}_{name}_memory", memory)
        call = bind_term(context, func, term.params, where, "curriculum", fixed)
        return None if call is None else call.expression()

    def _torch(self, name: str) -> Callable[[], None]:
        context, call = self.context, self.call(name)

        def run() -> None:
            env_ids = context.reset_mask.indices()
            if not len(env_ids):
                return
            value = call(env_ids)
            context.config_watch.take()
            if isinstance(value, Mapping):
                for key, part in value.items():
                    context.log_now(f"Curriculum/{name}/{key}", part)
            elif value is not None:
                context.log_now(f"Curriculum/{name}", value)

        return run

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
