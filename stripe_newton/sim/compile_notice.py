# SPDX-License-Identifier: Apache-2.0
"""Compile notice: one line when Warp compiles the first kernel of a program, in place of a line for each kernel."""

from __future__ import annotations

import sys

import warp as wp

__all__ = ["CompileNotice"]


class CompileNotice:
    """A logger for Warp that says once that kernels are compiled, which takes up to a minute on a new machine.

    Warp's own logger prints some hundred lines, or with ``LOG_WARNING`` nothing, for as long.
    """

    def __init__(self, otherwise: wp.Logger):
        self._otherwise, self._has_told = otherwise, False

    @classmethod
    def install(cls) -> None:
        """Let Warp log here, unless the program has chosen a logger or another level than Warp's default."""
        logger = wp.get_logger()
        if wp.config.log_level == wp.LOG_INFO and type(logger).__module__.startswith("warp"):
            wp.set_logger(cls(logger))

    def debug(self, message: str) -> None:
        """Ignore a message; the level of debugging is not Warp's default."""

    def info(self, message: str) -> None:
        """Say at the first module that was compiled that there are more; other messages are ignored."""
        if not self._has_told and message.startswith("Module ") and message.rstrip().endswith("(compiled)"):
            self._has_told = True
            print("compiling kernels, once for this machine", file=sys.stderr, flush=True)

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        """Pass a warning on."""
        self._otherwise.warning(message, category, stacklevel + 1)

    def error(self, message: str) -> None:
        """Pass an error on."""
        self._otherwise.error(message)
