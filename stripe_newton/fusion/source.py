# SPDX-License-Identifier: Apache-2.0
"""Source code of generated kernels: pieces of text that know which arrays, structs and functions they use.

Source is written, never read back. A manager writes a line with :func:`code`, whose placeholders take other pieces, and
the names that those use go along with the text. So a kernel knows its arguments without a search through its source.
"""

from __future__ import annotations

import string
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Code", "Name", "TunedNumber", "block", "code", "indented"]


@dataclass(frozen=True)
class Code:
    """An expression or a line of source, with the names in it that stand for values and functions of a scope."""

    text: str
    """The source."""
    uses: frozenset[str] = frozenset()
    """Names of arrays, structs and functions in it; ``struct.field`` for each field of a struct."""

    def __format__(self, spec: str) -> str:
        # An f-string would keep the text and lose the names: the kernel would miss an argument.
        raise TypeError(f"'{self.text}' is source in an f-string, write it with code('... {{}} ...', part)")


@dataclass(frozen=True)
class Name(Code):
    """The name of an array, a struct or a function in the source."""

    fields: frozenset[str] = frozenset()
    """Fields of a struct."""

    def field(self, field: str) -> Code:
        """A field of a struct.

        Raises:
            AttributeError: if the struct has none of that name.
        """
        if field not in self.fields:
            there = ", ".join(sorted(self.fields)) or "none"
            raise AttributeError(f"'{self.text}' has no field '{field}'; it has {there}")
        path = f"{self.text}.{field}"
        return Code(path, self.uses | {path})


@dataclass(frozen=True)
class TunedNumber(Code):
    """A number that is read from the parameters, so that it may have another value at every step."""


_PARSER = string.Formatter()


def code(template: str, *parts: Code | str | int, **named: Code | str | int) -> Code:
    """A piece of source from a template and its parts.

    Placeholders are those of :meth:`str.format`: ``{}`` takes the next part, ``{name}`` a named one, and
    ``{name.field}`` a field of a struct, whose :class:`Name` is passed. Strings and whole numbers are put in as they
    are; an array or a struct must be named by a scope first::

        code("{}[env, {}] += {episode.step_dt}", sums, 3, episode=episode)

    Raises:
        TypeError: if a part is anything else.
    """
    text: list[str] = []
    uses: set[str] = set()
    positions = iter(range(len(parts)))
    for literal, placeholder, _, _ in _PARSER.parse(template):
        text.append(literal)
        if placeholder is None:
            continue
        key, _, field = placeholder.partition(".")
        part = named[key] if key else parts[next(positions)]
        if field:
            assert isinstance(part, Name)
            part = part.field(field)
        if isinstance(part, Code):
            text.append(part.text)
            uses |= part.uses
        elif isinstance(part, (str, int)):
            text.append(str(part))
        else:
            raise TypeError(f"'{template}': {placeholder or 'a part'} is {type(part).__name__}, must be source or text")
    return Code("".join(text), frozenset(uses))


def indented(lines: Iterable[Code]) -> list[Code]:
    """The lines, one level further in."""
    return [Code(f"    {line.text}", line.uses) for line in lines]


def block(header: Code, body: Iterable[Code]) -> list[Code]:
    """A line such as ``if x:`` and what belongs to it; ``pass`` where that is nothing."""
    return [header, *(indented(body) or [Code("    pass")])]
