# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton compare``: compares groups of runs, as curves, a table and what differs in their configs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from stripe_newton.rl.experiments.comparison_report import Comparison, text_report, to_html
from stripe_newton.rl.experiments.curve_charts import draw_png
from stripe_newton.rl.experiments.loaded_runs import CompareError, LoadedRun, find_runs, load_run
from stripe_newton.rl.experiments.run_groups import Group, group_runs, pick_metrics, summarize

from .user_error import UserError
from .written_places import try_place

__all__ = ["CompareArgs", "run"]


@dataclass
class CompareArgs:
    """Compare runs: curves with confidence bands, a table, and the fields of the configs that differ."""

    runs: tyro.conf.Positional[Annotated[tuple[str, ...], tyro.conf.arg(metavar="RUN ...")]]
    """Run folders, folders that contain runs, or NAME=PATH,PATH for a group of them."""
    out: Path = Path("compare")
    """Folder for compare.html and compare.png."""
    group_by: tuple[str, ...] = ()
    """Fields whose values make a group; by default all but the seeds."""
    metric: tuple[str, ...] = ()
    """Columns of metrics.csv, * for any text; the first is what the table is about."""
    x: Literal["steps", "iterations", "seconds"] = "steps"
    """x axis of the curves; steps are samples of all environments."""
    minimize: bool = False
    """Whether less of the first metric is better."""


def run(argv: list[str]) -> int:
    """Run the command."""
    args = tyro.cli(CompareArgs, args=argv, prog="stripe-newton compare", config=(tyro.conf.FlagConversionOff,))
    if not args.runs:
        raise UserError("compare needs runs: stripe-newton compare RUN [RUN ...]")
    try_place("--out", args.out, folder=True)
    try:
        comparison = compare(args)
    except CompareError as error:
        raise UserError(str(error)) from None
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        page, picture = args.out / "compare.html", args.out / "compare.png"
        page.write_text(to_html(comparison), encoding="utf-8")
        draw_png(comparison.groups, comparison.metrics, comparison.x, picture, comparison.title)
    except OSError as error:
        print(text_report(comparison))  # so that the result is not lost
        raise UserError(f"--out {args.out}: could not be written: {error.strerror or error}") from None
    print(f"{text_report(comparison)}\n\n{page}\n{picture}")
    return 0


def compare(args: CompareArgs) -> Comparison:
    """The comparison that the arguments describe.

    Raises:
        CompareError: for runs that cannot be read or compared.
    """
    notes: list[str] = []
    groups = _groups_of(args, notes)
    if not groups:
        raise CompareError("; ".join(notes))
    metrics = pick_metrics(groups, args.metric)
    for group in groups:
        notes += _notes_on(group, args.x)
    return Comparison(groups, metrics, summarize(groups, metrics[0], args.minimize), args.x, notes)


def _groups_of(args: CompareArgs, notes: list[str]) -> list[Group]:
    """The groups: those that are named, and those that the configs of the other runs give."""
    named: list[Group] = []
    others: list[LoadedRun] = []
    for word in args.runs:
        name, equals, paths = word.partition("=")
        # A folder may have "=" in its name.
        if not equals or Path(word).exists():
            others += _load(word, notes)
            continue
        if not name or not paths:
            raise CompareError(f"{word}: a group is NAME=PATH or NAME=PATH,PATH")
        loaded = [run for path in paths.split(",") for run in _load(path, notes)]
        named += [Group(name, loaded)] if loaded else []
    groups = named + (group_runs(_once(others), args.group_by) if others else [])
    names = [group.name for group in groups]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise CompareError(f"two groups are called '{twice}'; give them other names, as NAME=PATH")
    return groups


def _load(path: str, notes: list[str]) -> list[LoadedRun]:
    """The runs of a path. A run that cannot be read becomes a note."""
    loaded = []
    for folder in find_runs(path):
        try:
            loaded.append(load_run(folder))
        except CompareError as error:
            notes.append(f"left out: {error}")
    return loaded


def _once(runs: list[LoadedRun]) -> list[LoadedRun]:
    """Each run once, even if several paths lead to it."""
    return list({run.path.resolve(): run for run in runs}.values())


def _notes_on(group: Group, x: str) -> list[str]:
    """Notes for the reader about a group: runs of different lengths.

    Raises:
        CompareError: if a run lacks what the curves are drawn over.
    """
    for run in group.runs:
        if x == "steps" and run.x["steps"].size and np.isnan(run.x["steps"]).all():
            raise CompareError(f"{run.path}: does not say how many samples it took; give --x iterations")
    lengths = [len(run.x["iterations"]) for run in group.runs]
    # Not for a few rows: runs that are still under way differ by those.
    if min(lengths) < 0.9 * max(lengths):
        return [
            f"{group.name}: its runs have {min(lengths)} to {max(lengths)} iterations; "
            "the mean ends where the shortest does"
        ]
    return []
