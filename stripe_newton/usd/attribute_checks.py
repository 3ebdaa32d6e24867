# SPDX-License-Identifier: Apache-2.0
"""Attribute checks: authored values held against the attribute table and against the types of their schemas."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from .attribute_table import Rule, rule_of

__all__ = ["attribute_reasons", "mistyped_values", "numbers"]

_QUATERNIONS = (Gf.Quatf, Gf.Quatd, Gf.Quath)
_CACHED_RULES = lru_cache(maxsize=4096)(rule_of)
# Names without a namespace are sizes of shapes; elsewhere they mean something else, such as the height of a texture.
_SHAPE_NAMES = {"size", "radius", "height", "width", "length", "axis"}


def attribute_reasons(prim: Usd.Prim) -> Iterator[str]:
    """Problems of the authored values of a prim, one sentence for each attribute: type, range, finiteness."""
    for attribute, rule in _read_attributes(prim):
        value = attribute.Get()
        if value is None:
            # UsdPhysics reads some number in the place of a value that is blocked.
            if attribute.GetName().startswith("physics:") and attribute.GetResolveInfo().ValueIsBlocked():
                yield f"{attribute.GetName()} is blocked (None); it must be {rule.right}, or not authored"
            continue
        reason = _type_reason(attribute, value, rule) or _range_reason(value, rule)
        if reason:
            yield f"{attribute.GetName()} {reason}; it must be {rule.right}"


def mistyped_values(prim: Usd.Prim) -> Iterator[tuple[str, object, str]]:
    """Values of another numeric type than their schema has, which UsdPhysics would not read: a double for a float.

    Yields:
        Name of the attribute, the value in the schema's type, and a sentence.
    """
    for attribute, _ in _read_attributes(prim):
        authored, expected = _authored_type(attribute), _schema_type(attribute)
        if authored is None or expected is None or authored.type == expected.type:
            continue
        value = _converted(attribute.Get(), expected)
        if value is not None:
            yield attribute.GetName(), value, f"is authored as {authored}, its schema has {expected}: converted"


def numbers(value: object) -> np.ndarray | None:
    """A value of an attribute as an array of float64; None if it is no number."""
    if isinstance(value, (bool, str)) or value is None:
        return None
    if isinstance(value, _QUATERNIONS):
        value = (value.GetReal(), *value.GetImaginary())  # NumPy cannot convert Gf's quaternions
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return None


def _read_attributes(prim: Usd.Prim) -> Iterator[tuple[Usd.Attribute, Rule]]:
    """Authored attributes that have a rule."""
    shape = prim.IsA(UsdGeom.Gprim)
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        if name in _SHAPE_NAMES and not shape:
            continue
        rule = _CACHED_RULES(name)
        if rule is not None:
            yield attribute, rule


def _type_reason(attribute: Usd.Attribute, value: object, rule: Rule) -> str:
    """Why a value has no type that the attribute can be read as; empty if it has."""
    expected = _schema_type(attribute)
    authored = _authored_type(attribute)
    shown = f"is {_article(str(authored))} ({value!r})" if authored is not None else f"is {value!r}"
    if expected is None:
        # Without a schema in this build of USD, such as those of PhysX: Newton takes what Python gives. UsdPhysics does
        # not read attributes without their schema, which is a row.
        return "" if attribute.GetName().startswith("physics:") else ("" if _has_kind(value, rule) else shown)
    if authored is None or authored.type == expected.type or _converted(value, expected) is not None:
        return ""
    return f"{shown}, its schema has {expected}"


def _article(noun: str) -> str:
    return f"an {noun}" if noun[0] in "aeiou" else f"a {noun}"


def _has_kind(value: object, rule: Rule) -> bool:
    if rule.kind == "token":
        return isinstance(value, str)
    if rule.kind == "bool":
        return isinstance(value, (bool, int))
    found = numbers(value)
    return rule.kind == "any" or (found is not None and (rule.vector or found.ndim == 0))


def _range_reason(value: object, rule: Rule) -> str:
    if rule.kind == "token":
        return f"is '{value}'" if rule.tokens and value not in rule.tokens else ""
    found = None if rule.kind == "bool" else numbers(value)
    if found is None or found.size == 0:
        return ""
    shown = value if found.size <= 16 else f"{found.size} numbers"
    if np.isnan(found).any():
        return f"is not a number ({shown})"
    endless = np.isinf(found)
    if not np.isin(found[endless], rule.infinite).all():
        return f"is infinite ({shown})"
    finite = found[~endless]
    low = finite <= rule.low if rule.above else finite < rule.low
    if low.any() or (finite > rule.high).any():
        return f"is {value:g}" if isinstance(value, float) else f"is {shown}"
    return f"is {shown}" if rule.nonzero and not found.any() else ""


def _schema_type(attribute: Usd.Attribute) -> Sdf.ValueTypeName | None:
    """Type of an attribute by its prim's schemas; None if none of them has it."""
    definition = attribute.GetPrim().GetPrimDefinition().GetAttributeDefinition(attribute.GetName())
    return definition.GetTypeName() if definition else None


def _authored_type(attribute: Usd.Attribute) -> Sdf.ValueTypeName | None:
    """Type that the strongest value was authored with; None for one of a value clip."""
    # The attribute itself gives the schema's type, and the value as it is.
    for spec in attribute.GetPropertyStack(Usd.TimeCode.Default()):
        if spec.HasDefaultValue():
            return spec.typeName
    return None


def _converted(value: object, expected: Sdf.ValueTypeName) -> object | None:
    """A value in the type ``expected``; None if that would need a guess, as for a number in a string."""
    default = expected.defaultValue
    if isinstance(default, str) or isinstance(value, str):
        # Strings and tokens are the same text.
        return value if isinstance(default, str) and isinstance(value, str) else None
    found = numbers(int(value) if isinstance(value, bool) else value)
    target = numbers(int(default) if isinstance(default, bool) else default)
    if found is None or target is None:
        return None
    try:
        if isinstance(default, bool):
            return bool(value) if found.shape == () and value in (0, 1) else None
        if expected.isArray:
            numeric = np.asarray(default).dtype
            same = found.ndim == np.asarray(default).ndim and found.shape[1:] == np.asarray(default).shape[1:]
            return type(default).FromNumpy(np.ascontiguousarray(found, dtype=numeric)) if same else None
        if found.shape != target.shape:
            return None
        if isinstance(default, int):
            return int(found) if float(found).is_integer() else None
        if isinstance(default, float):
            return float(found)
        return type(default)(value)
    except (TypeError, ValueError, AttributeError, OverflowError):  # Boost.Python's ArgumentError is a TypeError
        return None
