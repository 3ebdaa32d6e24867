# SPDX-License-Identifier: Apache-2.0
"""Names for what generated kernels read, write and call."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable
from typing import Any

import warp as wp

__all__ = ["Scope"]

_CPP = (
    "auto char class const double explicit extern final friend inline int8 long mutable namespace new operator private "
    "protected public register short signed static struct switch template this typename union unsigned virtual void"
)
_OWN = "env part thread num_envs wp out value total done left due i j k"
_RESERVED = {*_CPP.split(), *keyword.kwlist, *_OWN.split()}
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")


class Scope:
    """One name for each array, struct and function, shared by all kernels of an environment.

    A section of source mentions those names; what a kernel takes follows from the names found in it.
    """

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}
        """Arrays and structs by name."""
        self.functions: dict[str, wp.Function] = {}
        """Warp functions by name."""
        self._names: dict[Any, str] = {}

    def name(self, wish: str, value: Any) -> str:
        """The name of an array or a struct: ``wish``, or something like it where that is taken.

        Raises:
            TypeError: if ``value`` is neither; a number would be frozen into a graph, it belongs in ``Parameters``.
        """
        if not isinstance(value, wp.array) and not hasattr(value, "_cls"):
            raise TypeError(
                f"'{wish}': is {type(value).__name__}, must be a Warp array or an instance of a Warp struct"
            )
        key = _identity(value)
        if key not in self._names:
            self._names[key] = self._free(wish)
            self.values[self._names[key]] = value
        return self._names[key]

    def function(self, function: wp.Function) -> str:
        """The name of a Warp function in the source."""
        key = ("function", id(function))
        if key not in self._names:
            self._names[key] = self._free(function.func.__name__)
            self.functions[self._names[key]] = function
        return self._names[key]

    def mentioned(self, lines: Iterable[str]) -> tuple[list[str], list[str]]:
        """Values and functions that lines of source mention, each in order of their names' making."""
        found = {name for line in lines for name in _NAME.findall(line.partition("#")[0])}
        return [n for n in self.values if n in found], [n for n in self.functions if n in found]

    def _free(self, wish: str) -> str:
        base = re.sub(r"\W", "_", wish).lstrip("0123456789") or "x"
        name, count = base, 1
        while name in _RESERVED or name in self.values or name in self.functions:
            count += 1
            name = f"{base}_{count}"
        return name


def _identity(value: Any) -> Any:
    if isinstance(value, wp.array) and value.ptr:
        return value.ptr, value.dtype, tuple(value.shape), tuple(value.strides), str(value.device)
    return "object", id(value)
