# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton report``: writes the report of a run, or of several beside each other, as one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from stripe_newton.rl.experiments.loaded_runs import CompareError, find_runs
from stripe_newton.rl.report.report_data import ReportedRun, read_run
from stripe_newton.rl.report.run_report import REPORT_NAME, write_report
from stripe_newton.rl.runs.run_folder import RunFolder

from .user_error import UserError
from .written_places import try_place

__all__ = ["ReportArgs", "run"]


@dataclass
class ReportArgs:
    """Write the report of runs: curves, times, films, and the settings that differ from the task's default."""

    runs: tyro.conf.Positional[Annotated[tuple[str, ...], tyro.conf.arg(metavar="RUN ...")]]
    """Run folders, or folders that contain runs."""
    out: Path | None = None
    """The HTML file; by default report.html, in the folder of a single run, else in the current folder."""
    x: Literal["iterations", "steps", "seconds"] = "iterations"
    """x axis of the curves; steps are samples of all environments."""


def run(argv: list[str]) -> int:
    """Run the command."""
    args = tyro.cli(ReportArgs, args=argv, prog="stripe-newton report", config=(tyro.conf.FlagConversionOff,))
    if not args.runs:
        raise UserError("report needs a run: stripe-newton report RUN [RUN ...]")
    try:
        folders = list({folder.resolve(): folder for path in args.runs for folder in find_runs(path)}.values())
        runs = [read_run(folder, name) for folder, name in zip(folders, _names(folders))]
    except CompareError as error:
        raise UserError(str(error)) from None
    _check_axis(runs, args.x)
    if args.out is None and len(folders) == 1:
        RunFolder(folders[0]).check_links(folders[0] / REPORT_NAME)
    out = args.out or (folders[0] / REPORT_NAME if len(folders) == 1 else Path(REPORT_NAME))
    try_place("--out", out)
    try:
        write_report(runs, out, args.x)
    except OSError as error:
        raise UserError(f"--out {out}: could not be written: {error.strerror or error}") from None
    print(out)
    return 0


def _names(folders: Sequence[Path]) -> list[str]:
    """Names of runs: those of their folders, with the folders above where those are the same."""
    for depth in range(1, 4):
        names = ["/".join(folder.resolve().parts[-depth:]) for folder in folders]
        if len(set(names)) == len(names):
            return names
    return [str(folder.resolve()) for folder in folders]


def _check_axis(runs: Sequence[ReportedRun], x: str) -> None:
    for run in runs:
        values = run.log.x[x]
        if not (values == values).all():  # NaN where a log of another program does not say it
            raise UserError(f"{run.log.path}: does not say its {x}; give --x iterations")
