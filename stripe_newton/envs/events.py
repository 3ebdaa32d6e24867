# SPDX-License-Identifier: Apache-2.0
"""Event runner: events of direct environments, at startup, at resets, at intervals or in every step."""

from __future__ import annotations

from collections.abc import Callable

import torch
import warp as wp

from stripe_newton.configclass import ConfigError
from stripe_newton.fusion import resolve_entities
from stripe_newton.managers import EventTermCfg
from stripe_newton.managers.manager_base import terms_of
from stripe_newton.managers.term_class import make_instance

from .rl_env import RLEnv

__all__ = ["EventRunner", "EventTermCfg"]

_MODES = ("startup", "reset", "interval", "step")


class EventRunner:
    """Runs the event terms of a config, which is an object with fields :class:`EventTermCfg` or a dict of them.

    A torch term ``func(env, env_ids, **params)`` is called with an int64 tensor of environments, and so is the instance
    of a class term. A Warp term runs in these environments by :meth:`RLEnv.apply_event`.
    """

    def __init__(self, cfg: object, env: RLEnv):
        """Start the clocks.

        Raises:
            ConfigError: for a term that runs before the model is built.
        """
        self._env = env
        self._terms: dict[str, EventTermCfg] = {}
        problems: list[str] = []
        for name, term in terms_of(cfg).items():
            if isinstance(term, EventTermCfg):
                self._terms[name] = term
                problems += _refused(f"events.{name}", term)
            elif term is not None:
                problems.append(f"events.{name}: is {type(term).__name__}, must be EventTermCfg or None")
        if problems:
            raise ConfigError(problems)
        self._calls = {name: self._call_of(name, term) for name, term in self._terms.items()}
        self._steps_left: dict[str, torch.Tensor] = {}
        self._last_step: dict[str, torch.Tensor] = {}
        for name, term in self._terms.items():
            count = 1 if term.is_global_time else env.num_envs
            if term.mode == "interval":
                self._steps_left[name] = self._draw(term, count)
            self._last_step[name] = torch.full((env.num_envs,), -(10**9), device=env.device)

    def _call_of(self, name: str, term: EventTermCfg) -> Callable[[torch.Tensor], object]:
        """The call of a term with environments."""
        env = self._env
        if isinstance(term.func, wp.Function):
            return lambda env_ids: env.apply_event(term.func, env_ids, **term.params)
        params = resolve_entities(term.params, env.scene.__getitem__)
        func = term.func
        if isinstance(func, type):
            func = make_instance(f"events.{name}.func", func, term.replace(params=params), env)
        return lambda env_ids: func(env, env_ids, **params)

    def _draw(self, term: EventTermCfg, count: int) -> torch.Tensor:
        """Times until a term is due, in steps."""
        low, high = term.interval_range_s or (0.0, 0.0)
        return (low + (high - low) * torch.rand(count, device=self._env.device)) / self._env.step_dt

    def startup(self) -> None:
        """Run the startup terms on all environments."""
        everyone = torch.arange(self._env.num_envs, device=self._env.device)
        for name, term in self._terms.items():
            if term.mode == "startup":
                self._calls[name](everyone)

    def reset(self, env_ids: torch.Tensor) -> None:
        """Run the reset terms, and restart the interval clocks, of the environments that were reset."""
        now = self._env.common_step_counter
        for name, term in self._terms.items():
            if term.mode == "reset":
                last = self._last_step[name]
                due = env_ids[now - last[env_ids] >= term.min_step_count_between_reset]
                if len(due):
                    last[due] = now
                    self._calls[name](due)
            elif term.mode == "interval" and not term.is_global_time:
                self._steps_left[name][env_ids] = self._draw(term, len(env_ids))

    @property
    def has_intervals(self) -> bool:
        """Whether there are terms that run within a step, at intervals or always."""
        return any(term.mode in ("interval", "step") for term in self._terms.values())

    def clocks(self) -> list[dict[str, torch.Tensor]]:
        """State of the runner: the steps left until interval terms run, and the last step of each reset term."""
        return [self._steps_left, self._last_step]

    def interval(self, dt: float) -> bool:
        """Advance the clocks by ``dt`` [s], run the interval terms that are due and the terms of every step.

        Returns:
            Whether a term ran.
        """
        ran = False
        everyone = torch.arange(self._env.num_envs, device=self._env.device)
        for name, term in self._terms.items():
            if term.mode == "step":
                ran = True
                self._calls[name](everyone)
            if term.mode != "interval":
                continue
            left = self._steps_left[name]
            left -= dt / self._env.step_dt
            # A thousandth of a step: repeated float subtraction must not delay a term by a whole step.
            due = (left < 1.0e-3).nonzero().squeeze(-1)
            if len(due):
                ran = True
                left[due] = self._draw(term, len(due))
                self._calls[name](everyone if term.is_global_time else due)
        return ran


def _refused(path: str, term: EventTermCfg) -> list[str]:
    """Reasons why a term cannot run in a direct environment."""
    problems = []
    if term.mode not in _MODES:
        problems.append(f"{path}.mode: is '{term.mode}', in a direct environment it must be one of {', '.join(_MODES)}")
    return problems
