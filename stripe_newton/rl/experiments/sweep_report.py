# SPDX-License-Identifier: Apache-2.0
"""Report of a sweep: a table of its trials, ``results.csv`` and ``sweep.png``."""

from __future__ import annotations

import csv
import math
import os
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .sweep_cfg import Scalar, SweepCfg
from .text_tables import format_number, format_table, short_names

if TYPE_CHECKING:
    import optuna
    from matplotlib.axes import Axes

__all__ = ["Trial", "draw_slices", "report", "write_results"]

_BLUE, _ORANGE, _GREY = "#3b6fb6", "#d9822b", "#8a8f98"
_STATES = {"COMPLETE": "", "RUNNING": "not finished"}
"""Notes in the table for states of optuna that need other words than their names."""


@dataclass
class Trial:
    """A trial of the study."""

    number: int
    """Its number."""
    state: str
    """optuna's name of its state."""
    objective: float | None
    """Mean of the objective over the seeds, for a complete trial."""
    params: dict[str, Scalar]
    """Value of each field."""
    values: dict[str, float]
    """Objective of each seed."""
    last_step: int | None
    """Last iteration that was reported to the pruner."""
    error: str | None
    """Reason of the failure."""


def report(study: optuna.Study, cfg: SweepCfg, folder: Path) -> tuple[str, dict[str, Scalar] | None]:
    """Write ``results.csv`` and, if there is something to draw, ``sweep.png``.

    Returns:
        The table of the trials, best first, and the values of the best one, or None if none was completed.
    """
    trials = _sorted_trials(study, cfg)
    write_results(trials, cfg, folder / "results.csv")
    done = [trial for trial in trials if trial.state == "COMPLETE"]
    if done and cfg.varied:
        draw_slices(done, cfg, folder / "sweep.png")
    header = ["trial", cfg.objective, "± std", *short_names(cfg.varied).values(), ""]
    body = [_row(trial, cfg) for trial in trials]
    if not any(row[-1] for row in body):
        header, body = header[:-1], [row[:-1] for row in body]
    return format_table(header, body), done[0].params if done else None


def _row(trial: Trial, cfg: SweepCfg) -> list[object]:
    """Row of the table: number, objective, deviation over the seeds, values of the fields, note."""
    values = [value for value in trial.values.values() if not math.isnan(value)]
    spread = statistics.stdev(values) if len(values) > 1 else None
    tried = [trial.params.get(name) for name in cfg.varied]
    if trial.state == "FAIL":
        note = _why_failed(trial.error or "")
    else:
        note = _STATES.get(trial.state, trial.state.lower())
    return [trial.number, trial.objective, spread, *tried, note]


def write_results(trials: Sequence[Trial], cfg: SweepCfg, path: str | os.PathLike) -> None:
    """Write a line for each trial: values, objective over the seeds and for each seed, and why it failed."""
    part = Path(f"{path}.part")
    with open(part, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["trial", "state", "objective", *cfg.spaces, *(f"seed_{seed}" for seed in cfg.seeds), "pruned_at", "error"]
        )
        for trial in trials:
            seeds = [trial.values.get(str(seed)) for seed in cfg.seeds]
            tried = [trial.params.get(name) for name in cfg.spaces]
            last = trial.last_step if trial.state == "PRUNED" else None
            writer.writerow([trial.number, trial.state, trial.objective, *tried, *seeds, last, trial.error])
    os.replace(part, path)


def draw_slices(trials: Sequence[Trial], cfg: SweepCfg, path: str | os.PathLike) -> None:
    """Draw the objective over each field: a dot for each trial, a bar for each of its seeds, the best trial marked.

    Args:
        trials: The trials that were completed, best first.
        cfg: The sweep.
        path: A PNG file.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = short_names(cfg.varied)
    columns = min(3, len(names))
    lines = -(-len(names) // columns)
    figure = Figure(figsize=(max(5.0, 3.6 * columns), 0.7 + 3.2 * lines), layout="constrained")
    FigureCanvasAgg(figure)
    axes_of = figure.subplots(lines, columns, squeeze=False, sharey=True).flatten()
    for axes, (field, name) in zip(axes_of, names.items()):
        _draw_slice(axes, trials, cfg, field)
        axes.set_xlabel(name)
    for axes in axes_of[len(names) :]:
        axes.set_visible(False)
    for axes in axes_of[::columns]:
        axes.set_ylabel(cfg.objective)
    seeds = f", bars: {len(cfg.seeds)} seeds" if len(cfg.seeds) > 1 else ""
    figure.suptitle(f"{cfg.task}: {len(trials)} trials (orange: the best{seeds})", fontsize=11)
    figure.savefig(path, dpi=120)


def _draw_slice(axes: Axes, trials: Sequence[Trial], cfg: SweepCfg, field: str) -> None:
    space = cfg.spaces[field]
    # Choices stand side by side at equal distances, in the order of the file.
    places = {value: float(number) for number, value in enumerate(space.choices)}
    for number, trial in reversed(list(enumerate(trials))):  # the best one last, on top of the others
        value = trial.params[field]
        x = places[value] if places else value
        seeds = list(trial.values.values())
        if len(seeds) > 1:
            axes.plot([x] * len(seeds), seeds, "_", color=_GREY, markersize=8, alpha=0.8, zorder=1)
        size, colour = (60, _ORANGE) if number == 0 else (34, _BLUE)
        axes.scatter([x], [trial.objective], s=size, color=colour, edgecolor="white", linewidth=0.8, zorder=3)
    if places:
        axes.set_xticks(range(len(places)), [format_number(value) for value in space.choices])
        axes.set_xlim(-0.6, len(places) - 0.4)
    elif space.log:
        axes.set_xscale("log")
    axes.grid(alpha=0.25, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _why_failed(error: str) -> str:
    """The first and the last line of an error, short enough for a table."""
    first, *_, last = ["", *error.split("\n")] if "\n" not in error else error.split("\n")
    text = f"{first.split(';')[0]}: {last}" if first else last
    return text if len(text) <= 100 else f"{text[:97]}..."


def _sorted_trials(study: optuna.Study, cfg: SweepCfg) -> list[Trial]:
    """The trials that have begun: complete ones first, the best of them at the top."""
    trials = [
        Trial(
            number=trial.number,
            state=trial.state.name,
            objective=trial.value if trial.state.name == "COMPLETE" else None,
            params=trial.params,
            values=trial.user_attrs.get("values", {}),
            last_step=trial.last_step,
            error=trial.user_attrs.get("error"),
        )
        for trial in study.get_trials(deepcopy=False)
        if trial.state.name != "WAITING"
    ]
    sign = -1.0 if cfg.maximize else 1.0
    return sorted(trials, key=lambda row: (row.objective is None, sign * (row.objective or 0.0), row.number))
