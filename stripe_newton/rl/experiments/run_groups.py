# SPDX-License-Identifier: Apache-2.0
"""Groups of runs: which runs belong together, their mean curves with confidence bands, final values and speed."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .loaded_runs import CompareError, LoadedRun
from .text_tables import format_number, short_names

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
"""Share of the best final value whose time is reported."""
LAST_PART = 0.05
"""Share of the iterations, at the end, that the final value is averaged over."""

# Names of rsl_rl, Stable-Baselines3 and skrl for the same thing.
_REWARDS = ("Train/mean_reward", "rollout/ep_rew_mean", "Reward / Total reward (mean)")
_LENGTHS = ("Train/mean_episode_length", "rollout/ep_len_mean", "Episode / Total timesteps (mean)")
_GROUPS = ("Episode_Reward/", "Metrics/", "Curriculum/", "Episode/")
_NOT_SETTINGS = ("env.seed", "env.log_dir", "agent.seed", "agent.run_name", "agent.device", "agent.resume")
"""Fields that may differ within a group, since they do not change what is trained."""


@dataclass
class Group:
    """Runs with the same settings and different seeds."""

    name: str
    """Name in tables and pictures."""
    runs: list[LoadedRun]
    """The runs."""


@dataclass
class Curve:
    """A metric of a group over x."""

    x: np.ndarray
    """Places, ``(points,)``."""
    mean: np.ndarray
    """Mean over the runs, ``(points,)``."""
    half: np.ndarray
    """Half width of the confidence interval of the mean, ``(points,)``; NaN for a single run."""
    runs: list[tuple[np.ndarray, np.ndarray]]
    """x and value of each run."""


@dataclass
class Summary:
    """Row of the table: the final value of a group, and how fast it got there."""

    group: str
    """Name of the group."""
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
    """Mean over the runs of the seconds for so many samples."""
    steps_per_s: float
    """Samples in a second, mean over the runs."""


# -- curves and final values


def t_interval(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r"""Mean over the first axis and half width of its 95 % confidence interval: ``t s / sqrt(n)``.

    ``s`` is the standard deviation of the ``n`` values (with ``n - 1``), ``t`` the quantile 0.975 of Student's
    distribution with ``n - 1`` degrees of freedom (Student, "The probable error of a mean", Biometrika 6, 1908). With
    few seeds the interval is wide, and rightly so: a bootstrap of five values is too narrow. NaN for a single value.
    """
    from scipy.stats import t  # here, as it takes long to import

    count = len(values)
    mean = np.mean(values, axis=0)
    if count < 2:
        return mean, np.full_like(mean, np.nan)
    quantile = float(t.ppf(0.5 + CONFIDENCE / 2.0, count - 1))
    return mean, quantile * np.std(values, axis=0, ddof=1) / math.sqrt(count)


def curve_of(group: Group, metric: str, x: str, points: int | None = 300) -> Curve | None:
    """The curve of a metric over ``iterations``, ``steps`` or ``seconds``, where all runs of the group have values.

    Runs logged at the same places are averaged there, others are interpolated linearly.

    Args:
        group: The runs.
        metric: Name of the column.
        x: What the curve is drawn over.
        points: Longer curves are averaged over neighbours to so many points; ``None`` for all points.

    Returns:
        None if no run has the metric, or if the runs have no range of x in common.
    """
    runs = [found for run in group.runs if (found := _values_of(run, metric, x)) is not None]
    if not runs:
        return None
    # Before thinning, which puts runs of different lengths at different places.
    first = runs[0][0]
    same_places = all(len(place) == len(first) and np.array_equal(place, first) for place, _ in runs)
    runs = [_thin(*run, points) for run in runs]
    if same_places:
        grid, values = runs[0][0], np.stack([value for _, value in runs])
    else:
        low, high = max(place[0] for place, _ in runs), min(place[-1] for place, _ in runs)
        if low > high:
            return None
        grid = np.linspace(low, high, max(len(place) for place, _ in runs))
        values = np.stack([np.interp(grid, place, value) for place, value in runs])
    mean, half = t_interval(values)
    return Curve(grid, mean, half, runs)


def _values_of(run: LoadedRun, metric: str, x: str) -> tuple[np.ndarray, np.ndarray] | None:
    """X and value of a run where both are finite; None if they nowhere are."""
    values, place = run.columns.get(metric, np.array([])), run.x[x]
    there = np.isfinite(values) & np.isfinite(place[: len(values)])
    return (place[there], values[there]) if there.any() else None


def _thin(x: np.ndarray, y: np.ndarray, points: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Means over neighbours, so that at most ``points`` are left."""
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

    The threshold is 90 % of the best final value. For a negative value, or one to be minimised, it is worse than the
    best by a tenth of its size.
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
        # All points: means over neighbours would lower the maximum.
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
        # From the first row on: the time before it contains the start of the program.
        steps, seconds = run.x["steps"], run.x["seconds"]
        if len(steps) > 1 and seconds[-1] > seconds[0]:
            speeds.append((steps[-1] - steps[0]) / (seconds[-1] - seconds[0]))
    return float(np.mean(speeds)) if speeds else math.nan


# -- which runs belong together


def _is_setting(field: str) -> bool:
    """Whether a field changes what is trained."""
    return field not in _NOT_SETTINGS and (field == "run.task" or not field.startswith(("run.", "git.")))


def _comparable(field: str, value: object) -> str:
    """A value as text; the numbers of GPUs do not count."""
    return "cuda" if field.endswith("device") and str(value).startswith("cuda") else repr(value)


def differing_fields(configs: Iterable[Mapping[str, object]], settings_only: bool = True) -> list[str]:
    """Fields that are not the same in all configs, in the order of the first config that has them."""
    given = list(configs)
    # A dict rather than a set keeps the order.
    names = dict.fromkeys(name for config in given for name in config if not settings_only or _is_setting(name))
    return [name for name in names if len({_comparable(name, config.get(name)) for config in given}) > 1]


def group_runs(runs: Sequence[LoadedRun], by: Sequence[str] = ()) -> list[Group]:
    """Group runs that differ by nothing but their seed, or that have the same values of the fields ``by``.

    Raises:
        CompareError: if no run has a field of ``by``.
    """
    # Without `by`: runs of a group have equal settings, so the settings that differ at all tell the groups apart.
    fields = [_find_field(name, runs) for name in by] or differing_fields(run.config for run in runs)
    found: dict[tuple[str, ...], list[LoadedRun]] = {}
    for run in runs:
        found.setdefault(tuple(_comparable(name, run.config.get(name)) for name in fields), []).append(run)
    ordered = sorted(found.values(), key=lambda same: [_order(same[0].config.get(name)) for name in fields])
    telling = fields if by else _distinguishing_fields([same[0].config for same in ordered], fields)
    names = _unique([_group_name(same[0], telling) for same in ordered])
    return [Group(name, same) for name, same in zip(names, ordered)]


def _distinguishing_fields(configs: Sequence[Mapping[str, object]], fields: Sequence[str]) -> list[str]:
    """The fewest fields that distinguish all configs, in their order. The table of differences has the others.

    The field that splits the groups most comes first; the length of a run and its number of environments come last, as
    nobody looks for them in a name.
    """
    chosen: list[str] = []

    def groups_by(names: Sequence[str]) -> int:
        return len({tuple(_comparable(name, config.get(name)) for name in names) for config in configs})

    while groups_by(chosen) < groups_by(fields):
        rest = [name for name in fields if name not in chosen]
        chosen.append(max(rest, key=lambda name: (groups_by([*chosen, name]), not name.endswith(_OF_LENGTH))))
    return [name for name in fields if name in chosen]


_OF_LENGTH = ("max_iterations", "num_envs", "save_interval")


def _group_name(run: LoadedRun, fields: Sequence[str]) -> str:
    """Name of the group of a run, by the values of the fields that distinguish the groups."""
    short = short_names(fields)
    named = ", ".join(f"{short[name]} {format_number(run.config.get(name))}" for name in fields[:4])
    more = f" and {len(fields) - 4} more" if len(fields) > 4 else ""
    return named + more if named else run.label


def _order(value: object) -> tuple[float, str]:
    """Numbers by size, and then text by the alphabet."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value), ""
    return math.inf, str(value)


def _unique(names: list[str]) -> list[str]:
    return [
        f"{name} ({names[:at].count(name) + 1})" if names.count(name) > 1 else name for at, name in enumerate(names)
    ]


def _find_field(name: str, runs: Sequence[LoadedRun]) -> str:
    """The field that ``--group-by`` names, by its whole path or its end."""
    wanted = name.removeprefix("--").replace("-", "_")
    known = dict.fromkeys(field for run in runs for field in run.config)
    if wanted in known:
        return wanted
    ends = [field for field in known if field.endswith(f".{wanted}")]
    if len(ends) == 1:
        return ends[0]
    hint = f"it may be {', '.join(ends)}" if ends else "name it as params/env.yaml and params/agent.yaml do, such as"
    raise CompareError(f"--group-by {name}: no run has this field; {hint}" + ("" if ends else " agent.algorithm.gamma"))


# -- what is compared


def pick_metrics(groups: Sequence[Group], wanted: Sequence[str] = ()) -> list[str]:
    """The columns to compare.

    Args:
        groups: The runs.
        wanted: Columns, in which ``*`` stands for any text. By default return and episode length, and the columns of
            ``Episode_Reward``, ``Metrics``, ``Curriculum`` and ``Episode`` that all runs have.

    Raises:
        CompareError: if no run has a wanted column, or if the runs have none of the default ones in common.
    """
    runs = [run for group in groups for run in group.runs]
    known = dict.fromkeys(name for run in runs for name in run.columns)
    if wanted:
        return list(dict.fromkeys(name for pattern in wanted for name in _fitting(pattern, list(known))))
    metrics = _default_metrics([name for name in known if all(name in run.columns for run in runs)])
    if not metrics:
        raise CompareError(f"no return or other metric is in all runs; name some with --metric: {', '.join(known)}")
    return metrics


def _default_metrics(shared: Sequence[str]) -> list[str]:
    """Return, episode length, and the columns of the task, of those that all runs have."""
    heads = [name for names in (_REWARDS, _LENGTHS) for name in [n for n in names if n in shared][:1]]
    return heads + sorted(name for name in shared if name.startswith(_GROUPS))


def _fitting(pattern: str, known: Sequence[str]) -> list[str]:
    # Equal names count too: one with brackets does not match itself as a pattern.
    fitting = [name for name in known if name == pattern or fnmatch.fnmatchcase(name, pattern)]
    if not fitting:
        raise CompareError(f"--metric {pattern}: no run has it; there are {', '.join(known)}")
    return fitting
