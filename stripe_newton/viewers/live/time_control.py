# SPDX-License-Identifier: Apache-2.0
"""Time control: pause, single steps, reset and speed of what the live view shows."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from .inbox import Inbox

if TYPE_CHECKING:
    import viser

__all__ = ["SPEEDS", "TimeControl"]

SPEEDS: dict[str, float | None] = {
    "1/16": 1 / 16, "1/8": 1 / 8, "1/4": 1 / 4, "1/2": 1 / 2, "1": 1.0, "2": 2.0, "4": 4.0, "as fast as possible": None,
}  # fmt: skip
"""Simulated seconds per second; None for no waiting."""
_MOST_LATE = 0.25
"""Delay that is caught up with [s]."""
_LONGEST_WAIT = 0.02
"""Longest sleep between two looks at the page [s]."""


class TimeControl:
    """Buttons for the time, and the clock that says when the next step is due.

    Args:
        gui: Where the buttons go.
        inbox: Carries clicks to the simulation's thread.
        step_dt: Duration of a step [s].
        reset: Begins new episodes; None: there is no such button.
        is_paced: Keep to a speed. Without, steps are due at once, as in a training, and there is no choice of speed.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        inbox: Inbox,
        step_dt: float,
        reset: Callable[[], None] | None,
        is_paced: bool = True,
    ):
        self._inbox, self._step_dt, self._reset = inbox, step_dt, reset
        self._is_paused = False
        self._single = 0
        """Single steps that are still to be taken."""
        self._due = 0.0
        self._factor, self._window = 0.0, (time.monotonic(), 0)
        self._steps = 0
        self.pause_button = gui.add_button("Pause", icon="player-pause", hint="Stop before the next step, or go on")
        names = ("Step",) if reset is None else ("Step", "Reset")
        hint = "One step, then pause" if reset is None else "One step, then pause; new episodes everywhere"
        self.buttons = gui.add_button_group("", names, hint=hint)
        self.speed = gui.add_dropdown(
            "Speed", tuple(SPEEDS), initial_value="1" if is_paced else "as fast as possible", visible=is_paced,
            hint="Times real time",
        )  # fmt: skip
        inbox.on_click(self.pause_button, lambda: self.set_paused(not self._is_paused))
        inbox.on_choice(self.buttons, self._press)
        self.keys = {
            "P": gui.add_command("Pause or play", hotkey="P"),
            "N": gui.add_command("Next step", hotkey="N"),
        }
        inbox.on_key(self.keys["P"], lambda: self.set_paused(not self._is_paused))
        inbox.on_key(self.keys["N"], self.take_single_step)
        inbox.on_change(self.speed, lambda _: self._start_anew())

    @property
    def is_paused(self) -> bool:
        """Whether time stands still."""
        return self._is_paused

    @property
    def steps(self) -> int:
        """Steps that were taken since the viewer was opened."""
        return self._steps

    @property
    def factor(self) -> float:
        """Simulated seconds per second, over about the last second."""
        return self._factor

    def set_paused(self, paused: bool) -> None:
        """Stop before the next step, or go on."""
        self._is_paused, self._single = paused, 0
        self.pause_button.label = "Play" if paused else "Pause"
        self.pause_button.icon = "player-play" if paused else "player-pause"
        self._start_anew()

    def take_single_step(self) -> None:
        """Take one step; pause first, if time goes on."""
        single = self._single + 1 if self._is_paused else 1
        if not self._is_paused:
            self.set_paused(True)
        self._single = single

    def hide(self) -> None:
        """Take all inputs off the page, as nothing moves."""
        self.set_paused(True)
        for handle in (self.pause_button, self.buttons, self.speed):
            handle.visible = False
        for key in self.keys.values():
            key.disabled = True

    def takes_step(self) -> bool:
        """Whether a step is due now; the caller then takes it and calls :meth:`count_step`."""
        if self._is_paused:
            return self._single > 0
        return SPEEDS[self.speed.value] is None or time.monotonic() >= self._due

    def count_step(self) -> None:
        """Say that a step was taken."""
        now = time.monotonic()
        self._steps += 1
        if self._single:
            self._single -= 1
        speed = SPEEDS[self.speed.value]
        if speed is not None:
            self._due = max(self._due + self._step_dt / speed, now - _MOST_LATE)
        begin, steps = self._window
        if now - begin > 1.0:
            self._factor = (self._steps - steps) * self._step_dt / (now - begin)
            self._window = now, self._steps

    def wait(self) -> None:
        """Sleep until a step may be due, but no longer than clicks can wait."""
        left = _LONGEST_WAIT if self._is_paused else self._due - time.monotonic()
        time.sleep(min(max(left, 0.0), _LONGEST_WAIT))

    def _press(self, name: str) -> None:
        if name == "Step":
            self.take_single_step()
        elif self._reset is not None:
            self._reset()

    def _start_anew(self) -> None:
        """Measure speed and delay from now on."""
        self._due = time.monotonic()
        self._window = self._due, self._steps
