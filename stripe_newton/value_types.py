# SPDX-License-Identifier: Apache-2.0
"""Value types: whether a value is of the type that an annotation says, and that type in words.

Configs, saved runs and metadata of policies are checked by these rules:

* a number is finite in float32, unless its annotation has :data:`INFINITE`;
* it is within the :class:`Range` of its annotation;
* a bool is no number, and an ``int`` is a ``float``;
* a list will do for a tuple and the other way round, as YAML has no tuples;
* what cannot be decided, such as a protocol or a name that exists for type checkers alone, fits.
"""

from __future__ import annotations

import collections.abc
import enum
import functools
import inspect
import math
import numbers
import os
import re
import reprlib
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import typing_extensions
from typing_extensions import is_typeddict

from .field_annotations import (
    InheritedText,
    TypeForm,
    Unknown,
    UnknownType,
    annotation_of,
    annotations_of,
    has_mark,
)
from .value_marks import (
    CODE,
    INFINITE,
    MOST_INT,
    WRITTEN,
    AnyFloat,
    CodeName,
    NonNegativeFloat,
    NonNegativeInt,
    NonNegativeLimit,
    PositiveFloat,
    PositiveInt,
    Range,
    Seed,
    UnitFloat,
    WrittenPath,
)

__all__ = [
    "CODE",
    "INFINITE",
    "WRITTEN",
    "AnyFloat",
    "CodeName",
    "InheritedText",
    "NonNegativeFloat",
    "NonNegativeInt",
    "NonNegativeLimit",
    "PositiveFloat",
    "PositiveInt",
    "Range",
    "Seed",
    "TypeForm",
    "UnitFloat",
    "ValueType",
    "WrittenPath",
    "annotation_of",
    "annotations_of",
    "has_mark",
    "mismatches",
    "short",
    "value_type",
]


@dataclass(frozen=True)
class ValueType:
    """Type of values, as an annotation allows them."""

    text: str
    """In words, such as ``"a number above 0 or None"``."""
    fits: Callable[[object], bool]
    """Whether a value is of this type."""

    def problem(self, value: object) -> str | None:
        """Problem of a value, and what would be right; None if it fits."""
        if self.fits(value):
            return None
        return f"is {short(value)}, must be {self.text}{_too_large(value)}"


_ANYTHING = ValueType("anything", lambda value: True)


class _ShortRepr(reprlib.Repr):
    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 80
        self.maxlist = self.maxtuple = self.maxdict = self.maxset = self.maxfrozenset = 8
        self.maxlong = 40
        self.maxlevel = 4


def short(value: object) -> str:
    """The text of a value, cut where it is long; never an error."""
    try:
        return " ".join(_ShortRepr().repr(value).split())
    except Exception:  # the value's own __repr__
        return f"a {type(value).__name__}"


# -- types of values


def value_type(kind: TypeForm) -> ValueType:
    """The type of values that an annotation allows."""
    try:
        return _cached(kind)
    except TypeError:  # unhashable metadata
        return _value_type(kind)


def _value_type(kind: TypeForm) -> ValueType:
    if kind in _PLAIN:
        return _PLAIN[kind]
    if is_typeddict(kind):
        return ValueType("a mapping", lambda value: isinstance(value, Mapping))
    origin = typing.get_origin(kind)
    if origin in _GENERIC:
        return _GENERIC[origin](typing.get_args(kind))
    return _class(kind) if isinstance(kind, type) and origin is None else _ANYTHING


_cached = functools.cache(_value_type)


def _is_one_of(value: object, choices: tuple[object, ...]) -> bool:
    # By type as well: True == 1.
    return any(type(value) is type(choice) and value == choice for choice in choices)


def _is_real(value: object) -> bool:
    return isinstance(value, numbers.Real) and not _is_bool(value)


def _is_whole(value: object) -> bool:
    return isinstance(value, numbers.Integral) and not _is_bool(value)


def _is_bool(value: object) -> bool:
    return isinstance(value, bool) or type(value).__name__ in ("bool_", "bool")  # NumPy's has no common base with it


def _is_finite(value: Any) -> bool:
    # What a larger number becomes on a device is infinity.
    return _is_real(value) and abs(value) <= _LARGEST


def _is_not_nan(value: object) -> bool:
    return _is_real(value) and value == value


def _too_large(value: Any) -> str:
    """Why a number that is finite is none that a device can hold; empty for other values."""
    if not _is_real(value) or value != value or value in (math.inf, -math.inf):
        return ""
    if _is_whole(value) and MOST_INT < value <= _LARGEST:
        return f", and {MOST_INT} at most"
    return "" if _is_finite(value) else ", and 3.4e38 at most, as float32 holds no more"


_LARGEST = 3.4028234663852886e38
"""Largest number of float32."""
_SETS = (set, frozenset)
_FUNCTION = ValueType("a function or class", callable)
_PLAIN: dict[TypeForm, ValueType] = {
    bool: ValueType("True or False", _is_bool),
    int: ValueType("a whole number", _is_whole),
    float: ValueType("a finite number", _is_finite),
    complex: ValueType("a number", lambda value: isinstance(value, numbers.Number) and not _is_bool(value)),
    str: ValueType("text", lambda value: isinstance(value, str)),
    bytes: ValueType("bytes", lambda value: isinstance(value, bytes)),
    type(None): ValueType("None", lambda value: value is None),
    None: ValueType("None", lambda value: value is None),
    list: ValueType("a list", lambda value: isinstance(value, (list, tuple))),
    tuple: ValueType("a tuple", lambda value: isinstance(value, (list, tuple))),
    dict: ValueType("a dict", lambda value: isinstance(value, Mapping)),
    set: ValueType("a set", lambda value: isinstance(value, _SETS)),
    type: ValueType("a class", lambda value: isinstance(value, type)),
    os.PathLike: ValueType("a path", lambda value: isinstance(value, os.PathLike)),
    Callable: _FUNCTION,
    collections.abc.Sequence: ValueType("a sequence", lambda value: isinstance(value, (list, tuple, range))),
    collections.abc.Mapping: ValueType("a dict", lambda value: isinstance(value, Mapping)),
    object: _ANYTHING,
    Any: _ANYTHING,
    Unknown: _ANYTHING,
}


def _annotated(args: tuple[TypeForm, ...]) -> ValueType:
    """A type with bounds, or one that may be infinite."""
    inner, marks = value_type(args[0]), args[1:]
    if INFINITE in [mark for mark in marks if isinstance(mark, str)]:
        inner = ValueType("a number (also infinite)", _is_not_nan)
    for mark in marks:
        if isinstance(mark, Range):
            inner = _bounded(inner, mark)
    return inner


def _bounded(inner: ValueType, bounds: Range) -> ValueType:
    text = inner.text.replace("finite ", "")
    return ValueType(f"{text} {bounds}", lambda value: inner.fits(value) and bounds.holds(value))  # type: ignore[arg-type]


def _literal(args: tuple[object, ...]) -> ValueType:
    return ValueType(" or ".join(map(repr, args)), lambda value: _is_one_of(value, args))


def _union(args: tuple[TypeForm, ...]) -> ValueType:
    parts = [value_type(arg) for arg in args]
    texts = list(dict.fromkeys(part.text for part in parts))
    # A whole number is a number.
    if "a finite number" in texts and "a whole number" in texts:
        texts.remove("a whole number")
    text = "anything" if "anything" in texts else " or ".join(texts)
    return ValueType(text, lambda value: any(part.fits(value) for part in parts))


def _plural(item: ValueType) -> str:
    if item.text == "text":
        return "texts"
    found = re.fullmatch(r"a ((?:finite |whole )?number)(.*)", item.text)
    return f"{found[1]}s{found[2]}" if found and " or " not in item.text else f"items, each {item.text}"


def _tuple(args: tuple[TypeForm, ...]) -> ValueType:
    if len(args) == 2 and args[1] is Ellipsis:
        return _sequence(value_type(args[0]))
    items = [value_type(arg) for arg in args]
    alike = len({item.text for item in items}) == 1
    text = f"{len(items)} {_plural(items[0])}" if alike else f"({', '.join(item.text for item in items)})"

    def fits(value: object) -> bool:
        if not isinstance(value, (list, tuple)) or len(value) != len(items):
            return False
        return all(item.fits(part) for item, part in zip(items, value, strict=True))

    return ValueType(text, fits)


def _list(args: tuple[TypeForm, ...]) -> ValueType:
    return _sequence(value_type(args[0]))


def _set(args: tuple[TypeForm, ...]) -> ValueType:
    item = value_type(args[0])
    return ValueType(f"a set of {_plural(item)}", lambda value: isinstance(value, _SETS) and all(map(item.fits, value)))


def _sequence(item: ValueType) -> ValueType:
    def fits(value: object) -> bool:
        return isinstance(value, (list, tuple, range)) and all(map(item.fits, value))

    return ValueType("a sequence" if item is _ANYTHING else f"a sequence of {_plural(item)}", fits)


def _subclass(base: TypeForm) -> ValueType:
    """Subclasses of a class; any class where the base is no class, or is a name for type checkers alone."""
    if not isinstance(base, type) or isinstance(base, UnknownType) or getattr(base, "_is_protocol", False):
        return _PLAIN[type]
    text = f"{base.__name__}, or a subclass of it"
    return ValueType(text, lambda value: isinstance(value, type) and issubclass(value, base))


def _mapping(args: tuple[TypeForm, ...]) -> ValueType:
    key, item = map(value_type, args)

    def fits(value: object) -> bool:
        return isinstance(value, Mapping) and all(key.fits(k) and item.fits(v) for k, v in value.items())

    return ValueType("a dict" if item is _ANYTHING else f"a dict of {_plural(item)}", fits)


def _function(args: tuple[TypeForm, ...]) -> ValueType:
    """A callable; of as many arguments as an annotation lists."""
    if not isinstance(args[0], list):
        return _FUNCTION
    count = len(args[0])
    wanted = f"a function or class of {count} argument{'s' * (count != 1)}"
    return ValueType(wanted, lambda value: callable(value) and _takes(value, count))


def _takes(function: Callable[..., object], count: int) -> bool:
    """Whether a callable can be called with so many arguments, as far as it says which it takes."""
    try:
        inspect.signature(function).bind(*[None] * count)
    except TypeError:
        return False
    except ValueError:  # a class or function of native code that does not say
        return True
    return True


_GENERIC: dict[object, Callable[[tuple[TypeForm, ...]], ValueType]] = {
    Annotated: _annotated,
    Literal: _literal,
    typing.Union: _union,
    types.UnionType: _union,
    tuple: _tuple,
    list: _list,
    collections.abc.Sequence: _list,
    collections.abc.Iterable: _list,
    collections.abc.Collection: _list,
    set: _set,
    frozenset: _set,
    collections.abc.Set: _set,
    dict: _mapping,
    collections.abc.Mapping: _mapping,
    collections.abc.MutableMapping: _mapping,
    type: lambda args: _subclass(args[0]),
    collections.abc.Callable: _function,
}
"""Types of values by the generic that an annotation is made of."""


def _class(cls: type) -> ValueType:
    """Instances of a class; any value for a protocol, which would have to be asked for all its attributes."""
    if getattr(cls, "_is_protocol", False):
        return _ANYTHING
    if issubclass(cls, enum.Enum):
        names = ", ".join(member.name for member in cls)
        return ValueType(f"a {cls.__name__}: one of {names}", lambda value: isinstance(value, cls))
    article = "an" if cls.__name__[0] in "AEIO" else "a"
    return ValueType(f"{article} {cls.__name__}", lambda value: isinstance(value, cls))


# -- nested values


def mismatches(value: object, kind: TypeForm, path: str = "") -> Iterator[str]:
    """Problems of a nested value, each as ``path: what is wrong, what would be right``.

    Args:
        value: Such as the content of a file.
        kind: Its type; typed dicts are gone through key by key.
        path: Where the value is, for the messages.
    """
    problem = value_type(kind).problem(value)
    parts = _parts(value, kind) if problem is None or _has_items(value, kind) else ()
    inside = [
        text for name, part, inner in parts for text in mismatches(part, inner, f"{path}.{name}" if path else name)
    ]
    if problem and not inside:
        yield f"{path}: {problem}" if path else problem
    yield from inside


def _has_items(value: object, kind: TypeForm) -> bool:
    """Whether a value is a dict or a list as its type wants, so that what does not fit is one of its items."""
    origin: object = typing.get_origin(kind)
    return (origin is dict and isinstance(value, Mapping)) or (origin is list and isinstance(value, list))


def _parts(value: Any, kind: TypeForm) -> Iterator[tuple[str, object, TypeForm]]:
    """Parts of a value that fits so far, which may hold typed dicts: name, part and type."""
    origin: object = typing.get_origin(kind)
    args = typing.get_args(kind)
    if origin in (typing.Union, types.UnionType):
        fitting = [part for part in args if value_type(part).fits(value)]
        yield from _parts(value, fitting[0])
    elif is_typeddict(kind):
        hints = typing_extensions.get_type_hints(kind, include_extras=True)
        for name, hint in hints.items():
            if name in value:
                yield name, value[name], hint
            elif name in kind.__required_keys__:
                yield name, _Missing(), hint
    elif origin is list and value_type(args[0]) is not _ANYTHING:
        yield from ((str(index), item, args[0]) for index, item in enumerate(value))
    elif origin is dict and value_type(args[1]) is not _ANYTHING:
        yield from ((str(key), item, args[1]) for key, item in value.items())


class _Missing:
    """Stands for a key that a mapping lacks."""

    def __repr__(self) -> str:
        return "missing"
