# SPDX-License-Identifier: Apache-2.0
"""Commands of this program as a user types them in a shell, for messages."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from pathlib import Path

from .tasks import import_options

__all__ = ["command", "program"]


def program() -> str:
    """The words that start this program: its name where the shell finds it, else its path."""
    if shutil.which("stripe-newton"):
        return "stripe-newton"
    started = Path(sys.argv[0])
    if started.name != "stripe-newton":
        return shlex.join([sys.executable, "-m", "stripe_newton.cli"])
    return shlex.quote(os.path.relpath(started))


def command(*words: str) -> str:
    """A command of this program, with the options ``--import`` that this process was given."""
    return f"{program()} {shlex.join([*words, *import_options()])}"
