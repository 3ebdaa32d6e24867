# SPDX-License-Identifier: Apache-2.0
"""Event manager: terms that change environments at startup, at resets, at intervals or in every step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import ClassVar

import torch

from stripe_newton.configclass import MISSING
from stripe_newton.fusion import Code, HostFunction, Item, Section, code, single_thread

from .context import ManagerContext
from .event_cfg import EventTermCfg
from .event_source import EventSource
from .manager_base import is_warp_term, terms_of
from .model_events import ModelEvents
from .term_manager import TermManager

__all__ = ["EventManager", "prestartup_events"]

Indices = Callable[[], torch.Tensor]
"""Function that returns the environments that a torch term is called with, int64, shape ``(n,)``."""


class EventManager(TermManager[EventTermCfg]):
    """Runs event terms. Terms of one mode run in the order of the config, whose fields are :class:`EventTermCfg`.

    Terms that are Warp functions are fused; clocks and step counts are on the device. A curriculum may change these
    parameters: ``events.<term>.interval_range_s``, which affects the next time drawn,
    ``events.<term>.min_step_count_between_reset`` where it is not 0, and those of the terms.
    """

    name: ClassVar[str] = "events"
    FIXED = ("mode", "is_global_time")
    TORCH_ARGUMENTS = 1

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context, EventTermCfg)
        self._model = ModelEvents(context)
        for name, term in list(self._terms.items()):
            problems = [f"{self.name}.{name}.{field}: {text}" for field, text in _problems(term)]
            context.problems += problems
            if problems:
                del self._terms[name]

    def items(self) -> list[tuple[str, EventTermCfg]]:
        """Names and configs of the terms, in order."""
        return list(self._terms.items())

    # -- between steps

    def apply(self, mode: str, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Run the terms of a mode in some environments, whatever their clocks and step counts say.

        Args:
            mode: ``"startup"``, ``"reset"``, ``"interval"`` or ``"step"``.
            env_ids: The environments; None for all.

        Raises:
            ValueError: if there is no term of this mode.
        """
        terms = [name for name, term in self._terms.items() if term.mode == mode]
        if not terms:
            there = ", ".join(dict.fromkeys(term.mode for term in self._terms.values())) or "none"
            raise ValueError(f"events: there is no term of mode '{mode}'; there are {there}")
        self._outside.run_in(f"events_{mode}", lambda: self._chosen_items(terms), env_ids)

    @property
    def dynamics_terms(self) -> list[str]:
        """Names of the terms that change the model, such as masses and gains."""
        return [name for name, term in self._terms.items() if self._model.concerns(term.func)]

    def randomize_dynamics(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Run the terms that change the model, of all modes, in some environments; None means all of them."""
        self._outside.run_in("dynamics", lambda: self._chosen_items(self.dynamics_terms), env_ids)

    def _chosen_items(self, names: Sequence[str]) -> list[Item]:
        """Items that run terms in the environments of the reset mask."""
        items: list[Item] = []
        for name in names:
            term = self._terms[name]
            if is_warp_term(term.func):
                lines = EventSource(self.context, self._model, name, term).calls(term.func)
                lines = [code("# {}", name), *lines, self.context.code("{moved}[env] = True")]
                _append(items, Section("events_chosen", lines, [name]).only(self.context.is_reset))
            else:
                items.append(self._eager(term.mode, name, self.context.reset_mask.indices))
        return self._model.complete("chosen", items, last=True)

    # -- items

    def startup_items(self) -> list[Item]:
        """Items that run once, before the first reset, in all environments."""
        return self._everywhere("startup")

    def step_items(self) -> list[Item]:
        """Items that run in every step, in all environments. They set ``moved``."""
        return self._everywhere("step")

    def reset_items(self) -> list[Item]:
        """Items that run in the environments whose episode ended, and restart their interval clocks."""
        items: list[Item] = []
        ended = self.context.is_reset
        for name, term, source in self._of_mode("reset"):
            if is_warp_term(term.func):
                _append(items, Section("events_reset", source.reset_lines(term.func), [name]).only(ended))
            elif term.min_step_count_between_reset > 0:
                due, lines = source.mark_due()
                items.append(Section("events_reset_due", lines, [name]))
                items.append(self._eager("reset", name, _indices_of(self.context.torch(due))))
            else:
                items.append(self._eager("reset", name, self.context.reset_mask.indices))
        own_clocks = [s.clock_name for _, t, s in self._of_mode("interval") if not t.is_global_time]
        if own_clocks:
            _append(items, Section("events_clocks", [code("{}[env] = 0", c) for c in own_clocks]).only(ended))
        return self._model.complete("reset", items, last=not self._changes_model("interval", "step"))

    def interval_items(self) -> list[Item]:
        """Items that advance the clocks by a step and run the terms whose time is up. They set ``moved`` there."""
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
            items.append(self._eager("interval", name, _indices_where_zero(clock, count), moves=True))
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
                items.append(self._eager(mode, name, partial(_same, everyone), moves))
        return self._model.complete(mode, items, last=True)

    def _of_mode(self, mode: str) -> Iterator[tuple[str, EventTermCfg, EventSource]]:
        """Terms of a mode: name, config, source."""
        for name, term in self._terms.items():
            if term.mode == mode:
                yield name, term, EventSource(self.context, self._model, name, term)

    def _changes_model(self, *modes: str) -> bool:
        return any(t.mode in modes and self._model.concerns(t.func) for t in self._terms.values())

    def _eager(self, mode: str, name: str, indices: Indices, moves: bool = False) -> HostFunction:
        """Item that calls a torch term with some environments, unless there are none."""
        context = self.context
        moved = context.torch(context.moved)
        call = self.call(name)

        def run() -> None:
            env_ids = indices()
            if len(env_ids):
                if isinstance(call(env_ids), torch.Tensor):
                    raise ValueError(f"events.{name}.func: returned a tensor; an event returns nothing")
                context.config_watch.take()
                if moves:
                    moved[env_ids] = True

        return HostFunction(f"events_{mode}", run, f"torch term '{name}'", [name])

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


def prestartup_events(cfg: object, owner: object) -> list[HostFunction]:
    """Items of the terms with mode ``"prestartup"``, which change the stage before the model is built from it.

    Args:
        cfg: Config or dict of :class:`EventTermCfg`. Terms with problems are left out; :class:`EventManager` reports
            them.
        owner: The environment that the terms are called with; ``env_ids`` is None.
    """
    items = []
    for name, term in terms_of(cfg).items():
        if isinstance(term, EventTermCfg) and term.mode == "prestartup" and not any(_problems(term)):
            items.append(HostFunction("events_prestartup", partial(_call, term, owner), f"torch term '{name}'", [name]))
    return items


def _call(term: EventTermCfg, owner: object) -> None:
    term.func(owner, None, **term.params)


def _problems(term: EventTermCfg) -> Iterator[tuple[str, str]]:
    """Problems of a term, as field and message; checked here too, as a dict of terms has not been validated."""
    if term.mode is MISSING:
        yield "mode", "is missing, say when it runs"
    yield from term.problems()
    if term.mode == "prestartup" and is_warp_term(term.func):
        yield "func", "is a Warp function; before the model is built only torch functions (env, env_ids, ...) can run"


def _append(items: list[Item], section: Section) -> None:
    """Append a section, or join it to the last one if that has the same name."""
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
    """Function that returns the environments whose clock, one each or one for all, is at zero."""
    return lambda: (clock == 0).expand(count).nonzero().squeeze(-1)
