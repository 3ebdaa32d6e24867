# SPDX-License-Identifier: Apache-2.0
"""Source code of generated kernels: pieces of text, each with the names of the arrays, structs and functions in it.

A manager writes a line with :func:`code`, whose placeholders take other pieces. The names in those pieces are passed on
with the text. So the arguments of a kernel are known without parsing its source code.

>>> from stripe_newton.fusion import Code, code
>>> torque = Code("torque", frozenset({"torque"}))
>>> line = code("{total}[env] += {}[env, {}]", torque, 2, total=Code("total", frozenset({"total"})))
>>> line.text, sorted(line.uses)
('total[env] += torque[env, 2]', ['torque', 'total'])
"""

from __future__ import annotations

import string
from collections.abc import Iterable
from dataclasses import dataclass

__all__ = ["Code", "Name", "ParameterRead", "block", "code", "indented"]


@dataclass(frozen=True)
class Code:
    """An expression or a line of source code, with the names of values and functions of a scope in it."""

    text: str
    """The source code."""
    uses: frozenset[str] = frozenset()
    """Names of arrays, structs and functions in the text; also ``struct.field`` for each field of a struct."""

    def __format__(self, spec: str) -> str:
        # An f-string would keep the text and lose the names, and the kernel would lack an argument.
        raise TypeError(f"'{self.text}' is source code in an f-string, write it with code('... {{}} ...', part)")


@dataclass(frozen=True)
class Name(Code):
    """The name of an array, a struct or a function of a scope."""

    fields: frozenset[str] = frozenset()
    """Names of the fields, for a struct."""

    def field(self, field: str) -> Code:
        """Source code of a field of the struct.

        Raises:
            AttributeError: if the struct has no such field.
        """
        if field not in self.fields:
            there = ", ".join(sorted(self.fields)) or "none"
            raise AttributeError(f"'{self.text}' has no field '{field}'; it has {there}")
        path = f"{self.text}.{field}"
        return Code(path, self.uses | {path})


@dataclass(frozen=True)
class ParameterRead(Code):
    """The expression that reads a number from :class:`.parameters.Parameters`, whose value may change between steps."""


_PARSER = string.Formatter()


def code(template: str, *parts: Code | str | int, **named: Code | str | int) -> Code:
    """A piece of source code from a template and its parts.

    Placeholders are those of :meth:`str.format`: ``{}`` takes the next part, ``{name}`` a named part, and
    ``{name.field}`` a field of a struct whose :class:`Name` is a named part. Parts may be source code, text and whole
    numbers; an array or a struct must be named by a :class:`Scope` first::

        code("{}[env, {}] += {episode.step_dt}", sums, 3, episode=episode)

    Raises:
        TypeError: for any other part.
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
            raise TypeError(
                f"'{template}': {placeholder or 'a part'} is {type(part).__name__}, must be source code or text"
            )
    return Code("".join(text), frozenset(uses))


def indented(lines: Iterable[Code]) -> list[Code]:
    """The lines, indented by one more level."""
    return [Code(f"    {line.text}", line.uses) for line in lines]


def block(header: Code, body: Iterable[Code]) -> list[Code]:
    """A line such as ``if x:`` and its indented body; ``pass`` for an empty body."""
    return [header, *(indented(body) or [Code("    pass")])]
