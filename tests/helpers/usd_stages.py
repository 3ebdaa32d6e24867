# SPDX-License-Identifier: Apache-2.0
"""Stages in memory with bodies and joints, loaded or refused."""

from __future__ import annotations

from pathlib import Path

import newton
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from stripe_newton.usd import StageError, load_stage


def new_stage(metres: float = 1.0, kilograms: float | None = None, up: str = "Z") -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    UsdGeom.SetStageUpAxis(stage, up)
    if kilograms is not None:
        UsdPhysics.SetStageKilogramsPerUnit(stage, kilograms)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    return stage


def add_body(stage: Usd.Stage, path: str, at: tuple = (0, 0, 0), mass: float | None = 1.0, collider=True) -> Usd.Prim:
    prim = UsdGeom.Xform.Define(stage, path).GetPrim()
    UsdGeom.XformCommonAPI(prim).SetTranslate(Gf.Vec3d(*at))
    UsdPhysics.RigidBodyAPI.Apply(prim)
    if mass is not None:
        UsdPhysics.MassAPI.Apply(prim).CreateMassAttr(mass)
    if collider:
        cube = UsdGeom.Cube.Define(stage, f"{path}/box")
        cube.CreateSizeAttr(0.2)
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    return prim


def add_joint(stage: Usd.Stage, path: str, body0: str | None, body1: str | None, kind=UsdPhysics.RevoluteJoint):
    joint = kind.Define(stage, path)
    if body0:
        joint.CreateBody0Rel().SetTargets([body0])
    if body1:
        joint.CreateBody1Rel().SetTargets([body1])
    return joint


def load(stage: Usd.Stage | str | Path, **kwargs):
    builder = newton.ModelBuilder()
    return builder, load_stage(builder, stage, **kwargs)


def refuse(stage: Usd.Stage | str | Path, prim: str, words: str, **kwargs):
    with pytest.raises(StageError) as caught:
        load(stage, **kwargs)
    assert caught.value.prim == prim
    assert words in str(caught.value)


def usda(text: str, head: str = "") -> Usd.Stage:
    """A stage in memory from the text of its prims, in metres and with Z up unless ``head`` says otherwise."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.ImportFromString("#usda 1.0\n(\n" + (head or 'upAxis = "Z"') + "\n)\n" + text)
    return Usd.Stage.Open(layer)


def body_text(attributes: str = "", shape: str = "", kind: str = "Cube", name: str = "A", schemas: str = "") -> str:
    """Text of a rigid body with one collider, with more attributes and schemas."""
    return f"""
def Xform "{name}" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"{schemas}])
{{
    {attributes}
    def {kind} "shape" (prepend apiSchemas = ["PhysicsCollisionAPI", "MaterialBindingAPI"])
    {{
        {shape}
    }}
}}
"""


def joint_text(attributes: str = "", kind: str = "PhysicsRevoluteJoint") -> str:
    """Text of two bodies ``/A`` and ``/B``, and the joint ``/j`` between them with a drive."""
    return f"""{body_text()}{body_text(name="B")}
def {kind} "j" (prepend apiSchemas = ["PhysicsDriveAPI:angular"])
{{
    rel physics:body0 = </A>
    rel physics:body1 = </B>
    {attributes}
}}
"""
