# SPDX-License-Identifier: Apache-2.0
"""Refused stages: each reason names the prim, and what would be right."""

from __future__ import annotations

import math

import pytest
from pxr import Gf, Sdf, UsdGeom, UsdPhysics

from stripe_newton.usd import StageError
from tests.helpers.usd_stages import add_body, add_joint, load, new_stage, refuse


def test_a_missing_file_a_folder_and_a_file_that_is_not_usd(tmp_path):
    refuse(tmp_path / "nowhere.usda", "", "there is no such file")
    refuse(tmp_path, "", "is a folder")
    broken = tmp_path / "broken.usda"
    broken.write_text("hello")
    refuse(broken, "", "is not a USD file")
    broken.write_text("#usda 1.0\nint a = (1,\n")
    refuse(broken, "", "line 2, column")
    with pytest.raises(StageError, match=r"syntax error|Expected") as caught:
        load(broken)
    assert "pxrInternal" not in str(caught.value)
    robot = tmp_path / "robot.urdf"
    robot.write_text('<robot name="r"><link name="base"/></robot>')
    refuse(robot, "", "USD has no format with the suffix '.urdf'; give a .usd")
    broken.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n")
    refuse(broken, "", "is a pointer of git LFS, not the file itself; fetch that with 'git lfs pull'")


def test_references_that_do_not_resolve_are_all_named(tmp_path):
    file = tmp_path / "scene.usda"
    file.write_text(
        '#usda 1.0\ndef Xform "A" (references = @gone.usda@) {}\ndef Xform "B" (payload = @lost.usda@) {}\n'
    )
    with pytest.raises(StageError, match=r"gone\.usda") as caught:
        load(file)
    assert "payload 'lost.usda' of prim /B is not there; add the file" in str(caught.value)
    assert str(file) in str(caught.value)


def test_a_missing_file_is_named_before_what_is_missing_from_it_and_only_the_first_of_many(tmp_path, capfd):
    prims = "".join(f'def Xform "P{k}" (references = </colliders/p{k}>) {{}}\n' for k in range(9))
    file = tmp_path / "scene.usda"
    file.write_text(f"#usda 1.0\n(subLayers = [@parts/gone.usda@])\n{prims}")
    with pytest.raises(StageError, match=r"usda: sublayer 'parts/gone\.usda' of 'scene\.usda' is not .*; and 7 more$"):
        load(file)
    assert capfd.readouterr().err == ""  # USD would print each of them, too


def test_prims_that_lead_back_to_themselves(tmp_path):
    file = tmp_path / "scene.usda"
    file.write_text('#usda 1.0\ndef "A" (references = </B>) {\n}\ndef "B" {\ndef "C" (inherits = </A>) {\n}\n}\n')
    with pytest.raises(StageError, match="which leads back to it; take that out") as caught:
        load(file)
    assert "cannot inherit from /A" in str(caught.value)
    assert "@" not in str(caught.value)


@pytest.mark.parametrize(
    ("asset", "reason"),
    [
        ("https://example.org/spot.usd", "spot.usd' of prim /A is on the web, which is not read; download it"),
        ("pointer.usd", "'pointer.usd' of prim /A is a pointer of git LFS, not the file itself"),
        ("words.usda", "'words.usda' of prim /A cannot be read: "),
        ("bare.usda", "reference of prim /A names no prim of 'bare.usda', which has no defaultPrim; set it"),
    ],
)
def test_why_a_reference_does_not_resolve(tmp_path, asset, reason):
    (tmp_path / "pointer.usd").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n")
    (tmp_path / "words.usda").write_text("hello")
    (tmp_path / "bare.usda").write_text('#usda 1.0\ndef Xform "B" {}\n')
    file = tmp_path / "scene.usda"
    file.write_text(f'#usda 1.0\ndef Xform "A" (references = @{asset}@) {{}}\n')
    refuse(file, "/A", reason)


def test_a_file_of_materialx_need_not_be_read(tmp_path):
    (tmp_path / "wood.mtlx").write_text('<?xml version="1.0"?><materialx version="1.38"/>')
    file = tmp_path / "scene.usda"
    file.write_text(
        '#usda 1.0\ndef Scope "Looks" (references = @wood.mtlx@) {}\n'
        'def Cube "box" (apiSchemas = ["PhysicsCollisionAPI"]) {}\n'
    )
    _, report = load(file)
    assert len(report.shapes) == 1
    assert [row[:2] for row in report.ignored] == [("/Looks", "reference to wood.mtlx")]


def test_a_reference_to_a_stage_whose_default_prim_is_missing(tmp_path):
    (tmp_path / "robot.usda").write_text('#usda 1.0\n(defaultPrim = "cartPole")\ndef Xform "cartpole" {}\n')
    file = tmp_path / "scene.usda"
    file.write_text('#usda 1.0\ndef Xform "A" (references = @robot.usda@) {}\n')
    refuse(file, "/A", "reference of prim /A names prim /cartPole, which is not in 'robot.usda'")


def test_nothing_to_simulate():
    refuse(new_stage(), "", "no rigid body and no collider", allow_static=False)
    stage = new_stage()
    UsdPhysics.CollisionAPI.Apply(UsdGeom.Cube.Define(stage, "/World/floor").GetPrim())
    refuse(stage, "", "only 1 static collider", allow_static=False)
    _, report = load(stage)
    assert [(s.type, s.body, s.collides) for s in report.shapes] == [("box", "", True)]


def test_root_path_that_does_not_exist():
    refuse(new_stage(), "/Robot", "no such prim", root_path="/Robot")


def test_deformables_are_refused_unless_ignored():
    stage = new_stage()
    add_body(stage, "/World/a")
    cloth = UsdGeom.Mesh.Define(stage, "/World/cloth").GetPrim()
    cloth.SetMetadata("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["PhysicsDeformableBodyAPI"]))
    refuse(stage, "/World/cloth", "rigid bodies")
    assert len(load(stage, ignore_paths=["/World/cloth"])[1].bodies) == 1


def test_distance_joint_is_refused_for_mujoco():
    stage = new_stage()
    add_body(stage, "/World/a")
    add_body(stage, "/World/b", (1, 0, 0))
    add_joint(stage, "/World/d", "/World/a", "/World/b", UsdPhysics.DistanceJoint)
    refuse(stage, "/World/d", "distance joint")


def test_body_without_mass_and_without_collider():
    stage = new_stage()
    add_body(stage, "/World/a", mass=None, collider=False)
    refuse(stage, "/World/a", "has no mass")


@pytest.mark.parametrize(
    ("attribute", "value", "words"),
    [
        ("physics:mass", -1.0, "physics:mass is -1"),
        ("physics:mass", math.inf, "physics:mass is infinite"),
        ("physics:mass", math.nan, "physics:mass is not a number"),
        ("physics:density", -5.0, "physics:density is -5"),
        ("physics:diagonalInertia", Gf.Vec3f(1, -1, 1), "diagonalInertia"),
        ("xformOp:translate", Gf.Vec3d(math.nan, 0, 0), "xformOp:translate is not a number"),
        ("xformOp:translate", Gf.Vec3d(math.inf, 0, 0), "xformOp:translate is infinite"),
    ],
)
def test_values_that_cannot_be(attribute, value, words):
    stage = new_stage()
    body = add_body(stage, "/World/a")
    UsdPhysics.MassAPI(body).CreateDensityAttr()
    UsdPhysics.MassAPI(body).CreateDiagonalInertiaAttr()
    body.GetAttribute(attribute).Set(value)
    refuse(stage, "/World/a", words)


@pytest.mark.parametrize("name", ["Stiffness", "Damping", "TargetPosition", "TargetVelocity"])
def test_drives_that_cannot_be(name):
    """Infinite gains and targets: the first step would leave no finite state. An infinite limit or effort is none."""
    stage = new_stage()
    for body in ("/World/a", "/World/b"):
        add_body(stage, body)
    joint = add_joint(stage, "/World/j", "/World/a", "/World/b")
    joint.CreateUpperLimitAttr(math.inf)
    drive = UsdPhysics.DriveAPI.Apply(joint.GetPrim(), "angular")
    drive.CreateMaxForceAttr(math.inf)
    load(stage)
    getattr(drive, f"Create{name}Attr")(math.inf)
    refuse(stage, "/World/j", f"drive:angular:physics:{name[0].lower()}{name[1:]} is infinite")


def test_velocities_and_gravities_that_cannot_be():
    stage = new_stage()
    body = UsdPhysics.RigidBodyAPI(add_body(stage, "/World/a"))
    scene = UsdPhysics.Scene.Define(stage, "/World/physics")
    scene.CreateGravityMagnitudeAttr(-math.inf)  # the Earth's, by the schema
    load(stage)
    scene.GetGravityMagnitudeAttr().Set(math.inf)
    refuse(stage, "/World/physics", "physics:gravityMagnitude is infinite")
    scene.GetGravityMagnitudeAttr().Set(9.81)
    body.CreateVelocityAttr(Gf.Vec3f(math.inf, 0, 0))
    refuse(stage, "/World/a", "physics:velocity is infinite")


def test_joints_that_join_nothing():
    stage = new_stage()
    add_body(stage, "/World/a")
    joint = add_joint(stage, "/World/j", "/World/a", "/World/gone")
    refuse(stage, "/World/j", "names /World/gone, which does not exist")
    joint.GetBody1Rel().SetTargets(["/World/a/box"])
    refuse(stage, "/World/j", "to itself")
    joint.GetBody0Rel().SetTargets([])
    joint.GetBody1Rel().SetTargets([])
    refuse(stage, "/World/j", "joins no rigid body")
    joint.CreateJointEnabledAttr(False)
    _, report = load(stage)
    assert ("/World/j", "joint", "jointEnabled is false") in report.ignored


def test_scales_that_cannot_be():
    stage = new_stage()
    body = add_body(stage, "/World/a")
    UsdGeom.XformCommonAPI(body).SetScale(Gf.Vec3f(1, 1, -1))
    refuse(stage, "/World/a", "mirroring scale")
    UsdGeom.XformCommonAPI(body).SetScale(Gf.Vec3f(1, 1, 0))
    refuse(stage, "/World/a", "scale is zero")


def test_mesh_collider_without_points():
    stage = new_stage()
    add_body(stage, "/World/a")
    UsdPhysics.CollisionAPI.Apply(UsdGeom.Mesh.Define(stage, "/World/a/mesh").GetPrim())
    refuse(stage, "/World/a/mesh", "without points")


def test_plane_on_a_body():
    stage = new_stage()
    add_body(stage, "/World/a")
    UsdPhysics.CollisionAPI.Apply(UsdGeom.Plane.Define(stage, "/World/a/plane").GetPrim())
    refuse(stage, "/World/a/plane", "plane on a rigid body")


def test_joints_against_the_tree_are_refused():
    stage = new_stage()
    for name, x in (("a", 0), ("b", 1), ("c", 2)):
        add_body(stage, f"/World/{name}", (x, 0, 0))
    add_joint(stage, "/World/ac", "/World/a", "/World/c")
    add_joint(stage, "/World/bc", "/World/b", "/World/c")
    refuse(stage, "/World/bc", "swap physics:body0 and physics:body1")
