# SPDX-License-Identifier: Apache-2.0
"""Fields in the file of a sweep: their values, checked against the configs of the task."""

from __future__ import annotations

import copy
import dataclasses
import difflib
import functools
import math
import shlex
from collections.abc import Mapping
from typing import cast

import tyro

from stripe_newton.configclass import ConfigError, is_config
from stripe_newton.rl.experiments.sweep_cfg import Scalar, Space, words_of
from stripe_newton.value_types import WRITTEN, annotation_of, has_mark

from .field_options import Node, Options, TypeForm, apply_options, options_of
from .run_configs import Configs, check

__all__ = ["InvalidEntryError", "read_space"]

_OWN = {"env.seed": "seeds", "agent.seed": "seeds", "agent.max-iterations": "max_iterations"}
"""Fields that a sweep sets by entries of its own."""
_RANGE_KEYS = ("low", "high", "log", "step")


class InvalidEntryError(Exception):
    """An entry of the file that is wrong: what is wrong with it, and what would be right."""


def read_space(name: str, value: object, configs: Configs) -> Space:
    """The values of a field that a sweep tries.

    Args:
        name: The field as an option without dashes, such as ``agent.algorithm.gamma``.
        value: A value, a list of values, ``{"choices": [...]}``, or ``{"low": ..., "high": ...}`` with log or step.
        configs: The configs that have the field; they are not changed.

    Raises:
        InvalidEntryError: if the task has no such field, or the field cannot have these values.
    """
    if name in _OWN:
        raise InvalidEntryError(f"use '{_OWN[name]}' of this file")
    if name == "env.sim.device":
        raise InvalidEntryError("use the option --device")
    field = _Field(name, configs)
    if isinstance(value, Mapping) and "choices" not in value:
        return _range(field, value)
    choices = tuple(field.choice(item) for item in _listed(value))
    # Compared by their text, since 1 and True are equal in Python.
    if len(set(map(str, choices))) < len(choices):
        raise InvalidEntryError(f"has values twice: {', '.join(map(str, choices))}")
    return Space(choices=choices)


def _listed(value: object) -> list[object]:
    """The values of an entry that lists them."""
    if isinstance(value, Mapping):
        more = [str(key) for key in value if key != "choices"]
        if more:
            raise InvalidEntryError(f"has choices and also {', '.join(more)}; give choices alone, or low and high")
        value = value["choices"]
        if not isinstance(value, list):
            raise InvalidEntryError(f"choices are {value!r}, must be a list")
    values = value if isinstance(value, list) else [value]
    if not values:
        raise InvalidEntryError("has no values; give a list such as [1, 2], or {low: ..., high: ...}")
    return values


def _range(field: _Field, given: Mapping[object, object]) -> Space:
    """The numbers of an entry that gives their range."""
    unknown = [str(key) for key in given if key not in _RANGE_KEYS]
    if unknown or "low" not in given or "high" not in given:
        what = f"'{unknown[0]}' is not known" if unknown else "low or high is missing"
        raise InvalidEntryError(f"{what}; a range is {{low: ..., high: ...}}, with log: true or step: ... if wanted")
    low, high = field.number(given["low"]), field.number(given["high"])
    integer = isinstance(low, int) and isinstance(high, int)
    if not low < high:
        raise InvalidEntryError(f"the range from {low} to {high} is empty; low must be below high")
    log = given.get("log", False)
    if not isinstance(log, bool):
        raise InvalidEntryError(f"log is {log!r}, must be true or false")
    if log and low <= 0:
        raise InvalidEntryError(f"low is {low}, must be above 0 for a logarithm")
    step = _step(given.get("step"), high - low, integer)
    if log and step is not None:
        raise InvalidEntryError("has log and step; give one of them")
    return Space(low=low, high=high, log=log, step=step, integer=integer)


def _step(given: object, extent: float, integer: bool) -> float | None:
    """The step of a range, None for none."""
    if given is None:
        return None
    step = _number(given)
    if not step > 0 or (integer and step != int(step)) or step > extent:
        kind = "an integer" if integer else "a number"
        raise InvalidEntryError(f"step is {given!r}, must be {kind} within the range")
    return step


def _number(value: object) -> float:
    """The number that a value is, NaN for anything else."""
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        return math.nan
    try:
        return float(value)  # YAML takes 1e-4 for text
    except ValueError:
        return math.nan


class _Field:
    """A field of the task's configs, as an option of the command line.

    Raises:
        InvalidEntryError: if there is no such field, or its value is a place that runs write to. The file of a sweep
            may be somebody else's.
    """

    def __init__(self, name: str, configs: Configs):
        self._name, self._configs = name, configs
        self._root, *self._path = name.replace("-", "_").split(".")
        options = options_of(getattr(configs, self._root), self._root)
        group = _group_of(options, self._root, self._path)
        self._kind: TypeForm = {item.name: item.type for item in _fields(group)}[self._path[-1]]
        self._value = getattr(group, self._path[-1])
        cfg = functools.reduce(_part, self._path[:-1], getattr(configs, self._root))
        if is_config(cfg) and has_mark(annotation_of(type(cfg), self._path[-1]), WRITTEN):
            raise InvalidEntryError("names a place that is written, which no sweep varies; give it as an option")

    def number(self, value: object) -> int | float:
        """An end of a range.

        Raises:
            InvalidEntryError: if the field does not hold numbers, or cannot hold this one.
        """
        number = self.choice(value)
        if isinstance(number, (bool, str)):
            raise InvalidEntryError(f"a range needs numbers, the field holds {self._value!r}; give a list of values")
        return number

    def choice(self, value: object) -> Scalar:
        """A value as optuna keeps it: a number, a flag, or the words of the command line.

        Raises:
            InvalidEntryError: if the field cannot hold it, by its type or by the checks of its config.
        """
        try:
            words = [str(item) for item in value] if isinstance(value, list) else words_of(value)
        except ValueError as error:
            raise InvalidEntryError(f"{value!r}: {error}") from None
        parsed = self._parse(value, words)
        self._check(value, parsed)
        return parsed if isinstance(parsed, (bool, int, float)) else shlex.join(words)

    def _parse(self, value: object, words: list[str]) -> object:
        """The value as the command line reads it."""
        # By tyro, as the run's own command line will, so that both accept the same.
        holder = dataclasses.make_dataclass("Value", [("value", self._kind)])
        plain = (tyro.conf.FlagConversionOff,)
        try:
            parsed: object = tyro.cli(holder, args=["--value", *words], config=plain, console_outputs=False)
        except SystemExit:
            raise InvalidEntryError(
                f"{value!r} does not fit, the field holds {self._value!r}; give {_type_name(self._kind)}"
            ) from None
        return vars(parsed)["value"]

    def _check(self, value: object, parsed: object) -> None:
        """Check configs that have the value."""
        # On copies of both configs, since checks look at several fields together.
        trial = Configs(copy.deepcopy(self._configs.env), copy.deepcopy(self._configs.agent))
        cfg = getattr(trial, self._root)
        options = options_of(cfg, self._root)
        setattr(_group_of(options, self._root, self._path), self._path[-1], parsed)
        try:
            apply_options(cfg, options, self._root)
            check(trial)
        except ConfigError as error:
            raise InvalidEntryError(f"{value!r} is rejected: {'; '.join(error.problems)}") from None


def _part(cfg: Node, name: str) -> Node:
    """A config, or a dict, inside another one."""
    found = cfg[name] if isinstance(cfg, Mapping) else getattr(cfg, name)
    return cast("Node", found)


def _fields(options: Options) -> tuple[dataclasses.Field, ...]:
    return dataclasses.fields(options)  # type: ignore[arg-type]


def _group_of(options: Options, root: str, path: list[str]) -> Options:
    """The group of options that holds a field.

    Raises:
        InvalidEntryError: if there is no such field; the message names fields that there are.
    """
    group, done = options, root
    for number, part in enumerate(path):
        is_last = number == len(path) - 1
        is_group = dataclasses.is_dataclass(getattr(group, part, None))
        if part not in [item.name for item in _fields(group)] or is_group == is_last:
            raise InvalidEntryError(_no_such_field(group, done, part, is_last and is_group))
        if is_last:
            return group
        group, done = getattr(group, part), f"{done}.{part}"
    raise InvalidEntryError("names no field")


def _no_such_field(group: Options, done: str, part: str, is_group: bool) -> str:
    """The message about a name that is no field of a group, or that is a group itself."""
    if is_group:
        inside = [f"{done}.{part}.{item.name}" for item in _fields(getattr(group, part))]
        return f"is a group of fields, name one of {', '.join(inside)}".replace("_", "-")
    there = [item.name.replace("_", "-") for item in _fields(group)]
    near = difflib.get_close_matches(part.replace("_", "-"), there, n=3, cutoff=0.5)
    prefix = done.replace("_", "-")
    return f"there is no such field, there are {', '.join(f'{prefix}.{item}' for item in near or there)}"


def _type_name(kind: TypeForm) -> str:
    inner = getattr(kind, "__origin__", kind)
    return str(getattr(inner, "__name__", inner)) if isinstance(inner, type) else str(inner).replace("typing.", "")
