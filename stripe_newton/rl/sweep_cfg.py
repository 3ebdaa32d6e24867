# SPDX-License-Identifier: Apache-2.0
"""What a sweep tries: the values of fields, the seeds, and what is measured."""

from __future__ import annotations

import dataclasses
import math
import shlex
from dataclasses import dataclass, field
from typing import Any

__all__ = ["MedianPruning", "Space", "SweepCfg", "words_of"]

Scalar = bool | int | float | str


def words_of(value: Any) -> list[str]:
    """The words of a command line that give a field this value. Text is words already, quoted as in a shell."""
    return shlex.split(value) if isinstance(value, str) else [str(value)]


@dataclass(frozen=True)
class Space:
    """The values of one field that are tried: ``choices``, or numbers from ``low`` to ``high``, both included."""

    choices: tuple[Scalar, ...] = ()
    """Values to choose from. Text stands for the words of a command line, such as ``"64 64"`` for two layers."""
    low: float = math.nan
    """Smallest number."""
    high: float = math.nan
    """Largest number."""
    log: bool = False
    """Whether the logarithm is drawn evenly, rather than the number."""
    step: float | None = None
    """Distance between the numbers that are tried; any number by default, 1 for an integer."""
    integer: bool = False
    """Whether the numbers are integers."""


@dataclass(frozen=True)
class MedianPruning:
    """Ends a trial whose first run is worse than the median of the finished trials at the same iteration.

    The rule and its names are those of optuna's ``MedianPruner``.
    """

    startup_trials: int = 5
    """Trials that must have finished before any is ended."""
    warmup_iterations: int = 0
    """Iterations that each trial may do in any case."""
    interval_iterations: int = 1
    """Iterations between two looks."""


@dataclass(frozen=True)
class SweepCfg:
    """A sweep: trials of the same task with other values of its fields, each with all seeds."""

    task: str
    """The task."""
    spaces: dict[str, Space] = field(default_factory=dict)
    """What is tried of each field, by its name on the command line without dashes: ``agent.algorithm.gamma``."""
    seeds: tuple[int, ...] = (0,)
    """Seeds; a trial is one run with each."""
    trials: int = 1
    """Number of trials."""
    sampler: str = "grid"
    """``grid``: all combinations of the choices in order; ``random``; ``tpe``: tree-structured Parzen estimator."""
    objective: str = "Train/mean_reward"
    """Column of ``metrics.csv`` that a trial is judged by: the mean over its last rows, and over the seeds."""
    last: int = 10
    """Number of last iterations that the objective is averaged over."""
    maximize: bool = True
    """Whether more is better."""
    pruner: MedianPruning | None = None
    """When a trial is ended early; ``None`` for never."""
    max_iterations: int = 1
    """Iterations of each run."""
    num_envs: int | None = None
    """Environments of each run; ``None`` for the task's own number."""
    options: tuple[str, ...] = ()
    """Further words of the command line of each run."""

    def to_dict(self) -> dict[str, Any]:
        """All fields, in types that YAML has."""
        return _plain(dataclasses.asdict(self))

    @property
    def varied(self) -> list[str]:
        """Fields that have more than one value."""
        return [name for name, space in self.spaces.items() if len(space.choices) != 1]

    def words(self, params: dict[str, Any]) -> list[str]:
        """What follows ``stripe-newton train`` for a run with these values, but for its seed, device and folder."""
        words = [self.task, "--max-iterations", str(self.max_iterations), *self.options]
        words += [] if self.num_envs is None else ["--num-envs", str(self.num_envs)]
        for name, value in params.items():
            words += [f"--{name}", *words_of(value)]
        return words

    def differences(self, other: dict[str, Any]) -> list[str]:
        """In what a sweep that :meth:`to_dict` described is another than this; its number of trials may be."""
        mine = self.to_dict()
        names = [name for name in mine if name != "trials" and mine[name] != other.get(name)]
        return [f"{name}: was {other.get(name)!r}, is {mine[name]!r}" for name in names]


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
