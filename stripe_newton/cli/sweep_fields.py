# SPDX-License-Identifier: Apache-2.0
"""The fields in the file of a sweep, held against the configs of a task."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import math
import shlex
from typing import Any

import tyro

from stripe_newton.configclass import ConfigError
from stripe_newton.rl.sweep_cfg import Space, words_of

from .common import Configs, check
from .fields import apply_options, options_of

__all__ = ["Wrong", "read_space"]

_OWN = {"env.seed": "seeds", "agent.seed": "seeds", "agent.max-iterations": "max_iterations"}
_ELSEWHERE = {"env.sim.device": "--device", "env.scene.num-envs": "num_envs"}


class Wrong(Exception):
    """What is wrong with one entry, and what would be right."""


def read_space(name: str, value: Any, configs: Configs) -> Space:
    """The values of a field that a sweep tries.

    Args:
        name: the field as an option without dashes, such as ``agent.algorithm.gamma``.
        value: a value, a list of values, ``{"choices": [...]}``, or ``{"low": ..., "high": ...}`` with log or step.
        configs: the configs that have the field; they are left as they are.

    Raises:
        Wrong: if the task has no such field, or it cannot have these values.
    """
    if name in _OWN:
        raise Wrong(f"use '{_OWN[name]}' of this file")
    if name in _ELSEWHERE and name != "env.scene.num-envs":
        raise Wrong(f"use the option {_ELSEWHERE[name]}")
    kind = _kind_of(name, configs)
    if isinstance(value, dict) and "choices" in value:
        more = [str(key) for key in value if key != "choices"]
        if more:
            raise Wrong(f"has choices and also {', '.join(more)}; give choices alone, or low and high")
        value = value["choices"]
        if not isinstance(value, list):
            raise Wrong(f"choices are {value!r}, must be a list")
    elif isinstance(value, dict):
        return _range(name, value, kind, configs)
    values = value if isinstance(value, list) else [value]
    if not values:
        raise Wrong("has no values; give a list such as [1, 2], or {low: ..., high: ...}")
    choices = tuple(_choice(name, item, kind, configs) for item in values)
    if len(set(map(str, choices))) < len(choices):
        raise Wrong(f"has values twice: {', '.join(map(str, choices))}")
    return Space(choices=choices)


def _range(name: str, given: dict[Any, Any], kind: Any, configs: Configs) -> Space:
    known = ("low", "high", "log", "step")
    unknown = [str(key) for key in given if key not in known]
    if unknown or "low" not in given or "high" not in given:
        what = f"'{unknown[0]}' is not known" if unknown else "low or high is missing"
        raise Wrong(f"{what}; a range is {{low: ..., high: ...}}, with log: true or step: ... if wanted")
    low, high = (_end(name, given[key], kind, configs) for key in ("low", "high"))
    log, step = given.get("log", False), given.get("step")
    integer = isinstance(low, int) and isinstance(high, int)
    if not low < high:
        raise Wrong(f"the range from {low} to {high} is empty; low must be below high")
    if not isinstance(log, bool):
        raise Wrong(f"log is {log!r}, must be true or false")
    if log and low <= 0:
        raise Wrong(f"low is {low}, must be above 0 for a logarithm")
    if step is not None:
        step = _number(step)
        if not step > 0 or (integer and step != int(step)) or step > high - low:
            raise Wrong(
                f"step is {given['step']!r}, must be {'an integer' if integer else 'a number'} within the range"
            )
        if log:
            raise Wrong("has log and step; give one of them")
    return Space(low=low, high=high, log=log, step=step, integer=integer)


def _end(name: str, value: Any, kind: Any, configs: Configs) -> int | float:
    number = _choice(name, value, kind, configs)
    if isinstance(number, (bool, str)):
        raise Wrong(f"a range needs numbers, the field holds {_current(name, configs)!r}; give a list of values")
    return number


def _number(value: Any) -> float:
    try:
        return math.nan if isinstance(value, bool) else float(value)  # YAML takes 1e-4 for text
    except (TypeError, ValueError):
        return math.nan


def _choice(name: str, value: Any, kind: Any, configs: Configs) -> bool | int | float | str:
    """A value as optuna keeps it: a number, a flag, or the words of the command line."""
    try:
        words = [str(item) for item in value] if isinstance(value, list) else words_of(value)
    except ValueError as error:
        raise Wrong(f"{value!r}: {error}") from None
    holder: Any = dataclasses.make_dataclass("Value", [("value", kind)])
    words_in, plain = ["--value", *words], (tyro.conf.FlagConversionOff,)
    try:
        parsed = tyro.cli(holder, args=words_in, config=plain, console_outputs=False).value
    except SystemExit:
        now = _current(name, configs)
        raise Wrong(f"{value!r} does not fit, the field holds {now!r}; give {_type_name(kind)}") from None
    trial = Configs(copy.deepcopy(configs.env), copy.deepcopy(configs.agent))
    root, *path = name.replace("-", "_").split(".")
    cfg = getattr(trial, root)
    options = options_of(cfg, root)
    target = options
    for part in path[:-1]:
        target = getattr(target, part)
    setattr(target, path[-1], parsed)
    apply_options(cfg, options)
    try:
        check(trial)
    except ConfigError as error:
        raise Wrong(f"{value!r} does not do: {'; '.join(error.problems)}") from None
    return parsed if isinstance(parsed, (bool, int, float)) else shlex.join(words)


def _walk(name: str, configs: Configs) -> tuple[Any, str]:
    """The options that hold a field, and its name in them."""
    root, *path = name.replace("-", "_").split(".")
    options, done = options_of(getattr(configs, root), root), root
    for number, part in enumerate(path):
        names = [item.name for item in dataclasses.fields(options)]
        last = number == len(path) - 1
        nested = dataclasses.is_dataclass(getattr(options, part, None))
        if part not in names or nested == last:
            shown = [item.replace("_", "-") for item in names]
            near = difflib.get_close_matches(part.replace("_", "-"), shown, n=3, cutoff=0.5)
            what = (
                "is a group of fields, name one of" if part in names and last else "there is no such field, there are"
            )
            inside = [item.name for item in dataclasses.fields(getattr(options, part))] if nested and last else []
            some = [item.replace("_", "-") for item in inside] or near or shown
            prefix = f"{done}.{part}" if inside else done
            raise Wrong(f"{what} {', '.join(f'{prefix}.{item}'.replace('_', '-') for item in some)}")
        if last:
            return options, part
        options, done = getattr(options, part), f"{done}.{part}"
    raise Wrong("names no field")


def _kind_of(name: str, configs: Configs) -> Any:
    options, part = _walk(name, configs)
    hints = {item.name: item.type for item in dataclasses.fields(options)}
    return hints[part]


def _current(name: str, configs: Configs) -> Any:
    options, part = _walk(name, configs)
    return getattr(options, part)


def _type_name(kind: Any) -> str:
    inner = getattr(kind, "__origin__", kind)
    return str(getattr(inner, "__name__", inner)) if isinstance(inner, type) else str(inner).replace("typing.", "")
