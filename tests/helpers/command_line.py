# SPDX-License-Identifier: Apache-2.0
"""Command line in-process: train the stand-in task, and the message of a command that fails."""

from __future__ import annotations

from pathlib import Path

from stripe_newton.cli import main
from tests.helpers.fake_env import TASK


def train(*args: str) -> Path:
    """Train in-process and return the run folder."""
    assert main(["train", TASK, "--device", "cpu", *args]) == 0
    return max(Path("logs/fake_cart").iterdir(), key=lambda path: path.stat().st_mtime_ns)


def error_of(capsys, *args: str) -> str:
    """The message of a command that shall end with code 2."""
    capsys.readouterr()
    assert main(list(args)) == 2
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return captured.err + captured.out
