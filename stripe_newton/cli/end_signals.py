# SPDX-License-Identifier: Apache-2.0
"""End signals: SIGTERM and a closed terminal end a command as Ctrl-C does, so that nothing half-made remains."""

from __future__ import annotations

import os
import signal
import sys
import types

__all__ = ["end_on_signals", "is_one_of_several"]


def is_one_of_several() -> bool:
    """Whether this process says that it is a rank of several, before torch is loaded, which checks the numbers."""
    return os.environ.get("WORLD_SIZE", "").strip() not in ("", "0", "1")


def end_on_signals() -> None:
    """Raise SystemExit at SIGTERM and SIGHUP, in this process; a training handles them itself while it learns.

    A signal that is ignored stays ignored, as SIGHUP under ``nohup``. So do those of a rank of several: its launcher
    ends it by SIGTERM, at once, since it may wait for a rank that is gone.
    """
    if is_one_of_several():
        return
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _end)


def _end(number: int, _: types.FrameType | None) -> None:
    # The second time at once: what cleans up may hang.
    signal.signal(number, signal.SIG_DFL)
    if number != signal.SIGHUP:  # after that there is no terminal to print to
        print(f"ended by {signal.Signals(number).name}", file=sys.stderr)
    raise SystemExit(128 + number)
