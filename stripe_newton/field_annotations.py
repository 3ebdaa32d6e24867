# SPDX-License-Identifier: Apache-2.0
"""Field annotations: those of a config's field, evaluated in the modules of the classes that have them."""

from __future__ import annotations

import functools
import inspect
import sys
import typing
from typing import Annotated, Any, TypeAlias

__all__ = ["InheritedText", "TypeForm", "Unknown", "UnknownType", "annotation_of", "annotations_of", "has_mark"]

TypeForm: TypeAlias = Any
"""A type as an annotation has it: a class, a union, a generic. Python has no common type for them."""


class UnknownType(type):
    """Type of :class:`Unknown`, which may be used in an annotation like any type."""

    def __getattr__(cls, name: str) -> type:
        if name.startswith("__"):  # what Python itself looks for
            raise AttributeError(name)
        return cls

    def __getitem__(cls, item: object) -> type:
        return cls


class Unknown(metaclass=UnknownType):
    """Stands for names in annotations that exist for type checkers alone."""


class _Names(dict):
    """Names for the evaluation of an annotation."""

    def __missing__(self, name: str) -> object:
        return vars(typing).get(name, Unknown)


class InheritedText(str):
    """The text of an annotation that a field without one has from a base, whose module alone has the names in it."""


@functools.cache
def annotation_of(cls: type, name: str) -> TypeForm | None:
    """The annotation of a field, evaluated in the module that has it.

    Args:
        cls: The class that has or inherits the field.
        name: The field.

    Returns:
        The annotation, or None if there is none or it cannot be evaluated.
    """
    return next(iter(annotations_of(cls, name)), None)


@functools.cache
def annotations_of(cls: type, name: str, binding: bool = False) -> tuple[TypeForm, ...]:
    """Annotations of a field in a class and its bases, those that can be evaluated, nearest first.

    Args:
        cls: A config class.
        name: The field.
        binding: Leave out those of classes that have ``ANNOTATIONS_ARE_HINTS`` of their own.
    """
    found: list[TypeForm] = []
    for base in cls.__mro__:
        if binding and vars(base).get("ANNOTATIONS_ARE_HINTS", False):
            continue
        kind = inspect.get_annotations(base).get(name)
        if isinstance(kind, str):
            kind = None if isinstance(kind, InheritedText) else _evaluated(kind, base)
        if kind is not None:
            found.append(kind)
    # A bare number says nothing of the range that a base gives it: `decimation: int = 4` stays at least 1.
    bounded = {typing.get_args(kind)[0] for kind in found if _is_annotated(kind)}
    return tuple(kind for kind in found if kind not in (int, float) or kind not in bounded)


def _is_annotated(kind: TypeForm) -> bool:
    origin: object = typing.get_origin(kind)
    return origin is Annotated


def _evaluated(text: str, base: type) -> TypeForm | None:
    module = sys.modules.get(base.__module__)
    names = _Names({**vars(__import__("builtins")), **(vars(module) if module else {}), **vars(base)})
    try:
        return eval(text, {"__builtins__": {}}, names)
    except Exception:  # such as a subscript of a class that takes none at run time
        return None


def has_mark(kind: TypeForm, mark: str) -> bool:
    """Whether an annotation, or a part of it, has a mark such as ``CODE`` of :mod:`.value_marks`."""
    args = typing.get_args(kind)
    if _is_annotated(kind) and mark in [arg for arg in args[1:] if isinstance(arg, str)]:
        return True
    return any(has_mark(arg, mark) for arg in args if arg is not Ellipsis and not isinstance(arg, (str, list)))
