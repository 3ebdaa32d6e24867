# SPDX-License-Identifier: Apache-2.0
"""Expressions: regular expressions of configs and files, without those that may take hours to match a name.

Python tries every way in which an expression can fit a name: with a name of 40 letters, ``(a|a)*b`` has 2^40 of them.
A run folder or a stage may come from anybody, so the number of ways is bounded before an expression is used.
"""

from __future__ import annotations

import functools
import importlib
import math
import re
import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Expression", "SlowExpressionError", "expression_of", "full_match", "reason_of"]

MOST_WAYS = 10**8
"""Most ways to fit a name, each of which takes some 10 ns."""
_FEW = 16
"""Repeats of up to so many times are counted as choices, others as if they had no end."""

# Python's own parser of expressions has no public name.
_parser = importlib.import_module("re._parser" if sys.version_info >= (3, 11) else "sre_parse")
_Tree = Sequence[tuple[object, Any]]


class SlowExpressionError(re.error):
    """An expression that may take hours to match."""


@dataclass(frozen=True)
class _Cost:
    """Number of ways to fit a name."""

    ways: int = 1
    """Ways by choices: alternatives and short repeats."""
    repeats: int = 0
    """Long repeats, each of which may end anywhere in the name."""

    def followed_by(self, other: _Cost) -> _Cost:
        """The cost of both, one after the other."""
        return _Cost(min(self.ways * other.ways, MOST_WAYS + 1), self.repeats + other.repeats)

    def for_name(self, length: int) -> int:
        """Ways to fit a name of so many letters."""
        return self.ways * math.comb(length + self.repeats, self.repeats)


class Expression:
    """A compiled expression.

    Raises:
        re.error: if the text is no regular expression.
        SlowExpressionError: if it repeats what can itself fit in several ways.
    """

    def __init__(self, text: str):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Python warns of '[[' in all expressions
            self._pattern = re.compile(text)
            self._cost = _cost(_parser.parse(text))

    def fullmatch(self, name: str) -> re.Match[str] | None:
        """Match a whole name.

        Raises:
            SlowExpressionError: if there are too many ways to do so.
        """
        if self._cost.for_name(len(name)) > MOST_WAYS:
            short = name if len(name) <= 40 else f"{name[:40]}..."
            raise SlowExpressionError(f"may take hours to match '{short}', as it has too many repeats and alternatives")
        return self._pattern.fullmatch(name)


@functools.lru_cache(maxsize=1024)
def expression_of(text: str) -> Expression:
    """The compiled expression of a text.

    Raises:
        re.error: as :class:`Expression`; a text that is nested too deep for Python, too.
    """
    try:
        return Expression(text)
    except (RecursionError, OverflowError) as error:
        raise re.error(str(error)) from None


def full_match(text: str, name: str) -> re.Match[str] | None:
    """Match a whole name, as ``re.fullmatch`` does.

    Raises:
        re.error: as :func:`expression_of` and :meth:`Expression.fullmatch`.
    """
    return expression_of(text).fullmatch(name)


def reason_of(error: re.error) -> str:
    """The reason for a message, such as ``"is no regular expression: missing ), unterminated subpattern"``."""
    return str(error) if isinstance(error, SlowExpressionError) else f"is no regular expression: {error}"


def _cost(tree: _Tree) -> _Cost:
    """The cost of a parsed expression."""
    found = _Cost()
    for operator, value in tree:
        found = found.followed_by(_cost_of(str(operator), value))
    return found


def _cost_of(operator: str, value: Any) -> _Cost:  # as Python's parser writes it, without types
    if operator == "BRANCH":
        parts = [_cost(part) for part in value[1]]
        return _Cost(sum(part.ways for part in parts), max(part.repeats for part in parts))
    if operator in ("MAX_REPEAT", "MIN_REPEAT", "POSSESSIVE_REPEAT"):
        least, most, inner = value
        return _repeated(_cost(inner), int(least), int(most))
    found = _Cost()
    for part in value if isinstance(value, tuple) else (value,):
        if isinstance(part, _parser.SubPattern):
            found = found.followed_by(_cost(part))
    return found


def _repeated(inner: _Cost, least: int, most: int) -> _Cost:
    """The cost of something that is repeated."""
    if most <= 1:
        return _Cost(inner.ways + 1 - least, inner.repeats)
    if inner.repeats or (inner.ways > 1 and most > _FEW):
        raise SlowExpressionError("may take hours to match, as it repeats what has alternatives or repeats in it")
    if most > _FEW:
        return _Cost(repeats=1 if most > least else 0)
    return _Cost(min(sum(inner.ways**times for times in range(least, most + 1)), MOST_WAYS + 1))
