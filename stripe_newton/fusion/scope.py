# SPDX-License-Identifier: Apache-2.0
"""Scope: names of arrays, structs and functions in the generated kernels of one environment.

>>> import warp as wp
>>> from stripe_newton.fusion import Scope
>>> @wp.func
... def cube(x: float) -> float:
...     return x * x * x
>>> scope = Scope()
>>> force = scope.name("force", wp.zeros(2, dtype=float, device="cpu"))
>>> other = scope.name("force", wp.zeros(2, dtype=float, device="cpu"))
>>> force.text, other.text, scope.call(cube, force).text
('force', 'force_2', 'cube(force)')
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Hashable, Set

import warp as wp

from .source import Code, Name, code
from .warp_types import Value, struct_fields, struct_of

__all__ = ["Scope"]

_CPP = (
    "auto char class const double explicit extern final friend inline int8 long mutable namespace new operator private "
    "protected public register short signed static struct switch template this typename union unsigned virtual void"
)
_LOCAL = "env part thread num_envs wp out value total done left due i j k prepare ask ask_rows ask_table lane first_env"
_RESERVED = {*_CPP.split(), *keyword.kwlist, *_LOCAL.split()}
"""Names that generated source code uses itself, and keywords of Python and of C++, to which Warp translates it."""


class Scope:
    """One name for each array, struct and function, shared by all kernels of an environment."""

    def __init__(self) -> None:
        self.values: dict[str, Value] = {}
        """Arrays and structs by name."""
        self.functions: dict[str, wp.Function] = {}
        """Warp functions by name."""
        self._names: dict[Hashable, Name] = {}

    def name(self, preferred: str, value: Value) -> Name:
        """The name of an array or a struct.

        Args:
            preferred: The name to use if it is free; otherwise a number is appended.
            value: A Warp array or an instance of a Warp struct. It keeps its first name.

        Raises:
            TypeError: if ``value`` is neither. A number would be frozen into a graph; it belongs in ``Parameters``.
        """
        if not isinstance(value, wp.array) and not wp.types.is_struct(value):
            raise TypeError(
                f"'{preferred}': is {type(value).__name__}, must be a Warp array or an instance of a Warp struct"
            )
        key = _identity(value)
        if key not in self._names:
            name = self._free(preferred)
            fields = frozenset() if isinstance(value, wp.array) else frozenset(struct_fields(struct_of(value)))
            self._names[key] = Name(name, frozenset({name}), fields)
            self.values[name] = value
        return self._names[key]

    def function(self, function: wp.Function) -> Name:
        """The name of a Warp function."""
        key = ("function", id(function))
        if key not in self._names:
            name = self._free(function.func.__name__)
            self._names[key] = Name(name, frozenset({name}))
            self.functions[name] = function
        return self._names[key]

    def call(self, function: wp.Function, *arguments: Code | str | int) -> Code:
        """Source code of the call of a Warp function."""
        return code(f"{{}}({', '.join(['{}'] * len(arguments))})", self.function(function), *arguments)

    def used(self, uses: Set[str]) -> tuple[list[str], list[str]]:
        """The names in ``uses``, split into those of values and those of functions, each in the order of naming."""
        return [n for n in self.values if n in uses], [n for n in self.functions if n in uses]

    def _free(self, preferred: str) -> str:
        """An identifier made from a name, followed by a number where the name itself is taken or reserved."""
        base = re.sub(r"\W", "_", preferred).lstrip("0123456789") or "x"
        name, count = base, 1
        while name in _RESERVED or name in self.values or name in self.functions:
            count += 1
            name = f"{base}_{count}"
        return name


def _identity(value: Value) -> Hashable:
    """Key of a value. An array and a view of all of it have the same key, so that a kernel takes the memory once."""
    if isinstance(value, wp.array) and value.ptr:
        return value.ptr, value.dtype, tuple(value.shape), tuple(value.strides), str(value.device)
    return "object", id(value)
