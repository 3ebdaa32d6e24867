# SPDX-License-Identifier: Apache-2.0
"""Material bindings: colliders whose physics material does not resolve."""

from __future__ import annotations

from dataclasses import dataclass, field

from pxr import Usd, UsdPhysics, UsdShade

__all__ = ["LostMaterial", "inherited_materials", "lost_materials", "unapplied_bindings"]

_NAMES = ("material:binding:physics", "material:binding")


@dataclass
class LostMaterial:
    """A physics material that colliders name and do not get."""

    path: str
    why: str
    """Problem of the material, such as ``"does not exist"``."""
    colliders: list[str] = field(default_factory=list)
    """Paths of the colliders, in the order of the stage."""
    bindings: list[tuple[str, str]] = field(default_factory=list)
    """Path of the prim, and name of the relationship, of each binding: on the collider, or above it."""


def lost_materials(prims: list[Usd.Prim]) -> list[LostMaterial]:
    """Materials that are bound and give no physics material, in the order of the stage."""
    found: dict[tuple[str, str], LostMaterial] = {}
    for prim in prims:
        if prim.HasAPI(UsdPhysics.CollisionAPI) and (lost := _lost(prim)) is not None:
            owner, relationship, path, why = lost
            material = found.setdefault((path, why), LostMaterial(path, why))
            material.colliders.append(str(prim.GetPath()))
            material.bindings.append((owner, relationship))
    return list(found.values())


def unapplied_bindings(prims: list[Usd.Prim]) -> list[str]:
    """Paths of the prims that bind a material without MaterialBindingAPI, as older files do."""
    bound = (p for p in prims if not p.IsPseudoRoot() and any(p.GetRelationship(name) for name in _NAMES))
    return [str(p.GetPath()) for p in bound if not p.HasAPI(UsdShade.MaterialBindingAPI)]


def inherited_materials(prims: list[Usd.Prim]) -> list[str]:
    """Paths of the colliders whose physics material is bound above them, and which lack MaterialBindingAPI.

    UsdPhysics looks for a material, also an inherited one, only where that API is applied on the collider itself.
    """
    found = []
    for prim in prims:
        if prim.HasAPI(UsdPhysics.CollisionAPI) and not prim.HasAPI(UsdShade.MaterialBindingAPI):
            material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
            if material and material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
                found.append(str(prim.GetPath()))
    return found


def _lost(collider: Usd.Prim) -> tuple[str, str, str, str] | None:
    """Owner, name, target and reason of the binding that gives a collider no material; None if it has one or none."""
    material, binding = UsdShade.MaterialBindingAPI(collider).ComputeBoundMaterial("physics")
    if material:
        prim = material.GetPrim()
        if not prim.IsActive():
            why = "is not active"
        elif prim.IsAbstract() or not prim.IsDefined():
            why = "is a class or an over, no prim of the scene"
        elif binding.GetName().endswith(":physics") and not prim.HasAPI(UsdPhysics.MaterialAPI):
            why = "has no PhysicsMaterialAPI"
        else:
            return None
        return str(binding.GetPrim().GetPath()), binding.GetName(), str(prim.GetPath()), why
    owner = collider
    while owner and not owner.IsPseudoRoot():
        for name in _NAMES:
            binding = owner.GetRelationship(name)
            for target in binding.GetTargets() if binding else []:
                prim = collider.GetStage().GetPrimAtPath(target)
                if prim and prim.IsA(UsdShade.Material):
                    why = "is one of several targets"
                else:
                    why = (
                        f"is a {prim.GetTypeName() or 'prim without a type'}, no Material" if prim else "does not exist"
                    )
                return str(owner.GetPath()), name, str(target), why
        owner = owner.GetParent()
    return None
