# SPDX-License-Identifier: Apache-2.0
"""Functions of ``isaaclab.utils.string``: names matched by regular expressions, and changes of spelling."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from stripe_newton.configclass import resolve_name

__all__ = [
    "callable_to_string",
    "resolve_matching_names",
    "resolve_matching_names_values",
    "string_to_callable",
    "to_camel_case",
    "to_snake_case",
]

Value = TypeVar("Value")


def to_camel_case(snake_str: str, to: str = "cC") -> str:
    """A name in snake case as camel case: ``"cC"`` for ``camelCase``, ``"CC"`` for ``CamelCase``.

    Raises:
        ValueError: another form.
    """
    if to not in ("cC", "CC"):
        raise ValueError(f"to: is '{to}', must be 'cC' or 'CC'")
    words = snake_str.split("_")
    titled = "".join(word.title() for word in words)
    return titled if to == "CC" else words[0].lower() + "".join(word.title() for word in words[1:])


def to_snake_case(camel_str: str) -> str:
    """A name in camel case as snake case."""
    spaced = re.sub(r"(.)([A-Z][a-z]+)", r"\1_\2", camel_str)
    return re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", spaced).lower()


def callable_to_string(value: Callable[..., object]) -> str:
    """``"module:name"`` of a function.

    Raises:
        ValueError: the value cannot be called.
    """
    if not callable(value):
        raise ValueError(f"{value!r} cannot be called")
    return f"{value.__module__}:{value.__name__}"


def string_to_callable(name: str) -> Callable[..., object]:
    """The function of ``"module:name"``.

    Raises:
        ValueError: there is none.
    """
    found = resolve_name(name)
    if not callable(found):
        raise ValueError(f"'{name}' is {found!r}, which cannot be called")
    return found


def resolve_matching_names(
    keys: str | Sequence[str], list_of_strings: Sequence[str], preserve_order: bool = False
) -> tuple[list[int], list[str]]:
    """Indices and names that fully match one of the expressions.

    Args:
        keys: One or several expressions.
        list_of_strings: All names.
        preserve_order: Use the order of the expressions rather than that of the names.

    Raises:
        ValueError: an expression matches nothing, or two match the same name.
    """
    found = _matches([keys] if isinstance(keys, str) else list(keys), list_of_strings, preserve_order, strict=True)
    return [index for index, _ in found], [list_of_strings[index] for index, _ in found]


def resolve_matching_names_values(
    data: Mapping[str, Value], list_of_strings: Sequence[str], preserve_order: bool = False, strict: bool = True
) -> tuple[list[int], list[str], list[Value]]:
    """Indices, names and values of the names that match the keys of a dict.

    Args:
        data: Values by expression.
        list_of_strings: All names.
        preserve_order: Use the order of the expressions rather than that of the names.
        strict: Every expression must match.

    Raises:
        TypeError: ``data`` is no dict.
        ValueError: an expression matches nothing, or two match the same name.
    """
    if not isinstance(data, Mapping):
        raise TypeError(f"data is {data!r}, must be a dict")
    found, values = _matches(list(data), list_of_strings, preserve_order, strict), list(data.values())
    names = [list_of_strings[index] for index, _ in found]
    return [index for index, _ in found], names, [values[key] for _, key in found]


def _matches(keys: list[str], names: Sequence[str], by_key: bool, strict: bool) -> list[tuple[int, int]]:
    """Index of each name that matches, and index of its expression."""
    found = []
    for index, name in enumerate(names):
        hits = [k for k, key in enumerate(keys) if re.fullmatch(key, name)]
        if len(hits) > 1:
            raise ValueError(f"'{name}' matches both '{keys[hits[0]]}' and '{keys[hits[1]]}'")
        found += [(index, hits[0])] if hits else []
    missing = [key for k, key in enumerate(keys) if k not in {k for _, k in found}]
    if strict and missing:
        raise ValueError(f"{', '.join(map(repr, missing))} match nothing; there is: {', '.join(names) or 'nothing'}")
    return sorted(found, key=lambda pair: (pair[1], pair[0])) if by_key else found
