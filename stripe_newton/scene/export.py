# SPDX-License-Identifier: Apache-2.0
"""Scene export: a built scene as a USD file that gives the same model again."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path

import newton
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from .export_actuators import actuator_dofs, author_actuator
from .scene_contents import SceneContents

__all__ = ["export_stage"]

_NO_LIMIT = 1.0e9
"""Efforts and speeds above this are unlimited; Newton writes 1e10 where a file gives none."""


def export_stage(scene: SceneContents, path: Path) -> None:
    """Write ``scene`` to ``path``; see :meth:`InteractiveScene.export`."""
    sim = scene.sim
    if not scene.built:
        raise RuntimeError("the scene is not built: call 'scene.build()' before 'scene.export()'")
    # Flattened for a file that refers to no other. Flattening keeps instances as references to prototypes, whose prims
    # cannot be edited, and drives and materials are authored on the prims themselves: so without instances, once more.
    stage = Usd.Stage.Open(scene.stage.Flatten())
    for prim in [p for p in stage.Traverse() if p.IsInstance()]:
        prim.SetInstanceable(False)
    stage = Usd.Stage.Open(stage.Flatten())
    # The builder of one environment holds what configs made of the stage: drives, limits, initial state.
    builder = sim.template
    starts = zip(builder.joint_label, builder.joint_type, builder.joint_q_start, builder.joint_qd_start, strict=True)
    explicit = actuator_dofs(builder)
    if sim.actuation.draws_delays:
        warnings.warn("USD cannot say that a delay is drawn for each episode; the largest is written", stacklevel=3)
    for (label, kind, coord, dof), dims in zip(starts, builder.joint_dof_dim, strict=True):
        prim = stage.GetPrimAtPath(label) if label.startswith("/") else None
        if prim and kind in (newton.JointType.REVOLUTE, newton.JointType.PRISMATIC, newton.JointType.D6):
            _author_joint(prim, builder, coord, dof, dims)
            for i in range(dof, dof + sum(dims)):
                if i in explicit:
                    author_actuator(prim, sum(dims) == 1, explicit[i], folder=path.parent)
    _author_free_roots(stage, builder)
    if scene.terrain is not None:
        scene.terrain.author(stage)
    _author_default_material(stage, scene)
    _author_physics_scene(stage, scene)
    path.parent.mkdir(parents=True, exist_ok=True)
    stage.GetRootLayer().Export(str(path))


def _author_joint(
    prim: Usd.Prim,
    builder: newton.ModelBuilder,
    coord: int,
    dof: int,
    dims: tuple[int, int],
) -> None:
    """Author drive, state and passive properties of a joint; UsdPhysics has angles in degrees."""
    linear, angular = dims
    single = linear + angular == 1
    for k in range(linear + angular):
        i, q = dof + k, coord + k
        degrees = 180.0 / math.pi if k >= linear else 1.0
        # The drive of a joint with one axis is named by the kind of joint, of one with several by the axis.
        axis = ("angular" if k >= linear else "linear") if single else _axis_token(builder.joint_axis[i], k >= linear)
        if builder.joint_target_mode[i] != newton.JointTargetMode.NONE:
            drive = UsdPhysics.DriveAPI.Apply(prim, axis)
            drive.CreateTypeAttr("force")
            drive.CreateStiffnessAttr(builder.joint_target_ke[i] / degrees)
            drive.CreateDampingAttr(builder.joint_target_kd[i] / degrees)
            drive.CreateTargetPositionAttr(builder.joint_target_q[q] * degrees)
            drive.CreateTargetVelocityAttr(builder.joint_target_qd[i] * degrees)
            if builder.joint_effort_limit[i] < _NO_LIMIT:
                drive.CreateMaxForceAttr(builder.joint_effort_limit[i])
        prim.CreateAttribute(f"state:{axis}:physics:position", Sdf.ValueTypeNames.Float).Set(
            builder.joint_q[q] * degrees
        )
        prim.CreateAttribute(f"state:{axis}:physics:velocity", Sdf.ValueTypeNames.Float).Set(
            builder.joint_qd[i] * degrees
        )
    # Newton's own schema has these for the joint as a whole.
    degrees = 180.0 / math.pi if angular else 1.0
    prim.AddAppliedSchema("NewtonJointAPI")
    for name, values, factor in (
        ("armature", builder.joint_armature, 1.0),
        ("friction", builder.joint_friction, 1.0),
        ("damping", builder.joint_damping, 1.0 / degrees),
        ("velocityLimit", builder.joint_velocity_limit, degrees),
    ):
        own = set(values[dof : dof + linear + angular])
        if len(own) > 1:
            warnings.warn(
                f"'{prim.GetPath()}': {name} differs between its axes, which USD cannot say; the first is written",
                stacklevel=4,
            )
        value = values[dof]
        if value < _NO_LIMIT:
            prim.CreateAttribute(f"newton:{name}", Sdf.ValueTypeNames.Float).Set(value * factor)


def _axis_token(axis: Sequence[float], angular: bool) -> str:
    """``rotX`` and so on, for an axis of a joint with several degrees of freedom."""
    largest = max(range(3), key=lambda k: abs(axis[k]))
    return ("rot" if angular else "trans") + "XYZ"[largest]


def _author_free_roots(stage: Usd.Stage, builder: newton.ModelBuilder) -> None:
    """Put the root bodies of floating articulations, and all bodies below them, where the configs say."""
    for joint, kind in enumerate(builder.joint_type):
        label = builder.body_label[builder.joint_child[joint]]
        prim = stage.GetPrimAtPath(label) if label.startswith("/") else None
        if kind != newton.JointType.FREE or builder.joint_parent[joint] != -1 or not prim:
            continue
        start = builder.joint_q_start[joint]
        x, y, z, qx, qy, qz, qw = builder.joint_q[start : start + 7]
        new = Gf.Matrix4d().SetTransform(Gf.Rotation(Gf.Quatd(qw, qx, qy, qz)), Gf.Vec3d(x, y, z))
        old = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).RemoveScaleShear()
        if Gf.IsClose(new, old, 1.0e-6):
            continue
        # USD's matrices act on rows: first back from the old pose, then on to the new one.
        moved = old.GetInverse() * new
        # Bodies lie side by side below the articulation or below each other: each is moved by itself, in the world.
        bodies = [p for p in stage.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)]
        family = builder.articulation_label[builder.joint_articulation[joint]]
        for body in bodies:
            if str(body.GetPath()).startswith((family + "/", label + "/")) or str(body.GetPath()) in (family, label):
                _move(body, moved)


def _move(prim: Usd.Prim, moved: Gf.Matrix4d) -> None:
    """Move a prim in the world frame; what its parent does to it stays."""
    xform = UsdGeom.Xformable(prim)
    world = xform.ComputeLocalToWorldTransform(Usd.TimeCode.Default()) * moved
    parent = xform.ComputeParentToWorldTransform(Usd.TimeCode.Default())
    # A suffix of its own, as an operation without one may exist with another type or precision.
    xform.ClearXformOpOrder()
    xform.AddTransformOp(UsdGeom.XformOp.PrecisionDouble, "start").Set(world * parent.GetInverse())


def _author_default_material(stage: Usd.Stage, scene: SceneContents) -> None:
    """Bind the simulation's default material to colliders that have none.

    Its density is for bodies without MassAPI alone, as it was when the scene was built: a body that has the API but no
    mass gets UsdPhysics' own default density.
    """
    cfg = scene.sim.cfg.physics_material
    materials = {}
    for name, density in (("defaultPhysicsMaterial", None), ("defaultDensityMaterial", cfg.density)):
        if name == "defaultDensityMaterial" and density is None:
            continue
        materials[density is not None] = material = UsdShade.Material.Define(stage, f"/World/{name}")
        api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
        api.CreateStaticFrictionAttr(cfg.static_friction)
        api.CreateDynamicFrictionAttr(cfg.dynamic_friction)
        api.CreateRestitutionAttr(cfg.restitution)
        if density is not None:
            api.CreateDensityAttr(density)
    # The default material is a setting of the simulation and no prim: colliders would get that of whoever imports them.
    for prim in stage.Traverse():
        bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
        if prim.HasAPI(UsdPhysics.CollisionAPI) and not bound:
            body = prim
            while body and not body.HasAPI(UsdPhysics.RigidBodyAPI):
                body = body.GetParent()
            dense = True in materials and bool(body) and not body.HasAPI(UsdPhysics.MassAPI)
            UsdShade.MaterialBindingAPI.Apply(prim)
            UsdShade.MaterialBindingAPI(prim).Bind(materials[dense], UsdShade.Tokens.weakerThanDescendants, "physics")


def _author_physics_scene(stage: Usd.Stage, scene: SceneContents) -> None:
    gravity = scene.sim.model.gravity.numpy()[0]
    magnitude = math.sqrt(float((gravity**2).sum()))
    found = next((p for p in stage.Traverse() if p.IsA(UsdPhysics.Scene)), None)
    physics = UsdPhysics.Scene(found) if found else UsdPhysics.Scene.Define(stage, "/World/physicsScene")
    down = [float(g) / magnitude for g in gravity] if magnitude else (0.0, 0.0, -1.0)
    physics.CreateGravityDirectionAttr(Gf.Vec3f(*down))
    physics.CreateGravityMagnitudeAttr(magnitude)
