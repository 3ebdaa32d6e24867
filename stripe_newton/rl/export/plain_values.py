# SPDX-License-Identifier: Apache-2.0
"""Plain values of configs, tensors and functions, as JSON has them."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
import torch
import warp as wp

from stripe_newton.configclass import is_config

from .metadata_format import Plain

__all__ = ["plain", "qualified_name", "settings"]


def plain(value: object) -> Plain:
    """A value as JSON has it: tensors and arrays as lists, functions by name, numbers that are not finite as None."""
    if isinstance(value, wp.array):
        value = value.numpy()
    if isinstance(value, torch.Tensor):
        value = value.detach().cpu().numpy()
    if isinstance(value, np.ndarray):
        return [plain(v) for v in value] if value.ndim else plain(value[()])
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        # By way of text: the shortest number that is this float32, rather than all digits of it as float64.
        return float(str(value)) if math.isfinite(value) else None
    return _plain_container(value)


def _plain_container(value: object) -> Plain:
    """A dict, a config or a sequence with plain items; the name of anything else."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if is_config(value):
        return settings(value)
    if isinstance(value, slice):
        return str(value)
    if isinstance(value, (list, tuple, set, frozenset, range)):
        return [plain(v) for v in value]
    return qualified_name(value)


def settings(cfg: object, *without: str) -> dict[str, Plain]:
    """The fields of a config that are set, as plain values, and the name of its class as ``type``.

    Args:
        cfg: A config.
        without: Fields to leave out.
    """
    names = [field.name for field in dataclasses.fields(cfg)]  # type: ignore[arg-type]
    fields = {name: getattr(cfg, name) for name in names if name not in without and not name.startswith("_")}
    kept = {k: v for k, v in fields.items() if v is not None and not (isinstance(v, (dict, tuple, list)) and not v)}
    return {"type": type(cfg).__name__} | {k: plain(v) for k, v in kept.items()}


def qualified_name(function: object) -> str | None:
    """``module:name`` of a function, Warp's or Python's, or of the class of any other object; None for None."""
    if function is None:
        return None
    own = getattr(function, "func", function)  # Warp's functions wrap the one that they were made of
    name = getattr(own, "__qualname__", type(own).__qualname__)
    return f"{getattr(own, '__module__', type(own).__module__)}:{name}"
