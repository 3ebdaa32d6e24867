# SPDX-License-Identifier: Apache-2.0
"""Events: functions of the environment that run at startup, at resets or at intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import torch

from stripe_newton.configclass import MISSING, configclass

__all__ = ["EventRunner", "EventTermCfg"]

_MODES = ("startup", "reset", "interval")


@configclass
class EventTermCfg:
    """One event: ``func(env, env_ids, **params)`` is called with an int64 tensor of environments."""

    func: Callable[..., None] = MISSING
    """The function."""
    params: dict[str, Any] = {}
    """Its further arguments."""
    mode: str = MISSING
    """``"startup"``, ``"reset"`` or ``"interval"``."""
    interval_range_s: tuple[float, float] | None = None
    """Bounds of the time between two calls [s], drawn uniformly; for mode ``"interval"``."""
    is_global_time: bool = False
    """One clock for all environments rather than one each; it is not restarted by resets."""
    min_step_count_between_reset: int = 0
    """Environment steps that must lie between two calls for the same environment; for mode ``"reset"``."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.mode is not MISSING and self.mode not in _MODES:
            yield "mode", f"is '{self.mode}', must be one of {', '.join(_MODES)}"
        bounds = self.interval_range_s
        if self.mode == "interval" and (bounds is None or not 0 < bounds[0] <= bounds[1]):
            yield "interval_range_s", f"is {bounds}, must be (low, high) with 0 < low <= high [s]"


class EventRunner:
    """Runs the event terms of a config: an object whose fields are :class:`EventTermCfg`, or a dict of them."""

    def __init__(self, cfg: Any, env: Any):
        self._env = env
        terms = cfg if isinstance(cfg, dict) else {k: getattr(cfg, k) for k in type(cfg).__dataclass_fields__}
        self._terms: dict[str, EventTermCfg] = {k: v for k, v in terms.items() if v is not None}
        self._time_left: dict[str, torch.Tensor] = {}
        self._last_step: dict[str, torch.Tensor] = {}
        for name, term in self._terms.items():
            count = 1 if term.is_global_time else env.num_envs
            if term.mode == "interval":
                self._time_left[name] = self._draw(term, count)
            self._last_step[name] = torch.full((env.num_envs,), -(10**9), device=env.device)

    def _draw(self, term: EventTermCfg, count: int) -> torch.Tensor:
        low, high = term.interval_range_s or (0.0, 0.0)
        return low + (high - low) * torch.rand(count, device=self._env.device)

    def startup(self) -> None:
        """Run the startup terms on all environments."""
        for term in self._terms.values():
            if term.mode == "startup":
                term.func(self._env, torch.arange(self._env.num_envs, device=self._env.device), **term.params)

    def reset(self, env_ids: torch.Tensor) -> None:
        """Run the reset terms, and restart the interval clocks, of the environments that were reset."""
        now = self._env.common_step_counter
        for name, term in self._terms.items():
            if term.mode == "reset":
                last = self._last_step[name]
                due = env_ids[now - last[env_ids] >= term.min_step_count_between_reset]
                if len(due):
                    last[due] = now
                    term.func(self._env, due, **term.params)
            elif term.mode == "interval" and not term.is_global_time:
                self._time_left[name][env_ids] = self._draw(term, len(env_ids))

    @property
    def has_intervals(self) -> bool:
        """Whether there are terms that run at intervals."""
        return any(term.mode == "interval" for term in self._terms.values())

    def clocks(self) -> list[dict[str, torch.Tensor]]:
        """What the runner remembers: the time left of the interval terms, and when the reset terms last ran."""
        return [self._time_left, self._last_step]

    def interval(self, dt: float) -> bool:
        """Let ``dt`` seconds pass, and run the interval terms that are due; whether there was one."""
        ran = False
        for name, term in self._terms.items():
            if term.mode != "interval":
                continue
            left = self._time_left[name]
            left -= dt
            due = (left < 1.0e-6).nonzero().squeeze(-1)
            if len(due):
                ran = True
                left[due] = self._draw(term, len(due))
                everyone = torch.arange(self._env.num_envs, device=self._env.device)
                term.func(self._env, everyone if term.is_global_time else due, **term.params)
        return ran
