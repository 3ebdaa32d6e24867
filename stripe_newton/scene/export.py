# SPDX-License-Identifier: Apache-2.0
"""Scene export: a built scene as a USD file that gives the same model again."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import newton
from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

from stripe_newton.sim import RigidBodyMaterialCfg
from stripe_newton.usd import StageReport, labelled_prim, schema_typed, to_si

from .export_joints import AuthoredJoints, export_joints
from .scene_contents import SceneContents

__all__ = ["export_stage"]


def export_stage(
    scene: SceneContents, path: Path, authored: AuthoredJoints | None, reports: Sequence[StageReport]
) -> None:
    """Write ``scene`` to ``path``; see :meth:`InteractiveScene.export`.

    Args:
        scene: The scene.
        path: File to write.
        authored: Joints of one environment as the stage gave them; None before the scene is built.
        reports: What the importer read of the stage.

    Raises:
        RuntimeError: the scene is not built.
        ValueError: an explicit actuator that USD has no way to express.
    """
    sim = scene.sim
    if not scene.built or authored is None:
        raise RuntimeError("the scene is not built: call 'scene.build()' before 'scene.export()'")
    if scene.scenery is not None and scene.scenery.stage.bodies:
        raise ValueError(
            f"the scenery {scene.scenery.stage.file} has rigid bodies, of which each environment has copies where the "
            "stage has them; USD cannot say that: export the scene without scenery"
        )
    stage = _editable_copy(scene.stage)
    if sim.actuation.draws_delays:
        warnings.warn("USD cannot say that a delay is drawn for each episode; the largest is written", stacklevel=3)
    # The builder of one environment holds what configs made of the stage: drives, limits, initial state.
    export_joints(stage, sim.template, authored, folder=path.parent)
    _author_free_roots(stage, sim.template, authored)
    if scene.terrain is not None:
        scene.terrain.author(stage)
    _author_default_material(stage, scene)
    _author_gravity(stage, scene, reports)
    path.parent.mkdir(parents=True, exist_ok=True)
    stage.GetRootLayer().Export(str(path))


def _editable_copy(stage: Usd.Stage) -> Usd.Stage:
    """A copy of a stage in one layer, in metres and kilograms, without instances.

    What is authored on it comes from the builder, in SI units: so the whole of it must be. The up axis stays.
    """
    copy = Usd.Stage.Open(to_si(schema_typed(stage)).Flatten())
    # Flattening keeps instances as references to prototypes, whose prims cannot be edited, and drives and materials are
    # authored on the prims themselves. Instances inside of instances show once the outer ones are none.
    while instances := [p for p in copy.Traverse() if p.IsInstance()]:
        for prim in instances:
            prim.SetInstanceable(False)
    copy = Usd.Stage.Open(copy.Flatten())
    # Flattening writes there which file of this machine it was made from.
    copy.GetRootLayer().documentation = stage.GetRootLayer().documentation
    return copy


def _to_stage(stage: Usd.Stage) -> Gf.Matrix4d:
    """The rotation from the simulation's frame, with Z up, to that of the stage; USD's matrices act on rows."""
    if UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.y:
        return Gf.Matrix4d(1.0)
    return Gf.Matrix4d(1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1)


def _author_free_roots(stage: Usd.Stage, builder: newton.ModelBuilder, authored: AuthoredJoints) -> None:
    """Put the root bodies of floating articulations, and all bodies below them, where the configs say."""
    for joint, kind in enumerate(builder.joint_type):
        label = builder.body_label[builder.joint_child[joint]]
        prim = labelled_prim(stage, label)
        start = builder.joint_q_start[joint]
        free = kind == newton.JointType.FREE and builder.joint_parent[joint] == -1
        if not prim or not free or not authored.moved(builder, start):
            continue
        x, y, z, qx, qy, qz, qw = builder.joint_q[start : start + 7]
        new = Gf.Matrix4d().SetTransform(Gf.Rotation(Gf.Quatd(qw, qx, qy, qz)), Gf.Vec3d(x, y, z)) * _to_stage(stage)
        old = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).RemoveScaleShear()
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
    materials: dict[bool, UsdShade.Material] = {}
    # The default material is a setting of the simulation and no prim: colliders would get that of whoever imports them.
    for prim in list(stage.Traverse()):
        bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
        # A material for rendering may be bound to all purposes: it says nothing about the physics.
        if not prim.HasAPI(UsdPhysics.CollisionAPI) or (bound and bound.GetPrim().HasAPI(UsdPhysics.MaterialAPI)):
            continue
        body = prim
        while body and not body.HasAPI(UsdPhysics.RigidBodyAPI):
            body = body.GetParent()
        dense = cfg.density is not None and bool(body) and not body.HasAPI(UsdPhysics.MassAPI)
        if dense not in materials:
            materials[dense] = _default_material(stage, cfg, dense)
        UsdShade.MaterialBindingAPI.Apply(prim)
        UsdShade.MaterialBindingAPI(prim).Bind(materials[dense], UsdShade.Tokens.weakerThanDescendants, "physics")


def _default_material(stage: Usd.Stage, cfg: RigidBodyMaterialCfg, dense: bool) -> UsdShade.Material:
    """Author the simulation's default material, with its density if ``dense``."""
    base = f"/World/{'defaultDensityMaterial' if dense else 'defaultPhysicsMaterial'}"
    path, number = base, 2
    while stage.GetPrimAtPath(path):  # of an earlier export, whose colliders keep it
        path, number = f"{base}_{number}", number + 1
    material = UsdShade.Material.Define(stage, path)
    api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    api.CreateStaticFrictionAttr(cfg.static_friction)
    api.CreateDynamicFrictionAttr(cfg.dynamic_friction)
    api.CreateRestitutionAttr(cfg.restitution)
    if dense:
        api.CreateDensityAttr(cfg.density)
    return material


def _author_gravity(stage: Usd.Stage, scene: SceneContents, reports: Sequence[StageReport]) -> None:
    gravity = Gf.Vec3d(*map(float, scene.sim.model.gravity.numpy()[0]))
    # Of several physics scenes Newton reads one.
    read = next((report.units for report in reports if report.units["scene"] is not None), None)
    # Without a scene it is that of the Earth.
    if Gf.Vec3f(gravity) == Gf.Vec3f(*(read["gravity"] if read is not None else (0.0, 0.0, -9.81))):
        return
    path = "/World/physicsScene" if read is None else read["scene"]
    physics = UsdPhysics.Scene.Define(stage, path)
    if gravity:
        down = _to_stage(stage).TransformDir(gravity.GetNormalized())
        physics.CreateGravityDirectionAttr(Gf.Vec3f(down))
        for name in ("newton:gravityEnabled", "mjc:flag:gravity"):
            if switch := physics.GetPrim().GetAttribute(name):
                switch.Set(True)
    physics.CreateGravityMagnitudeAttr(gravity.GetLength())
