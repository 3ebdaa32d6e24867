# SPDX-License-Identifier: Apache-2.0
"""Start of the program ``stripe-newton``, also by ``python -m stripe_newton``.

It imports nothing before it handles Ctrl-C: loading the command line takes a tenth of a second, and Python's own
handler would show a traceback of an import.
"""

from __future__ import annotations

import os
import signal
import sys
import types

__all__ = ["main"]


def main() -> int:
    """Run the command line of this process. Returns its exit code: 130 after Ctrl-C, also while it is loaded."""
    # Not where it is ignored, as in a shell's background.
    is_handled = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_handled:
        signal.signal(signal.SIGINT, _leave)
    from .cli import main as run

    try:
        if is_handled:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        return run()
    except KeyboardInterrupt:  # between that line and the command line's own handler
        print("interrupted", file=sys.stderr)
        return 130


def _leave(number: int, frame: types.FrameType | None) -> None:
    """End the process at once: there is nothing to clean up yet, and an exception could get lost in an import."""
    os.write(2, b"interrupted\n")
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
