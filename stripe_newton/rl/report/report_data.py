# SPDX-License-Identifier: Apache-2.0
"""ReportedRun: a run as its report shows it, read from the files of its folder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from stripe_newton.rl.experiments.loaded_runs import LoadedRun, load_run
from stripe_newton.rl.experiments.run_groups import differing_fields
from stripe_newton.rl.runs.run_folder import RunFolder

from .run_facts import RunFacts, read_facts

__all__ = ["SECTIONS", "IterationTimes", "ReportedRun", "changed_fields", "newest_film", "read_run", "sort_columns"]

SECTIONS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("Returns and episodes", ("Train/",)),
    ("Reward terms", ("Episode_Reward/",)),
    ("Terminations", ("Episode_Termination/",)),
    ("Commands, curricula and metrics", ("Metrics/", "Curriculum/", "Episode/")),
    ("Losses and exploration", ("Loss/", "Policy/")),
    ("Speed", ("Perf/",)),
)
"""Headings of the charts, each with the beginnings of its columns' names; all other columns come after them."""
OTHERS = "Other values"


@dataclass
class IterationTimes:
    """Times of the iterations of a run, means over all of them [s]."""

    iteration: float
    """Whole iteration: time between the first and the last row over the iterations between; NaN for a single row."""
    rollout: float
    """Rollout: policy, physics and task."""
    update: float
    """Update of the networks."""


@dataclass
class ReportedRun:
    """Numbers, configs and facts of a run."""

    name: str
    """Name in the report."""
    log: LoadedRun
    """Configs, and columns of ``metrics.csv``."""
    facts: RunFacts = field(default_factory=RunFacts)
    """Device, versions and changed settings."""
    film: Path | None = None
    """The newest film."""

    @property
    def iterations(self) -> int:
        """Iterations that are done."""
        return int(self.log.x["iterations"][-1])

    @property
    def planned(self) -> int | None:
        """Iterations that the run was started for, or None if its configs do not say."""
        value = self.log.config.get("agent.max_iterations")
        return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else None

    def times(self) -> IterationTimes:
        """Means of the times of an iteration."""
        seconds, numbers = self.log.x["seconds"], self.log.x["iterations"]
        # Rows may be tens of iterations apart in a long run, so not the number of rows.
        count = float(numbers[-1] - numbers[0])
        whole = float(seconds[-1] - seconds[0]) / count if count > 0 else math.nan
        return IterationTimes(whole, self._mean("Perf/collection_time"), self._mean("Perf/learning_time"))

    def samples_per_s(self) -> float:
        """Samples of all environments in a second, from the first row on; NaN for a single row."""
        steps, seconds = self.log.x["steps"], self.log.x["seconds"]
        passed = float(seconds[-1] - seconds[0])
        return float(steps[-1] - steps[0]) / passed if passed > 0 else math.nan

    def last(self, column: str) -> float:
        """The last value of a column that is finite; NaN if there is none."""
        values = self.log.columns.get(column, np.array([]))
        values = values[np.isfinite(values)]
        return float(values[-1]) if len(values) else math.nan

    def _mean(self, column: str) -> float:
        values = self.log.columns.get(column, np.array([]))
        # The first iteration contains the loading of kernels and the recording of graphs.
        values = values[1:] if len(values) > 1 else values
        values = values[np.isfinite(values)]
        return float(values.mean()) if len(values) else math.nan


def read_run(path: Path, name: str | None = None) -> ReportedRun:
    """Read a run from its folder.

    Args:
        path: The run folder.
        name: Name in the report; by default that of the folder.

    Raises:
        CompareError: if nothing was logged, or it cannot be read.
    """
    log = load_run(path)
    folder = RunFolder(path)
    return ReportedRun(name or path.resolve().name, log, read_facts(folder), newest_film(folder))


def newest_film(folder: RunFolder) -> Path | None:
    """The film of a run that was written last, or None if there is none."""
    films = [film for film in folder.videos.glob("*.mp4") if film.is_file()] if folder.videos.is_dir() else []
    return max(films, key=lambda film: (film.stat().st_mtime, film.name), default=None)


def sort_columns(runs: Sequence[ReportedRun]) -> dict[str, list[str]]:
    """Columns of all runs by heading, in the order of :data:`SECTIONS`; headings without columns are left out."""
    columns = dict.fromkeys(column for run in runs for column in run.log.columns)
    found: dict[str, list[str]] = {heading: [] for heading in [*(name for name, _ in SECTIONS), OTHERS]}
    for column in columns:
        heading = next((heading for heading, starts in SECTIONS if column.startswith(starts)), OTHERS)
        found[heading].append(column)
    return {heading: names for heading, names in found.items() if names}


def changed_fields(runs: Sequence[ReportedRun]) -> list[tuple[str, str, list[str]]]:
    """Fields of the configs to show: ``(path, default, value in each run)``.

    They are the fields that differ from the task's default in any run, and, of several runs, those that differ
    between them. The default is ``""`` where no run says it.
    """
    defaults: dict[str, str] = {}
    for run in runs:
        defaults |= {path: pair[0] for path, pair in (run.facts.changes or {}).items()}
    between = differing_fields(run.log.config for run in runs) if len(runs) > 1 else []
    names = dict.fromkeys([*defaults, *between])
    return [(name, defaults.get(name, ""), [_value(run, name, defaults) for run in runs]) for name in names]


def _value(run: ReportedRun, name: str, defaults: Mapping[str, str]) -> str:
    changes = run.facts.changes or {}
    if name in changes:
        return changes[name][1]
    if name in run.log.config:
        value = run.log.config[name]
        return f"{value:.9g}" if isinstance(value, float) else str(value)
    return defaults.get(name, "") if run.facts.changes is not None else "(not known)"
