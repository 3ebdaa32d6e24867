# SPDX-License-Identifier: Apache-2.0
"""The rows of a :class:`StageReport`, from a builder and the stage that was read into it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import newton
import numpy as np
from newton import GeoType, JointTargetMode, JointType, ShapeFlags
from newton.usd import SchemaResolverMjc, SchemaResolverNewton, SchemaResolverPhysx
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

from .checks import BuilderStart
from .extras import ignored_lights, read_lights, read_semantics
from .report import ArticulationRow, BodyRow, JointRow, MaterialRow, ShapeRow, SiteRow, StageReport
from .stage import api_schemas, walk
from .units import stage_units

__all__ = ["build_report"]

_VENDOR_PREFIXES = ("physx", "omniphysics")
_SIZES = {
    GeoType.SPHERE: 1,
    GeoType.CAPSULE: 2,
    GeoType.CYLINDER: 2,
    GeoType.CONE: 2,
    GeoType.PLANE: 2,
}


def build_report(
    builder: newton.ModelBuilder,
    start: BuilderStart,
    authored: Usd.Stage,
    prepared: Usd.Stage,
    root_path: str,
    ignore: Iterable[str],
    rows: list[tuple[str, str, str]],
    name: str,
    scene_path: str | None,
) -> StageReport:
    """Rows of all that was added since ``start``. ``prepared`` is the stage as Newton read it, in SI."""
    metres, kilograms = stage_units(authored)
    prims = list(walk(prepared, root_path, ignore))
    shapes = range(start.shape, builder.shape_count)
    sites = [s for s in shapes if builder.shape_flags[s] & ShapeFlags.SITE]
    return StageReport(
        file=name,
        root_path=root_path,
        units={
            "meters_per_unit": metres,
            "kilograms_per_unit": kilograms,
            "up_axis": str(UsdGeom.GetStageUpAxis(authored)),
            "gravity": [float(g) for g in np.asarray(builder.gravity, dtype=float).reshape(-1)],
            "scene": scene_path,
        },
        bodies=[_body(builder, b) for b in range(start.body, builder.body_count)],
        joints=joint_rows(builder, start.joint),
        shapes=[_shape(builder, s, prepared) for s in shapes if s not in set(sites)],
        articulations=[_articulation(builder, a) for a in range(start.articulation, builder.articulation_count)],
        lights=read_lights(prepared, root_path),
        materials=[_material(p) for p in prims if p.HasAPI(UsdPhysics.MaterialAPI)],
        sites=[_site(builder, s) for s in sites],
        semantics=read_semantics(prepared, root_path),
        ignored=[*rows, *_ignored(prims), *ignored_lights(prepared, root_path)],
    )


def joint_rows(builder: newton.ModelBuilder, first: int = 0) -> list[JointRow]:
    """One row a degree of freedom, of the joints from ``first`` on."""
    return [row for joint in range(first, builder.joint_count) for row in _joint(builder, joint)]


def _floats(values: Iterable[float]) -> tuple[float, ...]:
    return tuple(float(v) for v in values)


def _body(builder: newton.ModelBuilder, body: int) -> BodyRow:
    inertia = np.array(builder.body_inertia[body], dtype=float).reshape(3, 3)
    return BodyRow(
        path=builder.body_label[body],
        mass=float(builder.body_mass[body]),
        com=_floats(builder.body_com[body]),  # type: ignore[arg-type]
        inertia=_floats(np.diag(inertia)),  # type: ignore[arg-type]
        kinematic=bool(int(builder.body_flags[body]) & int(newton.BodyFlags.KINEMATIC)),
        position=_floats(list(builder.body_q[body])[:3]),  # type: ignore[arg-type]
    )


def _joint(builder: newton.ModelBuilder, joint: int) -> list[JointRow]:
    kind = JointType(builder.joint_type[joint])
    linear, angular = builder.joint_dof_dim[joint]
    first, at = builder.joint_qd_start[joint], builder.joint_q_start[joint]
    parent = builder.joint_parent[joint]
    common: dict[str, Any] = {
        "path": builder.joint_label[joint],
        "type": kind.name.lower(),
        "parent": builder.body_label[parent] if parent >= 0 else "",
        "child": builder.body_label[builder.joint_child[joint]],
        "loop": builder.joint_articulation[joint] < 0,
    }
    if kind in (JointType.FIXED, JointType.FREE, JointType.BALL):
        numbers: dict[str, Any] = dict.fromkeys(("stiffness", "damping", "target", "position"), 0.0)
        dynamics: dict[str, Any] = {
            "armature": float(builder.joint_armature[first]) if kind == JointType.BALL else 0.0,
            "friction": float(builder.joint_friction[first]) if kind == JointType.BALL else 0.0,
            "passive_damping": float(builder.joint_damping[first]) if kind == JointType.BALL else 0.0,
        }
        limits: dict[str, Any] = {
            "lower": -math.inf,
            "upper": math.inf,
            "max_force": math.inf,
            "velocity_limit": math.inf,
        }
        rest: dict[str, Any] = {"dof": -1, "angular": kind == JointType.BALL, "axis": None, "target_mode": "none"}
        return [JointRow(**common, **numbers, **dynamics, **limits, **rest)]
    return [
        JointRow(
            **common,
            dof=k,
            angular=k >= linear,
            axis=_floats(builder.joint_axis[first + k]),  # type: ignore[arg-type]
            lower=float(builder.joint_limit_lower[first + k]),
            upper=float(builder.joint_limit_upper[first + k]),
            stiffness=float(builder.joint_target_ke[first + k]),
            damping=float(builder.joint_target_kd[first + k]),
            max_force=float(builder.joint_effort_limit[first + k]),
            target_mode=JointTargetMode(builder.joint_target_mode[first + k]).name.lower(),
            target=float(builder.joint_target_q[at + k]),
            position=float(builder.joint_q[at + k]),
            armature=float(builder.joint_armature[first + k]),
            friction=float(builder.joint_friction[first + k]),
            passive_damping=float(builder.joint_damping[first + k]),
            velocity_limit=float(builder.joint_velocity_limit[first + k]),
        )
        for k in range(linear + angular)
    ]


def _shape(builder: newton.ModelBuilder, shape: int, stage: Usd.Stage) -> ShapeRow:
    kind, body, flags = GeoType(builder.shape_type[shape]), builder.shape_body[shape], builder.shape_flags[shape]
    return ShapeRow(
        path=builder.shape_label[shape],
        type=kind.name.lower(),
        size=_floats(builder.shape_scale[shape])[: _SIZES.get(kind, 3)],
        body=builder.body_label[body] if body >= 0 else "",
        collides=bool(flags & ShapeFlags.COLLIDE_SHAPES),
        visible=bool(flags & ShapeFlags.VISIBLE),
        friction=float(builder.shape_material_mu[shape]),
        restitution=float(builder.shape_material_restitution[shape]),
        density=_density(stage.GetPrimAtPath(builder.shape_label[shape])),
    )


def _density(prim: Usd.Prim) -> float | None:
    """Of the shape's own MassAPI, else of the bound physics material."""
    if not prim:
        return None
    own = UsdPhysics.MassAPI(prim).GetDensityAttr().Get() if prim.HasAPI(UsdPhysics.MassAPI) else None
    if own:
        return float(own)
    material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if material and material.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        bound = UsdPhysics.MaterialAPI(material.GetPrim()).GetDensityAttr().Get()
        return float(bound) if bound else None
    return None


def _articulation(builder: newton.ModelBuilder, articulation: int) -> ArticulationRow:
    joints = range(builder.articulation_start[articulation], builder.articulation_end[articulation])
    root = JointType(builder.joint_type[joints[0]])
    return ArticulationRow(
        path=builder.articulation_label[articulation],
        base="floating" if root == JointType.FREE else "fixed",
        dofs=sum(sum(builder.joint_dof_dim[j]) for j in joints),
        bodies=[builder.body_label[builder.joint_child[j]] for j in joints],
    )


def _material(prim: Usd.Prim) -> MaterialRow:
    api = UsdPhysics.MaterialAPI(prim)
    return MaterialRow(
        path=str(prim.GetPath()),
        static_friction=float(api.GetStaticFrictionAttr().Get()),
        dynamic_friction=float(api.GetDynamicFrictionAttr().Get()),
        restitution=float(api.GetRestitutionAttr().Get()),
        density=float(api.GetDensityAttr().Get()),
    )


def _site(builder: newton.ModelBuilder, shape: int) -> SiteRow:
    body = builder.shape_body[shape]
    return SiteRow(
        path=builder.shape_label[shape],
        body=builder.body_label[body] if body >= 0 else "",
        position=_floats(list(builder.shape_transform[shape])[:3]),  # type: ignore[arg-type]
    )


def _ignored(prims: list[Usd.Prim]) -> list[tuple[str, str, str]]:
    rows: list[tuple[str, str, str]] = []
    for prim in prims:
        path = str(prim.GetPath())
        rows.extend((path, what, why) for what, why in _prim_ignored(prim))
    return [*rows, *_vendor_attributes(prims)]


def _prim_ignored(prim: Usd.Prim) -> Iterable[tuple[str, str]]:
    if prim.IsA(UsdGeom.Camera):
        yield "camera", "cameras of a stage are not used; a task's viewer has its own"
    if prim.IsA(UsdGeom.PointInstancer):
        yield "point instancer", "its instances are not read; author them as prims"
    if prim.HasAPI(UsdPhysics.CollisionAPI):
        if UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr().Get() is False:
            yield "collider", "collisionEnabled is false: visible at most"
        elif not prim.IsA(UsdGeom.Gprim) and not prim.HasAPI(UsdPhysics.RigidBodyAPI):
            yield (
                "collider",
                f"PhysicsCollisionAPI on a {prim.GetTypeName() or 'prim without a type'}, which has no shape",
            )
    if prim.HasAPI(UsdPhysics.MaterialAPI):
        api = UsdPhysics.MaterialAPI(prim)
        static, dynamic = api.GetStaticFrictionAttr().Get(), api.GetDynamicFrictionAttr().Get()
        if not math.isclose(static, dynamic, rel_tol=1e-6):
            yield "staticFriction", f"Newton has one coefficient: dynamicFriction {dynamic:g} is used, not {static:g}"
    if prim.IsA(UsdPhysics.Joint):
        yield from _joint_ignored(prim)
    if any(a.GetNumTimeSamples() for a in prim.GetAuthoredAttributes() if a.GetName().startswith("xformOp:")):
        yield "animation", "only the default time is read, not time samples"


def _joint_ignored(prim: Usd.Prim) -> Iterable[tuple[str, str]]:
    joint = UsdPhysics.Joint(prim)
    if joint.GetJointEnabledAttr().Get() is False:
        yield "joint", "jointEnabled is false"
    for attribute in (joint.GetBreakForceAttr(), joint.GetBreakTorqueAttr()):
        if attribute.Get() is not None and attribute.Get() < 1e30:
            yield attribute.GetName(), "joints do not break"
    if prim.IsA(UsdPhysics.SphericalJoint) and not prim.IsA(UsdPhysics.FixedJoint):
        cone = UsdPhysics.SphericalJoint(prim)
        angles = (cone.GetConeAngle0LimitAttr().Get(), cone.GetConeAngle1LimitAttr().Get())
        if any(angle is not None and angle >= 0.0 for angle in angles):
            yield "cone limit", "a ball joint of Newton has no limits"
    if prim.GetTypeName() == "PhysicsJoint":
        limited = {name.partition(":")[2] for name in api_schemas(prim) if name.startswith("PhysicsLimitAPI:")}
        loose = [axis for axis in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ") if axis not in limited]
        if loose:
            yield (
                f"free axes {' '.join(loose)}",
                "Newton locks an axis without PhysicsLimitAPI; author wide limits to free it",
            )
    for schema in api_schemas(prim):
        if schema.startswith("PhysicsDriveAPI:"):
            drive = UsdPhysics.DriveAPI(prim, schema.partition(":")[2])
            if drive.GetTypeAttr().Get() == UsdPhysics.Tokens.acceleration:
                yield "acceleration drive", "its gains are taken as those of a force drive"


def _understood() -> set[str]:
    """Vendor attributes that Newton's schema resolvers read."""
    names: set[str] = set()
    for resolver in (SchemaResolverNewton, SchemaResolverMjc, SchemaResolverPhysx):
        for attributes in resolver.mapping.values():
            for attribute in attributes.values():
                names.update(attribute.attribute_names or (attribute.name,))
    # Read by Newton into the report's schema attributes, and never used by it.
    return names - {"physxRigidBody:linearDamping", "physxRigidBody:angularDamping"}


def _vendor_attributes(prims: list[Usd.Prim]) -> list[tuple[str, str, str]]:
    """Authored PhysX attributes without a counterpart: one row a name, with how many prims have it."""
    understood = _understood()
    found: dict[str, list[str]] = {}
    for prim in prims:
        for attribute in prim.GetAuthoredAttributes():
            name = attribute.GetName()
            if name.startswith(_VENDOR_PREFIXES) and name not in understood:
                found.setdefault(name, []).append(str(prim.GetPath()))
    return [
        (paths[0] + (f" (+{len(paths) - 1} more)" if len(paths) > 1 else ""), name, "Newton has no counterpart")
        for name, paths in sorted(found.items())
    ]
