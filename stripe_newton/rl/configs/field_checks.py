# SPDX-License-Identifier: Apache-2.0
"""Checks of config fields beyond their types: choices, layer widths. Each yields ``(field, message)`` pairs."""

from __future__ import annotations

from collections.abc import Iterator

__all__ = ["Problems", "layer_widths", "one_of"]

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
