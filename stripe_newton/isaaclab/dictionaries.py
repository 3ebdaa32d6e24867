# SPDX-License-Identifier: Apache-2.0
"""Functions of ``isaaclab.utils`` on nested dicts, and the version of Isaac Sim that the dialect answers with."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
import warp as wp
from packaging.version import Version

from .strings import callable_to_string, string_to_callable

__all__ = [
    "class_to_dict",
    "convert_dict_to_backend",
    "get_isaac_sim_version",
    "print_dict",
    "replace_slices_with_strings",
    "replace_strings_with_slices",
    "update_class_from_dict",
]

_SLICE = "slice("


def class_to_dict(obj: object) -> Any:
    """The attributes of an object as nested dicts; functions as ``"module:name"``, tensors and numbers as they are."""
    if isinstance(obj, torch.Tensor) or not (isinstance(obj, Mapping) or hasattr(obj, "__dict__")):
        return obj
    items = obj if isinstance(obj, Mapping) else vars(obj)
    return {key: _plain(value) for key, value in items.items() if not str(key).startswith("__")}


def _plain(value: Any) -> Any:
    if callable(value):
        return callable_to_string(value)
    if isinstance(value, (list, tuple)):
        return type(value)([class_to_dict(part) for part in value])
    return class_to_dict(value)


def update_class_from_dict(obj: Any, data: Mapping[str, Any], _ns: str = "") -> None:
    """Set attributes of an object, or entries of a dict, from a nested dict, in place.

    Args:
        obj: The object.
        data: New values by name; dicts are merged into what is there.
        _ns: Path of ``obj``, for error messages.

    Raises:
        KeyError: a name that ``obj`` does not have.
        ValueError: a value of another type than the present one, unless one of both is ``None``.
    """
    for name, value in data.items():
        path, has = f"{_ns}/{name}", name in obj if isinstance(obj, Mapping) else hasattr(obj, name)
        if not has:
            raise KeyError(f"'{path}': there is no such name")
        present = obj[name] if isinstance(obj, Mapping) else getattr(obj, name)
        if isinstance(value, Mapping) and present is not None:
            update_class_from_dict(present, value, path)
            continue
        if isinstance(present, tuple) and isinstance(value, list):
            value = tuple(value)
        if callable(present) and isinstance(value, str):
            value = string_to_callable(value)
        number = isinstance(present, (int, float)) and isinstance(value, (int, float))
        if not (present is None or value is None or number or isinstance(value, type(present)) or callable(present)):
            raise ValueError(f"'{path}' is {type(value).__name__}, must be {type(present).__name__}")
        if isinstance(obj, dict):
            obj[name] = value
        else:
            setattr(obj, name, value)


def replace_slices_with_strings(data: object) -> object:
    """A copy of nested dicts, lists and tuples with each slice as text, such as ``"slice(0,3,None)"``."""
    if isinstance(data, dict):
        return {key: replace_slices_with_strings(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [replace_slices_with_strings(value) for value in data]
    return f"{_SLICE}{data.start},{data.stop},{data.step})" if isinstance(data, slice) else data


def replace_strings_with_slices(data: object) -> object:
    """The inverse of :func:`replace_slices_with_strings`.

    Raises:
        ValueError: a text begins like a slice and is not one.
    """
    if isinstance(data, dict):
        return {key: replace_strings_with_slices(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [replace_strings_with_slices(value) for value in data]
    return _slice_of(data) if isinstance(data, str) and data.startswith(_SLICE) else data


def _slice_of(text: str) -> slice:
    parts = [part.strip() for part in text.removeprefix(_SLICE).removesuffix(")").split(",")]
    try:
        numbers = [None if part == "None" else int(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise ValueError(f"'{text}' is no slice; expected 'slice(start,stop,step)' of whole numbers or None")
    return slice(*numbers)


def convert_dict_to_backend(
    data: Mapping[str, Any], backend: str = "numpy", array_types: tuple[str, ...] = ("numpy", "torch", "warp")
) -> dict[str, Any]:
    """A copy of a nested dict with its arrays in another library; everything else is kept.

    Args:
        data: The dict.
        backend: ``"numpy"``, ``"torch"`` or ``"warp"``.
        array_types: Libraries whose arrays are converted.

    Raises:
        ValueError: an unknown library.
    """
    for name in (backend, *array_types):
        if name not in _ARRAYS:
            raise ValueError(f"unknown library of arrays '{name}'; use one of {list(_ARRAYS)}")
    kinds = tuple(_ARRAYS[name] for name in array_types)
    new: dict[str, Any] = {}
    for key, value in data.items():
        if isinstance(value, Mapping):
            new[key] = convert_dict_to_backend(value, backend, array_types)
        else:
            new[key] = _CONVERSIONS[backend](value) if isinstance(value, kinds) else value
    return new


_ARRAYS: dict[str, type] = {"numpy": np.ndarray, "torch": torch.Tensor, "warp": wp.array}


def _to_numpy(value: Any) -> np.ndarray:
    if isinstance(value, wp.array):
        return np.asarray(value.numpy())
    return value.detach().cpu().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)


def _to_torch(value: Any) -> torch.Tensor:
    return wp.to_torch(value) if isinstance(value, wp.array) else torch.as_tensor(value)


def _to_warp(value: Any) -> Any:
    if isinstance(value, torch.Tensor):
        return wp.from_torch(value)
    return wp.from_numpy(value, device="cpu") if isinstance(value, np.ndarray) else value


_CONVERSIONS: dict[str, Callable[[Any], Any]] = {"numpy": _to_numpy, "torch": _to_torch, "warp": _to_warp}


def print_dict(val: object, nesting: int = -4, start: bool = True) -> None:
    """Print a nested dict, one entry a line, indented by depth."""
    if not isinstance(val, Mapping):
        print(val)
        return
    if not start:
        print()
    for key, value in val.items():
        print(f"{' ' * (nesting + 4)}{key}: ", end="")
        print_dict(value, nesting + 4, start=False)


def get_isaac_sim_version() -> Version:
    """The version that Isaac Lab 2.3 is written for. Isaac Sim itself is not there."""
    return Version("5.1.0")
