# SPDX-License-Identifier: Apache-2.0
"""Forked processes of tests, which may hang."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable

__all__ = ["run_forked"]


def run_forked(function: Callable[[], int], timeout_s: float = 20.0) -> int | None:
    """Run a function in a fork of this process.

    Args:
        function: The function, which returns an exit code, 0 to 255.
        timeout_s: Longest time that it may take [s].

    Returns:
        The exit code, 1 for an exception; None if it did not end in time, and was killed.
    """
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = function()
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)  # no clean-up of the parent's: pytest's, and threads that are not there
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, 9)
    os.waitpid(child, 0)
    return None
