# SPDX-License-Identifier: Apache-2.0
"""Model arrays: in which arrays two Newton models differ."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp

__all__ = ["different_arrays", "model_arrays"]


def model_arrays(model: Any) -> dict[str, np.ndarray]:
    """Every plain array of a model, by name."""
    found = {}
    for name, value in vars(model).items():
        if isinstance(value, wp.array) and value.dtype is not wp.uint64 and "bvh" not in name:
            array = value.numpy()
            if array.dtype.names is None:
                found[name] = array
    return found


def different_arrays(one: Any, two: Any) -> list[str]:
    """Names of the arrays in which two models differ."""
    first, second = model_arrays(one), model_arrays(two)
    names = sorted(first.keys() | second.keys())
    return [
        n for n in names if n not in first or n not in second or not np.array_equal(first[n], second[n], equal_nan=True)
    ]
