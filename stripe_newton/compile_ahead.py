# SPDX-License-Identifier: Apache-2.0
"""Compiling ahead: kernels are compiled in threads, several at a time, and waited for at their launch.

Warp compiles a kernel when it is first launched, so one after the other. Its compilers run in native code, beside
Python and each other; what they share of Warp's own work is guarded by its lock.
"""

from __future__ import annotations

import os
from concurrent.futures import Future, wait
from weakref import WeakKeyDictionary

import warp as wp

from .thread_pool import ThreadPool

__all__ = ["compile_ahead", "wait_for"]

_MOST_THREADS = 8
_running: WeakKeyDictionary[wp.Module, Future[None]] = WeakKeyDictionary()
_pool = ThreadPool(min(_MOST_THREADS, os.cpu_count() or 1), "compile")


def compile_ahead(kernel: wp.Kernel, block_dim: int, device: str) -> None:
    """Begin to compile a kernel's module into Warp's cache. :func:`wait_for` must come before its launch.

    On a GPU nothing is loaded, so that it may go on while a graph is recorded.

    Args:
        kernel: The kernel.
        block_dim: Threads of a block that it is launched with; on the CPU Warp takes 1.
        device: ``"cpu"`` or ``"cuda:N"``.
    """
    module = kernel.module
    if module in _running or module.execs or (os.cpu_count() or 1) < 2:
        return
    block_dim = 1 if device == "cpu" else block_dim
    if module.options["block_dim"] != block_dim:
        module.options["block_dim"] = block_dim
        module.mark_modified()  # else a hash of before would name the files
    _running[module] = _pool.executor.submit(_compile, module, device)


def _compile(module: wp.Module, device: str) -> None:
    if device == "cpu":  # where Warp warns of files that are compiled for this processor alone, and does not load them
        wp.force_load(device, modules=[module], block_dim=1, max_workers=1)
    else:
        wp.compile_aot_module(module, device)


def wait_for(kernel: wp.Kernel) -> None:
    """Wait until a kernel's module is compiled, if that was begun. Its launch then reports an error that occurred."""
    compiling = _running.pop(kernel.module, None)
    if compiling is not None:
        wait([compiling])


if hasattr(os, "register_at_fork"):  # not on Windows
    # What the parent of a forked process compiles never ends here: its threads do not come along.
    os.register_at_fork(after_in_child=_running.clear)
