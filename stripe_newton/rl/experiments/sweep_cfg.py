# SPDX-License-Identifier: Apache-2.0
"""SweepCfg: the values of fields and the seeds that a sweep tries, and what its trials are judged by."""

from __future__ import annotations

import dataclasses
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field

__all__ = ["MedianPruning", "Scalar", "Space", "SweepCfg", "words_of"]

Scalar = bool | int | float | str
"""A value that is tried. Text stands for words of a command line."""


def words_of(value: object) -> list[str]:
    """The words of a command line that give a field this value. Text is split into words as by a shell."""
    return shlex.split(value) if isinstance(value, str) else [str(value)]


@dataclass(frozen=True)
class Space:
    """Values of one field that are tried: ``choices``, or numbers from ``low`` to ``high``, both included."""

    choices: tuple[Scalar, ...] = ()
    """Values to choose from. Text stands for the words of a command line, such as ``"64 64"`` for two layers."""
    low: float = math.nan
    """Smallest number."""
    high: float = math.nan
    """Largest number."""
    log: bool = False
    """Whether the logarithm of the number is drawn uniformly, rather than the number."""
    step: float | None = None
    """Distance between numbers that are tried. By default all numbers are possible, or all integers."""
    integer: bool = False
    """Whether the numbers are integers."""


@dataclass(frozen=True)
class MedianPruning:
    """Ends a trial whose first run is worse than the median of the finished trials at the same iteration.

    The rule and its names are those of optuna's ``MedianPruner``.
    """

    startup_trials: int = 5
    """Trials that must have finished before the first is ended."""
    warmup_iterations: int = 0
    """Iterations that every trial does."""
    interval_iterations: int = 1
    """Iterations from one comparison to the next."""


@dataclass(frozen=True)
class SweepCfg:
    """A sweep: trials of one task with different values of its fields, each with all seeds."""

    task: str
    """The task."""
    spaces: dict[str, Space] = field(default_factory=dict)
    """Values of each field, by its name on the command line without dashes: ``agent.algorithm.gamma``."""
    seeds: tuple[int, ...] = (0,)
    """Seeds; a trial is one run with each."""
    trials: int = 1
    """Number of trials."""
    sampler: str = "grid"
    """``grid``: all combinations of the choices in order; ``random``; ``tpe``: tree-structured Parzen estimator."""
    objective: str = "Train/mean_reward"
    """Column of ``metrics.csv`` that trials are judged by: its mean over the last rows and over the seeds."""
    last: int = 10
    """Number of last iterations that the objective is averaged over."""
    maximize: bool = True
    """Whether a larger objective is better."""
    pruner: MedianPruning | None = None
    """Rule by which trials are ended early; ``None`` for none."""
    max_iterations: int = 1
    """Iterations of each run."""
    num_envs: int | None = None
    """Environments of each run; ``None`` for the number of the task."""
    options: tuple[str, ...] = ()
    """Further arguments of each run."""

    def to_dict(self) -> dict[str, object]:
        """All fields, in types that YAML has."""
        return {name: _plain(value) for name, value in dataclasses.asdict(self).items()}

    @property
    def varied(self) -> list[str]:
        """Fields that have more than one value."""
        return [name for name, space in self.spaces.items() if len(space.choices) != 1]

    def words(self, params: Mapping[str, Scalar]) -> list[str]:
        """The arguments of ``stripe-newton train`` for a run with these values, without seed, device and folder."""
        # Fields that are tried stand last, so that they override options of the same name.
        words = [self.task, "--max-iterations", str(self.max_iterations), *self.options]
        words += [] if self.num_envs is None else ["--num-envs", str(self.num_envs)]
        for name, value in params.items():
            words += [f"--{name}", *words_of(value)]
        return words

    def differences(self, other: Mapping[str, object]) -> list[str]:
        """Differences from a sweep that :meth:`to_dict` described. The number of trials may differ."""
        mine = self.to_dict()
        names = [name for name in mine if name != "trials" and mine[name] != other.get(name)]
        return [f"{name}: was {other.get(name)!r}, is {mine[name]!r}" for name in names]


def _plain(value: object) -> object:
    """A value with lists for tuples, and None for NaN, which is not equal to itself."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and math.isnan(value) else value
