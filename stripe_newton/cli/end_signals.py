# SPDX-License-Identifier: Apache-2.0
"""End signals: SIGTERM and a closed terminal end a command as Ctrl-C does, so that nothing half-made remains.

Signals are handled as exceptions in the main thread. Three traps of that are avoided:

- An exception in an import becomes another one, or is lost in a library that tries whether a module is there. So it is
  put off until the import has ended. While the command itself is imported there is nothing to clean up: it ends.
- An exception while a thread pool starts a thread leaves a thread that Python waits for without end. So an ended
  command cleans up and then leaves without waiting for its threads.
- Native code that does not return handles no signal. So what has not ended within ``GRACE_S`` is cut off.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
import threading
import time
import types
from collections.abc import Callable
from typing import NoReturn

__all__ = [
    "GRACE_S",
    "EndedBySignal",
    "begin",
    "end_on_signals",
    "ended_by",
    "is_one_of_several",
    "leave",
    "leave_signals",
]

Handler = Callable[[int, types.FrameType | None], None]

GRACE_S = 10
"""Seconds that an ended command has to clean up. Containers are killed after as long."""
_ENDS = (signal.SIGTERM, signal.SIGHUP)
_LONGEST_IMPORT_S = 5.0
"""Time that a signal is put off for an import [s]. Then the process ends as it is."""
_POLL_S = 0.02

_has_begun = False
_is_quiet = False
_ended_by: int | None = None
_put_off_since: float | None = None


class EndedBySignal(SystemExit):
    """Raised in the main thread when the process is to end, with the exit code of the signal."""


def is_one_of_several() -> bool:
    """Whether this process says that it is a rank of several, before torch is loaded, which checks the numbers."""
    return os.environ.get("WORLD_SIZE", "").strip() not in ("", "0", "1")


def end_on_signals(quietly: bool = False) -> None:
    """Raise EndedBySignal at SIGTERM and SIGHUP, in this process; a training handles them itself while it learns.

    A signal that is ignored stays ignored, as SIGHUP under ``nohup``. So do those of a rank of several: its launcher
    ends it by SIGTERM, at once, since it may wait for a rank that is gone.

    Args:
        quietly: Whether nothing is printed about it, as by a process that helps another one.
    """
    global _is_quiet
    _is_quiet = quietly
    if is_one_of_several():
        return
    for number in _ENDS:
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _end)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = _raise_again
    _watch()


def begin() -> None:
    """Tell that the command is imported and begins its work."""
    global _has_begun
    _has_begun = True


def ended_by() -> int | None:
    """The signal that this process was told to end by; None before."""
    return _ended_by


def leave_signals() -> None:
    """Handle signals as before :func:`end_on_signals`, at the end of a command: nothing is left to clean up."""
    for number in _ENDS:
        if signal.getsignal(number) is _end:
            signal.signal(number, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) is _interrupt:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if sys.unraisablehook is _raise_again:
        sys.unraisablehook = sys.__unraisablehook__
    if _put_off_since is not None:  # one that waits for the end of an import, whose timer would kill the process
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.set_wakeup_fd(-1)


def leave(code: int) -> NoReturn:
    """End this process after what is registered for its end, without waiting for its threads."""
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # such as a terminal that is gone
            stream.flush()
    os._exit(code)


def _end(number: int, frame: types.FrameType | None) -> None:
    global _ended_by
    _ended_by = number
    # The second time at once: what cleans up may hang.
    signal.signal(number, signal.SIG_DFL)
    if _put_off(_end, number, frame):
        return
    # Of the system, so that it also ends a process whose threads wait for each other and for Python's lock. The
    # watching thread comes first where it can run.
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(GRACE_S + 2)
    _tell(number)
    raise EndedBySignal(128 + number)


def _tell(number: int) -> None:
    if number != signal.SIGHUP and not _is_quiet:  # after that there is no terminal to print to
        text = "interrupted" if number == signal.SIGINT else f"ended by {signal.Signals(number).name}"
        print(text, file=sys.stderr)


def _interrupt(number: int, frame: types.FrameType | None) -> None:
    if not _put_off(_interrupt, number, frame):
        signal.default_int_handler(number, frame)


def _put_off(handler: Handler, number: int, frame: types.FrameType | None) -> bool:
    """If an import is under way, call a handler again soon, or end the process. Returns whether it is."""
    global _put_off_since
    if not _is_importing(frame):
        _put_off_since = None
        return False
    now = time.monotonic()
    _put_off_since = _put_off_since or now
    if not _has_begun or now - _put_off_since > _LONGEST_IMPORT_S:
        _tell(number)
        leave(128 + number)
    _call_soon(handler, number)
    return True


def _is_importing(frame: types.FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _call_soon(handler: Handler, number: int) -> None:
    signal.signal(signal.SIGALRM, lambda _, frame: handler(number, frame))
    signal.setitimer(signal.ITIMER_REAL, _POLL_S)


def _raise_again(unraisable: sys.UnraisableHookArgs) -> None:
    """Raise the exception of a signal once more that could not leave a destructor or a callback from native code."""
    if isinstance(unraisable.exc_value, EndedBySignal) and _ended_by is not None:
        _call_soon(_end, _ended_by)
    elif isinstance(unraisable.exc_value, KeyboardInterrupt):
        _call_soon(_interrupt, signal.SIGINT)
    else:
        sys.__unraisablehook__(unraisable)


def _watch() -> None:
    """Start a thread that ends the process if the main thread does not: it handles no signal while in native code."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    # The number of each signal is written there when it arrives, before Python handles it.
    signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    # The pipe is the parent's: it must not take the signals of a forked process for its own.
    os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))
    threading.Thread(target=_end_when_stuck, args=(reading,), name="end_when_stuck", daemon=True).start()


def _end_when_stuck(reading: int) -> None:
    while number := os.read(reading, 1):
        # SIG_DFL: it has been handled. Any other handler is one of a user's code, which ends the process itself.
        if number[0] in _ENDS and signal.getsignal(number[0]) in (_end, signal.SIG_DFL):
            time.sleep(GRACE_S)
            with contextlib.suppress(OSError):
                os.write(2, f"no end within {GRACE_S} s of {signal.Signals(number[0]).name}\n".encode())
            os._exit(128 + number[0])
