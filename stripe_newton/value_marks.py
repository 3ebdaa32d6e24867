# SPDX-License-Identifier: Apache-2.0
"""Value marks: what an annotation says of a number or a text beyond its class, and types that have such marks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, TypeAlias

__all__ = [
    "CODE",
    "INFINITE",
    "MOST_INT",
    "WRITTEN",
    "AnyFloat",
    "CodeName",
    "NonNegativeFloat",
    "NonNegativeInt",
    "NonNegativeLimit",
    "PositiveFloat",
    "PositiveInt",
    "Range",
    "Seed",
    "UnitFloat",
    "WrittenPath",
]

MOST_INT = 2**31 - 1
"""Largest whole number of 32 bits."""


@dataclass(frozen=True)
class Range:
    """Bounds of a number, for an annotation: ``Annotated[float, Range(above=0.0)]``."""

    at_least: float | None = None
    """Smallest number."""
    at_most: float | None = None
    """Largest number."""
    above: float | None = None
    """Bound that is smaller than every number."""
    below: float | None = None
    """Bound that is larger than every number."""

    def holds(self, value: float) -> bool:
        """Whether a number is within the bounds."""
        return (
            (self.at_least is None or value >= self.at_least)
            and (self.at_most is None or value <= self.at_most)
            and (self.above is None or value > self.above)
            and (self.below is None or value < self.below)
        )

    def __str__(self) -> str:
        if self.at_least is not None and self.at_most not in (None, MOST_INT):
            return f"from {self.at_least:.12g} to {self.at_most:.12g}"
        most = None if self.at_most == MOST_INT else self.at_most  # a bound that few come near to
        named = {"of at least": self.at_least, "above": self.above, "at most": most, "below": self.below}
        return " and ".join(f"{words} {value:.12g}" for words, value in named.items() if value is not None)


INFINITE = "infinity means something"
"""Mark of a number that may be infinite, for an annotation: ``Annotated[float, INFINITE]``. NaN stays wrong."""
CODE = "names code"
"""Mark of a text that names a class, a function, or a file of code."""
WRITTEN = "names a place that is written"
"""Mark of a text that names a file or folder that is written."""
CodeName: TypeAlias = Annotated[str, CODE]
"""A name of a class or function, ``module:Name``, or a file of code. Of saved configs only trusted ones are used."""
WrittenPath: TypeAlias = Annotated[str, WRITTEN]
"""A file or folder that is written. None is taken from a saved config."""
AnyFloat: TypeAlias = Annotated[float, INFINITE]
"""A number that may be infinite."""
PositiveFloat: TypeAlias = Annotated[float, Range(above=0.0)]
"""A finite number above 0."""
NonNegativeFloat: TypeAlias = Annotated[float, Range(at_least=0.0)]
"""A finite number of at least 0."""
NonNegativeLimit: TypeAlias = Annotated[float, INFINITE, Range(at_least=0.0)]
"""A number of at least 0, or infinity for no limit."""
UnitFloat: TypeAlias = Annotated[float, Range(at_least=0.0, at_most=1.0)]
"""A number from 0 to 1."""
PositiveInt: TypeAlias = Annotated[int, Range(at_least=1, at_most=MOST_INT)]
"""A whole number of at least 1 that fits 32 bits, as indices on a device do."""
NonNegativeInt: TypeAlias = Annotated[int, Range(at_least=0, at_most=MOST_INT)]
"""A whole number of at least 0 that fits 32 bits."""
Seed: TypeAlias = Annotated[int, Range(at_least=0, at_most=MOST_INT)]
"""A seed that Python, NumPy, torch and Warp all take."""
