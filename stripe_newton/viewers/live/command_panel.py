# SPDX-License-Identifier: Apache-2.0
"""Command panel: sliders for the commands of a task, which show the task's own until somebody moves one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import torch

from .command_controls import CommandControl, command_controls
from .inbox import Inbox
from .viewed_env import ViewedEnv

if TYPE_CHECKING:
    import viser

__all__ = ["CommandPanel"]

_EVERY = 0.2
"""Time between two updates of sliders that follow the task [s]."""
_POSITIONS = 200
"""Positions of a slider."""


class CommandPanel:
    """Sliders for all commands.

    Args:
        gui: Where the sliders go.
        inbox: Carries changes to the simulation's thread.
        env: The environment.
        chosen: The environment by number that the sliders are about.
    """

    def __init__(self, gui: viser.GuiApi, inbox: Inbox, env: ViewedEnv, chosen: Callable[[], int]):
        self._env, self._inbox, self._chosen = env, inbox, chosen
        self._device = env.reward_buf.device
        self.sliders: dict[str, dict[str, viser.GuiSliderHandle]] = {}
        """Sliders by command and by number."""
        self.hold: dict[str, viser.GuiCheckboxHandle] = {}
        """Checkboxes by command: whether the sliders hold, or the task's own commands."""
        self.everywhere: dict[str, viser.GuiCheckboxHandle] = {}
        """Checkboxes by command: whether all environments get the sliders' numbers."""
        self._controls = {control.name: control for control in command_controls(env)}
        self._held: dict[str, torch.Tensor] = {}
        """Environments by command in which numbers are held."""
        self._next = 0.0
        for control in self._controls.values():
            self._add(gui, control)

    @property
    def is_empty(self) -> bool:
        """Whether the environment has no commands."""
        return not self._controls

    def _add(self, gui: viser.GuiApi, control: CommandControl) -> None:
        name = control.name
        with gui.add_folder(f"Command {name}"):
            self.hold[name] = gui.add_checkbox(
                "By hand", initial_value=False, hint="Hold these numbers; otherwise the sliders show the task's own"
            )
            self.everywhere[name] = gui.add_checkbox(
                "In all environments", initial_value=False, visible=self._env.num_envs > 1
            )
            values = control.read(self._chosen())
            self.sliders[name] = {
                key: _slider(gui, key, low, high, value)
                for (key, (low, high)), value in zip(control.numbers.items(), values, strict=True)
            }
        self._inbox.on_change(self.hold[name], lambda _: self._choose(control))
        self._inbox.on_change(self.everywhere[name], lambda _: self._choose(control))
        for slider in self.sliders[name].values():
            self._inbox.on_change(slider, lambda _: self._take_over(control))

    def after_step(self) -> None:
        """Set the held numbers again, as an episode that began has drawn others."""
        with torch.no_grad():
            for name, envs in self._held.items():
                self._controls[name].write(envs, self._values(name))

    def update(self, at_once: bool = False) -> None:
        """Let the sliders of commands that nobody holds show the task's own."""
        now = time.monotonic()
        if now < self._next and not at_once:
            return
        self._next = now + _EVERY
        for name, control in self._controls.items():
            if name in self._held:
                continue
            values = control.read(self._chosen())
            for slider, value in zip(self.sliders[name].values(), values, strict=True):
                self._inbox.set_quietly(slider, _within(value, slider.min, slider.max, slider.step))

    def release(self) -> None:
        """Give all commands back to the task."""
        for name, control in self._controls.items():
            self._inbox.set_quietly(self.hold[name], False)
            self._choose(control)

    def follow_choice(self) -> None:
        """Hold the numbers in the environment that is now the chosen one, rather than in the one before."""
        for name, control in self._controls.items():
            if name in self._held and not self.everywhere[name].value:
                self._choose(control)
        self.update(at_once=True)

    def _values(self, name: str) -> list[float]:
        return [float(slider.value) for slider in self.sliders[name].values()]

    def _take_over(self, control: CommandControl) -> None:
        """Hold the numbers, as a slider was moved."""
        self._inbox.set_quietly(self.hold[control.name], True)
        self._choose(control)

    @torch.no_grad()
    def _choose(self, control: CommandControl) -> None:
        """Hold or give back a command, where the checkboxes say."""
        name = control.name
        before = self._held.pop(name, None)
        envs = None
        if self.hold[name].value:
            ids = range(self._env.num_envs) if self.everywhere[name].value else [self._chosen()]
            envs = torch.tensor(list(ids), dtype=torch.int64, device=self._device)
        if before is not None:
            left = before if envs is None else before[~torch.isin(before, envs)]
            if len(left):
                control.release(left)
        if envs is not None:
            self._held[name] = envs
            control.write(envs, self._values(name))


def _slider(gui: viser.GuiApi, name: str, low: float, high: float, value: float) -> viser.GuiSliderHandle:
    """A slider with a round step, and bounds that are multiples of it."""
    step = 10.0 ** math.floor(math.log10((high - low) / _POSITIONS) + 0.5)
    digits = max(0, -round(math.log10(step)))
    low, high = round(math.floor(low / step + 1e-6) * step, digits), round(math.ceil(high / step - 1e-6) * step, digits)
    return gui.add_slider(name, low, high, step, initial_value=_within(value, low, high, step))


def _within(value: float, low: float, high: float, step: float) -> float:
    """A value within bounds, to the nearest step."""
    if not math.isfinite(value):
        return low
    return round(min(max(round(value / step) * step, low), high), 6)
