# SPDX-License-Identifier: Apache-2.0
"""Array arguments of terms: indices of joints, bodies and sensor parts, term states, and constants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import torch
import warp as wp

from stripe_newton.configclass import configclass
from stripe_newton.matching import match_names, match_values

from .scene_entity import SceneEntityCfg
from .source import Code
from .term_binding import ArgumentError, TermBinding

__all__ = ["TermState", "array_argument"]

_NUMPY = {wp.int32: np.int32, wp.bool: np.bool_}
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")
_SAME = {float: wp.float32, int: wp.int32, bool: wp.bool}
"""Warp's types of Python's."""


@configclass
class TermState:
    """An array of a term that lasts from step to step. Terms that give it the same name share it."""

    name: str = "state"
    """Its name."""
    dtype: type = float
    """Warp type of an element."""
    shape: Sequence[int] = ()
    """Shape for one environment."""


class ArrayType(Protocol):
    """Type of an array argument, as ``wp.array2d[float]`` makes it."""

    dtype: type
    ndim: int


def array_argument(binding: TermBinding, name: str, kind: ArrayType) -> Code:
    """Source code of an array argument.

    Some names stand for indices: of joints (``joint_ids`` and ``<prefix>_joint_ids``), bodies (``body_ids``,
    ``<prefix>_body_ids``), termination terms (``term_ids``) or sensor parts (``ray_ids`` if the sensor has
    ``num_rays``). Any other array is in the config: a :class:`TermState`, a tensor, or numbers.

    Raises:
        ArgumentError: if it cannot be found.
        ValueError: if an expression matches nothing.
    """
    context = binding.context
    if name == "term_ids":
        keys = binding.take("term_keys", name) or ".*"
        return _constant(binding, name, match_names(keys, context.termination_names, what="termination term")[0], kind)
    for what in ("joint", "body"):
        if name.endswith(f"{what}_ids"):
            ids = _choose(binding, name, what)
            binding.counts[name] = len(ids)
            return context.scope.name(f"{what}_ids", context.index_array(ids))
    part = name.removesuffix("_ids")
    if part != name and f"num_{part}s" in binding.counts:
        ids = _choose_parts(binding, name, part, binding.counts[f"num_{part}s"])
        binding.counts[name] = len(ids)
        return context.scope.name(name, context.index_array(ids))
    return _configured_array(binding, name, kind)


def _choose(binding: TermBinding, name: str, what: str) -> list[int]:
    """Indices of joints (``what="joint"``) or bodies (``"body"``) that the config chooses.

    An argument ``<prefix>_joint_ids`` has the joints of ``<prefix>_cfg``; ``joint_ids`` those of the asset or sensor
    that another argument of the term names.
    """
    prefix = name.removesuffix(f"{what}_ids").rstrip("_")
    given = binding.take(name)
    cfg = binding.take_entity(prefix, f"{prefix}_cfg") if prefix else None
    cfg = cfg or binding.asset or binding.sensor or binding.take_entity("asset_cfg") or SceneEntityCfg()
    names = binding.context.entity(cfg.name).names_of(what)
    if names is None:
        raise ArgumentError(f"'{cfg.name}' has no {what}s to choose from")
    if given is not None:
        texts = isinstance(given, str) or (given and isinstance(given[0], str))
        return match_names(given, names, what=f"{what} of '{cfg.name}'")[0] if texts else list(given)
    other = {"joint": "body", "body": "joint"}[what]
    if not cfg.chooses(what) and cfg.chooses(other) and not any(n.endswith(f"{other}_ids") for n in binding.types):
        about = {"joint": "joints", "body": "bodies"}[what]
        raise ArgumentError(
            f"'{binding.name}' is about {about} of '{cfg.name}', choose by {what}_names, not {other}_names"
        )
    ids = cfg.indices(what, names)
    binding.chosen[name] = [names[i] for i in ids]
    return ids


def _choose_parts(binding: TermBinding, name: str, part: str, count: int) -> list[int]:
    """Indices of sensor parts, such as rays, that the config chooses; by default all."""
    there, chosen = range(count), binding.take(name)
    for wrong in (i for i in chosen or () if i not in there):
        raise ArgumentError(f"has {wrong}, the sensor has {part}s 0 to {there[-1]}")
    return list(there if chosen is None else chosen)


def _configured_array(binding: TermBinding, name: str, kind: ArrayType) -> Code:
    """Source code of an array that the config gives."""
    scope, value = binding.context.scope, binding.take(name)
    # A two-dimensional array that the config does not give is the term's own state, with a column for each body.
    if value is None and kind.ndim == 2 and "body_ids" in binding.counts:
        value = TermState(f"{binding.where}.{name}", kind.dtype, (binding.counts["body_ids"],))
    if value is None:
        raise ArgumentError(f"is missing, '{binding.name}' needs {kind}")
    if isinstance(value, TermState):
        return _state(binding, value, kind)
    if isinstance(value, torch.Tensor):
        return scope.name(name, wp.from_torch(value, dtype=kind.dtype))
    if isinstance(value, wp.array):
        return scope.name(name, value)
    if isinstance(value, Mapping) and kind.dtype is wp.vec2:
        return _constant(binding, name, _by_axis(value), kind)
    if isinstance(value, (Mapping, int, float)):
        return _constant(binding, name, _by_joint(binding, value), kind)
    return _constant(binding, name, value, kind)


def _state(binding: TermBinding, state: TermState, kind: ArrayType) -> Code:
    if _SAME.get(state.dtype, state.dtype) is not kind.dtype or len(state.shape) + 1 != kind.ndim:
        raise ArgumentError(
            f"is a state of {state.dtype.__name__}, shape {tuple(state.shape)}, '{binding.name}' needs {kind}"
        )
    array = binding.context.array(f"state.{state.name}", state.dtype, *state.shape)
    return binding.context.scope.name(state.name, array)


def _by_axis(ranges: Mapping[str, tuple[float, float]]) -> list[tuple[float, float]]:
    """Ranges by axis as a list of six; (0, 0) for an axis that is not named."""
    wrong = ranges.keys() - set(_AXES)
    if wrong:
        raise ArgumentError(f"has {', '.join(map(repr, sorted(wrong)))}, keys must be among {', '.join(_AXES)}")
    return [ranges.get(axis, (0.0, 0.0)) for axis in _AXES]


def _by_joint(binding: TermBinding, values: float | Mapping[str, float]) -> list[float]:
    """Values by joint-name expression as a list with one for each chosen joint."""
    asset = binding.asset or SceneEntityCfg()
    there = binding.context.entity(asset.name).names_of("joint") or []
    names = [there[i] for i in _choose(binding, "joint_ids", "joint")]
    found = match_values(values, names, what="joint")
    missing = [n for i, n in enumerate(names) if i not in found]
    if missing:
        raise ArgumentError(f"has no value for {', '.join(missing)}")
    return [found[i] for i in range(len(names))]


def _constant(binding: TermBinding, name: str, value: object, kind: ArrayType) -> Code:
    """Source code of an array with numbers of the config."""
    data: np.ndarray = np.array(value, dtype=_NUMPY.get(kind.dtype, np.float32))
    size = len(data) if data.ndim else 1
    array = binding.context.shared(f"{binding.where}.{name}", kind.dtype, size)
    try:
        array.assign(data)
    except (RuntimeError, ValueError, TypeError):
        raise ArgumentError(f"is {value!r}, must be {size} times {kind.dtype.__name__}") from None
    return binding.context.scope.name(f"{binding.where}_{name}", array)
