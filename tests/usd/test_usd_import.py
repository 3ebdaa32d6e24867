# SPDX-License-Identifier: Apache-2.0
"""USD import: values, units and axes, and what Newton alone would read otherwise."""

from __future__ import annotations

import json
import math
from pathlib import Path

import newton
import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdSemantics, UsdShade

from stripe_newton.usd import (
    StageError,
    asset_prim,
    inspect_stage,
    load_stage,
    read_lights,
    read_semantics,
)
from tests.helpers.usd_stages import add_body, add_joint, load, new_stage

PACKAGE = Path(newton.__file__).parent


def test_mass_is_density_times_volume():
    stage = new_stage()
    add_body(stage, "/World/a", mass=None)
    ball = UsdGeom.Sphere.Define(stage, "/World/ball")
    ball.CreateRadiusAttr(0.1)
    UsdPhysics.RigidBodyAPI.Apply(ball.GetPrim())
    UsdPhysics.CollisionAPI.Apply(ball.GetPrim())
    material = UsdShade.Material.Define(stage, "/World/steel")
    api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    api.CreateDensityAttr(7850.0)
    api.CreateDynamicFrictionAttr(0.4)
    api.CreateStaticFrictionAttr(0.7)
    api.CreateRestitutionAttr(0.25)
    binding = UsdShade.MaterialBindingAPI.Apply(ball.GetPrim())
    binding.Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
    _, report = load(stage)
    bodies = {b.path: b for b in report.bodies}
    mass = 7850.0 * 4.0 / 3.0 * math.pi * 0.1**3
    assert bodies["/World/ball"].mass == pytest.approx(mass, rel=1e-5)
    assert bodies["/World/ball"].inertia == pytest.approx([0.4 * mass * 0.01] * 3, rel=1e-5)
    assert bodies["/World/a"].mass == pytest.approx(1000.0 * 0.2**3, rel=1e-5)  # Newton's default density
    shape = next(s for s in report.shapes if s.path == "/World/ball")
    assert (shape.friction, shape.restitution, shape.density) == pytest.approx((0.4, 0.25, 7850.0))
    assert any(row[:2] == ("/World/steel", "staticFriction") for row in report.ignored)
    assert report.materials[0].static_friction == pytest.approx(0.7)


def arm(stage: Usd.Stage) -> UsdPhysics.RevoluteJoint:
    """A base fixed to the world with a link on a hinge, as an articulation."""
    UsdPhysics.ArticulationRootAPI.Apply(stage.GetPrimAtPath("/World"))
    add_body(stage, "/World/base")
    add_body(stage, "/World/link", (1, 0, 0))
    add_joint(stage, "/World/root", None, "/World/base", UsdPhysics.FixedJoint)
    hinge = add_joint(stage, "/World/hinge", "/World/base", "/World/link")
    hinge.CreateAxisAttr("Z")
    hinge.CreateLocalPos0Attr(Gf.Vec3f(1, 0, 0))
    return hinge


def test_limits_drives_and_initial_state_come_in_radians():
    stage = new_stage()
    hinge = arm(stage)
    hinge.CreateLowerLimitAttr(-45.0)
    hinge.CreateUpperLimitAttr(90.0)
    drive = UsdPhysics.DriveAPI.Apply(hinge.GetPrim(), "angular")
    drive.CreateStiffnessAttr(2.0)
    drive.CreateDampingAttr(0.5)
    drive.CreateMaxForceAttr(30.0)
    drive.CreateTargetPositionAttr(10.0)
    prim = hinge.GetPrim()
    prim.CreateAttribute("state:angular:physics:position", Sdf.ValueTypeNames.Float).Set(30.0)
    prim.CreateAttribute("physxJoint:armature", Sdf.ValueTypeNames.Float).Set(0.02)
    builder, report = load(stage)
    row = next(j for j in report.joints if j.path == "/World/hinge")
    assert (row.type, row.axis, row.parent, row.child) == ("revolute", (0, 0, 1), "/World/base", "/World/link")
    assert (row.lower, row.upper) == pytest.approx((-math.pi / 4, math.pi / 2), rel=1e-6)
    assert row.limits_deg == pytest.approx((-45.0, 90.0), rel=1e-6)
    assert row.stiffness == pytest.approx(2.0 * 180.0 / math.pi, rel=1e-6)
    assert row.damping == pytest.approx(0.5 * 180.0 / math.pi, rel=1e-6)
    assert row.max_force == pytest.approx(30.0)
    assert row.target == pytest.approx(math.radians(10.0))
    assert row.armature == pytest.approx(0.02)
    assert row.target_mode == "position"
    assert builder.joint_q[-1] == pytest.approx(math.radians(30.0))
    assert [(a.base, a.dofs, len(a.bodies)) for a in report.articulations] == [("fixed", 1, 2)]


def test_translations_of_a_d6_joint_begin_where_the_stage_says():
    stage = new_stage(0.01)
    for name in "ab":
        add_body(stage, f"/World/{name}")
    joint = add_joint(stage, "/World/slide", "/World/a", "/World/b", UsdPhysics.Joint).GetPrim()
    for axis in ("transX", "transZ", "rotY"):
        limit = UsdPhysics.LimitAPI.Apply(joint, axis)
        limit.CreateLowAttr(-30.0)
        limit.CreateHighAttr(30.0)
    for name, value in (
        ("transZ:physics:position", 20.0),
        ("transX:physics:velocity", 50.0),
        ("rotY:physics:position", 9.0),
    ):
        joint.CreateAttribute(f"state:{name}", Sdf.ValueTypeNames.Float).Set(value)
    builder, _ = load(stage)
    at, dof = builder.joint_q_start[-1], builder.joint_qd_start[-1]
    np.testing.assert_allclose(builder.joint_q[at : at + 3], (0.0, 0.2, np.radians(9.0)), atol=1e-6)
    np.testing.assert_allclose(builder.joint_qd[dof : dof + 3], (0.5, 0.0, 0.0), atol=1e-6)


def machine(metres: float, kilograms: float, y_up: bool) -> Usd.Stage:
    """The same cart, link and loose box in the units and with the up axis that are asked for."""
    stage = new_stage(metres, kilograms, "Y" if y_up else "Z")
    length, mass = 1.0 / metres, 1.0 / kilograms
    world = stage.GetPrimAtPath("/World")
    if y_up:
        UsdGeom.XformCommonAPI(world).SetRotate(Gf.Vec3f(-90, 0, 0))
    scene = UsdPhysics.Scene.Define(stage, "/World/scene")
    scene.CreateGravityMagnitudeAttr(9.0 * length)
    robot = UsdGeom.Xform.Define(stage, "/World/robot").GetPrim()
    UsdGeom.XformCommonAPI(robot).SetTranslate(Gf.Vec3d(0.5, 0.25, 2.0) * length)
    UsdPhysics.ArticulationRootAPI.Apply(robot)

    def body(path, at, weight=None, density=None):
        prim = UsdGeom.Xform.Define(stage, path).GetPrim()
        UsdGeom.XformCommonAPI(prim).SetTranslate(Gf.Vec3d(*at) * length)
        UsdPhysics.RigidBodyAPI.Apply(prim)
        api = UsdPhysics.MassAPI.Apply(prim)
        if weight:
            api.CreateMassAttr(weight * mass)
            api.CreateDiagonalInertiaAttr(Gf.Vec3f(0.1, 0.2, 0.15) * mass * length**2)
            api.CreateCenterOfMassAttr(Gf.Vec3f(0.01, 0.02, 0.03) * length)
        if density:
            api.CreateDensityAttr(density * mass / length**3)
        shape = UsdGeom.Capsule.Define(stage, f"{path}/shape")
        shape.CreateRadiusAttr(0.1 * length)
        shape.CreateHeightAttr(0.4 * length)
        UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
        return prim

    body("/World/robot/cart", (0, 0, 0), weight=3.0)
    body("/World/robot/link", (0, 0, 0.5), density=800.0)
    body("/World/loose", (-1, 0, 1), density=500.0)
    ball = UsdGeom.Sphere.Define(stage, "/World/ball")  # radius left to the schema: one stage unit
    UsdPhysics.CollisionAPI.Apply(ball.GetPrim())
    if metres != 1.0:
        ball.CreateRadiusAttr(length)
    UsdGeom.XformCommonAPI(ball.GetPrim()).SetTranslate(Gf.Vec3d(0, 3, -1) * length)
    rail = add_joint(stage, "/World/robot/rail", None, "/World/robot/cart", UsdPhysics.PrismaticJoint)
    rail.CreateAxisAttr("X")
    rail.CreateLocalPos0Attr(Gf.Vec3f(0, 0, 0))
    rail.CreateLowerLimitAttr(-2.0 * length)
    rail.CreateUpperLimitAttr(2.0 * length)
    drive = UsdPhysics.DriveAPI.Apply(rail.GetPrim(), "linear")
    drive.CreateStiffnessAttr(100.0 * mass)
    drive.CreateDampingAttr(10.0 * mass)
    drive.CreateMaxForceAttr(50.0 * mass * length)
    drive.CreateTargetPositionAttr(0.3 * length)
    hinge = add_joint(stage, "/World/robot/hinge", "/World/robot/cart", "/World/robot/link")
    hinge.CreateAxisAttr("Y")
    hinge.CreateLocalPos0Attr(Gf.Vec3f(0, 0, 0.25) * length)
    hinge.CreateLocalPos1Attr(Gf.Vec3f(0, 0, -0.25) * length)
    turn = UsdPhysics.DriveAPI.Apply(hinge.GetPrim(), "angular")
    turn.CreateStiffnessAttr(4.0 * mass * length**2)
    turn.CreateMaxForceAttr(7.0 * mass * length**2)
    return stage


UNIT_FREE = (
    *("body_mass", "body_inertia", "body_com", "joint_q", "joint_axis", "joint_limit_lower", "joint_limit_upper"),
    *("joint_target_ke", "joint_target_kd", "joint_target_q", "joint_effort_limit", "shape_scale", "gravity"),
)


@pytest.mark.parametrize(("metres", "kilograms", "y_up"), [(0.01, 1.0, True), (0.01, 0.001, True), (1.0, 1.0, True)])
def test_units_and_up_axis_make_no_difference(metres, kilograms, y_up):
    expected, _ = load(machine(1.0, 1.0, False))
    got, report = load(machine(metres, kilograms, y_up))
    for name in UNIT_FREE:
        a, b = (np.array(getattr(builder, name), dtype=float) for builder in (expected, got))
        np.testing.assert_allclose(b.reshape(a.shape), a, rtol=2e-4, atol=2e-5, err_msg=name)
    for name in ("body_q", "joint_X_p", "joint_X_c", "shape_transform"):
        for a, b in zip(getattr(expected, name), getattr(got, name), strict=True):
            a, b = np.array(a, dtype=float), np.array(b, dtype=float)
            np.testing.assert_allclose(b[:3], a[:3], atol=1e-5, err_msg=name)
            assert abs(a[3:] @ b[3:]) == pytest.approx(1.0, abs=1e-5), name
    assert expected.joint_label == got.joint_label
    assert np.array(got.gravity) == pytest.approx([0, 0, -9.0], abs=1e-5)
    assert report.units["meters_per_unit"] == pytest.approx(metres)
    assert any(row[1] == "units" for row in report.ignored) == (metres != 1.0 or kilograms != 1.0)


def test_default_sizes_are_stage_units():
    stage = new_stage(metres=0.01)
    sphere = UsdGeom.Sphere.Define(stage, "/World/ball")
    UsdPhysics.RigidBodyAPI.Apply(sphere.GetPrim())
    UsdPhysics.CollisionAPI.Apply(sphere.GetPrim())
    builder, report = load(stage)
    assert report.shapes[0].size == pytest.approx((0.01,))
    assert builder.body_mass[0] == pytest.approx(1000.0 * 4 / 3 * math.pi * 1e-6, rel=1e-4)


@pytest.mark.parametrize("metres", [1.0, 0.01])
def test_the_size_of_a_mesh_is_that_of_its_points(metres):
    stage = new_stage(metres=metres)
    cube = UsdGeom.Mesh.Define(stage, "/World/cube")
    points = [(x, 2.0 * y, 3.0 * z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    cube.CreatePointsAttr(points)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    cube.CreateFaceVertexIndicesAttr([i for quad in quads for i in quad])
    cube.CreateFaceVertexCountsAttr([4] * 6)
    cube.AddScaleOp().Set(Gf.Vec3f(2.0, -2.0, 2.0))
    UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
    _, report = load(stage)
    (size,) = (shape.size for shape in report.shapes)
    assert size == pytest.approx([metres, 2.0 * metres, 3.0 * metres])


def test_the_given_stage_is_not_changed():
    stage = new_stage(metres=0.01)
    add_body(stage, "/World/a")
    add_body(stage, "/World/b", (1, 0, 0))
    UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath("/World/b")).CreateRigidBodyEnabledAttr(False)
    add_joint(stage, "/World/j", "/World/a", "/World/b")
    before = stage.ExportToString(), stage.GetSessionLayer().ExportToString()
    load(stage)
    assert (stage.ExportToString(), stage.GetSessionLayer().ExportToString()) == before


# ---------------------------------------------------------------- what Newton would read otherwise


def test_a_disabled_body_is_static_geometry():
    stage = new_stage()
    add_body(stage, "/World/a", (0, 0, 1))
    off = add_body(stage, "/World/off", (0, 0, 0.5))
    UsdPhysics.RigidBodyAPI(off).CreateRigidBodyEnabledAttr(False)
    builder, report = load(stage)
    assert [b.path for b in report.bodies] == ["/World/a"]
    shape = builder.shape_label.index("/World/off/box")
    assert builder.shape_body[shape] == -1
    assert list(builder.shape_transform[shape])[:3] == pytest.approx([0, 0, 0.5])
    assert any(row[:2] == ("/World/off", "rigid body") for row in report.ignored)


def test_collision_group_that_filters_a_missing_group_still_collides():
    stage = new_stage()
    add_body(stage, "/World/a")
    add_body(stage, "/World/b", (0.1, 0, 0))
    group = UsdPhysics.CollisionGroup.Define(stage, "/World/group")
    group.GetCollidersCollectionAPI().CreateIncludesRel().SetTargets(["/World/a", "/World/b"])
    group.CreateFilteredGroupsRel().SetTargets(["/World/gone"])
    builder, report = load(stage)
    assert not builder.shape_collision_filter_pairs
    assert any(row[:2] == ("/World/group", "filteredGroups") for row in report.ignored)
    group.GetFilteredGroupsRel().SetTargets(["/World/group"])
    builder, report = load(stage)
    assert builder.shape_collision_filter_pairs
    assert any(row[:2] == ("/World/group", "collision group") for row in report.ignored)


def test_joints_without_articulation_become_one_and_loops_constraints():
    stage = new_stage()
    corners = {"a": (0, 0, 0), "b": (1, 0, 0), "c": (1, 0, 1), "d": (0, 0, 1)}
    for name, at in corners.items():
        add_body(stage, f"/World/{name}", at)
    for pair in ("ab", "bc", "cd", "da"):
        joint = add_joint(stage, f"/World/{pair}", f"/World/{pair[0]}", f"/World/{pair[1]}")
        joint.CreateAxisAttr("Y")
        joint.CreateLocalPos1Attr(Gf.Vec3f(*np.subtract(corners[pair[0]], corners[pair[1]]).tolist()))
    add_body(stage, "/World/door", (5, 0, 0))
    add_joint(stage, "/World/hinge", None, "/World/door")
    builder, report = load(stage)
    found = sorted((a.base, a.dofs, len(a.bodies)) for a in report.articulations)
    assert found == [("fixed", 1, 1), ("floating", 9, 4)]
    assert [j.path for j in report.joints if j.loop] == ["/World/da"]
    assert builder.articulation_start == sorted(builder.articulation_start)
    model = builder.finalize(device="cpu")
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    for label, pose in zip(builder.body_label, state.body_q.numpy(), strict=True):
        expected = corners.get(label[-1], (5, 0, 0)) if len(label) == 8 else (5, 0, 0)
        assert pose[:3] == pytest.approx(expected, abs=1e-5)


def test_joints_inside_an_instance(tmp_path):
    part = Usd.Stage.CreateNew(str(tmp_path / "part.usda"))
    part.SetDefaultPrim(UsdGeom.Xform.Define(part, "/World").GetPrim())
    add_body(part, "/World/a")
    add_body(part, "/World/b", (1, 0, 0))
    add_joint(part, "/World/j", "/World/a", "/World/b").CreateLocalPos0Attr(Gf.Vec3f(1, 0, 0))
    part.GetRootLayer().Save()
    stage = new_stage()
    for k in range(2):
        prim = UsdGeom.Xform.Define(stage, f"/World/i{k}").GetPrim()
        UsdGeom.XformCommonAPI(prim).SetTranslate(Gf.Vec3d(0, k, 0))
        prim.GetReferences().AddReference(str(tmp_path / "part.usda"))
        prim.SetInstanceable(True)
    builder, report = load(stage)
    assert [(a.base, a.dofs, len(a.bodies)) for a in report.articulations] == [("floating", 7, 2)] * 2
    assert [list(q)[1] for q in builder.body_q] == pytest.approx([0, 0, 1, 1])


def test_a_mirrored_mesh_is_baked():
    builder, _ = load(PACKAGE / "tests/assets/negative_scale_mesh_pair.usda")
    plain, mirrored = builder.shape_source
    assert all(s > 0 for scale in builder.shape_scale for s in scale)
    volume = []
    for mesh in (plain, mirrored):
        v, f = np.array(mesh.vertices), np.array(mesh.indices).reshape(-1, 3)
        volume.append(np.einsum("ij,ij->i", v[f[:, 0]], np.cross(v[f[:, 1]], v[f[:, 2]])).sum() / 6.0)
    assert volume == pytest.approx([1.0, 1.0], rel=1e-5)


def test_free_joints_hold_the_world_pose_of_their_body():
    builder, _ = load(machine(0.01, 1.0, True))
    for joint, kind in enumerate(builder.joint_type):
        if kind == newton.JointType.FREE:
            at, child = builder.joint_q_start[joint], builder.joint_child[joint]
            assert list(builder.joint_X_p[joint]) == pytest.approx([0, 0, 0, 0, 0, 0, 1])
            assert list(builder.joint_X_c[joint]) == pytest.approx([0, 0, 0, 0, 0, 0, 1])
            assert builder.joint_q[at : at + 7] == pytest.approx(list(builder.body_q[child]))


def test_reading_into_a_builder_that_holds_something_reports_only_what_is_new():
    builder = newton.ModelBuilder()
    load_stage(builder, machine(1.0, 1.0, False))
    stage = new_stage()
    add_body(stage, "/World/second")
    report = load_stage(builder, stage)
    assert [b.path for b in report.bodies] == ["/World/second"]
    assert len(report.joints) == len(report.articulations) == 1


# ---------------------------------------------------------------- assets, lights, labels, report


def test_asset_prim():
    cartpole = PACKAGE / "examples/assets/cartpole_single_pendulum.usda"
    assert asset_prim(cartpole) == "/cartpole"  # its defaultPrim says cartPole
    assert asset_prim(PACKAGE / "examples/assets/ant.usda") == "/ant"
    assert asset_prim(PACKAGE / "tests/assets/pendulum_revolute_vs_d6.usda") == "/Robot"
    assert asset_prim(cartpole, "/cartpole/cart") == "/cartpole/cart"
    with pytest.raises(StageError, match="no such prim; root prims: /cartpole"):
        asset_prim(cartpole, "/robot")
    stage = Usd.Stage.CreateInMemory()
    for name in ("A", "B"):
        add_body(stage, f"/{name}")
    with pytest.raises(StageError, match="name one of: /A, /B"):
        asset_prim(stage)
    UsdPhysics.ArticulationRootAPI.Apply(stage.GetPrimAtPath("/B"))
    assert asset_prim(stage) == "/B"


def test_lights_are_read_in_the_simulation_frame():
    stage = new_stage(up="Y")
    sun = UsdLux.DistantLight.Define(stage, "/World/sun")
    sun.CreateIntensityAttr(1000.0)
    sun.CreateExposureAttr(1.0)
    sun.CreateColorAttr(Gf.Vec3f(1.0, 0.5, 0.25))
    UsdGeom.XformCommonAPI(sun.GetPrim()).SetRotate(Gf.Vec3f(-90, 0, 0))  # from -Z to straight down, -Y
    sky = UsdLux.DomeLight.Define(stage, "/World/sky")
    sky.CreateEnableColorTemperatureAttr(True)
    sky.CreateColorTemperatureAttr(3000.0)
    UsdLux.SphereLight.Define(stage, "/World/bulb")
    first, second = read_lights(stage)
    assert (first.kind, first.intensity, first.color) == ("distant", 2000.0, (1.0, 0.5, 0.25))
    assert first.direction == pytest.approx((0, 0, -1), abs=1e-6)
    assert second.kind == "dome"
    assert second.color[0] > second.color[1] > second.color[2]  # 3000 K is warm
    _, report = load(stage)
    assert ("/World/bulb", "SphereLight", "only dome and distant lights are rendered") in report.ignored


@pytest.mark.parametrize(("intensity", "exposure"), [(1.0, 9e18), (1e10, 127.0), (float("nan"), 0.0)])
def test_lights_without_a_finite_brightness_are_ignored(intensity, exposure):
    stage = new_stage()
    sun = UsdLux.DistantLight.Define(stage, "/World/sun")
    sun.CreateIntensityAttr(intensity)
    sun.CreateExposureAttr(exposure)
    add_body(stage, "/World/a")
    assert read_lights(stage) == []
    _, report = load(stage)
    assert ("/World/sun", "DistantLight", "intensity and exposure give no finite brightness") in report.ignored


def test_semantics_old_and_new():
    stage = new_stage()
    body = add_body(stage, "/World/a")
    UsdSemantics.LabelsAPI.Apply(body, "category").CreateLabelsAttr(["tree", "pine"])
    body.CreateAttribute("semantic:Semantics:params:semanticType", Sdf.ValueTypeNames.String).Set("class")
    body.CreateAttribute("semantic:Semantics:params:semanticData", Sdf.ValueTypeNames.String).Set("tree")
    assert read_semantics(stage) == {"/World/a": {"category": ["tree", "pine"], "class": ["tree"]}}


def test_report_prints_within_the_page_and_is_json():
    report = inspect_stage(PACKAGE / "tests/assets/humanoid.usda")
    text = report.to_text()
    assert max(len(line) for line in text.splitlines()) <= 120
    assert "16 bodies, 27 degrees of freedom in 1 articulation" in text
    assert "authored pose" in text  # its joints start elsewhere
    data = json.loads(json.dumps(report.to_dict(), allow_nan=False))
    assert len(data["bodies"]) == 16
    assert sum(j["axis"] is not None for j in data["joints"]) == 21


def test_long_tables_are_folded():
    stage = new_stage()
    for k in range(60):
        add_body(stage, f"/World/body{k}", (k, 0, 0))
    text = load(stage)[1].to_text()
    assert "Bodies (60)" in text
    assert "... and 20 more" in text


def test_what_is_ignored_is_said():
    stage = new_stage()
    body = add_body(stage, "/World/a")
    UsdGeom.Camera.Define(stage, "/World/camera")
    UsdGeom.PointInstancer.Define(stage, "/World/grass")
    off = UsdGeom.Cube.Define(stage, "/World/off").GetPrim()
    UsdPhysics.CollisionAPI.Apply(off).CreateCollisionEnabledAttr(False)
    body.CreateAttribute("physxRigidBody:sleepThreshold", Sdf.ValueTypeNames.Float).Set(0.1)
    hinge = add_joint(stage, "/World/j", None, "/World/a")
    hinge.CreateBreakForceAttr(5.0)
    UsdPhysics.DriveAPI.Apply(hinge.GetPrim(), "angular").CreateTypeAttr("acceleration")
    ignored = {(path, what) for path, what, _ in load(stage)[1].ignored}
    assert ignored >= {
        ("/World/camera", "camera"),
        ("/World/grass", "point instancer"),
        ("/World/off", "collider"),
        ("/World/a", "physxRigidBody:sleepThreshold"),
        ("/World/j", "physics:breakForce"),
        ("/World/j", "acceleration drive"),
    }


def test_units_that_look_wrong_are_said(tmp_path):
    part = Usd.Stage.CreateNew(str(tmp_path / "part.usda"))
    UsdGeom.SetStageMetersPerUnit(part, 0.01)
    part.SetDefaultPrim(UsdGeom.Xform.Define(part, "/World").GetPrim())
    part.GetRootLayer().Save()
    stage = new_stage()
    add_body(stage, "/World/a")
    UsdGeom.Xform.Define(stage, "/World/part").GetPrim().GetReferences().AddReference(str(tmp_path / "part.usda"))
    UsdPhysics.Scene.Define(stage, "/World/scene").CreateGravityMagnitudeAttr(981.0)
    what = {row[1]: row[2] for row in load(stage)[1].ignored}
    assert "0.01 m a unit" in what["metersPerUnit"]
    assert "981 m/s^2" in what["gravityMagnitude"]
    # As Omniverse does where it references a file with other units.
    resolve = UsdGeom.Xform.Get(stage, "/World/part").AddScaleOp(UsdGeom.XformOp.PrecisionDouble, "unitsResolve")
    resolve.Set(Gf.Vec3d(0.01, 0.01, 0.01))
    assert "metersPerUnit" not in {row[1] for row in load(stage)[1].ignored}


def test_mesh_approximations_without_scipy(monkeypatch):
    monkeypatch.setattr("stripe_newton.usd.loading.can_approximate", lambda: False)
    builder, report = load(PACKAGE / "tests/assets/cube_cylinder.usda")
    assert builder.body_mass[0] > 0.0
    assert any(row[1].startswith("approximation ") for row in report.ignored)
