# SPDX-License-Identifier: Apache-2.0
"""File of a sweep: read, and checked against the configs of a task before anything is started."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from stripe_newton.input_files import InputFileError, read_yaml
from stripe_newton.rl.experiments.sweep_cfg import MedianPruning, Space, SweepCfg

from .run_configs import Configs
from .sweep_fields import InvalidEntryError, read_space
from .user_error import UserError

__all__ = ["read_sweep_file"]

SAMPLERS = ("grid", "random", "tpe")
_MOST_ENTRIES = 1000
_LOGGED = {
    "Train": ("mean_reward", "mean_episode_length"),
    "Perf": ("total_fps", "collection_time", "learning_time"),
    "Policy": ("mean_std",),
    "Rnd": ("mean_extrinsic_reward", "mean_intrinsic_reward", "weight"),
}
"""Columns that rsl_rl logs, beside the losses. All others are the task's."""


def read_sweep_file(path: Path, task: str, configs: Configs) -> tuple[SweepCfg, str]:
    """Read the file of a sweep.

    Args:
        path: A YAML file.
        task: The task.
        configs: Its configs, with the values of the command line; they are not changed.

    Returns:
        The sweep, and its name: that of the file if the file gives none.

    Raises:
        UserError: all that is wrong with the file, as ``FILE: FIELD: what is wrong, what would be right``.
    """
    entries = {str(name).removeprefix("--").replace("_", "-"): value for name, value in _read(path).items()}
    agent, wrong = configs.need_agent(), list[str]()
    # Fields of SweepCfg; the reader of each has checked its type.
    found: dict[str, Any] = {"max_iterations": agent.max_iterations, "seeds": (agent.seed,)}
    spaces: dict[str, Space] = {}
    # The sweep's own entries first, so that their errors are listed first.
    for name, value in sorted(entries.items(), key=lambda entry: _is_field(entry[0])):
        try:
            if _is_field(name):
                spaces[name] = read_space(name, value, configs)
            else:
                own = name.replace("-", "_")
                found[own] = _read_own(own, value, configs)
        except InvalidEntryError as error:
            wrong.append(f"{name if _is_field(name) else name.replace('-', '_')}: {error}")
    # Only of a file without errors: a wrong entry is not in `found`, and would be filled in.
    if not wrong:
        wrong += _complete(found, spaces)
    if wrong:
        raise UserError("\n".join(f"{path}: {line}" for line in wrong))
    title = str(found.pop("name", path.stem))
    return dataclasses.replace(SweepCfg(task=task, spaces=spaces), **found), title


def _is_field(name: str) -> bool:
    """Whether an entry names a field of the configs, rather than something of the sweep."""
    return name.startswith(("env.", "agent."))


def _read(path: Path) -> Mapping[object, object]:
    try:
        data = read_yaml(path)
    except InputFileError as error:
        raise UserError(f"--sweep {error}; give a YAML file") from None
    if not isinstance(data, dict):
        example = "agent.algorithm.gamma: [0.98, 0.99]"
        kind = type(data).__name__
        raise UserError(f"{path}: contains {kind}, must contain fields and their values, such as {example}")
    if len(data) > _MOST_ENTRIES:
        raise UserError(f"{path}: has {len(data)} entries, at most {_MOST_ENTRIES} can be")
    return data


# -- entries about the sweep itself


def _read_own(name: str, value: object, configs: Configs) -> object:
    """The value of an entry about the sweep itself.

    Raises:
        InvalidEntryError: if there is no such entry, or it cannot have this value.
    """
    if name not in _READERS:
        near = difflib.get_close_matches(name, _READERS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else "fields begin with 'env.' or 'agent.'; else there are"
        raise InvalidEntryError(f"is not known; {hint}" + ("" if near else f" {', '.join(_READERS)}"))
    return _READERS[name](value, configs)


def _integer(low: int) -> Callable[[object, Configs], int]:
    def read(value: object, configs: Configs) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value < low:
            raise InvalidEntryError(f"is {value!r}, must be an integer of at least {low}")
        return value

    return read


def _seeds(value: object, configs: Configs) -> tuple[int, ...]:
    seeds = value if isinstance(value, list) else []
    good = seeds and all(type(seed) is int and seed >= 0 for seed in seeds)
    if not good or len(set(seeds)) < len(seeds):
        raise InvalidEntryError(f"is {value!r}, must be a list of different integers of at least 0, such as [1, 2, 3]")
    return tuple(seeds)


def _sampler(value: object, configs: Configs) -> str:
    if value not in SAMPLERS:
        raise InvalidEntryError(f"is {value!r}, must be one of {', '.join(SAMPLERS)}")
    return str(value)


def _flag(value: object, configs: Configs) -> bool:
    if not isinstance(value, bool):
        raise InvalidEntryError(f"is {value!r}, must be true or false")
    return value


def _name(value: object, configs: Configs) -> str:
    if not isinstance(value, str) or not value or Path(value).name != value or value in (".", ".."):
        raise InvalidEntryError(f"is {value!r}, must be a name for a folder")
    return value


def _objective(value: object, configs: Configs) -> str:
    """A column that the training can log. Columns that torch hooks of a task log are known only when it runs."""
    text = value if isinstance(value, str) else ""
    group, slash, name = text.partition("/")
    if not slash or not name:
        raise InvalidEntryError(
            f"is {value!r}, must be a column of metrics.csv, such as Train/mean_reward or Loss/value"
        )
    known = _columns_of(group, configs)
    if known and name not in known:
        there = ", ".join(f"{group}/{item}" for item in known)
        raise InvalidEntryError(f"there is no column '{text}'; there are {there}")
    return text


def _columns_of(group: str, configs: Configs) -> list[str]:
    """Names of the columns of a group, as far as they are known before the task runs."""
    managed = {"Episode_Reward": "rewards", "Episode_Termination": "terminations"}.get(group)
    terms = getattr(configs.env, managed, None) if managed else None  # configs of managers alone have such fields
    if terms is not None and dataclasses.is_dataclass(terms):
        return [item.name for item in dataclasses.fields(terms) if getattr(terms, item.name) is not None]
    return list(_LOGGED.get(group, ()))


def _pruner(value: object, configs: Configs) -> MedianPruning | None:
    names = [item.name for item in dataclasses.fields(MedianPruning)]
    if value is None or value == "none":
        return None
    value = {} if value == "median" else value
    if not isinstance(value, dict):
        raise InvalidEntryError(f"is {value!r}, must be median, none, or numbers for {', '.join(names)}")
    given = {str(name).replace("-", "_"): number for name, number in value.items()}
    for name, number in given.items():
        if name not in names:
            raise InvalidEntryError(f"'{name}' is not known; there are {', '.join(names)}")
        low = 1 if name == "interval_iterations" else 0
        if type(number) is not int or number < low:
            raise InvalidEntryError(f"{name} is {number!r}, must be an integer of at least {low}")
    return MedianPruning(**given)


_READERS: dict[str, Callable[[object, Configs], object]] = {
    "name": _name,
    "seeds": _seeds,
    "trials": _integer(1),
    "sampler": _sampler,
    "objective": _objective,
    "last": _integer(1),
    "maximize": _flag,
    "pruner": _pruner,
    "max_iterations": _integer(1),
    "num_envs": _integer(1),
}


def _complete(found: dict[str, object], spaces: dict[str, Space]) -> list[str]:
    """Fill in the sampler and the number of trials where the file leaves them out; returns what does not fit."""
    ranges = [name for name, space in spaces.items() if not space.choices]
    sampler, trials = found.setdefault("sampler", "tpe" if ranges else "grid"), found.get("trials")
    if sampler != "grid":
        if trials is None:
            return [f"trials: is missing; give the number of trials for the sampler {sampler}"]
        return []
    if ranges:
        text = "is a range, which a grid cannot try completely; give a list, or sampler: tpe"
        return [f"{name}: {text}" for name in ranges]
    size = math.prod(len(space.choices) for space in spaces.values())
    if isinstance(trials, int) and trials > size:
        return [f"trials: is {trials}, but the grid has {size} combinations; leave it out"]
    found["trials"] = size if trials is None else trials
    return []
