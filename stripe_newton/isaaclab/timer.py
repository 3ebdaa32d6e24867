# SPDX-License-Identifier: Apache-2.0
"""Timer of the Isaac Lab dialect: the wall-clock time of a block."""

from __future__ import annotations

import time
from types import TracebackType

__all__ = ["Timer"]


class Timer:
    """Wall-clock time of a ``with`` block, or between :meth:`start` and :meth:`stop` [s].

    Work that was put on a GPU and is not finished does not count.
    """

    _by_name: dict[str, float] = {}

    def __init__(self, msg: str | None = None, name: str | None = None):
        """Take what is printed at the end, if anything, and a name for :meth:`get_timer_info`."""
        self._msg = msg
        self._name = name
        self._start: float | None = None
        self._elapsed: float | None = None

    def __str__(self) -> str:
        return f"{self.time_elapsed:0.6f} seconds"

    @property
    def time_elapsed(self) -> float:
        """Time since the start; after the stop, until then [s].

        Raises:
            RuntimeError: the timer was not started.
        """
        if self._elapsed is not None:
            return self._elapsed
        if self._start is None:
            raise RuntimeError("the timer was not started; use 'with Timer():' or start()")
        return time.perf_counter() - self._start

    total_run_time = time_elapsed

    def start(self) -> None:
        """Begin to measure, again if the timer has run before."""
        self._start, self._elapsed = time.perf_counter(), None

    def stop(self) -> None:
        """End the measurement.

        Raises:
            RuntimeError: the timer is not running.
        """
        if self._elapsed is not None:
            raise RuntimeError("the timer is not running; call start() first")
        self._elapsed = self.time_elapsed
        if self._name is not None:
            Timer._by_name[self._name] = self._elapsed

    def __enter__(self) -> Timer:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        if self._msg:
            print(f"{self._msg}: {self}")

    @staticmethod
    def get_timer_info(name: str) -> float:
        """The latest time of the timers of a name [s].

        Raises:
            KeyError: no timer of that name has run.
        """
        if name not in Timer._by_name:
            raise KeyError(f"no timer '{name}' has run; there are {sorted(Timer._by_name)}")
        return Timer._by_name[name]
