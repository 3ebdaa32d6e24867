# SPDX-License-Identifier: Apache-2.0
"""Joints on static colliders: their frames are counted from the collider, as UsdPhysics says."""

from __future__ import annotations

import newton
import numpy as np
import pytest
from pxr import UsdGeom, UsdPhysics

from tests.helpers.usd_stages import load, usda

STAGE = """
def Cube "wall" (apiSchemas = ["PhysicsCollisionAPI"])
{
    double size = 1
    double3 xformOp:translate = (3, 0, 1)
    float xformOp:rotateZ = 90
    float3 xformOp:scale = (2, 0.2, 2)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ", "xformOp:scale"]
}
def Cube "door" (apiSchemas = ["PhysicsCollisionAPI", "PhysicsRigidBodyAPI"])
{
    double size = 1
    double3 xformOp:translate = (3, 1.5, 1)
    float xformOp:rotateZ = 90
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]
}
def PhysicsRevoluteJoint "hinge"
{
    rel physics:body0 = </wall>
    rel physics:body1 = </door>
    uniform token physics:axis = "Z"
    point3f physics:localPos0 = (0.5, 0, 0)
    point3f physics:localPos1 = (-0.5, 0, 0)
}
"""
SWAPPED = STAGE.replace("body0", "body2").replace("body1", "body0").replace("body2", "body1")
SWAPPED = SWAPPED.replace("(0.5, 0, 0)", "(9)").replace("(-0.5, 0, 0)", "(0.5, 0, 0)").replace("(9)", "(-0.5, 0, 0)")


@pytest.mark.parametrize("text", [STAGE, SWAPPED], ids=["wall to door", "door to wall"])
@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_a_door_on_a_wall_hangs_where_the_stage_has_it(text, unit):
    stage = usda(text)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    builder, report = load(stage)
    assert not [row for row in report.ignored if row[1] in ("authored pose", "warning of Newton")]
    model = builder.finalize(device="cpu")
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    np.testing.assert_allclose(state.body_q.numpy()[0, :3], np.array((3, 1.5, 1)) * unit, atol=1e-6)
    assert builder.joint_label == ["/hinge"]
    assert stage.GetPrimAtPath("/hinge").GetRelationship("physics:body0").GetTargets() != []  # the file's is unchanged


@pytest.mark.parametrize("collides", [False, True])
def test_door_and_wall_collide_if_the_joint_says_so(collides):
    stage = usda(STAGE)
    UsdPhysics.Joint(stage.GetPrimAtPath("/hinge")).CreateCollisionEnabledAttr(collides)
    builder, _ = load(stage)
    pairs = {frozenset(builder.shape_label[s] for s in pair) for pair in builder.shape_collision_filter_pairs}
    assert (frozenset(("/wall", "/door")) in pairs) is not collides
