# SPDX-License-Identifier: Apache-2.0
"""Groups of runs compared: mean curves with confidence bands, final values, speed, and how their configs differ."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .compare_runs import CompareError, LoadedRun
from .tables import format_number, short_names

__all__ = [
    "CONFIDENCE",
    "Curve",
    "Group",
    "Summary",
    "curve_of",
    "differing_fields",
    "final_value",
    "group_runs",
    "pick_metrics",
    "summarize",
    "t_interval",
]

CONFIDENCE = 0.95
"""Probability that an interval covers the mean."""
REACHED = 0.9
"""Part of the best final value that is timed."""
LAST_PART = 0.05
"""Part of the iterations, at the end, that the final value is averaged over."""

_REWARDS = ("Train/mean_reward", "rollout/ep_rew_mean", "Reward / Total reward (mean)")
_LENGTHS = ("Train/mean_episode_length", "rollout/ep_len_mean", "Episode / Total timesteps (mean)")
_GROUPS = ("Episode_Reward/", "Metrics/", "Curriculum/", "Episode/")
_NOT_SETTINGS = ("env.seed", "env.log_dir", "agent.seed", "agent.run_name", "agent.device", "agent.resume")
"""Fields that may differ within a group: they do not say what is trained."""


@dataclass
class Group:
    """Runs that are seeds of the same thing."""

    name: str
    """What it is called."""
    runs: list[LoadedRun]
    """Its runs."""


@dataclass
class Curve:
    """A metric of a group over x."""

    x: np.ndarray
    """Where, (points,)."""
    mean: np.ndarray
    """Mean over the runs, (points,)."""
    half: np.ndarray
    """Half width of the confidence interval of the mean, (points,); NaN for a single run."""
    runs: list[tuple[np.ndarray, np.ndarray]]
    """x and value of each run."""


@dataclass
class Summary:
    """A row of the table: what a group reached by the end, and how fast."""

    group: str
    """Its name."""
    runs: int
    """Number of runs."""
    final: float
    """Mean of the last iterations, over the runs."""
    final_half: float
    """Half width of its confidence interval."""
    best: float
    """Best value of the mean curve."""
    steps_to_reach: float
    """Samples until the mean curve reached the threshold; NaN if it never did."""
    seconds_to_reach: float
    """Seconds that the runs took for so many samples, their mean."""
    steps_per_s: float
    """Samples in a second, the mean over the runs."""


def t_interval(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Mean over the first axis and half width of its 95 % confidence interval: ``t s / sqrt(n)``.

    ``s`` is the standard deviation of the ``n`` values (with ``n - 1``), ``t`` the quantile 0.975 of Student's
    distribution with ``n - 1`` degrees of freedom (Student, "The probable error of a mean", Biometrika 6, 1908). With
    few seeds it is wide, and rightly so: a bootstrap of five values is too narrow. NaN for a single value.
    """
    from scipy.stats import t

    count = len(values)
    mean = np.mean(values, axis=0)
    if count < 2:
        return mean, np.full_like(mean, np.nan)
    quantile = float(t.ppf(0.5 + CONFIDENCE / 2.0, count - 1))
    return mean, quantile * np.std(values, axis=0, ddof=1) / math.sqrt(count)


def curve_of(group: Group, metric: str, x: str, points: int | None = 300) -> Curve | None:
    """A metric over ``iterations``, ``steps`` or ``seconds``, where all runs of the group have it.

    Runs logged at the same places are averaged there, others are interpolated linearly.

    Args:
        group: the runs.
        metric: name of the column.
        x: over what.
        points: longer curves are averaged over neighbours to so many; ``None`` for all.

    Returns:
        None if no run has the metric, or if there is nowhere that all have it.
    """
    runs = []
    for run in group.runs:
        values, place = run.columns.get(metric, np.array([])), run.x[x]
        there = np.isfinite(values) & np.isfinite(place[: len(values)])
        if there.any():
            runs.append((place[there], values[there]))
    if not runs:
        return None
    first = runs[0][0]
    if all(len(place) == len(first) and np.array_equal(place, first) for place, _ in runs):
        runs = [_thin(*run, points) for run in runs]
        grid, values = runs[0][0], np.stack([value for _, value in runs])
    else:
        runs = [_thin(*run, points) for run in runs]
        low, high = max(place[0] for place, _ in runs), min(place[-1] for place, _ in runs)
        if low > high:
            return None
        grid = np.linspace(low, high, max(len(place) for place, _ in runs))
        values = np.stack([np.interp(grid, place, value) for place, value in runs])
    mean, half = t_interval(values)
    return Curve(grid, mean, half, runs)


def _thin(x: np.ndarray, y: np.ndarray, points: int | None) -> tuple[np.ndarray, np.ndarray]:
    if points is None or len(x) <= points:
        return x, y
    bounds = np.linspace(0, len(x), points + 1).astype(int)[:-1]
    counts = np.diff([*bounds, len(x)])
    return np.add.reduceat(x, bounds) / counts, np.add.reduceat(y, bounds) / counts


def final_value(run: LoadedRun, metric: str) -> float:
    """Mean over the last 5 % of the iterations, over those that have a value; NaN if none has."""
    values = run.columns.get(metric, np.array([]))
    last = values[-max(1, math.ceil(LAST_PART * len(values))) :]
    last = last[np.isfinite(last)]
    return float(np.mean(last)) if len(last) else math.nan


def summarize(groups: Sequence[Group], metric: str, minimize: bool = False) -> list[Summary]:
    """A row for each group, the best final value first.

    The threshold is 90 % of the best final value; for a negative or a minimised one, the value a tenth of its size
    worse.
    """
    sign = -1.0 if minimize else 1.0
    finals = {}
    for group in groups:
        values = np.array([final_value(run, metric) for run in group.runs])
        values = values[np.isfinite(values)]
        finals[group.name] = t_interval(values) if len(values) else (np.nan, np.nan)
    reached = [sign * float(mean) for mean, _ in finals.values() if np.isfinite(mean)]
    threshold = max(reached) - (1.0 - REACHED) * abs(max(reached)) if reached else math.nan
    rows = []
    for group in groups:
        mean, half = finals[group.name]
        curve = curve_of(group, metric, "iterations", None)
        best = float(sign * np.max(sign * curve.mean)) if curve is not None else math.nan
        steps, seconds = _first_at(group, metric, sign, threshold)
        row = (group.name, len(group.runs), float(mean), float(half), best, steps, seconds, _speed(group))
        rows.append(Summary(*row))
    return sorted(rows, key=lambda row: (math.isnan(row.final), -sign * row.final))


def _first_at(group: Group, metric: str, sign: float, threshold: float) -> tuple[float, float]:
    """Samples, and the runs' mean seconds for so many, until the mean curve is first as good as the threshold."""
    by = "steps" if all(np.isfinite(run.x["steps"]).all() for run in group.runs) else "iterations"
    curve = curve_of(group, metric, by, None)
    if curve is None:
        return math.nan, math.nan
    there = np.flatnonzero(sign * curve.mean >= threshold)
    if not len(there):
        return math.nan, math.nan
    place = float(curve.x[there[0]])
    seconds = float(np.mean([np.interp(place, run.x[by], run.x["seconds"]) for run in group.runs]))
    return place if by == "steps" else math.nan, seconds


def _speed(group: Group) -> float:
    speeds = []
    for run in group.runs:
        steps, seconds = run.x["steps"], run.x["seconds"]
        if len(steps) > 1 and seconds[-1] > seconds[0]:
            speeds.append((steps[-1] - steps[0]) / (seconds[-1] - seconds[0]))
    return float(np.mean(speeds)) if speeds else math.nan


# -- which runs belong together, and what is compared


def _is_setting(field: str) -> bool:
    """Whether a field says what is trained."""
    return field not in _NOT_SETTINGS and (field == "run.task" or not field.startswith(("run.", "git.")))


def _comparable(field: str, value: Any) -> str:
    return "cuda" if field.endswith("device") and str(value).startswith("cuda") else repr(value)


def differing_fields(configs: Iterable[dict[str, Any]], settings_only: bool = True) -> list[str]:
    """Fields that are not the same in all configs, in the order of the first that has them."""
    given = list(configs)
    names = dict.fromkeys(name for config in given for name in config if not settings_only or _is_setting(name))
    return [name for name in names if len({_comparable(name, config.get(name)) for config in given}) > 1]


def group_runs(runs: Sequence[LoadedRun], by: Sequence[str] = ()) -> list[Group]:
    """Put runs together that differ by their seed alone, or that have the same values of the fields ``by``.

    Raises:
        CompareError: if no run has a field of ``by``.
    """
    fields = [_find_field(name, runs) for name in by] or differing_fields(run.config for run in runs)
    found: dict[tuple[str, ...], list[LoadedRun]] = {}
    for run in runs:
        found.setdefault(tuple(_comparable(name, run.config.get(name)) for name in fields), []).append(run)
    short = short_names(fields)
    names = []
    ordered = sorted(found.values(), key=lambda same: [_order(same[0].config.get(name)) for name in fields])
    for same in ordered:
        told = ", ".join(f"{short[name]} {format_number(same[0].config.get(name))}" for name in fields[:3])
        more = f" and {len(fields) - 3} more" if len(fields) > 3 else ""
        names.append(told + more if told else same[0].label)
    return [Group(name, same) for name, same in zip(_unique(names), ordered)]


def _order(value: Any) -> tuple[float, str]:
    """Numbers by size, and then text by the alphabet."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return (float(value), "") if number else (math.inf, str(value))


def _unique(names: list[str]) -> list[str]:
    return [
        f"{name} ({names[:at].count(name) + 1})" if names.count(name) > 1 else name for at, name in enumerate(names)
    ]


def _find_field(name: str, runs: Sequence[LoadedRun]) -> str:
    wanted = name.removeprefix("--").replace("-", "_")
    known = dict.fromkeys(field for run in runs for field in run.config)
    if wanted in known:
        return wanted
    ends = [field for field in known if field.endswith(f".{wanted}")]
    if len(ends) == 1:
        return ends[0]
    hint = f"it may be {', '.join(ends)}" if ends else "name it as params/env.yaml and params/agent.yaml do, such as"
    raise CompareError(f"--group-by {name}: no run has this field; {hint}" + ("" if ends else " agent.algorithm.gamma"))


def pick_metrics(groups: Sequence[Group], wanted: Sequence[str] = ()) -> list[str]:
    """The columns to compare: those ``wanted`` (``*`` stands for any text), or else return, episode length and what
    else of ``Episode_Reward``, ``Metrics``, ``Curriculum`` and ``Episode`` all runs have.

    Raises:
        CompareError: if no run has what is wanted, or all have nothing in common.
    """
    known = dict.fromkeys(name for group in groups for run in group.runs for name in run.columns)
    if wanted:
        picked: dict[str, None] = {}
        for pattern in wanted:
            fitting = [name for name in known if name == pattern or fnmatch.fnmatchcase(name, pattern)]
            if not fitting:
                raise CompareError(f"--metric {pattern}: no run has it; there are {', '.join(known)}")
            picked |= dict.fromkeys(fitting)
        return list(picked)
    shared = [name for name in known if all(name in run.columns for group in groups for run in group.runs)]
    heads = [next((name for name in names if name in shared), None) for names in (_REWARDS, _LENGTHS)]
    rest = [name for name in shared if name.startswith(_GROUPS)]
    metrics = [name for name in heads if name is not None] + sorted(rest)
    if not metrics:
        raise CompareError(f"no return or other metric is in all runs; name some with --metric: {', '.join(known)}")
    return metrics
