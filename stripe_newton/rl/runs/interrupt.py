# SPDX-License-Identifier: Apache-2.0
"""Interrupts: the first signal requests a stop, the second ends the program at once."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import threading
import types
from collections.abc import Callable, Iterator

__all__ = ["leave_terminal", "on_first_signal"]

Handler = Callable[[int, types.FrameType | None], object]


@contextlib.contextmanager
def on_first_signal(
    signals: tuple[signal.Signals, ...], call: Callable[[signal.Signals], None], then: Handler | None = None
) -> Iterator[None]:
    """Call a function at the first of some signals. In any other thread than the main one this does nothing.

    SIGHUP stays ignored under ``nohup``. It does not count as a second signal, as a terminal that closes may send it
    twice, by its shell and by the system. After it, what is printed goes nowhere, as writing to that terminal fails.

    Args:
        signals: The signals.
        call: Called with the first of them.
        then: Handler of those that follow; by default the handler that each signal had before.
    """
    # Python lets only the main thread set handlers.
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.getsignal(number) for number in signals}
    if previous.get(signal.SIGHUP) is signal.SIG_IGN:
        del previous[signal.SIGHUP]

    def handle(number: int, frame: types.FrameType | None) -> None:
        if number == signal.SIGHUP:
            leave_terminal()
        # Before the call: a second signal that arrives during it must end the program.
        for other, before in previous.items():
            signal.signal(other, before if then is None else then)
        if signal.SIGHUP in previous:
            signal.signal(signal.SIGHUP, signal.SIG_IGN)
        call(signal.Signals(number))

    # The thread that ends a stuck command (`cli.end_signals`) must not cut the iteration short.
    watching = signal.set_wakeup_fd(-1)
    for number in previous:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number, before in previous.items():
            signal.signal(number, before)
        signal.set_wakeup_fd(watching)


def leave_terminal() -> None:
    """Send the output of this process nowhere, if it goes to a terminal."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (1, 2):
        if os.isatty(descriptor) or _is_closed_terminal(descriptor):
            os.dup2(nowhere, descriptor)
    os.close(nowhere)


def _is_closed_terminal(descriptor: int) -> bool:
    """Whether a descriptor is that of a terminal that was closed, which is no terminal for ``os.isatty``."""
    try:
        os.get_terminal_size(descriptor)
    except OSError as error:
        return error.errno == errno.EIO
    return False
