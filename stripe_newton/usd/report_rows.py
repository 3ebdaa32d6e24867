# SPDX-License-Identifier: Apache-2.0
"""Report rows: a :class:`StageReport` from a builder and the stage that was read into it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import newton
import numpy as np
from newton import GeoType, JointTargetMode, JointType, ShapeFlags
from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

from .builder_start import BuilderStart
from .ignored_content import ignored_content, unapplied_attributes
from .ignored_rows import Ignored
from .semantic_labels import read_semantics
from .stage_access import labelled_prim, walk
from .stage_lights import ignored_lights, read_lights
from .stage_report import ArticulationRow, BodyRow, JointRow, MaterialRow, ShapeRow, SiteRow, StageReport
from .units import stage_units

__all__ = ["build_report", "joint_rows"]

_SIZES = {
    GeoType.SPHERE: 1,
    GeoType.CAPSULE: 2,
    GeoType.CYLINDER: 2,
    GeoType.CONE: 2,
    GeoType.PLANE: 2,
}
"""Number of a shape's three scale values that are its size; all three for other types."""


def build_report(
    builder: newton.ModelBuilder,
    start: BuilderStart,
    authored: Usd.Stage,
    prepared: Usd.Stage,
    root_path: str,
    ignore: Iterable[str],
    rows: Ignored,
    name: str,
    scene_path: str | None,
) -> StageReport:
    """Report on everything that was added to a builder since ``start``.

    Args:
        builder: The builder.
        start: Its counts before the stage was read.
        authored: The stage as given.
        prepared: The stage as Newton read it, in SI.
        root_path: Prim that was loaded.
        ignore: Regular expressions of prim paths that were left out.
        rows: Rows ``(path, what, why)`` of what was changed so far.
        name: Name of the stage.
        scene_path: Path of the PhysicsScene, None without one.
    """
    metres, kilograms = stage_units(authored)
    prims = list(walk(prepared, root_path, ignore))
    shapes = range(start.shape, builder.shape_count)
    # Newton stores a site as a shape with a flag.
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
        ignored=[
            *rows,
            *ignored_content(prims),
            *unapplied_attributes(list(walk(authored, root_path, ignore))),
            *ignored_lights(prepared, root_path),
        ],
    )


def joint_rows(builder: newton.ModelBuilder, first: int = 0) -> list[JointRow]:
    """A row for each degree of freedom of the joints from ``first`` on."""
    return [row for joint in range(first, builder.joint_count) for row in _joint(builder, joint)]


def _vec3(values: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _body(builder: newton.ModelBuilder, body: int) -> BodyRow:
    inertia = np.array(builder.body_inertia[body], dtype=float).reshape(3, 3)
    return BodyRow(
        path=builder.body_label[body],
        mass=float(builder.body_mass[body]),
        com=_vec3(builder.body_com[body]),
        inertia=_vec3(np.diag(inertia)),
        kinematic=bool(int(builder.body_flags[body]) & int(newton.BodyFlags.KINEMATIC)),
        position=_vec3(builder.body_q[body]),
    )


def _joint(builder: newton.ModelBuilder, joint: int) -> list[JointRow]:
    linear, angular = builder.joint_dof_dim[joint]
    if JointType(builder.joint_type[joint]) in (JointType.FIXED, JointType.FREE, JointType.BALL):
        return [_joint_without_axes(builder, joint)]
    return [_joint_axis(builder, joint, k, angular=k >= linear) for k in range(linear + angular)]


def _joint_without_axes(builder: newton.ModelBuilder, joint: int) -> JointRow:
    kind, first = JointType(builder.joint_type[joint]), builder.joint_qd_start[joint]
    ball = kind == JointType.BALL  # the others have no passive dynamics, a fixed one not even a degree of freedom
    return JointRow(
        path=builder.joint_label[joint],
        type=kind.name.lower(),
        dof=-1,
        angular=ball,
        axis=None,
        parent=_parent(builder, joint),
        child=builder.body_label[builder.joint_child[joint]],
        lower=-math.inf,
        upper=math.inf,
        stiffness=0.0,
        damping=0.0,
        max_force=math.inf,
        target_mode="none",
        target=0.0,
        position=0.0,
        armature=float(builder.joint_armature[first]) if ball else 0.0,
        friction=float(builder.joint_friction[first]) if ball else 0.0,
        passive_damping=float(builder.joint_damping[first]) if ball else 0.0,
        velocity_limit=math.inf,
        loop=builder.joint_articulation[joint] < 0,
    )


def _joint_axis(builder: newton.ModelBuilder, joint: int, axis: int, angular: bool) -> JointRow:
    dof, coord = builder.joint_qd_start[joint] + axis, builder.joint_q_start[joint] + axis
    return JointRow(
        path=builder.joint_label[joint],
        type=JointType(builder.joint_type[joint]).name.lower(),
        dof=axis,
        angular=angular,
        axis=_vec3(builder.joint_axis[dof]),
        parent=_parent(builder, joint),
        child=builder.body_label[builder.joint_child[joint]],
        lower=float(builder.joint_limit_lower[dof]),
        upper=float(builder.joint_limit_upper[dof]),
        stiffness=float(builder.joint_target_ke[dof]),
        damping=float(builder.joint_target_kd[dof]),
        max_force=float(builder.joint_effort_limit[dof]),
        target_mode=JointTargetMode(builder.joint_target_mode[dof]).name.lower(),
        target=float(builder.joint_target_q[coord]),
        position=float(builder.joint_q[coord]),
        armature=float(builder.joint_armature[dof]),
        friction=float(builder.joint_friction[dof]),
        passive_damping=float(builder.joint_damping[dof]),
        velocity_limit=float(builder.joint_velocity_limit[dof]),
        loop=builder.joint_articulation[joint] < 0,
    )


def _parent(builder: newton.ModelBuilder, joint: int) -> str:
    parent = builder.joint_parent[joint]
    return builder.body_label[parent] if parent >= 0 else ""


def _shape(builder: newton.ModelBuilder, shape: int, stage: Usd.Stage) -> ShapeRow:
    kind, body, flags = GeoType(builder.shape_type[shape]), builder.shape_body[shape], builder.shape_flags[shape]
    label = builder.shape_label[shape]
    prim = labelled_prim(stage, label)
    # Friction and restitution are those that Newton computes with, not those of a material in the stage.
    return ShapeRow(
        path=label,
        type=kind.name.lower(),
        size=_size(builder, shape, kind),
        body=builder.body_label[body] if body >= 0 else "",
        collides=bool(flags & ShapeFlags.COLLIDE_SHAPES),
        visible=bool(flags & ShapeFlags.VISIBLE),
        friction=float(builder.shape_material_mu[shape]),
        restitution=float(builder.shape_material_restitution[shape]),
        density=_density(prim),
    )


def _size(builder: newton.ModelBuilder, shape: int, kind: GeoType) -> tuple[float, ...]:
    """Value of :attr:`.ShapeRow.size`: half the extents of a mesh, whose scale alone says nothing about its size."""
    scale, source = _vec3(builder.shape_scale[shape]), builder.shape_source[shape]
    if kind in (GeoType.MESH, GeoType.CONVEX_MESH) and source is not None and len(source.vertices):
        return _vec3(0.5 * np.ptp(np.asarray(source.vertices), axis=0) * np.abs(scale))
    return scale[: _SIZES.get(kind, 3)]


def _density(prim: Usd.Prim | None) -> float | None:
    """Density of the shape's own MassAPI, otherwise of the bound physics material."""
    if not prim:  # a shape whose label is no prim's path
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
    root = JointType(builder.joint_type[joints[0]])  # the joint between the world and the root body comes first
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
        position=_vec3(builder.shape_transform[shape]),
    )
