# SPDX-License-Identifier: Apache-2.0
"""RunReport: writes ``report.html`` of a run while it trains, and of finished runs."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from stripe_newton.output_files import write_whole
from stripe_newton.rl.experiments.loaded_runs import CompareError
from stripe_newton.rl.runs.run_folder import RunFolder

from .report_data import ReportedRun, read_run
from .report_page import report_html

__all__ = ["REPORT_NAME", "RunReport", "write_report"]

REPORT_NAME = "report.html"
_LARGEST_SHARE = 0.02
"""Share of the training's time that its reports may take."""


def write_report(runs: Sequence[ReportedRun], path: Path, x: str = "iterations", live: bool = False) -> None:
    """Write the report of runs: whole, or not at all.

    Args:
        runs: The runs.
        path: The HTML file.
        x: x axis of the curves: ``iterations``, ``steps`` or ``seconds``.
        live: Whether the training goes on, so that an open page loads itself again.

    Raises:
        OSError: if it cannot be written.
    """
    write_whole(path, report_html(runs, x, path.parent, live))


class RunReport:
    """The report in the folder of a run that trains. Errors become warnings, so that the training continues."""

    def __init__(self, folder: RunFolder):
        """Prepare the report; nothing is written yet."""
        self._folder = folder
        self._next = 0.0
        self._warned = False

    def update(self) -> None:
        """Write the report during a training, unless reports have taken too much of its time."""
        began = time.monotonic()
        if began >= self._next:
            self._write(live=True)
            # Rows of a long run take long to read, so its reports are rarer.
            now = time.monotonic()
            self._next = now + (now - began) / _LARGEST_SHARE

    def finish(self) -> None:
        """Write the report of a training that has ended."""
        self._write(live=False)

    def _write(self, live: bool) -> None:
        if not self._folder.metrics.is_file():  # no iteration was done, or the folder was deleted, which others say
            return
        try:
            write_report([read_run(self._folder.path)], self._folder.path / REPORT_NAME, live=live)
        except (OSError, CompareError) as error:
            # A full disk: once, as the checkpoints say it, too.
            if not self._warned:
                why = f"no report: {error}"
                if isinstance(error, OSError):
                    why = f"{REPORT_NAME}: could not be written: {error.strerror}"
                print(f"\nwarning: {why}", file=sys.stderr)
            self._warned = True
