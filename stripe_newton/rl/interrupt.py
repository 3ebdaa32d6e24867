# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C that asks for a stop, and only the second time ends at once."""

from __future__ import annotations

import contextlib
import signal
import threading
import types
from collections.abc import Callable, Iterator
from typing import Any

__all__ = ["on_first_signal"]


@contextlib.contextmanager
def on_first_signal(signals: tuple[signal.Signals, ...], call: Callable[[], None], then: Any = None) -> Iterator[None]:
    """Have the first of these signals call a function. Only the main thread can; elsewhere nothing is done.

    Args:
        signals: those that count.
        call: what the first of them does.
        then: handler of those that follow; by default what each had before.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.getsignal(number) for number in signals}

    def handle(number: int, frame: types.FrameType | None) -> None:
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
