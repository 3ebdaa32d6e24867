# SPDX-License-Identifier: Apache-2.0
"""Event source: source code of event terms, with the clocks and step counts that decide when they are due.

The section of interval events with a push::

    if interval_is_due(env, rng, events_push_robot_clock, wp.vec2(parameters[41], parameters[42]), episode.step_dt):
        push_by_setting_velocity(env, robot, rng, events_push_robot_velocity_range)
        moved[env] = True
"""

from __future__ import annotations

from collections.abc import Iterable

import warp as wp

from stripe_kernels.mdp import events as mdp
from stripe_kernels.term_info import is_for_each_asset
from stripe_newton.fusion import Code, SceneEntityCfg, bind_term, block, code

from .context import ManagerContext
from .event_cfg import EventTermCfg
from .model_events import ModelEvents
from .terrain_checks import check_terrain

__all__ = ["EventSource"]


class EventSource:
    """Source code of one event term."""

    def __init__(self, context: ManagerContext, model: ModelEvents, name: str, cfg: EventTermCfg):
        self._context, self._model, self._name, self._cfg = context, model, name, cfg
        self._path = f"events.{name}"

    def calls(self, func: wp.Function) -> list[Code]:
        """Lines that call a Warp term and, where it changes the model, mark the environment for the solver."""
        check_terrain(self._context, self._path, func)
        calls = [bind_term(self._context, func, p, self._path, "event") for p in self._params(func)]
        lines = [call.expression() for call in calls if call is not None]
        return [*lines, *self._model.mark(func)] if lines else []

    def _params(self, func: wp.Function) -> Iterable[dict[str, object]]:
        """Parameters of each call of a Warp term; some terms are called once for each asset."""
        given = self._cfg.params
        if is_for_each_asset(func) and not given.keys() & {"asset_cfg", "robot", "robot_cfg"}:
            return [{**given, "asset_cfg": SceneEntityCfg(name)} for name in self._context.entity_names()]
        if self._model.concerns(func):
            found = self._model.resolve(self._path, self._cfg, func)
            return [found] if found is not None else []
        return [given]

    # -- clocks and step counts

    @property
    def clock(self) -> wp.array:
        """Steps until the term is due, int32, for each environment or one for all. 0: due, or a time is to be drawn."""
        path = f"{self._path}.steps_left"
        return self._context.shared(path, int, 1) if self._cfg.is_global_time else self._context.array(path, int)

    @property
    def clock_name(self) -> Code:
        """Name of :attr:`clock` in the source."""
        return self._context.scope.name(f"events_{self._name}_clock", self.clock)

    def tick(self) -> Code:
        """Expression that advances the clock by a step and is true where the time is up."""
        context = self._context
        assert self._cfg.interval_range_s is not None  # its checks have passed
        bounds = context.parameters.add(f"{self._path}.interval_range_s", self._cfg.interval_range_s, wp.vec2)
        step_dt = context.code("{episode.step_dt}")
        return context.scope.call(mdp.interval_is_due, "env", context.code("{rng}"), self.clock_name, bounds, step_dt)

    def interval_lines(self, func: wp.Function) -> list[Code]:
        """Lines that run a Warp term where its time is up, and set ``moved``, as it may have moved assets."""
        due = code("{}[0] == 0", self.clock_name) if self._cfg.is_global_time else self.tick()
        moved = self._context.code("{moved}[env] = True")
        return block(code("if {}:  # {}", due, self._name), [*self.calls(func), moved])

    def reset_lines(self, func: wp.Function) -> list[Code]:
        """Lines that run a Warp term where an episode ended, unless it ran too few steps ago."""
        lines = self.calls(func)
        if self._cfg.min_step_count_between_reset > 0 and lines:
            lines = block(code("if {}:", self.reset_is_due()), lines)
        return [code("# {}", self._name), *lines]

    def reset_is_due(self) -> Code:
        """Expression that is true where enough steps have passed since the term last ran."""
        context, path = self._context, f"{self._path}.min_step_count_between_reset"
        steps = context.parameters.add(path, self._cfg.min_step_count_between_reset, int)
        last_run = context.array(f"{self._path}.last_run", wp.int64)
        last = context.scope.name(f"events_{self._name}_last_run", last_run)
        return context.scope.call(mdp.reset_is_due, "env", context.code("{step}"), last, steps)

    def mark_due(self) -> tuple[wp.array, list[Code]]:
        """A mask of the environments where a torch term is due at a reset, and the lines that write it."""
        due = self._context.array(f"{self._path}.due", wp.bool)
        name = self._context.scope.name(f"events_{self._name}_due", due)
        ended = self._context.code("if {reset}[env]:")
        write = block(ended, [code("{}[env] = {}", name, self.reset_is_due())])
        return due, [code("{}[env] = False", name), *write]
