# SPDX-License-Identifier: Apache-2.0
"""What happens to environments beside the physics: at the start, at resets, from time to time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, ClassVar

import torch
import warp as wp

from stripe_kernels.mdp import events as mdp
from stripe_newton.configclass import MISSING
from stripe_newton.fusion import Eager, Item, SceneEntityCfg, Section, bind_term, resolve_entities, single_thread

from .context import ManagerContext
from .event_cfg import EventTermCfg
from .manager_base import ManagerBase, is_warp_term
from .model_events import ModelEvents
from .terrain_checks import check_terrain

__all__ = ["EventManager", "prestartup_events"]


class EventManager(ManagerBase):
    """Runs events. A config's fields are :class:`EventTermCfg`; terms of a mode run in the config's order.

    Terms that are Warp functions are fused, clocks and step counts are kept on the device. Numbers that may be changed
    are parameters: ``events.<term>.interval_range_s``, which holds from the next time drawn on,
    ``events.<term>.min_step_count_between_reset`` where it is not 0, and the terms' own.
    """

    name: ClassVar[str] = "events"

    def __init__(self, cfg: Any, context: ManagerContext):
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

    def prestartup(self) -> list[Eager]:
        """Items that run before the model is built; see :func:`prestartup_events`."""
        return prestartup_events(self._terms, self.context.owner)

    def startup(self) -> list[Item]:
        """Items that run once, in all environments."""
        return self._everywhere("startup")

    def step(self) -> list[Item]:
        """Items that run in every step, in all environments; ``moved`` is set."""
        return self._everywhere("step")

    def reset(self) -> list[Item]:
        """Items that run in the environments whose episode ended, and restart their interval clocks."""
        items: list[Item] = []
        for name, term in self._of_mode("reset"):
            spaced = term.min_step_count_between_reset > 0
            if is_warp_term(term.func):
                lines = self._calls(name, term)
                if spaced and lines:
                    lines = [f"if {self._reset_is_due(name, term)}:", *_indent(lines)]
                _append(items, Section("events_reset", [f"# {name}", *lines], [name], where_reset=True))
                continue
            mask = self.context.torch(self.context.reset)
            if spaced:
                due = self.context.array(f"events.{name}.due", wp.bool)
                due_name, is_due = self._scope(f"{name}_due", due), self._reset_is_due(name, term)
                lines = [f"{due_name}[env] = False", "if reset[env]:", f"    {due_name}[env] = {is_due}"]
                items.append(Section("events_reset_due", lines, [name]))
                mask = self.context.torch(due)
            items.append(self._eager("reset", name, term, partial(_same, mask)))
        clocks = [f"{self._clock(n)}[env] = 0" for n, t in self._of_mode("interval") if not t.is_global_time]
        if clocks:
            _append(items, Section("events_clocks", clocks, where_reset=True))
        return self._model.complete("reset", items, last=not self._changes_model("interval", "step"))

    def interval(self) -> list[Item]:
        """Items that let a step pass on the clocks, and run the terms whose time is up; ``moved`` is set there."""
        items: list[Item] = []
        ticks = [self._interval_is_due(n, t) for n, t in self._of_mode("interval") if t.is_global_time]
        if ticks:
            names = [n for n, t in self._of_mode("interval") if t.is_global_time]
            items.append(single_thread(self.context, "events_global_clocks", ticks, names))
        for name, term in self._of_mode("interval"):
            clock = self._clock(name)
            due = f"{clock}[0] == 0" if term.is_global_time else self._interval_is_due(name, term)
            if is_warp_term(term.func):
                lines = [f"if {due}:  # {name}", *_indent([*self._calls(name, term), "moved[env] = True"])]
                _append(items, Section("events_interval", lines, [name]))
                continue
            if not term.is_global_time:
                _append(items, Section("events_interval", [due], [name]))
            items.append(self._eager("interval", name, term, self._time_is_up(name), moves=True))
        return self._model.complete("interval", items, last=not self._changes_model("step"))

    def _everywhere(self, mode: str) -> list[Item]:
        items: list[Item] = []
        moves = mode == "step"
        for name, term in self._of_mode(mode):
            if is_warp_term(term.func):
                lines = [*self._calls(name, term), *(["moved[env] = True"] if moves else [])]
                _append(items, Section(f"events_{mode}", [f"# {name}", *lines], [name]))
            else:
                everyone = torch.ones(self.context.num_envs, dtype=torch.bool, device=self.context.device)
                items.append(self._eager(mode, name, term, partial(_same, everyone), moves))
        return self._model.complete(mode, items, last=True)

    # -- parts of them

    def _of_mode(self, mode: str) -> Iterator[tuple[str, EventTermCfg]]:
        return ((n, t) for n, t in self._terms.items() if t.mode == mode)

    def _scope(self, wish: str, array: wp.array) -> str:
        return self.context.scope.name(f"events_{wish}", array)

    def _calls(self, name: str, term: EventTermCfg) -> list[str]:
        """Lines that call a Warp term; ``reset_scene_to_default`` that names no asset is called for each."""
        params = [term.params]
        check_terrain(self.context, f"{self.name}.{name}", term.func)
        if term.func is mdp.reset_scene_to_default and not term.params.keys() & {"asset_cfg", "robot", "robot_cfg"}:
            params = [{**term.params, "asset_cfg": SceneEntityCfg(n)} for n in self.context.entity_names()]
        elif self._model.concerns(term.func):
            found = self._model.resolve(f"{self.name}.{name}", term)
            params = [found] if found is not None else []
        calls = [bind_term(self.context, term.func, p, f"{self.name}.{name}", "event") for p in params]
        lines = [c.expression() for c in calls if c is not None]
        return [*lines, *self._model.mark(term.func)] if lines else []

    def _changes_model(self, *modes: str) -> bool:
        return any(t.mode in modes and self._model.concerns(t.func) for t in self._terms.values())

    def _clock(self, name: str) -> str:
        """Name of the array of steps until a term is due; 0 where its time is up or is to be drawn."""
        context, is_global = self.context, self._terms[name].is_global_time
        path = f"{self.name}.{name}.steps_left"
        return self._scope(f"{name}_clock", context.shared(path, int, 1) if is_global else context.array(path, int))

    def _interval_is_due(self, name: str, term: EventTermCfg) -> str:
        bounds = self.context.parameters.add(f"{self.name}.{name}.interval_range_s", term.interval_range_s, wp.vec2)
        function = self.context.scope.function(mdp.interval_is_due)
        return f"{function}(env, rng, {self._clock(name)}, {bounds}, episode.step_dt)"

    def _time_is_up(self, name: str) -> Callable[[], torch.Tensor]:
        self._clock(name)
        clock, count = self.context.torch(self.context.arrays[f"{self.name}.{name}.steps_left"]), self.context.num_envs
        return lambda: (clock == 0).expand(count)

    def _reset_is_due(self, name: str, term: EventTermCfg) -> str:
        path = f"{self.name}.{name}.min_step_count_between_reset"
        steps = self.context.parameters.add(path, term.min_step_count_between_reset, int)
        last = self._scope(f"{name}_last_run", self.context.array(f"{self.name}.{name}.last_run", wp.int64))
        return f"{self.context.scope.function(mdp.reset_is_due)}(env, step, {last}, {steps})"

    def _eager(
        self, mode: str, name: str, term: EventTermCfg, mask: Callable[[], torch.Tensor], moves: bool = False
    ) -> Eager:
        """A torch term, called with the environments of a mask where there are any."""
        context = self.context
        moved = context.torch(context.moved)
        params = resolve_entities(term.params, context.scene.__getitem__)

        def run() -> None:
            env_ids = mask().nonzero().squeeze(-1)
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


def prestartup_events(cfg: Any, owner: Any) -> list[Eager]:
    """Items of the terms with mode ``"prestartup"``, which change the stage before the model is built from it.

    Args:
        cfg: Config or dict of :class:`EventTermCfg`; what is wrong with it an event manager reports.
        owner: What the terms get as their environment; ``env_ids`` is None.
    """
    named = cfg if isinstance(cfg, Mapping) else {n: getattr(cfg, n) for n in getattr(cfg, "__dataclass_fields__", ())}
    items = []
    for name, term in named.items():
        if isinstance(term, EventTermCfg) and term.mode == "prestartup" and not any(_problems(term)):
            call = partial(term.func, owner, None, **term.params)
            items.append(Eager("events_prestartup", call, f"torch term '{name}'", [name]))
    return items


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
        last.body, last.terms = [*last.body, *section.body], [*last.terms, *section.terms]
    else:
        items.append(section)


def _same(mask: torch.Tensor) -> torch.Tensor:
    return mask


def _indent(lines: list[str]) -> list[str]:
    return [f"    {line}" for line in lines]
