# SPDX-License-Identifier: Apache-2.0
"""Progress of a long command: one line that changes on a terminal, plain lines elsewhere."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Callable
from types import TracebackType

__all__ = ["Progress", "steps_left"]

_BAR = 24
_QUIET = 10.0
"""Seconds without a line, after which a long loop says how far it is."""


def steps_left(what: str, steps: int) -> Callable[[int], None]:
    """A function that a long loop calls after each step; every ten seconds it prints how many are done.

    Args:
        what: What was done, such as ``filmed``.
        steps: Number of steps of the loop.
    """
    began = last = time.perf_counter()

    def after_step(done: int) -> None:
        nonlocal last
        now = time.perf_counter()
        if now - last < _QUIET or done >= steps:
            return
        last = now
        print(f"{what} {done} of {steps} steps, {(now - began) * (steps / done - 1.0):.0f} s left", flush=True)

    return after_step


class Progress:
    """Steps of a command with their durations; steps that ended stay on the terminal.

    Attributes:
        seconds: Durations by phase [s].
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._terminal = sys.stdout.isatty()
        self._phase, self._text, self._began = "", "", 0.0

    def __enter__(self) -> Progress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(kind is None)

    def step(self, phase: str, text: str, part: int = 0, parts: int = 0) -> None:
        """End the current step and begin another.

        Args:
            phase: Phase whose duration the step adds to.
            text: Text about the step.
            part: Number of the step among ``parts``, from 1, where they are known.
            parts: Number of steps of the phase.
        """
        self._end(True)
        self._phase, self._text, self._began = phase, text, time.perf_counter()
        if self._terminal:
            filled = round(_BAR * (part - 1) / parts) if parts else 0
            bar = f"[{'#' * min(filled, _BAR):<{_BAR}}] " if parts else ""
            width = max(shutil.get_terminal_size().columns - 1, 20)
            print(f"\r{f'{bar}{text} ...'[:width]:<{width}}", end="", flush=True)

    def finish(self) -> None:
        """End the current step, before other output."""
        self._end(True)

    def _end(self, well: bool) -> None:
        """End the current step, if there is one."""
        if not self._phase:
            return
        took = time.perf_counter() - self._began
        self.seconds[self._phase] = self.seconds.get(self._phase, 0.0) + took
        line = f"{self._text}: {took:.1f} s" if well else f"{self._text}: failed"
        if self._terminal:
            width = max(shutil.get_terminal_size().columns - 1, 20)
            line = f"\r{line[:width]:<{width}}"
        print(line, flush=True)
        self._phase = ""

    @staticmethod
    def peak_memory() -> float:
        """Largest memory of this process so far [bytes]; 0 where the system does not report it."""
        try:
            import resource
        except ImportError:  # not on Windows
            return 0.0
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return float(most) * (1.0 if sys.platform == "darwin" else 1024.0)
