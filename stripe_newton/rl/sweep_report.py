# SPDX-License-Identifier: Apache-2.0
"""What a sweep found: a table, ``results.csv`` and ``sweep.png``."""

from __future__ import annotations

import csv
import math
import os
import statistics
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .sweep_cfg import SweepCfg
from .tables import format_number, format_table, short_names

if TYPE_CHECKING:
    import optuna

__all__ = ["draw_slices", "report", "write_results"]

_BLUE, _ORANGE, _GREY = "#3b6fb6", "#d9822b", "#8a8f98"


def report(study: optuna.Study, cfg: SweepCfg, folder: Path) -> tuple[str, dict[str, Any] | None]:
    """Write ``results.csv`` and, if there is something to draw, ``sweep.png``.

    Returns:
        The table of the trials, best first, and the values of the best one, or None if none was completed.
    """
    rows = _sorted_rows(study, cfg)
    write_results(rows, cfg, folder / "results.csv")
    done = [row for row in rows if row["state"] == "COMPLETE"]
    if done and cfg.varied:
        draw_slices(done, cfg, folder / "sweep.png")
    names = short_names(cfg.varied)
    body = []
    for row in rows:
        values = [value for value in row["values"].values() if not math.isnan(value)]
        spread = statistics.stdev(values) if len(values) > 1 else None
        note = _why_failed(row["error"] or "") if row["state"] == "FAIL" else row["state"].lower()
        note = {"COMPLETE": "", "RUNNING": "not finished"}.get(row["state"], note)
        tried = [row["params"].get(name) for name in cfg.varied]
        body.append([row["trial"], row["objective"], spread, *tried, note])
    header = ["trial", cfg.objective, "± std", *names.values(), ""]
    if not any(row[-1] for row in body):
        header, body = header[:-1], [row[:-1] for row in body]
    return format_table(header, body), done[0]["params"] if done else None


def write_results(rows: list[dict[str, Any]], cfg: SweepCfg, path: str | os.PathLike) -> None:
    """Write a line for each trial: its values, its objective over the seeds and for each seed, and why it failed."""
    part = Path(f"{path}.part")
    with open(part, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(
            ["trial", "state", "objective", *cfg.spaces, *(f"seed_{seed}" for seed in cfg.seeds), "pruned_at", "error"]
        )
        for row in rows:
            seeds = [row["values"].get(str(seed)) for seed in cfg.seeds]
            tried = [row["params"].get(name) for name in cfg.spaces]
            last = row["last_step"] if row["state"] == "PRUNED" else None
            writer.writerow([row["trial"], row["state"], row["objective"], *tried, *seeds, last, row["error"]])
    os.replace(part, path)


def draw_slices(rows: list[dict[str, Any]], cfg: SweepCfg, path: str | os.PathLike) -> None:
    """Draw the objective over each field: a dot for each trial, small ones for its seeds, the best one marked.

    Args:
        rows: the trials that were completed, best first.
        cfg: the sweep.
        path: a PNG file.
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
        space = cfg.spaces[field]
        numbers = all(type(row["params"][field]) in (int, float) for row in rows)
        places = {value: number for number, value in enumerate(space.choices)}
        even = bool(space.choices)  # choices stand side by side, in the order of the file
        for number, row in reversed(list(enumerate(rows))):
            x = places[row["params"][field]] if even else row["params"][field]
            values = list(row["values"].values())
            colour = _ORANGE if number == 0 else _BLUE
            if len(values) > 1:
                axes.plot([x] * len(values), values, "_", color=_GREY, markersize=8, alpha=0.8, zorder=1)
            size = 60 if number == 0 else 34
            axes.scatter([x], [row["objective"]], s=size, color=colour, edgecolor="white", linewidth=0.8, zorder=3)
        if even:
            axes.set_xticks(range(len(space.choices)), [format_number(value) for value in space.choices])
            axes.set_xlim(-0.6, len(space.choices) - 0.4)
        elif space.log and numbers:
            axes.set_xscale("log")
        axes.set_xlabel(name)
        axes.grid(alpha=0.25, linewidth=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    for axes in axes_of[len(names) :]:
        axes.set_visible(False)
    for axes in axes_of[::columns]:
        axes.set_ylabel(cfg.objective)
    seeds = f", bars: {len(cfg.seeds)} seeds" if len(cfg.seeds) > 1 else ""
    figure.suptitle(f"{cfg.task}: {len(rows)} trials (orange: the best{seeds})", fontsize=11)
    figure.savefig(path, dpi=120)


def _why_failed(error: str) -> str:
    """The first and the last line of an error, short enough for a table."""
    first, *_, last = ["", *error.split("\n")] if "\n" not in error else error.split("\n")
    text = f"{first.split(';')[0]}: {last}" if first else last
    return text if len(text) <= 100 else f"{text[:97]}..."


def _sorted_rows(study: optuna.Study, cfg: SweepCfg) -> list[dict[str, Any]]:
    """A row for each trial that was begun: those that were completed come first, the best of them first."""
    rows = [
        {
            "trial": trial.number,
            "state": trial.state.name,
            "objective": trial.value if trial.state.name == "COMPLETE" else None,
            "params": trial.params,
            "values": trial.user_attrs.get("values", {}),
            "last_step": trial.last_step,
            "error": trial.user_attrs.get("error"),
        }
        for trial in study.get_trials(deepcopy=False)
        if trial.state.name != "WAITING"
    ]
    sign = -1.0 if cfg.maximize else 1.0
    return sorted(rows, key=lambda row: (row["objective"] is None, sign * (row["objective"] or 0.0), row["trial"]))
