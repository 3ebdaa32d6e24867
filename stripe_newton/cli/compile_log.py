# SPDX-License-Identifier: Apache-2.0
"""Compile log: says which kernels are compiled while a command waits for them, and nothing else of Warp's messages."""

from __future__ import annotations

import ctypes.util
import logging
import os
import re
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import TextIO

import warp as wp

__all__ = ["CompileLog", "init_warp"]

_COMPILED = re.compile(r"Module (?P<name>\S+) .*load on device .* took (?P<ms>[\d.]+) ms\s+\(compiled\)")
_LONG = 5.0
"""Seconds of a module that is worth a line where lines cannot change."""


@contextmanager
def _quiet() -> Iterator[None]:
    """Drop what native code writes to the standard error, such as Warp's warning that there is no NVIDIA driver."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def init_warp() -> None:
    """Initialise Warp, without its lines about devices and its warning where there is no NVIDIA driver."""
    level, wp.config.log_level = wp.config.log_level, wp.LOG_WARNING
    with _quiet() if ctypes.util.find_library("cuda") is None else nullcontext():
        wp.init()
    wp.config.log_level = level


class CompileLog:
    """A logger for Warp that counts compiled kernel modules, in one line that changes on a terminal.

    Attributes:
        count: Modules that have been compiled.
        seconds: Time that it took [s].
    """

    def __init__(self, out: TextIO | None = None):
        self._given = out
        self.count, self.seconds, self._open = 0, 0.0, False

    @classmethod
    def install(cls) -> CompileLog:
        """Let Warp log here from now on."""
        log = cls()
        wp.set_logger(log)
        wp.config.log_level = wp.LOG_INFO  # below it Warp does not say what it compiles
        logging.getLogger("newton").setLevel(logging.WARNING)  # it prints files that it writes, as commands do
        init_warp()
        return log

    @property
    def _out(self) -> TextIO:
        return self._given or sys.stderr  # which may be another one by now: the logger stays after the command

    def debug(self, message: str) -> None:
        """Ignore a message."""

    def info(self, message: str) -> None:
        """Take note of a compiled module; other messages are ignored."""
        found = _COMPILED.search(message)
        if found is None:
            return
        self.count, took = self.count + 1, float(found["ms"]) / 1000.0
        self.seconds += took
        # Of a kernel that a function makes: its own name, without that function's and Warp's hash.
        name = re.sub(r".*__locals__|_[0-9a-f]{8}$", "", found["name"].rpartition(".")[2])[:40].strip("_")
        if self._out.isatty():
            text = f"compiling kernels, once: {self.count} done in {self.seconds:.0f} s ({name})"
            print(f"\r{text:<79}", end="", file=self._out, flush=True)
            self._open = True
        elif took > _LONG:
            print(f"compiled {name} in {took:.0f} s", file=self._out, flush=True)

    def finish(self) -> None:
        """End the line that changes, before other output."""
        if self._open:
            print(file=self._out, flush=True)
            self._open = False

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        """Pass a warning on to Python's warnings."""
        warnings.warn(message, category or UserWarning, stacklevel=stacklevel)

    def error(self, message: str) -> None:
        """Print an error."""
        self.finish()
        print(message, file=self._out, flush=True)
