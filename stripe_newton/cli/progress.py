# SPDX-License-Identifier: Apache-2.0
"""What a long command is doing: a line that changes on a terminal, plain lines elsewhere."""

from __future__ import annotations

import shutil
import sys
import time
from types import TracebackType

__all__ = ["Progress"]

_BAR = 24


class Progress:
    """Steps of a command with the seconds that each took; ended steps stay on the terminal.

    Attributes:
        seconds: By the name of the phase that steps belong to.
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
        """End the step under way, begin another.

        Args:
            phase: What its seconds are counted to.
            text: What is being made.
            part: Number of the step among ``parts``, from 1, where they are known.
            parts: How many steps the phase has.
        """
        self._end(True)
        self._phase, self._text, self._began = phase, text, time.perf_counter()
        if self._terminal:
            filled = round(_BAR * (part - 1) / parts) if parts else 0
            bar = f"[{'#' * min(filled, _BAR):<{_BAR}}] " if parts else ""
            width = max(shutil.get_terminal_size().columns - 1, 20)
            print(f"\r{f'{bar}{text} ...'[:width]:<{width}}", end="", flush=True)

    def _end(self, well: bool) -> None:
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
        """The most memory that this process had [bytes]; 0 where the system does not say."""
        try:
            import resource
        except ImportError:  # not on Windows
            return 0.0
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return float(most) * (1.0 if sys.platform == "darwin" else 1024.0)
