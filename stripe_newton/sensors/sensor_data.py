# SPDX-License-Identifier: Apache-2.0
"""Sensor data: the arrays of a sensor as torch tensors."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch
import warp as wp

from .warp_struct import field_values

__all__ = ["SensorData"]


class SensorData:
    """The arrays of a sensor's struct as torch tensors of the same memory, by the struct's names.

    Attributes:
        warp: The struct.
    """

    def __init__(self, struct: object, absent: Iterable[str] = ()):
        """Make the tensors.

        Args:
            struct: An instance of a Warp struct.
            absent: Fields that were not asked for; they are ``None``.
        """
        self.warp = struct
        arrays = {name: value for name, value in field_values(struct).items() if isinstance(value, wp.array)}
        self._tensors = {name: wp.to_torch(array) for name, array in arrays.items()}
        self._tensors |= dict.fromkeys(absent)

    def __getattr__(self, name: str) -> Any:  # a tensor, or None for what is absent
        # Copying and unpickling ask for attributes before __init__ has run: hence no self._tensors here.
        tensors = self.__dict__.get("_tensors", {})
        if name not in tensors:
            raise AttributeError(f"no '{name}' in the data of this sensor; there is {', '.join(tensors) or 'nothing'}")
        return tensors[name]

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors by name, views of the sensor's memory. Those of a dict, such as images, go by their keys."""
        found: dict[str, torch.Tensor] = {}
        for name, value in {**vars(self), **self._tensors}.items():
            if isinstance(value, torch.Tensor):
                found[name] = value
            elif isinstance(value, dict) and not name.startswith("_"):
                found |= {key: item for key, item in value.items() if isinstance(item, torch.Tensor)}
        return found

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._tensors]
