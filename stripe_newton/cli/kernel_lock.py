# SPDX-License-Identifier: Apache-2.0
"""Kernel lock: of several processes that start at once, one compiles a kernel module, and the others wait for it."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import warp as wp

from stripe_newton.file_lock import FileLock, Owner

__all__ = ["compile_once", "hold_cache"]

_POLL_S = 0.1
_SILENT_S = 2.0
"""Seconds after which the user is told what is waited for."""
_MOST_S = 1200.0
"""Longest wait; then the module is compiled here, too."""


def compile_once() -> None:
    """Let this process compile a kernel module only if no other one is compiling it into the same cache.

    Warp itself lets each process compile, and takes the files of whichever is first.
    """
    # Warp has no public hook around a compilation. Without this method all is as it would be without the lock.
    compile_module = getattr(wp.Module, "_compile", None)
    if compile_module is None or hasattr(compile_module, "__wrapped__"):
        return

    @functools.wraps(compile_module)
    def compile_locked(
        self: wp.Module,
        device: object = None,
        output_dir: object = None,
        output_name: object = None,
        *args: object,
        **kwargs: object,
    ) -> bool:
        if output_dir is None:  # of a module that is compiled ahead
            output_dir = f"{wp.config.kernel_cache_dir}/{self.get_module_identifier()}"
        there = output_name is not None and os.path.exists(f"{output_dir}/{output_name}")
        with contextlib.nullcontext() if there else hold_cache(Path(f"{output_dir}.lock"), self.name):
            # Looks for the files once more, which the other process may have written by now.
            return bool(compile_module(self, device, output_dir, output_name, *args, **kwargs))

    wp.Module._compile = compile_locked


@contextlib.contextmanager
def hold_cache(path: Path, what: str) -> Iterator[None]:
    """Hold a lock in the kernel cache; wait while another process has it.

    A cache that cannot be written is left alone: what is compiled then says so.

    Args:
        path: File of the lock.
        what: What is compiled, for the message.
    """
    lock = FileLock(path)
    try:
        # Within the `try`, as a signal may end the wait once the lock is held, for which a thread here may wait, too.
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            _wait(lock, what)
        yield
    finally:
        lock.release()


def _wait(lock: FileLock, what: str) -> None:
    began, told = time.monotonic(), False
    while (owner := lock.acquire()) is not None:
        waited = time.monotonic() - began
        if waited > _MOST_S:
            print(f"{_name(owner)} has been compiling for long; compiling {what} here, too", file=sys.stderr)
            return
        if waited > _SILENT_S and not told:
            told = True
            print(f"waiting for {_name(owner)}, which compiles {what}", file=sys.stderr, flush=True)
        time.sleep(_POLL_S)


def _name(owner: Owner) -> str:
    return f"process {owner.process}" if owner.process else "another process"
