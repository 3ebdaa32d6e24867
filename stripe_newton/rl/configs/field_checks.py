# SPDX-License-Identifier: Apache-2.0
"""Checks of the fields of a config: choices, bounds, layer widths. Each yields ``(field, message)`` pairs."""

from __future__ import annotations

from collections.abc import Iterator

__all__ = ["Problems", "at_least", "in_unit_interval", "layer_widths", "one_of", "positive"]

Problems = Iterator[tuple[str, str]]
"""Result of the method ``problems`` of a config: pairs of a field and what is wrong with it."""


def one_of(cfg: object, field: str, choices: tuple[str, ...]) -> Problems:
    """A field must be one of some strings, whatever its case."""
    value = getattr(cfg, field)
    if not isinstance(value, str) or value.lower() not in choices:
        yield field, f"is {value!r}, must be one of {', '.join(choices)}"


def at_least(cfg: object, low: float, *fields: str) -> Problems:
    """Fields must be numbers of at least ``low``."""
    for field in fields:
        value = getattr(cfg, field)
        # `not value >= low` rather than `value < low`: NaN is refused too. The same below.
        if not _is_number(value) or not value >= low:
            yield field, f"is {value!r}, must be a number of at least {low}"


def positive(cfg: object, *fields: str) -> Problems:
    """Fields must be numbers above 0."""
    for field in fields:
        value = getattr(cfg, field)
        if not _is_number(value) or not value > 0.0:
            yield field, f"is {value!r}, must be a number above 0"


def in_unit_interval(cfg: object, *fields: str) -> Problems:
    """Fields must be numbers from 0 to 1."""
    for field in fields:
        value = getattr(cfg, field)
        if not _is_number(value) or not 0.0 <= value <= 1.0:
            yield field, f"is {value!r}, must lie in [0, 1]"


def layer_widths(cfg: object, *fields: str) -> Problems:
    """Fields must be sequences of layer widths; -1 is the width of the input."""
    for field in fields:
        value = getattr(cfg, field)
        if not isinstance(value, (tuple, list)) or not all(isinstance(n, int) and (n > 0 or n == -1) for n in value):
            yield field, f"is {value!r}, must be a sequence of positive widths (-1: the width of the input)"


def _is_number(value: object) -> bool:
    """Whether a value is an int or a float; a bool, which Python counts as an int, is not."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)
