# SPDX-License-Identifier: Apache-2.0
"""Interrupts: the first Ctrl-C asks for a stop, the second ends the program at once."""

from __future__ import annotations

import contextlib
import signal
import threading
import types
from collections.abc import Callable, Iterator

__all__ = ["on_first_signal"]

Handler = Callable[[int, types.FrameType | None], object]


@contextlib.contextmanager
def on_first_signal(
    signals: tuple[signal.Signals, ...], call: Callable[[], None], then: Handler | None = None
) -> Iterator[None]:
    """Call a function at the first of some signals. In any other thread than the main one this does nothing.

    Args:
        signals: The signals.
        call: Called at the first of them.
        then: Handler of those that follow; by default the handler that each signal had before.
    """
    # Python lets only the main thread set handlers.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.getsignal(number) for number in signals}

    def handle(number: int, frame: types.FrameType | None) -> None:
        # Before the call: a second signal that arrives during it must end the program.
        for other, before in previous.items():
            signal.signal(other, before if then is None else then)
        call()

    for number in signals:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)
