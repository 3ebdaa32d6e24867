# SPDX-License-Identifier: Apache-2.0
"""Attribute checks: a value that would be read as something else is refused, converted with a row, or replaced."""

from __future__ import annotations

import pytest

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg
from stripe_newton.usd import StageError, load_stage
from tests.helpers.usd_stages import body_text, joint_text, load, refuse, usda

ANGULAR = "drive:angular:physics"


@pytest.mark.parametrize(
    ("prim", "text", "words"),
    [
        ("/A/shape", body_text(shape='string size = "0.2"'), "size is a string ('0.2'), its schema has double"),
        ("/A/shape", body_text(shape="double radius = -1", kind="Sphere"), "radius is -1; it must be a length above 0"),
        ("/A/shape", body_text(shape="double radius = inf", kind="Sphere"), "radius is infinite"),
        ("/A/shape", body_text(shape="double height = -1", kind="Capsule"), "height is -1"),
        ("/A/shape", body_text(shape='uniform token axis = "W"', kind="Cylinder"), "axis is 'W'; it must be X, Y or Z"),
        ("/A", body_text('string physics:mass = "3"'), "physics:mass is a string ('3')"),
        ("/A", body_text("float3 physics:diagonalInertia = (1, 1, 3e38)"), "it must be positive and at most 1e+30"),
        ("/A", body_text('string physics:rigidBodyEnabled = "no"'), "physics:rigidBodyEnabled is a string ('no')"),
        ("/A", body_text("quatf physics:principalAxes = (nan, 0, 0, 0)"), "physics:principalAxes is not a number"),
        ("/A", body_text('string xformOp:translate = "1"'), "xformOp:translate is a string ('1')"),
        ("/A", body_text("double3 xformOp:translate = (1e30, 0, 0)"), "within 1e+09 of the origin"),
        ("/A", body_text("double3 xformOp:scale = (3e38, 1, 1)"), "it must be finite and at most 1e+09"),
        ("/A", body_text("uniform int xformOpOrder = 1"), "xformOpOrder is an int (1), its schema has token[]"),
        (
            "/A/shape",
            body_text(
                'double3 xformOp:scale = (1e8, 1, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]',
                "double size = 1e8",
            ),
            "has a size of",
        ),
        ("/A", body_text("quatf xformOp:orient = (0, 0, 0, 0)"), "a finite quaternion other than 0"),
        ("/A", body_text('uniform token[] xformOpOrder = ["xformOp:no"]'), "Invalid xform opType token 'no'"),
        ("/A", body_text(schemas=', "PhysicsRigidBodyApi"'), "did you mean PhysicsRigidBodyAPI?"),
        ("/j", joint_text('uniform token physics:axis = "W"'), "physics:axis is 'W'"),
        ("/j", joint_text('string physics:lowerLimit = "-1"'), "physics:lowerLimit is a string"),
        ("/j", joint_text("float physics:lowerLimit = inf"), "it must be finite, or -inf for none"),
        ("/j", joint_text("float physics:upperLimit = -inf"), "it must be finite, or inf for none"),
        ("/j", joint_text("float physics:lowerLimit = 2\nfloat physics:upperLimit = 1"), "is above physics:upperLimit"),
        ("/j", joint_text("float physics:upperLimit = None"), "physics:upperLimit is blocked (None)"),
        ("/j", joint_text(f"float {ANGULAR}:stiffness = -5"), "stiffness is -5; it must be finite and 0 or more"),
        ("/j", joint_text(f"float {ANGULAR}:maxForce = -5"), "maxForce is -5; it must be 0 or more, or inf"),
        ("/j", joint_text(f'uniform token {ANGULAR}:type = "fast"'), "it must be force or acceleration"),
        ("/j", joint_text("float newton:armature = -1"), "newton:armature is -1"),
        ("/j", joint_text('string physxJoint:armature = "1"'), "physxJoint:armature is a string"),
        ("/j", joint_text("float3 limit:rotX:physics:low = (1, 2, 3)"), "limit:rotX:physics:low is a float3"),
        ("/j", joint_text("quatf physics:localRot0 = (0, 0, 0, 0)"), "a finite quaternion other than 0"),
        ("/j", joint_text(kind="DistancePhysicsJoint"), "did you mean PhysicsDistanceJoint?"),
        ("/j", joint_text(kind="PhysicsRevolutJoint"), "did you mean PhysicsRevoluteJoint?"),
        ("/s", body_text() + 'def PhysicsScene "s" { float physics:gravityMagnitude = -9.81 }', "is -9.81"),
        ("/s", body_text() + 'def PhysicsScene "s" { string physics:gravityMagnitude = "3" }', "is a string ('3')"),
        ("", body_text(), "metersPerUnit is 0; it must be positive, from 1e-09"),
    ],
)
def test_values_that_would_be_read_as_something_else_are_refused(prim, text, words):
    head = "metersPerUnit = 0" if words.startswith("metersPerUnit") else ""
    refuse(usda(text.replace(" }", "\n}").replace("{ ", "{\n"), head), prim, words)


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("metersPerUnit = -1", "metersPerUnit is -1"),
        ("metersPerUnit = nan", "metersPerUnit is nan"),
        ("kilogramsPerUnit = 0", "kilogramsPerUnit is 0"),
        ("kilogramsPerUnit = 3e38", "kilogramsPerUnit is 3e+38"),
        ('upAxis = "X"', "upAxis is X; it must be Y or Z"),
    ],
)
def test_units_and_axes_that_mean_nothing(head, words):
    refuse(usda(body_text(), head), "", words)


def material(attributes: str, schemas: str = '"PhysicsMaterialAPI"', fields: str = "", kind: str = "def") -> str:
    return f'{kind} Material "m" ({fields}\n prepend apiSchemas = [{schemas}])\n{{\n{attributes}\n}}\n'


@pytest.mark.parametrize(
    ("attribute", "words"),
    [
        ("float physics:dynamicFriction = nan", "dynamicFriction is not a number"),
        ("float physics:dynamicFriction = -1", "dynamicFriction is -1; it must be finite and 0 or more"),
        ('string physics:dynamicFriction = "1"', "dynamicFriction is a string"),
        ("float physics:density = -3", "density is -3"),
        ("float physics:restitution = inf", "restitution is infinite"),
    ],
)
def test_materials_that_cannot_be_are_refused_wherever_they_are(attribute, words):
    stage = usda(material(attribute) + 'def Xform "W"\n{' + body_text() + "\n}")
    refuse(stage, "/m", words)
    refuse(stage, "/m", words, root_path="/W")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "/m does not exist"),
        ('def Xform "m" {}\n', "/m is a Xform, no Material"),
        (material("", '"X"'), "/m has no PhysicsMaterialAPI"),
        (material("float physics:dynamicFriction = 0.2", fields="active = false"), "/m is not active"),
        (material("float physics:dynamicFriction = 0.2", kind="class"), "/m is a class or an over"),
    ],
)
def test_a_material_that_does_not_resolve_is_a_row(text, why):
    bodies = "".join(body_text(shape="rel material:binding:physics = </m>", name=f"b{k}") for k in range(20))
    # The same row each time: USD's parser visits prims in parallel.
    reports = [load(usda(text + bodies))[1] for _ in range(3)]
    assert [s.friction for s in reports[0].shapes] == [1.0] * 20
    for report in reports:
        row = next(row for row in report.ignored if row[1] == "physics material")
        assert row[0] == "/b0/shape (+19 more)"
        assert row[2] == f"{row[2].partition(':')[0]}: default friction and restitution are used"
        assert row[2].startswith(why)


def test_a_binding_without_its_schema_is_read():
    text = body_text(shape="rel material:binding:physics = </m>").replace(', "MaterialBindingAPI"', "")
    _, report = load(usda(material("float physics:dynamicFriction = 0.2") + text))
    assert report.shapes[0].friction == pytest.approx(0.2)
    assert ("/A/shape", "material binding", "MaterialBindingAPI is not applied: taken as if it were") in report.ignored


@pytest.mark.parametrize(
    ("attribute", "size"), [("float size = 0.25", 0.125), ("int size = 1", 0.5), ("half size = 0.5", 0.25)]
)
@pytest.mark.parametrize("metres", [1.0, 0.01])
def test_numbers_of_another_type_are_converted(attribute, size, metres):
    _, report = load(usda(body_text(shape=attribute), f'metersPerUnit = {metres}\nupAxis = "Z"'))
    assert report.shapes[0].size == pytest.approx((size * metres,) * 3)
    kind = attribute.split()[0]
    assert ("/A/shape", "size", f"is authored as {kind}, its schema has double: converted") in report.ignored


def test_doubles_of_joints_are_converted():
    text = f"double physics:lowerLimit = -1\ndouble physics:upperLimit = 2\ndouble {ANGULAR}:stiffness = 5"
    joint = next(j for j in load(usda(joint_text(text)))[1].joints if j.path == "/j")
    assert joint.limits_deg == pytest.approx((-1.0, 2.0))
    assert joint.stiffness == pytest.approx(5.0 * 57.29578)


def test_an_export_of_numbers_of_another_type_is_the_same(tmp_path):
    head = 'metersPerUnit = 0.01\nupAxis = "Z"'
    scene = InteractiveScene.from_usd(usda(body_text(shape="int size = 20"), head), sim_cfg=SimulationCfg(gravity=None))
    scene.export(tmp_path / "scene.usda")
    again = InteractiveScene.from_usd(tmp_path / "scene.usda", sim_cfg=SimulationCfg(gravity=None))
    assert float(again.sim.model.body_mass.numpy()[0]) == float(scene.sim.model.body_mass.numpy()[0])


@pytest.mark.parametrize(
    ("text", "row"),
    [
        (
            'def PhysicsScene "s" {}\ndef PhysicsScene "t" {}\n' + body_text(),
            ("/t", "PhysicsScene", "a stage has one; /s is used"),
        ),
        (
            body_text("float physics:mass = 3\nfloat3 physics:diagonalInertia = (1, 1, 5)"),
            (
                "/A",
                "inertia",
                "1 1 5 kg m^2 is of no body, as two must not add up to less than the third: 4 4 8 is used",
            ),
        ),
        (
            body_text('uniform token[] xformOpOrder = ["xformOp:translate"]'),
            ("/A", "xformOpOrder", "xformOp:translate is not authored: left out"),
        ),
        (
            body_text("float physics:lowerLimit = 3"),
            ("/A", "physics:lowerLimit", "not read: no schema of the prim has it"),
        ),
        ('def OmniThing "o" {}\n' + body_text(), ("/o", "type OmniThing", "USD does not know it")),
    ],
)
def test_what_is_left_out_or_corrected_is_a_row(text, row):
    assert row in load(usda(text))[1].ignored


def test_an_inertia_that_newton_corrects_is_the_one_of_the_model():
    text = body_text("float physics:mass = 3\nfloat3 physics:diagonalInertia = (1, 1, 5)")
    builder, report = load(usda(text))
    assert report.bodies[0].inertia == pytest.approx((4.0, 4.0, 8.0), rel=1e-4)
    assert builder.finalize(device="cpu").body_inertia.numpy()[0].diagonal() == pytest.approx((4, 4, 8), rel=1e-4)


def test_rows_are_shown_once_on_import():
    stage = usda(body_text("float physics:lowerLimit = 3"))
    with pytest.warns(UserWarning, match="1 thing left out, converted or replaced") as caught:
        InteractiveScene.from_usd(stage, sim_cfg=SimulationCfg(gravity=None))
    assert "/A: physics:lowerLimit: not read" in str(caught[0].message)
    assert len([w for w in caught if "left out" in str(w.message)]) == 1


def test_what_newton_raises_is_one_error(monkeypatch):
    import newton

    def fail(self, *args, **kwargs):
        raise IndexError("of no use at /A/shape")

    monkeypatch.setattr(newton.ModelBuilder, "add_usd", fail)
    with pytest.raises(StageError, match="/A/shape: Newton does not read it: IndexError"):
        load_stage(newton.ModelBuilder(), usda(body_text()))


def test_a_drive_without_effort_is_next_to_none():
    drive = f"float {ANGULAR}:stiffness = 5\nfloat {ANGULAR}:maxForce = 0"
    builder, _ = load(usda(joint_text(drive).replace(" }", "\n}").replace("{ ", "{\n")))
    assert 0.0 < max(builder.joint_effort_limit[-1:]) < 1e-4
