# SPDX-License-Identifier: Apache-2.0
"""Run and SweepProcess: a run of a sweep as its folder shows it, and the process that trains it."""

from __future__ import annotations

import math
import os
import shutil
import signal
import stat
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from stripe_newton.rl.errors import CheckpointError
from stripe_newton.rl.runs.metrics_csv import read_metrics
from stripe_newton.rl.runs.run_folder import RunFolder, find_checkpoint

__all__ = ["Run", "Slot", "SweepProcess", "end_with_sweep", "mean_of_last"]

_PIPE = "STRIPE_NEWTON_SWEEP_PIPE"
"""Environment variable with a file descriptor, whose other end closes when the sweep's process ends."""
_OUTPUT_LINES = 12
"""Last lines of a failed process that its error shows."""


@dataclass(frozen=True)
class Slot:
    """Place for one process at a time: a GPU, or a share of the CPU."""

    name: str
    """Name in messages, such as ``GPU 0``."""
    device: str
    """The ``--device`` of the process."""
    environ: dict[str, str] = field(default_factory=dict)
    """Environment variables of the process, in addition to those of this one."""


class Run:
    """The folder of one seed of one trial: ``output.txt`` and, below, the run folder that the training makes."""

    def __init__(self, path: Path, seed: int, max_iterations: int):
        self.path, self.seed, self.max_iterations = path, seed, max_iterations
        self.output = path / "output.txt"

    def folder(self) -> RunFolder | None:
        """The run folder, the newest if there are several, or None."""
        found = sorted(file.parent for file in self.path.rglob("metrics.csv"))
        return RunFolder(found[-1]) if found else None

    def columns(self) -> dict[str, list[float]]:
        """The columns of ``metrics.csv``, empty if there is none."""
        folder = self.folder()
        return {} if folder is None else read_metrics(folder.metrics)

    def iterations_done(self) -> int:
        """Iterations in ``metrics.csv``."""
        iterations = self.columns().get("iteration", [])
        return int(iterations[-1]) + 1 if iterations else 0

    def is_complete(self) -> bool:
        """Whether all iterations were done."""
        return self.iterations_done() >= self.max_iterations

    def resume_words(self) -> list[str]:
        """Options that continue the run of an earlier process. A run without a checkpoint is deleted."""
        folder = self.folder()
        # A folder without a checkpoint is no obstacle: nothing of it would be used.
        try:
            if folder is not None:
                find_checkpoint(folder.path)
                return ["--resume", str(folder.path)]
        except CheckpointError:
            pass
        shutil.rmtree(self.path, ignore_errors=True)
        return []

    def value(self, column: str, last: int, until: int | None = None) -> float:
        """Mean of the last rows of a column that have a value; NaN if none has.

        Args:
            column: Name in ``metrics.csv``.
            last: Number of rows.
            until: Number of rows that are considered; by default all.
        """
        return mean_of_last(self.columns().get(column, [])[:until], last)

    def last_lines(self) -> str:
        """The last lines of the output."""
        try:
            text = self.output.read_text(encoding="utf-8", errors="replace")
        except FileNotFoundError:
            return ""
        lines = [line.rsplit("\r", 1)[-1].rstrip() for line in text.splitlines()]
        return "\n".join([line for line in lines if line][-_OUTPUT_LINES:])


class SweepProcess:
    """A training in a process of its own. It gets Ctrl-C only by :meth:`interrupt`, or when this process dies."""

    def __init__(self, run: Run, slot: Slot, command: Sequence[str], keep_open: Sequence[int] = ()):
        """Start the process; its output is appended to the run's ``output.txt``.

        Args:
            run: The run.
            slot: Its place.
            command: The whole command.
            keep_open: File descriptors that it inherits.
        """
        self.run, self.slot = run, slot
        self.interrupted = 0
        # Never written to. The system closes our end if this process dies, which the other end notices.
        theirs, self._mine = os.pipe()
        run.path.mkdir(parents=True, exist_ok=True)
        with open(run.output, "a", encoding="utf-8") as output:
            self.process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=os.environ | {"PYTHONUNBUFFERED": "1", _PIPE: str(theirs)} | slot.environ,
                start_new_session=True,  # a terminal's Ctrl-C is for the sweep
                pass_fds=(theirs, *keep_open),
            )
        os.close(theirs)

    def ended(self) -> bool:
        """Whether the process has ended."""
        return self.process.poll() is not None

    def close(self) -> None:
        """Close the pipe to the process, after its end."""
        os.close(self._mine)

    def interrupt(self) -> None:
        """Send Ctrl-C: the first lets it end its iteration and save, the second ends it at once, the third kills it."""
        self.interrupted += 1
        if not self.ended():
            self.process.send_signal(signal.SIGINT if self.interrupted < 3 else signal.SIGKILL)

    def error(self) -> str | None:
        """Reason of the failure, with the last lines of output; None if the process is complete or was interrupted."""
        code = self.process.returncode
        if self.interrupted or self.run.is_complete():
            return None
        # Negative codes are signals. Code 0 without all iterations is a run that was stopped from outside.
        how = f"ended with code {code}" if code > 0 else f"was killed by {signal.Signals(-code).name}" if code else ""
        how = how or f"stopped after {self.run.iterations_done()} of {self.run.max_iterations} iterations"
        return f"seed {self.run.seed} {how}; the end of {self.run.output}:\n{self.run.last_lines()}"


def mean_of_last(values: Sequence[float], last: int) -> float:
    """Mean of the last values, without those that are NaN; NaN if there are no others."""
    there = [value for value in values[-last:] if not math.isnan(value)]
    return sum(there) / len(there) if there else math.nan


def end_with_sweep() -> None:
    """In a run of a sweep: send this process one Ctrl-C if the sweep's process dies.

    It shows by a pipe whose other end the sweep alone has. Linux's death signal would come once for each thread of the
    sweep's process, and a second Ctrl-C ends a run without saving.
    """
    end = os.environ.pop(_PIPE, None)
    if end is None:
        return
    if not _is_pipe(end):
        print(f"warning: {_PIPE}={end}: is no open pipe of a sweep; this run does not end with one", file=sys.stderr)
        return

    def wait() -> None:
        os.read(int(end), 1)  # returns when the other end is closed
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=wait, name="end_with_sweep", daemon=True).start()


def _is_pipe(number: str) -> bool:
    """Whether a text is the number of an open pipe."""
    try:
        return stat.S_ISFIFO(os.fstat(int(number)).st_mode)
    except (ValueError, OverflowError, OSError):
        return False
