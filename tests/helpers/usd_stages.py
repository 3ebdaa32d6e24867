# SPDX-License-Identifier: Apache-2.0
"""Stages in memory with bodies and joints, loaded or refused."""

from __future__ import annotations

from pathlib import Path

import newton
import pytest
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from stripe_newton.usd import (
    StageError,
    load_stage,
)


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
