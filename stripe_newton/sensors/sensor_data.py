# SPDX-License-Identifier: Apache-2.0
"""What a sensor hands out to torch."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import warp as wp

__all__ = ["SensorData"]


class SensorData:
    """The arrays of a sensor's struct as torch tensors of the same memory, by the struct's names.

    Attributes:
        warp: The struct.
    """

    def __init__(self, struct: Any, absent: Iterable[str] = ()):
        """Make the tensors.

        Args:
            struct: An instance of a Warp struct.
            absent: Fields that were not asked for; they are ``None``.
        """
        self.warp = struct
        fields = {name: getattr(struct, name) for name in struct._cls.vars}
        self._tensors = {name: wp.to_torch(value) for name, value in fields.items() if isinstance(value, wp.array)}
        self._tensors |= dict.fromkeys(absent)

    def __getattr__(self, name: str) -> Any:
        tensors = self.__dict__.get("_tensors", {})
        if name not in tensors:
            raise AttributeError(f"no '{name}' in the data of this sensor; there is {', '.join(tensors) or 'nothing'}")
        return tensors[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._tensors]
