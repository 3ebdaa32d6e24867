# SPDX-License-Identifier: Apache-2.0
"""Event manager: terms that change environments at startup, at resets, at intervals or in every step."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import ClassVar

import torch

from stripe_newton.configclass import MISSING
from stripe_newton.fusion import Code, Eager, Item, Section, code, resolve_entities, single_thread

from .context import ManagerContext
from .event_cfg import EventTermCfg
from .event_source import EventSource
from .manager_base import ManagerBase, is_warp_term, terms_of
from .model_events import ModelEvents

__all__ = ["EventManager", "prestartup_events"]

Indices = Callable[[], torch.Tensor]
"""Gives the environments that a torch term is called with, int64, shape ``(n,)``."""


class EventManager(ManagerBase):
    """Runs events. A config's fields are :class:`EventTermCfg`; terms of a mode run in the config's order.

    Terms that are Warp functions are fused, clocks and step counts are kept on the device. Numbers that may be changed
    are parameters: ``events.<term>.interval_range_s``, which holds from the next time drawn on,
    ``events.<term>.min_step_count_between_reset`` where it is not 0, and the terms' own.
    """

    name: ClassVar[str] = "events"

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context)
        self._model = ModelEvents(context)
        self._terms: dict[str, EventTermCfg] = {}
        for name, term in self.terms(cfg, EventTermCfg).items():
            problems = [f"{self.name}.{name}.{field}: {text}" for field, text in _problems(term)]
            context.problems += problems
            if not problems:
                self._terms[name] = term

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    # -- items

    def startup(self) -> list[Item]:
        """Items that run once, in all environments."""
        return self._everywhere("startup")

    def step(self) -> list[Item]:
        """Items that run in every step, in all environments; ``moved`` is set."""
        return self._everywhere("step")

    def reset(self) -> list[Item]:
        """Items that run in the environments whose episode ended, and restart their interval clocks."""
        items: list[Item] = []
        ended = self.context.is_reset
        for name, term, source in self._of_mode("reset"):
            if is_warp_term(term.func):
                _append(items, Section("events_reset", source.reset_lines(term.func), [name]).only(ended))
            elif term.min_step_count_between_reset > 0:
                due, lines = source.mark_due()
                items.append(Section("events_reset_due", lines, [name]))
                items.append(self._eager("reset", name, term, _indices_of(self.context.torch(due))))
            else:
                items.append(self._eager("reset", name, term, self.context.reset_mask.indices))
        own_clocks = [s.clock_name for _, t, s in self._of_mode("interval") if not t.is_global_time]
        if own_clocks:
            _append(items, Section("events_clocks", [code("{}[env] = 0", c) for c in own_clocks]).only(ended))
        return self._model.complete("reset", items, last=not self._changes_model("interval", "step"))

    def interval(self) -> list[Item]:
        """Items that let a step pass on the clocks, and run the terms whose time is up; ``moved`` is set there."""
        items: list[Item] = []
        ticks = {name: source.tick() for name, term, source in self._of_mode("interval") if term.is_global_time}
        if ticks:
            scope, device = self.context.scope, self.context.device
            items.append(single_thread(scope, device, "events_global_clocks", list(ticks.values()), list(ticks)))
        for name, term, source in self._of_mode("interval"):
            if is_warp_term(term.func):
                _append(items, Section("events_interval", source.interval_lines(term.func), [name]))
                continue
            if not term.is_global_time:
                _append(items, Section("events_interval", [source.tick()], [name]))
            clock, count = self.context.torch(source.clock), self.context.num_envs
            items.append(self._eager("interval", name, term, _indices_where_zero(clock, count), moves=True))
        return self._model.complete("interval", items, last=not self._changes_model("step"))

    def _everywhere(self, mode: str) -> list[Item]:
        items: list[Item] = []
        moves = mode == "step"
        for name, term, source in self._of_mode(mode):
            if is_warp_term(term.func):
                moved = [self.context.code("{moved}[env] = True")] if moves else list[Code]()
                lines = [code("# {}", name), *source.calls(term.func), *moved]
                _append(items, Section(f"events_{mode}", lines, [name]))
            else:
                everyone = torch.arange(self.context.num_envs, device=self.context.device)
                items.append(self._eager(mode, name, term, partial(_same, everyone), moves))
        return self._model.complete(mode, items, last=True)

    # -- parts of them

    def _of_mode(self, mode: str) -> Iterator[tuple[str, EventTermCfg, EventSource]]:
        """Terms of a mode: name, config, source."""
        for name, term in self._terms.items():
            if term.mode == mode:
                yield name, term, EventSource(self.context, self._model, name, term)

    def _changes_model(self, *modes: str) -> bool:
        return any(t.mode in modes and self._model.concerns(t.func) for t in self._terms.values())

    def _eager(self, mode: str, name: str, term: EventTermCfg, indices: Indices, moves: bool = False) -> Eager:
        """A torch term, called with some environments where there are any."""
        context = self.context
        moved = context.torch(context.moved)
        params = resolve_entities(term.params, context.scene.__getitem__)

        def run() -> None:
            env_ids = indices()
            if len(env_ids):
                term.func(context.owner, env_ids, **params)
                if moves:
                    moved[env_ids] = True

        return Eager(f"events_{mode}", run, f"torch term '{name}'", [name])

    def __str__(self) -> str:
        rows = []
        for name, term in self._terms.items():
            when = ""
            if term.mode == "interval" and term.interval_range_s is not None:
                low, high = term.interval_range_s
                when = f"every {low:g} to {high:g} s" + (", one clock for all" if term.is_global_time else "")
            elif term.mode == "reset" and term.min_step_count_between_reset:
                when = f"after {term.min_step_count_between_reset} steps at the earliest"
            rows.append((name, term.mode, when, "Warp" if is_warp_term(term.func) else "torch"))
        return self.table("Event terms", ("Name", "Mode", "When", "Kind"), rows)


def prestartup_events(cfg: object, owner: object) -> list[Eager]:
    """Items of the terms with mode ``"prestartup"``, which change the stage before the model is built from it.

    Args:
        cfg: Config or dict of :class:`EventTermCfg`; what is wrong with it an event manager reports.
        owner: What the terms get as their environment; ``env_ids`` is None.
    """
    items = []
    for name, term in terms_of(cfg).items():
        if isinstance(term, EventTermCfg) and term.mode == "prestartup" and not any(_problems(term)):
            items.append(Eager("events_prestartup", partial(_call, term, owner), f"torch term '{name}'", [name]))
    return items


def _call(term: EventTermCfg, owner: object) -> None:
    term.func(owner, None, **term.params)


def _problems(term: EventTermCfg) -> Iterator[tuple[str, str]]:
    """What is wrong with a term, also where the config was not validated."""
    if term.mode is MISSING:
        yield "mode", "is missing, say when it runs"
    yield from term.problems()
    if term.mode == "prestartup" and is_warp_term(term.func):
        yield "func", "is a Warp function; before the model is built only torch functions (env, env_ids, ...) can run"


def _append(items: list[Item], section: Section) -> None:
    """Add a section, to the one before where that is of the same kind."""
    last = items[-1] if items else None
    if isinstance(last, Section) and last.name == section.name:
        items[-1] = last.joined(section)
    else:
        items.append(section)


def _same(indices: torch.Tensor) -> torch.Tensor:
    return indices


def _indices_of(mask: torch.Tensor) -> Indices:
    return lambda: mask.nonzero().squeeze(-1)


def _indices_where_zero(clock: torch.Tensor, count: int) -> Indices:
    """Environments whose clock, of their own or for all, is at zero."""
    return lambda: (clock == 0).expand(count).nonzero().squeeze(-1)
