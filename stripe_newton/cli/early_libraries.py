# SPDX-License-Identifier: Apache-2.0
"""Early libraries: threads that load torch's shared libraries and wake the GPU while Python imports other packages.

Both take about a second on a machine with a GPU, and Python's import of an extension module holds the interpreter for
as long as its libraries take to load. Here they are loaded by the system's own call, which does not.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import sys
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

from .end_signals import is_one_of_several

__all__ = ["load_early"]

_LIBRARIES = ("libtorch_global_deps.so", "libtorch_cpu.so", "libtorch_cuda.so")
"""Libraries of torch in the order in which torch loads them. None of them calls Python while it is loaded. The one that
does, libtorch_python, is left to torch."""
_USES_NO_GPU = ("--gpus", "--sweep", "--help", "-h")
"""Options with which this process uses no GPU itself: it starts other processes, or shows its help."""


def load_early(device: str | None, words: Sequence[str]) -> None:
    """Begin to load torch's libraries, and to make the context of the GPU, each in a thread of its own.

    Nothing depends on it: what is there by then is not loaded again, and what could not be loaded is loaded when it is
    used, which reports what is wrong. At its end Python waits for the threads.

    Args:
        device: ``"cpu"``, ``"cuda:N"``, or None for the first GPU if there is one.
        words: The command's arguments.
    """
    if sys.platform != "linux" or "torch" in sys.modules or (os.cpu_count() or 1) < 2:
        return
    # All that Python has to look up comes first: the system does not look up a name while it loads a library.
    jobs = [_torch_loader()]
    name, _, number = (device or "cuda:0").partition(":")
    options = {word.partition("=")[0] for word in words}
    if name == "cuda" and (number or "0").isdecimal() and options.isdisjoint(_USES_NO_GPU) and not is_one_of_several():
        jobs.insert(0, _context_maker(int(number or 0)))
    for job in jobs:
        if job is not None:
            threading.Thread(target=job, name=f"stripe-newton: {job.__name__}").start()


def _torch_loader() -> Callable[[], None] | None:
    """A function that loads torch's libraries, without Python's lock; None if there is nothing to load them with."""
    found, system = importlib.util.find_spec("torch"), ctypes.CDLL(None)
    if found is None or found.origin is None or not hasattr(system, "dlopen"):
        return None
    paths = [Path(found.origin).parent / "lib" / name for name in _LIBRARIES]
    load = system.dlopen
    load.restype = ctypes.c_void_p

    def load_torch() -> None:
        for path in paths:
            # The first one makes symbols global, as torch itself does.
            flags = os.RTLD_NOW | (os.RTLD_GLOBAL if path == paths[0] else os.RTLD_LOCAL)
            if path.exists() and not load(os.fsencode(path), flags):
                return

    return load_torch


def _context_maker(number: int) -> Callable[[], None] | None:
    """A function that makes the context of a GPU, which torch and Warp share; None without a driver."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
        initialise, find, retain = driver.cuInit, driver.cuDeviceGet, driver.cuDevicePrimaryCtxRetain
    except (OSError, AttributeError):
        return None

    def make_context() -> None:
        gpu, context = ctypes.c_int(), ctypes.c_void_p()
        if initialise(0) == 0 and find(ctypes.byref(gpu), number) == 0:
            retain(ctypes.byref(context), gpu)

    return make_context
