# SPDX-License-Identifier: Apache-2.0
"""Checks of config fields beyond their types: choices, layer widths. Each yields ``(field, message)`` pairs."""

from __future__ import annotations

import re
from collections.abc import Iterator

from stripe_newton.value_types import short

__all__ = ["Problems", "folder_names", "layer_widths", "one_of", "why_no_folder_name"]

_NAME = re.compile(r"(?![. _-])[\w .+=@,-]{1,100}(?<! )")
"""Names of folders that stay where they are, and that a shell and other systems take as they are."""
Problems = Iterator[tuple[str, str]]
"""Result of the method ``problems`` of a config: pairs of a field and what is wrong with it."""


def one_of(cfg: object, field: str, choices: tuple[str, ...]) -> Problems:
    """A field must be one of some strings, whatever its case."""
    value = getattr(cfg, field)
    if value.lower() not in choices:
        yield field, f"is {value!r}, must be one of {', '.join(choices)}"


def layer_widths(cfg: object, *fields: str) -> Problems:
    """Fields must be sequences of layer widths; -1 is the width of the input."""
    for field in fields:
        value = getattr(cfg, field)
        if not all(n > 0 or n == -1 for n in value):
            yield field, f"is {value!r}, must be a sequence of positive widths (-1: the width of the input)"


def folder_names(cfg: object, *fields: str, parts: bool = False) -> Problems:
    """Fields must be names of folders below the log folder; with ``parts`` they may be nested, ``a/b``."""
    for field in fields:
        if problem := why_no_folder_name(getattr(cfg, field), parts):
            yield field, problem


def why_no_folder_name(name: object, parts: bool = False) -> str:
    """Problem with a name of a folder below the log folder; empty if there is none.

    Args:
        name: The name.
        parts: Whether it may have several parts, ``a/b``.
    """
    if not isinstance(name, str):
        return f"is {short(name)}, must be text"
    wrong = [part for part in (name.split("/") if parts else [name]) if name and not _NAME.fullmatch(part)]
    if not wrong:
        return ""
    kind = "names, with '/' between them" if parts else "a name"
    return f"is {short(name)}, must be {kind}: letters, digits, spaces and ._+=@,- and begin with none of ._- or space"
