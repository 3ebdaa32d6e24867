# SPDX-License-Identifier: Apache-2.0
"""Schema names: types and API schemas of prims that USD does not know, and what they were meant to be."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from functools import lru_cache

from pxr import Tf, Usd

from .stage_access import api_schemas

__all__ = ["misspelt_names", "unknown_types"]

_READ = re.compile(r"Physics.*|Cube|Sphere|Capsule|Cylinder|Cone|Mesh|Plane|Xform|Scope|Material")
"""Types whose misspelling changes the simulation."""
_VENDORS = ("Physx", "Omni", "Newton", "Mjc", "Isaac", "Semantics")
"""Beginnings of schemas that need no plug-in: they are read by name, or have a row in the report."""
_NEAR = 0.85
"""Least likeness of a misspelt name to the right one, as difflib measures it."""
_MAX_LETTERS = 2
"""Most letters that a misspelt name has more or less."""


def misspelt_names(prim: Usd.Prim) -> Iterator[str]:
    """Reasons to refuse a prim whose type or API schema is none, but nearly one that is simulated."""
    kind = _unknown_type(prim)
    if kind and (meant := _meant(kind, _types())):
        yield f"has the type {kind}, which USD does not know; did you mean {meant}?"
    for schema in api_schemas(prim):
        name = schema.partition(":")[0]
        if name not in _schemas() and (meant := _meant(name, _schemas())):
            yield f"applies {schema}, which USD does not know; did you mean {meant}?"


def unknown_types(prims: list[Usd.Prim]) -> list[tuple[str, str, str]]:
    """Rows of prims with a type that USD does not know: one for each type, with the number of prims."""
    found: dict[str, list[str]] = {}
    for prim in prims:
        if kind := _unknown_type(prim):
            found.setdefault(kind, []).append(str(prim.GetPath()))
    return [
        (paths[0] + (f" (+{len(paths) - 1} more)" if len(paths) > 1 else ""), f"type {kind}", "USD does not know it")
        for kind, paths in sorted(found.items())
    ]


def _unknown_type(prim: Usd.Prim) -> str:
    """Type name of a prim that neither USD nor Newton knows; empty for a known one and for none."""
    name = str(prim.GetTypeName())
    return "" if prim.GetPrimTypeInfo().GetSchemaTypeName() or name.startswith(("Newton", "Mjc")) else name


def _meant(name: str, known: frozenset[str]) -> str:
    """The name that was probably meant; empty without one."""
    if name.startswith(_VENDORS):
        return ""
    words = sorted(re.findall(r"[A-Z][a-z0-9]*|[a-z0-9]+", name))
    for other in sorted(known):
        if sorted(re.findall(r"[A-Z][a-z0-9]*|[a-z0-9]+", other)) == words or other.lower() == name.lower():
            return other
    # A vendor's schema has a word more than the one it extends: it is no misspelling.
    alike = [other for other in sorted(known) if abs(len(other) - len(name)) <= _MAX_LETTERS]
    return next(iter(difflib.get_close_matches(name, alike, 1, _NEAR)), "")


@lru_cache(maxsize=1)
def _types() -> frozenset[str]:
    registry = Usd.SchemaRegistry()
    derived = Tf.Type.FindByName("UsdTyped").GetAllDerivedTypes()
    names = {registry.GetConcreteSchemaTypeName(kind) for kind in derived}
    return frozenset(name for name in names if name and _READ.fullmatch(name))


@lru_cache(maxsize=1)
def _schemas() -> frozenset[str]:
    registry = Usd.SchemaRegistry()
    derived = Tf.Type.FindByName("UsdAPISchemaBase").GetAllDerivedTypes()
    return frozenset(name for kind in derived if (name := registry.GetAPISchemaTypeName(kind)))
