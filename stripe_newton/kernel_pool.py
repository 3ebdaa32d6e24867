# SPDX-License-Identifier: Apache-2.0
"""Kernel pool: compiles kernels side by side, in threads, while an environment is built.

Warp compiles a module when its first kernel is launched, one after the other. Its compilers run without Python's lock,
so that threads keep all cores busy. What is compiled already is only loaded.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import warp as wp

__all__ = ["compile_ahead", "kernel_pool"]

_pool: ThreadPoolExecutor | None = None
_futures: list[Future[None]] = []


@contextlib.contextmanager
def kernel_pool(workers: int) -> Iterator[None]:
    """Compile what :func:`compile_ahead` is given in this many threads; at the end of the context all of it is done.

    So nothing is loaded later, when a CUDA graph may be under capture. Without the context, kernels are compiled when
    they are launched.
    """
    global _pool
    if _pool is not None or workers < 2:
        yield
        return
    _pool = ThreadPoolExecutor(workers, thread_name_prefix="kernels")
    try:
        yield
        for future in _futures:
            # An error of a kernel is raised, with all that the user needs, when it is launched.
            with contextlib.suppress(Exception):
                future.result()
    finally:
        pool, _pool = _pool, None
        _futures.clear()
        pool.shutdown(cancel_futures=True)  # after an error: what has not begun is left out


def compile_ahead(kernel: wp.Kernel, device: str, block_dim: int) -> None:
    """Begin to compile the module of a kernel for launches of this block size, within :func:`kernel_pool`."""
    if _pool is not None:
        _futures.append(
            _pool.submit(wp.force_load, device, modules=[kernel.module], block_dim=block_dim, max_workers=0)
        )
