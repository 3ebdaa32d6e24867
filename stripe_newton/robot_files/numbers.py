# SPDX-License-Identifier: Apache-2.0
"""Numbers in XML attributes: read them, or say what is wrong with them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element

__all__ = ["MAX_NUMBER", "number_problems", "numbers_of"]

MAX_NUMBER = 1e15
"""Largest number that is no range: single precision has no room for its square and cube."""


def numbers_of(element: Element | None, attribute: str, default: str = "") -> list[float]:
    """Numbers of an attribute; empty if it is not there, or if one is no number."""
    text = default if element is None else element.get(attribute, default)
    try:
        return [float(word) for word in text.split()]
    except ValueError:
        return []


def number_problems(
    element: Element | None, attribute: str, size: int = 1, *, least: float = -math.inf, infinite: bool = False
) -> Iterator[str]:
    """Problems of the numbers of an attribute; none if it is not there.

    Args:
        element: The element; None has no attributes.
        attribute: Name of the attribute.
        size: How many numbers there must be.
        least: The smallest that may be.
        infinite: Whether they may be infinite.
    """
    text = None if element is None else element.get(attribute)
    if element is None or text is None:
        return
    name, words = f"{attribute} of <{element.tag}>", text.split()
    expected = "a number" if size == 1 else f"{size} numbers"
    try:
        values = [float(word) for word in words]
    except ValueError:
        yield f"{name} is '{text}', must be {expected}"
        return
    if len(values) != size:
        yield f"{name} is '{text}', must be {expected}"
    elif any(math.isnan(v) for v in values):
        yield f"{name} is not a number (nan), must be {'finite' if size == 1 else f'{size} finite numbers'}"
    elif not infinite and any(math.isinf(v) for v in values):
        yield f"{name} is infinite ({text}), must be finite"
    elif not infinite and any(abs(v) > MAX_NUMBER for v in values):
        yield f"{name} is {text}, must be at most {MAX_NUMBER:g}"
    elif any(v < least for v in values):
        yield f"{name} is {text}, must be at least {least:g}"
