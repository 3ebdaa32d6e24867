# SPDX-License-Identifier: Apache-2.0
"""LoadedRun: a run as comparisons read it, its configs and what it logged to ``metrics.csv`` or tensorboard events."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from stripe_newton.input_files import InputFileError, SafeLoader, read_yaml
from stripe_newton.rl.runs.metrics_csv import read_metrics

__all__ = ["CompareError", "LoadedRun", "find_runs", "load_run"]

_HEAD = ("iteration", "total_steps", "elapsed_s")
"""Columns that are no metrics."""

FlatConfig = dict[str, object]
"""Fields of configs by dotted path."""


class CompareError(ValueError):
    """Runs that cannot be read or compared."""


@dataclass
class LoadedRun:
    """The log of one run. Each array has a value for each iteration that was logged, NaN where there is none."""

    path: Path
    """The run folder."""
    x: dict[str, np.ndarray]
    """``iterations`` done, ``steps``: samples of all environments, and ``seconds`` since the start."""
    columns: dict[str, np.ndarray]
    """Metrics by name."""
    config: FlatConfig = field(default_factory=dict)
    """Fields of the configs by dotted path, from ``env.``, ``agent.``, ``run.`` and ``git.``."""

    @property
    def label(self) -> str:
        """Name of the run: its experiment, its task, or its folder."""
        return str(self.config.get("agent.experiment_name") or self.config.get("run.task") or self.path.name)


def find_runs(path: str | os.PathLike) -> list[Path]:
    """The run folders of a path: itself, or those below it.

    Raises:
        CompareError: if there are none.
    """
    root = Path(path).expanduser()
    if not root.is_dir():
        raise CompareError(f"{path}: is not a folder; give a run folder, or one that contains runs")
    found: list[Path] = []
    for folder, below, files in os.walk(root):
        below.sort()
        if "metrics.csv" in files or any(name.startswith("events.out.tfevents") for name in files):
            found.append(Path(folder))
            below.clear()  # a run contains no runs, but maybe many files
    if not found:
        raise CompareError(f"{path}: contains no run; a run has a metrics.csv, or tensorboard events")
    return found


def load_run(path: Path) -> LoadedRun:
    """Read a run.

    Raises:
        CompareError: if nothing was logged, or it cannot be read.
    """
    config = _read_config(path)
    try:
        columns = _from_csv(path / "metrics.csv") if (path / "metrics.csv").exists() else _from_events(path, config)
    except (ValueError, TypeError) as error:
        raise CompareError(f"{path}: cannot be read: {error}") from None
    if not columns or not len(columns["iteration"]):
        raise CompareError(f"{path}: no iteration was logged")
    x = {
        "iterations": columns["iteration"] + 1.0,
        "steps": columns["total_steps"],
        "seconds": columns["elapsed_s"],
    }
    logged = {name: values for name, values in columns.items() if name not in _HEAD}
    return LoadedRun(path, x, logged, config)


def _from_csv(file: Path) -> dict[str, np.ndarray]:
    columns = {name: np.asarray(values) for name, values in read_metrics(file).items()}
    missing = [name for name in _HEAD if name not in columns]
    if columns and missing:
        raise ValueError(f"{file.name} has no column {', '.join(missing)}")
    return columns


def _from_events(path: Path, config: FlatConfig) -> dict[str, np.ndarray]:
    """Columns of the events that a logger of rsl_rl wrote for tensorboard, whose step is the iteration."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator  # slow, and seldom needed

    events = EventAccumulator(str(path), size_guidance={"scalars": 0})
    events.Reload()
    tags = [tag for tag in events.Tags()["scalars"] if not tag.endswith("/time")]  # those are over seconds
    values = {tag: {event.step: event for event in events.Scalars(tag)} for tag in tags}
    steps = sorted({step for of_tag in values.values() for step in of_tag})
    columns = {
        tag: np.array([of_tag[step].value if step in of_tag else np.nan for step in steps], dtype=float)
        for tag, of_tag in values.items()
    }
    # Events say neither samples nor seconds. The former follow from the configs, the latter from the times of writing.
    per_iteration = _number(config.get("env.scene.num_envs")) * _number(config.get("agent.num_steps_per_env"))
    clock = [min(of_tag[step].wall_time for of_tag in values.values() if step in of_tag) for step in steps]
    iteration = np.array(steps, dtype=float)
    seconds = np.array(clock) - (clock[0] if clock else 0.0)
    head = {"iteration": iteration, "total_steps": (iteration + 1.0) * per_iteration, "elapsed_s": seconds}
    return head | columns


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else np.nan


# -- configs


class _Loader(SafeLoader):
    """Safe YAML that reads tagged Python objects, which other programs write, as the plain values inside them."""


def _plain(loader: yaml.SafeLoader, suffix: str, node: yaml.Node) -> object:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    return f"{suffix} {node.value}".strip()


_Loader.add_multi_constructor("tag:yaml.org,2002:python/", _plain)


def _read_config(path: Path) -> FlatConfig:
    flat: FlatConfig = {}
    for name in ("run", "env", "agent"):
        file = path / "params" / f"{name}.yaml"
        if file.exists():
            try:
                data = read_yaml(file, _Loader)
            except InputFileError as error:
                raise CompareError(str(error)) from None
            _flatten(data, name, flat)
    for file in sorted((path / "git").glob("*.diff")):  # written by rsl_rl: commit, status and diff of a repository
        text = file.read_text(encoding="utf-8", errors="replace")
        commit, _, rest = text.removeprefix("--- git commit ---").partition("--- git status ---")
        diff = rest.partition("--- git diff ---")[2].strip()
        changes = hashlib.sha1(diff.encode()).hexdigest()[:8] if diff else "none"
        flat[f"git.{file.stem}.commit"] = commit.strip()[:10]
        flat[f"git.{file.stem}.uncommitted_changes"] = changes
    return flat


def _flatten(value: object, path: str, flat: FlatConfig) -> None:
    if isinstance(value, dict) and value:
        for key, item in value.items():
            _flatten(item, f"{path}.{key}", flat)
    else:
        flat[path] = value
