# SPDX-License-Identifier: Apache-2.0
"""Ignored content: what prims author that Newton does not read, or reads differently."""

from __future__ import annotations

import math
from collections.abc import Iterator

from newton.usd import SchemaResolverMjc, SchemaResolverNewton, SchemaResolverPhysx
from pxr import Usd, UsdGeom, UsdPhysics

from .schema_names import unknown_types
from .stage_access import api_schemas

__all__ = ["ignored_content", "unapplied_attributes"]

_PHYSICS_PREFIXES = ("physics:", "drive:", "limit:")
_SHAPES = ("Cube", "Sphere", "Capsule", "Cylinder", "Cone", "Plane", "Mesh")
"""Types with a shape in Newton."""
_VENDOR_PREFIXES = ("physx", "omniphysics")


def ignored_content(prims: list[Usd.Prim]) -> list[tuple[str, str, str]]:
    """``(path, what, why)`` of everything on the prims that is left out or read differently from what is authored."""
    places: dict[tuple[str, str], list[str]] = {}
    for prim in prims:
        for row in _prim_ignored(prim):
            places.setdefault(row, []).append(str(prim.GetPath()))
    rows = [(_first(paths), what, why) for (what, why), paths in places.items()]
    rows += _second_scenes(prims)
    return [*rows, *_shapeless_types(prims), *unknown_types(prims), *_vendor_attributes(prims)]


def _shapeless_types(prims: list[Usd.Prim]) -> list[tuple[str, str, str]]:
    """A row for each type of geometry that Newton has no shape for, and one for skeletons."""
    found: dict[str, list[str]] = {}
    for prim in prims:
        if prim.IsA(UsdGeom.Gprim) and prim.GetTypeName() not in _SHAPES:
            found.setdefault(str(prim.GetTypeName()), []).append(str(prim.GetPath()))
    rows = _by_name(found, "Newton has no such shape: it is neither drawn nor collided with")
    if posed := [str(prim.GetPath()) for prim in prims if prim.GetTypeName() == "SkelRoot"]:
        rows += _by_name({"skeleton": posed}, "it poses no meshes: they are as they are modelled")
    return rows


def _second_scenes(prims: list[Usd.Prim]) -> Iterator[tuple[str, str, str]]:
    scenes = [str(prim.GetPath()) for prim in prims if prim.IsA(UsdPhysics.Scene)]
    for path in scenes[1:]:
        yield path, "PhysicsScene", f"a stage has one; {scenes[0]} is used"


def _prim_ignored(prim: Usd.Prim) -> Iterator[tuple[str, str]]:
    if prim.IsA(UsdGeom.Camera):
        yield "camera", "cameras of a stage are not used; a task's viewer has its own"
    if prim.HasAPI(UsdPhysics.CollisionAPI):
        yield from _collider_ignored(prim)
    if prim.HasAPI(UsdPhysics.MaterialAPI):
        api = UsdPhysics.MaterialAPI(prim)
        static, dynamic = api.GetStaticFrictionAttr().Get(), api.GetDynamicFrictionAttr().Get()
        if not math.isclose(static, dynamic, rel_tol=1e-6):
            yield "staticFriction", f"Newton has one coefficient: dynamicFriction {dynamic:g} is used, not {static:g}"
    if prim.IsA(UsdPhysics.Joint):
        yield from _joint_ignored(prim)
    if prim.IsA(UsdGeom.Mesh) and UsdGeom.Mesh(prim).GetHoleIndicesAttr().Get():
        yield "holeIndices", "not read: its holes are faces"
    if prim.IsA(UsdGeom.Xformable):
        order = UsdGeom.Xformable(prim).GetXformOpOrderAttr().Get() or ()
        names = dict.fromkeys(name.removeprefix("!invert!") for name in order if name != "!resetXformStack!")
        if missing := [name for name in names if not prim.GetAttribute(name)]:
            yield "xformOpOrder", f"{' '.join(missing)} is not authored: left out"
    if any(a.GetNumTimeSamples() for a in prim.GetAuthoredAttributes() if _is_read(prim, a.GetName())):
        yield "animation", "only the default time is read, not time samples"


def _is_read(prim: Usd.Prim, name: str) -> bool:
    """Whether an attribute places a prim, shapes it, shows it or is physics."""
    if name.startswith(("xformOp:", *_PHYSICS_PREFIXES)) or name == "visibility":
        return True
    return prim.IsA(UsdGeom.Gprim) and ":" not in name


def _collider_ignored(prim: Usd.Prim) -> Iterator[tuple[str, str]]:
    if UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get() is False:
        yield "collider", "collisionEnabled is false: visible at most"
    elif not prim.IsA(UsdGeom.Gprim) and not prim.HasAPI(UsdPhysics.RigidBodyAPI):
        kind = prim.GetTypeName() or "prim without a type"
        yield "collider", f"PhysicsCollisionAPI on a {kind}, which has no shape"


def _joint_ignored(prim: Usd.Prim) -> Iterator[tuple[str, str]]:
    joint = UsdPhysics.Joint(prim)
    if joint.GetJointEnabledAttr().Get() is False:
        yield "joint", "jointEnabled is false"
    for attribute in (joint.GetBreakForceAttr(), joint.GetBreakTorqueAttr()):
        if (
            attribute.Get() is not None and attribute.Get() < 1e30
        ):  # infinite by default, exporters write the largest float
            yield attribute.GetName(), "joints do not break"
    if prim.IsA(UsdPhysics.SphericalJoint) and _has_cone(prim):
        yield "cone limit", "a ball joint of Newton has no limits"
    if prim.GetTypeName() == "PhysicsJoint":
        limited = {name.partition(":")[2] for name in api_schemas(prim) if name.startswith("PhysicsLimitAPI:")}
        loose = [axis for axis in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ") if axis not in limited]
        if loose:
            why = "Newton locks an axis without PhysicsLimitAPI; author wide limits to free it"
            yield f"free axes {' '.join(loose)}", why
    for schema in api_schemas(prim):
        if schema.startswith("PhysicsDriveAPI:"):
            drive = UsdPhysics.DriveAPI(prim, schema.partition(":")[2])
            if drive.GetTypeAttr().Get() == UsdPhysics.Tokens.acceleration:
                yield "acceleration drive", "its gains are taken as those of a force drive"


def _has_cone(prim: Usd.Prim) -> bool:
    """Whether a spherical joint has a cone limit; a negative angle means none."""
    joint = UsdPhysics.SphericalJoint(prim)
    angles = (joint.GetConeAngle0LimitAttr().Get(), joint.GetConeAngle1LimitAttr().Get())
    return any(angle is not None and angle >= 0.0 for angle in angles)


def _understood() -> set[str]:
    """Names of the vendor attributes that Newton's schema resolvers read."""
    names: set[str] = set()
    for resolver in (SchemaResolverNewton, SchemaResolverMjc, SchemaResolverPhysx):
        for attributes in resolver.mapping.values():
            for attribute in attributes.values():
                names.update(attribute.attribute_names or (attribute.name,))
    # Newton reads these into the schema attributes that it returns, and does not use them.
    return names - {"physxRigidBody:linearDamping", "physxRigidBody:angularDamping"}


def unapplied_attributes(prims: list[Usd.Prim]) -> list[tuple[str, str, str]]:
    """Attributes of UsdPhysics on prims that do not apply their schema, which nobody reads: a row for each name."""
    found: dict[str, list[str]] = {}
    for prim in prims:
        names = [a.GetName() for a in prim.GetAuthoredAttributes() if a.GetName().startswith(_PHYSICS_PREFIXES)]
        if names:
            known = set(prim.GetPrimDefinition().GetPropertyNames())
            for name in names:
                if name not in known:
                    found.setdefault(name, []).append(str(prim.GetPath()))
    return _by_name(found, "not read: no schema of the prim has it")


def _by_name(found: dict[str, list[str]], why: str) -> list[tuple[str, str, str]]:
    """A row for each name with the number of prims: a row for each of a robot's links would hide all others."""
    return [(_first(paths), name, why) for name, paths in sorted(found.items())]


def _first(paths: list[str]) -> str:
    return paths[0] + (f" (+{len(paths) - 1} more)" if len(paths) > 1 else "")


def _vendor_attributes(prims: list[Usd.Prim]) -> list[tuple[str, str, str]]:
    """Authored PhysX attributes without a counterpart in Newton: a row for each name, with the number of prims."""
    understood = _understood()
    found: dict[str, list[str]] = {}
    for prim in prims:
        for attribute in prim.GetAuthoredAttributes():
            name = attribute.GetName()
            if name.startswith(_VENDOR_PREFIXES) and name not in understood:
                found.setdefault(name, []).append(str(prim.GetPath()))
    return _by_name(found, "Newton has no counterpart")
