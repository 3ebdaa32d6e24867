# SPDX-License-Identifier: Apache-2.0
"""Parameters: numbers of terms, such as weights and bounds, in arrays that kernels read.

>>> import warp as wp
>>> from stripe_newton.fusion import Parameters, Scope
>>> parameters = Parameters(Scope(), "cpu")
>>> parameters.add("rewards.alive.weight", 2.0, float).text
'parameters[0]'
>>> parameters.add("rewards.reach.goal", (0.5, 0.0, 0.3), wp.vec3).text
'wp.vec3(parameters[1], parameters[2], parameters[3])'
>>> parameters["rewards.alive.weight"] = 3.0
>>> parameters["rewards.alive.weight"]
3.0
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
import warp as wp

from stripe_kernels.data import Parameter

from .scope import Scope
from .source import Code, ParameterRead, code

__all__ = ["ParameterKind", "ParameterValue", "Parameters"]

_CAPACITY = 4096
"""Numbers of each array. The arrays never grow, as graphs hold their addresses."""
_GREATEST_INT = 2**31 - 1
_VECTORS = {wp.vec2: 2, wp.vec3: 3, wp.vec4: 4, wp.quat: 4}

ParameterKind = type[float] | type[int] | type[bool]  # or wp.vec2, wp.vec3, wp.vec4, wp.quat
"""Type of a parameter as a Warp function declares it."""
ParameterValue = float | Sequence[float] | np.ndarray | torch.Tensor
"""A number, a boolean, or the numbers of a vector."""


class Parameters:
    """Weights, bounds and other numbers by path, such as ``rewards.alive.weight``.

    They are in two arrays on the device, which kernels read. A change takes effect in the next step, without recording
    graphs again::

        parameters["rewards.alive.weight"] = 2.0
    """

    def __init__(self, scope: Scope, device: str):
        self.floats = wp.zeros(_CAPACITY, dtype=float, device=device)
        """Real numbers and the elements of vectors, float32."""
        self.ints = wp.zeros(_CAPACITY, dtype=int, device=device)
        """Integers and booleans, int32."""
        self._names = scope.name("parameters", self.floats), scope.name("int_parameters", self.ints)
        self._used = [0, 0]
        self._slots: dict[str, tuple[ParameterKind, int]] = {}

    def add(self, path: str, value: ParameterValue, kind: ParameterKind) -> Code:
        """Store a parameter and return the expression that reads it in generated source code.

        Args:
            path: Its name. A path that exists keeps its place and takes the new value.
            value: A number, a boolean, or the numbers of a vector.
            kind: ``float``, ``int``, ``bool``, ``wp.vec2``, ``wp.vec3``, ``wp.vec4`` or ``wp.quat``.

        Raises:
            ValueError: if ``value`` does not fit ``kind``, or there are too many parameters.
        """
        if path not in self._slots:
            whole, size = kind in (int, bool), _VECTORS.get(kind, 1)
            if self._used[whole] + size > _CAPACITY:
                raise ValueError(f"{path}: more than {_CAPACITY} parameters; keep large tables in arrays")
            self._slots[path] = kind, self._used[whole]
            try:
                self[path] = value
            except ValueError:
                del self._slots[path]
                raise
            self._used[whole] += size
        else:
            self[path] = value
        return self._expression(path)

    @contextmanager
    def keeping_values(self) -> Iterator[None]:
        """Within this context :meth:`add` does not change the values of paths that exist."""
        arrays, used = [wp.to_torch(self.floats), wp.to_torch(self.ints)], list(self._used)
        before = [array[:count].clone() for array, count in zip(arrays, used, strict=True)]
        try:
            yield
        finally:
            for array, values, count in zip(arrays, before, used, strict=True):
                array[:count] = values

    def _expression(self, path: str) -> Code:
        kind, index = self._slots[path]
        floats, ints = self._names
        if kind is bool:
            return code("({}[{}] != 0)", ints, index)
        if kind in (int, float):
            number = code("{}[{}]", floats if kind is float else ints, index)
            return ParameterRead(number.text, number.uses)
        parts = [code("{}[{}]", floats, index + k) for k in range(_VECTORS[kind])]
        name = kind.__name__.removesuffix("f")
        return code(f"wp.{name}({', '.join(['{}'] * len(parts))})", *parts)

    def index(self, path: str) -> int:
        """Index of the first number of a parameter in :attr:`floats`, or in :attr:`ints` for integers and booleans.

        Raises:
            KeyError: if there is no such parameter.
        """
        return self._slot(path)[1]

    def paths(self) -> list[str]:
        """Paths of all parameters."""
        return list(self._slots)

    def __contains__(self, path: str) -> bool:
        return path in self._slots

    def __getitem__(self, path: str) -> float | tuple[float, ...]:
        """The current value. It waits for the device.

        Raises:
            KeyError: if there is no such parameter.
        """
        kind, index = self._slot(path)
        tensor = wp.to_torch(self.ints if kind in (int, bool) else self.floats)
        values = tensor[index : index + _VECTORS.get(kind, 1)].tolist()
        return tuple(values) if kind in _VECTORS else kind(values[0])

    def __setitem__(self, path: str, value: ParameterValue) -> None:
        """Change the value of a parameter.

        Raises:
            KeyError: if there is no such parameter.
            ValueError: if the value does not fit its kind.
        """
        kind, index = self._slot(path)
        size = _VECTORS.get(kind, 1)
        if isinstance(value, torch.Tensor):
            value = value.tolist()
        values: list[Any] = list(value) if isinstance(value, (tuple, list, np.ndarray)) else [value]
        number = (int, float, np.integer, np.floating, np.bool_)
        if len(values) != size or not all(isinstance(v, number) for v in values):
            what = "a number" if size == 1 else f"{size} numbers"
            raise ValueError(f"{path}: is {value!r}, must be {what}")
        whole = kind in (int, bool)
        if whole and not all(v % 1 == 0 and abs(v) <= _GREATEST_INT for v in values):
            raise ValueError(f"{path}: is {value!r}, must be a whole number of at most {_GREATEST_INT}")
        tensor = wp.to_torch(self.ints if whole else self.floats)
        # Not by float32, which has no integers beyond 2^24 that are not even.
        numbers = [int(v) if whole else float(v) for v in values]
        tensor[index : index + size] = torch.tensor(numbers, dtype=tensor.dtype, device=tensor.device)

    def reference(self, path: str) -> Parameter:
        """Reference to a float parameter, for a term that changes it; ``path.0`` is the first element of a vector.

        Raises:
            KeyError: if there is no such parameter, or it is not a float.
        """
        base, _, element = path.rpartition(".")
        inside = path not in self._slots and element.isdigit() and base in self._slots
        kind, index = self._slot(base if inside else path)
        if inside and int(element) < _VECTORS.get(kind, 0):
            kind, index = float, index + int(element)
        if kind is not float:
            raise KeyError(f"'{path}' is {kind.__name__}, must be a float; of a vector name an element: '{path}.0'")
        reference = Parameter()
        reference.values, reference.index = self.floats, index
        return reference

    def _slot(self, path: str) -> tuple[ParameterKind, int]:
        if path not in self._slots:
            near = difflib.get_close_matches(path, self._slots, n=3, cutoff=0.4)
            hint = f"; near it: {', '.join(near)}" if near else ""
            raise KeyError(f"no parameter '{path}'{hint}")
        return self._slots[path]
