# SPDX-License-Identifier: Apache-2.0
"""Untapered shapes: capsules and cylinders of USD's newer types, which have two radii, as those with one."""

from __future__ import annotations

from pxr import Sdf, Usd

__all__ = ["untapered", "write_untapered"]

_TYPES = {"Capsule_1": "Capsule", "Cylinder_1": "Cylinder"}


def untapered(prim: Usd.Prim) -> bool:
    """Whether a prim is a ``Capsule_1`` or ``Cylinder_1`` whose radii are equal, so that it has an older type."""
    if prim.GetTypeName() not in _TYPES:
        return False
    return bool(prim.GetAttribute("radiusTop").Get() == prim.GetAttribute("radiusBottom").Get())


def write_untapered(prim: Usd.Prim) -> None:
    """Give such a prim the older type, which Newton reads; their other attributes and defaults are the same."""
    radius = prim.GetAttribute("radiusTop").Get()
    prim.SetTypeName(_TYPES[str(prim.GetTypeName())])
    prim.CreateAttribute("radius", Sdf.ValueTypeNames.Double).Set(radius)
