# SPDX-License-Identifier: Apache-2.0
"""The file of a sweep, read and checked against the configs of a task before anything is started."""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml

from stripe_newton.rl.sweep_cfg import MedianPruning, Space, SweepCfg

from .common import Configs
from .errors import UserError
from .sweep_fields import Wrong, read_space

__all__ = ["read_sweep_file"]

SAMPLERS = ("grid", "random", "tpe")
_LOGGED = {
    "Train": ("mean_reward", "mean_episode_length"),
    "Perf": ("total_fps", "collection_time", "learning_time"),
    "Policy": ("mean_std",),
    "Rnd": ("mean_extrinsic_reward", "mean_intrinsic_reward", "weight"),
}
"""What rsl_rl logs besides the losses; other groups are the task's."""


def read_sweep_file(path: Path, task: str, configs: Configs) -> tuple[SweepCfg, str]:
    """Read a sweep.

    Args:
        path: a YAML file.
        task: the task.
        configs: its configs, with what the command line says; they are left as they are.

    Returns:
        The sweep, and its name: that of the file if the file gives none.

    Raises:
        UserError: all that is wrong with the file, as ``FILE: FIELD: what is wrong, what would be right``.
    """
    data = _read(path)
    entries = {str(name).removeprefix("--").replace("_", "-"): value for name, value in data.items()}
    own = {name.replace("-", "_"): value for name, value in entries.items() if not name.startswith(("env.", "agent."))}
    wrong: list[str] = []
    found: dict[str, Any] = {"max_iterations": configs.agent.max_iterations, "seeds": (configs.agent.seed,)}
    for name, value in own.items():
        try:
            found[name] = _check_own(name, value, configs)
        except Wrong as error:
            wrong.append(f"{name}: {error}")
    spaces: dict[str, Space] = {}
    for name, value in entries.items():
        if name.startswith(("env.", "agent.")):
            try:
                spaces[name] = read_space(name, value, configs)
            except Wrong as error:
                wrong.append(f"{name}: {error}")
    if not wrong:
        wrong += _complete(found, spaces)
    if wrong:
        raise UserError("\n".join(f"{path}: {line}" for line in wrong))
    title = found.pop("name", path.stem)
    return SweepCfg(task=task, spaces=spaces, **found), title


def _read(path: Path) -> dict[Any, Any]:
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"--sweep {path}: {error.strerror}; give a YAML file") from None
    except UnicodeDecodeError:
        raise UserError(f"{path}: is no text; give a YAML file") from None
    except yaml.YAMLError as error:
        raise UserError(f"{path}: is no valid YAML: {' '.join(str(error).split())}") from None
    if not isinstance(data, dict):
        example = "agent.algorithm.gamma: [0.98, 0.99]"
        raise UserError(f"{path}: holds {type(data).__name__}, must hold fields and what they try, such as {example}")
    return data


# -- entries about the sweep itself


def _check_own(name: str, value: Any, configs: Configs) -> Any:
    if name not in _CHECKS:
        near = difflib.get_close_matches(name, _CHECKS, n=1)
        hint = f"did you mean '{near[0]}'?" if near else "fields begin with 'env.' or 'agent.'; else there are"
        raise Wrong(f"is not known; {hint}" + ("" if near else f" {', '.join(_CHECKS)}"))
    return _CHECKS[name](value, configs)


def _integer(low: int) -> Callable[[Any, Configs], int]:
    def check_it(value: Any, configs: Configs) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or value < low:
            raise Wrong(f"is {value!r}, must be an integer of at least {low}")
        return value

    return check_it


def _seeds(value: Any, configs: Configs) -> tuple[int, ...]:
    good = isinstance(value, list) and value and all(type(seed) is int and seed >= 0 for seed in value)
    if not good or len(set(value)) < len(value):
        raise Wrong(f"is {value!r}, must be a list of different integers of at least 0, such as [1, 2, 3]")
    return tuple(value)


def _sampler(value: Any, configs: Configs) -> str:
    if value not in SAMPLERS:
        raise Wrong(f"is {value!r}, must be one of {', '.join(SAMPLERS)}")
    return value


def _flag(value: Any, configs: Configs) -> bool:
    if not isinstance(value, bool):
        raise Wrong(f"is {value!r}, must be true or false")
    return value


def _name(value: Any, configs: Configs) -> str:
    if not isinstance(value, str) or not value or Path(value).name != value or value in (".", ".."):
        raise Wrong(f"is {value!r}, must be a name for a folder")
    return value


def _objective(value: Any, configs: Configs) -> str:
    """A column that the training can log; what a task of torch hooks logs shows only in its runs."""
    group, slash, name = value.partition("/") if isinstance(value, str) else ("", "", "")
    if not slash or not name:
        raise Wrong(f"is {value!r}, must be a column of metrics.csv, such as Train/mean_reward or Loss/value")
    known = list(_LOGGED.get(group, ()))
    managed = {"Episode_Reward": "rewards", "Episode_Termination": "terminations"}.get(group)
    terms = getattr(configs.env, managed, None) if managed else None
    if terms is not None and dataclasses.is_dataclass(terms):
        known = [item.name for item in dataclasses.fields(terms) if getattr(terms, item.name) is not None]
    if known and name not in known:
        raise Wrong(f"there is no column '{value}'; there are {', '.join(f'{group}/{item}' for item in known)}")
    return value


def _pruner(value: Any, configs: Configs) -> MedianPruning | None:
    names = [item.name for item in dataclasses.fields(MedianPruning)]
    if value is None or value == "none":
        return None
    value = {} if value == "median" else value
    if not isinstance(value, dict):
        raise Wrong(f"is {value!r}, must be median, none, or numbers for {', '.join(names)}")
    given = {str(name).replace("-", "_"): number for name, number in value.items()}
    for name, number in given.items():
        low = 1 if name == "interval_iterations" else 0
        if name not in names:
            raise Wrong(f"'{name}' is not known; there are {', '.join(names)}")
        if type(number) is not int or number < low:
            raise Wrong(f"{name} is {number!r}, must be an integer of at least {low}")
    return MedianPruning(**given)


_CHECKS: dict[str, Callable[[Any, Configs], Any]] = {
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


def _complete(found: dict[str, Any], spaces: dict[str, Space]) -> list[str]:
    """Fill in what follows from the rest; returns what does not fit together."""
    ranges = [name for name, space in spaces.items() if not space.choices]
    found.setdefault("sampler", "tpe" if ranges else "grid")
    if found["sampler"] == "grid":
        if ranges:
            return [
                f"{name}: is a range, of which a grid cannot try all; give a list, or sampler: tpe" for name in ranges
            ]
        size = math.prod(len(space.choices) for space in spaces.values())
        if found.setdefault("trials", size) > size:
            return [f"trials: is {found['trials']}, but the grid has {size} combinations; leave it out"]
    elif "trials" not in found:
        return [f"trials: is missing; say how many the sampler {found['sampler']} shall propose"]
    return []
