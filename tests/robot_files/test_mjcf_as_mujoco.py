# SPDX-License-Identifier: Apache-2.0
"""MJCF files are read as MuJoCo's compiler reads them, or a row says what is not."""

from __future__ import annotations

from pathlib import Path

import mujoco
import newton
import numpy as np
import pytest
from PIL import Image

from stripe_newton.robot_files import RobotFileError, inspect_robot_file
from stripe_newton.robot_files.importing import import_robot_file
from stripe_newton.sim.connect_anchors import ConnectAnchors

INERTIAL = '<inertial pos="0.1 0 0" mass="2" diaginertia=".02 .03 .04"/>'


def imported(
    folder: Path, bodies: str, rest: str = "", **options: object
) -> tuple[newton.ModelBuilder, mujoco.MjModel, dict[str, str]]:
    """Builder, MuJoCo's model, and what the rows say by element."""
    path = folder / "robot.xml"
    path.write_text(f"<mujoco>{rest}<worldbody>{bodies}</worldbody></mujoco>")
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    report = import_robot_file(builder, "mjcf", path, options)
    return (
        builder,
        mujoco.MjModel.from_xml_path(str(path)),
        {where: f"{what}: {why}" for where, what, why in report.ignored},
    )


def places(builder: newton.ModelBuilder, coordinates: list[float]) -> np.ndarray:
    """Positions of the bodies at some coordinates, shape ``(bodies, 3)``."""
    builder.joint_q[:] = coordinates
    model = builder.finalize(device="cpu")
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    return state.body_q.numpy()[:, :3]


def test_a_hinge_turns_about_its_own_anchor_whatever_that_of_the_slide_before_it(tmp_path):
    """As in the planar robots of Gymnasium, whose slides have a ``pos`` that means nothing."""
    joints = (
        '<joint name="x" type="slide" axis="1 0 0" pos="0 0 -1.25"/>'
        '<joint name="z" type="slide" axis="0 0 1" pos="0 0 -1.25" ref="1.25"/>'
        '<joint name="turn" axis="0 1 0" pos="0 0 0.1"/>'
    )
    tip = f'<body name="tip" pos="0 0 0.5"><joint name="bend" axis="0 1 0"/>{INERTIAL}</body>'
    builder, model, rows = imported(tmp_path, f'<body name="torso" pos="0 0 1.25">{joints}{INERTIAL}{tip}</body>')
    coordinates = [0.3, 1.5, 0.8, -0.4]
    data = mujoco.MjData(model)
    data.qpos[:] = coordinates
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(places(builder, coordinates), data.xpos[1:], atol=1e-6)
    assert not [row for row in rows.values() if row.startswith("motion")]


@pytest.mark.parametrize(
    "joints",
    [
        '<joint name="a" axis="0 1 0" pos="0 0 0.08"/><joint name="b" axis="1 0 0" pos="0 0 0.04"/>',
        '<joint name="a" axis="0 1 0"/><joint name="b" type="slide" axis="1 0 0"/>',
    ],
)
def test_joints_that_move_a_body_otherwise_have_a_row(tmp_path, joints):
    _, _, rows = imported(tmp_path, f'<body name="foot">{joints}{INERTIAL}</body>')
    (row,) = [text for where, text in rows.items() if text.startswith("motion")]
    assert "MuJoCo moves its body otherwise" in row


def test_masses_are_those_of_the_compiler(tmp_path):
    body = '<body name="a"><freejoint/><geom type="sphere" size="0.1" mass="2"/></body>'
    for compiler in ('<compiler settotalmass="7"/>', '<compiler boundmass="3" boundinertia="0.5"/>'):
        builder, model, rows = imported(tmp_path, body, compiler)
        assert builder.body_mass[0] == pytest.approx(model.body_mass[1])
        np.testing.assert_allclose(np.diag(np.array(builder.body_inertia[0]).reshape(3, 3)), model.body_inertia[1])
        assert not any(text.startswith(("mass", "inertia")) for text in rows.values())


def test_the_inertia_of_a_marker_of_a_milligram_stays(tmp_path):
    body = '<body name="a"><freejoint/><inertial pos="0 0 0" mass="1e-6" diaginertia="1e-12 1e-12 1e-12"/></body>'
    builder, _, _ = imported(tmp_path, body)
    np.testing.assert_allclose(np.diag(builder.finalize(device="cpu").body_inertia.numpy()[0]), 1e-12, rtol=1e-5)


def test_an_inertia_of_no_body_has_one_row_and_is_balanced(tmp_path):
    inertia = '<inertia ixx="1" iyy="1" izz="3" ixy="0" ixz="0" iyz="0"/>'
    body = f'<link name="a"><inertial><mass value="1"/>{inertia}</inertial></link>'
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{body}</robot>')
    report = inspect_robot_file(path)
    (row,) = [row for row in report.ignored if row[1] == "inertia"]
    assert row[0] == "a"
    assert "two must not add up to less than the third" in row[2]
    low, middle, high = sorted(report.bodies[0].inertia)
    assert low + middle >= high * (1 - 1e-5)


def test_defaults_of_a_named_outermost_class_hold_for_all(tmp_path):
    rest = '<default class="main"><geom friction="0.7" type="box"/><joint damping="3"/></default>'
    body = f'<body name="a"><joint name="j"/>{INERTIAL}<geom size="0.1 0.1 0.1"/></body>'
    builder, _, _ = imported(tmp_path, body, rest)
    assert builder.joint_damping[0] == pytest.approx(3.0)
    assert builder.shape_material_mu[0] == pytest.approx(0.7)
    assert builder.shape_type[0] == newton.GeoType.BOX


@pytest.mark.parametrize("condim", [None, 1, 3])
def test_contacts_of_another_dimension_than_the_file_says(tmp_path, condim):
    rest = '<default><default class="foot"><geom condim="6"/></default></default>'
    geoms = '<geom size="0.1" class="foot"/><geom size="0.1" condim="4"/><geom size="0.1"/>'
    builder, model, rows = imported(
        tmp_path, f'<body name="a"><freejoint/>{INERTIAL}{geoms}</body>', rest, condim=condim
    )
    compiled = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu")).mj_model
    assert model.geom_condim.tolist() == [6, 4, 3]
    assert compiled.geom_condim.tolist() == ([condim] * 3 if condim else [6, 4, 3])
    assert rows.keys() == {"option"}


@pytest.mark.parametrize("solimp", [None, (0.8, 0.9, 0.01, 0.4, 3.0)])
def test_contacts_of_another_impedance_than_the_file_says(tmp_path, solimp):
    rest = '<default><default class="foot"><geom solimp="0.015 1 0.031"/></default></default>'
    geoms = '<geom size="0.1" class="foot"/><geom size="0.1" solimp="0.5 0.6 0.02"/><geom size="0.1"/>'
    body = f'<body name="a"><freejoint/>{INERTIAL}{geoms}</body>'
    builder, model, _ = imported(tmp_path, body, rest, solimp=solimp)
    compiled = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu")).mj_model
    expected = model.geom_solimp if solimp is None else [solimp] * 3
    np.testing.assert_allclose(compiled.geom_solimp, expected, rtol=1e-6)


def test_joints_that_a_tendon_loses_have_a_row(tmp_path):
    joints = '<joint name="a" axis="0 1 0"/><joint name="b" axis="1 0 0"/>'
    body = f'<body name="x">{joints}{INERTIAL}<body name="y"><joint name="c"/>{INERTIAL}</body></body>'
    rest = '<tendon><fixed name="t"><joint joint="a" coef="1"/><joint joint="c" coef="1"/></fixed></tendon>'
    _, _, rows = imported(tmp_path, body, rest)
    assert rows["t"].startswith("tendon: a of the tendon left out")


def test_a_collision_with_a_fixed_parent_has_a_row(tmp_path):
    geom = '<geom size="0.1"/>'
    body = f'<body name="base">{geom}<body name="link"><joint name="a" axis="0 1 0"/>{geom}{INERTIAL}</body></body>'
    _, _, rows = imported(tmp_path, body)
    assert "not with its parent 'base'" in rows["link"]


@pytest.mark.parametrize("joint", ["axis='0 1e30 0'", "damping='1e20'"])
def test_numbers_beyond_single_precision_are_refused(tmp_path, joint):
    with pytest.raises(RobotFileError, match=r"<joint> 'a': .* must be at most 1e\+15"):
        imported(tmp_path, f'<body name="x"><joint name="a" {joint}/>{INERTIAL}</body>')


def test_a_urdf_drive_without_effort_does_nothing(tmp_path):
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    links = "".join(f'<link name="{n}"><inertial><mass value="1"/>{inertia}</inertial></link>' for n in "ab")
    joint = (
        '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><limit effort="0" velocity="1"/></joint>'
    )
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{links}{joint}</robot>')
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    report = import_robot_file(builder, "urdf", path, {"floating": False})
    assert ("j", "effort limit 0") in {(where, what) for where, what, _ in report.ignored}
    solver = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu"))  # MuJoCo refuses ranges without a width
    assert abs(solver.mj_model.jnt_actfrcrange[0]).max() < 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_an_inertia_at_the_limit_is_taken_whatever_its_axes(tmp_path, seed):
    """A plate: two moments add up to the third, and rounding puts every other one beyond."""
    quat = np.random.default_rng(seed).normal(size=4)
    moments = '<inertial pos="0 0 0" mass="2" diaginertia="0.2 0.1 0.3" quat="{:g} {:g} {:g} {:g}"/>'.format(*quat)
    builder, model, rows = imported(tmp_path, f'<body name="a"><freejoint/>{moments}<geom size="0.1"/></body>')
    compiled = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu")).mj_model
    np.testing.assert_allclose(np.sort(compiled.body_inertia[1]), np.sort(model.body_inertia[1]), rtol=3e-5)
    assert ("a", "inertia") not in rows


def test_a_joint_with_an_empty_range_has_no_limits(tmp_path):
    tip = f'<body name="b"><joint name="k" range="-9 9"/>{INERTIAL}</body>'
    builder, model, rows = imported(tmp_path, f'<body name="a"><joint name="j" range="30 30"/>{INERTIAL}{tip}</body>')
    compiled = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu")).mj_model
    assert model.jnt_limited.tolist() == compiled.jnt_limited.tolist() == [False, True]
    assert rows.keys() == {"option"}


def test_a_plane_on_a_body_that_stands_still_is_one_of_the_world(tmp_path):
    plane = '<geom name="floor" type="plane" size="0 0 1" pos="0 0 0.5"/>'
    turned = '<body name="stand" pos="0 0 1" euler="90 0 0">{}<body name="a"><freejoint/>{}</body></body>'
    builder, _, rows = imported(tmp_path, turned.replace("<freejoint/>", '<joint name="j"/>').format(plane, INERTIAL))
    compiled = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu")).mj_model
    np.testing.assert_allclose(compiled.geom_pos[0], (0.0, -0.5, 1.0), atol=1e-6)
    assert rows["floor"] == "plane: of the world, as its body 'stand' stands still"


def test_the_folder_of_meshes_is_that_of_the_file_for_what_it_includes_too(tmp_path):
    """As in the kitchen of Gymnasium-Robotics."""
    corners = "0 0 0 1 0 0 0 1 0 0 0 1"
    points = np.array(corners.split(), dtype=float).reshape(4, 3)
    for folder in ("parts", "parts/stl"):
        (tmp_path / folder).mkdir()
    text = "".join("v {:g} {:g} {:g}\n".format(*p) for p in points) + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "parts/stl/wedge.obj").write_text(text)
    part = '<compiler meshdir="nowhere"/><asset><mesh name="wedge" file="wedge.obj"/></asset>'
    (tmp_path / "parts/assets.xml").write_text(f"<mujocoinclude>{part}</mujocoinclude>")
    head = '<include file="parts/assets.xml"/><compiler meshdir="parts/stl"/>'
    body = '<body name="a"><freejoint/><geom type="mesh" mesh="wedge"/></body>'
    builder, model, _ = imported(tmp_path, body, head)
    assert builder.body_mass[0] == pytest.approx(model.body_mass[1], rel=1e-5)


@pytest.mark.parametrize("servo", ['position kp="3" kv="0.5"', 'velocity kv="2"'])
def test_the_gear_of_a_servo_is_in_the_gains_of_its_drive(tmp_path, servo):
    rest = f'<actuator><{servo} joint="j" gear="10" ctrlrange="-4 5"/></actuator>'
    builder, theirs, _ = imported(tmp_path, f'<body name="a"><joint name="j" axis="0 1 0"/>{INERTIAL}</body>', rest)
    ours = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu")).mj_model
    accelerations = []
    for model, control in ((ours, 0.4), (theirs, 4.0)):  # a position of the joint, and of the motor before the gear
        model.opt.gravity[:] = 0.0
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0], data.ctrl[0] = 0.3, -0.7, control
        mujoco.mj_forward(model, data)
        accelerations.append(data.qacc[0])
    assert accelerations[0] == pytest.approx(accelerations[1], rel=1e-5)
    np.testing.assert_allclose(ours.actuator_ctrlrange[0] * 10, theirs.actuator_ctrlrange[0], rtol=1e-6)


@pytest.mark.parametrize("kind", ["connect", "weld"])
def test_sites_that_are_apart_are_pulled_together(tmp_path, kind):
    site = '<site name="{}" pos="{}" euler="{}"/>'
    bodies = "".join(
        f'<body name="{name}" pos="{pos}"><freejoint/>{INERTIAL}{site.format(*own)}</body>'
        for name, pos, own in (("a", "0 0 1", ("s", ".5 0 0", "0 0 30")), ("b", "1 0 1", ("t", "-.2 .1 0", "20 0 0")))
    )
    builder, theirs, rows = imported(tmp_path, bodies, f'<equality><{kind} site1="s" site2="t"/></equality>')
    model = builder.finalize(device="cpu")
    solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True)
    ConnectAnchors(solver)
    assert rows.keys() == {"option"}
    places = []
    for mj in (solver.mj_model, theirs):
        mj.opt.gravity[:] = 0.0
        mj.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        data = mujoco.MjData(mj)
        mujoco.mj_step(mj, data, 300)
        places.append(data.xpos[1:3].copy())
    np.testing.assert_allclose(places[0], places[1], atol=2e-3)


@pytest.mark.parametrize("kind", ["connect", "weld"])
@pytest.mark.parametrize("order", ["st", "ts"])
def test_a_body_is_pulled_to_a_site_of_the_world(tmp_path, kind, order):
    site = '<site name="s" pos=".2 .1 0" euler="0 0 30"/>'
    body = f'<body name="a" pos="0 0 1" euler="0 10 0"><freejoint/>{INERTIAL}{site}</body>'
    world = '<site name="t" pos="0 0.3 1.2" euler="0 0 10"/>'
    tie = f'<equality><{kind} site1="{order[0]}" site2="{order[1]}"/></equality>'
    builder, theirs, rows = imported(tmp_path, world + body, tie)
    solver = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu"), use_mujoco_cpu=True)
    ConnectAnchors(solver)
    assert "equality 0" not in rows
    places = []
    for mj in (solver.mj_model, theirs):
        mj.opt.gravity[:] = 0.0
        mj.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        data = mujoco.MjData(mj)
        mujoco.mj_step(mj, data, 300)
        places.append(np.concatenate([data.xpos[1], data.xmat[1]]))
    np.testing.assert_allclose(places[0], places[1], atol=2e-3)


@pytest.mark.parametrize("kind", ["connect", "weld"])
@pytest.mark.parametrize("excluded", [False, True])
def test_tied_bodies_collide_as_in_mujoco(tmp_path, kind, excluded):
    body = '<body name="{}" pos="{} 0 0"><freejoint/><geom size="0.1"/></body>'
    tie = f'<equality><{kind} body1="a" body2="b" anchor="0.1 0 0"/></equality>'
    exclude = '<contact><exclude body1="a" body2="b"/></contact>' if excluded else ""
    builder, theirs, _ = imported(tmp_path, body.format("a", 0) + body.format("b", 0.15), tie + exclude)
    ours = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu"), use_mujoco_cpu=True).mj_model
    contacts = []
    for model in (ours, theirs):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        contacts.append(int(data.ncon))
    assert contacts[0] == contacts[1] == int(not excluded)


@pytest.mark.parametrize(("kind", "factor"), [("png", 1), ("png", 250), ("bin", 1)])
def test_a_height_field_has_the_heights_of_its_file(kind: str, factor: int, tmp_path: Path) -> None:
    heights = np.random.default_rng(0).integers(0, 255, (5, 7)).astype(np.uint8)
    if factor > 1:  # a picture of 16 bits
        heights = heights.astype(np.uint16) * factor
    if kind != "bin":
        Image.fromarray(heights).save(tmp_path / f"hills.{kind}")
    else:
        data = heights.astype(np.float32).tobytes()
        (tmp_path / "hills.bin").write_bytes(np.array(heights.shape, dtype=np.int32).tobytes() + data)
    rest = f'<asset><hfield file="hills.{kind}" size="2 3 1 0.1"/></asset>'
    bodies = '<geom type="hfield" hfield="hills"/><body pos="0 0 3"><freejoint/><geom size="0.1"/></body>'
    builder, theirs, _ = imported(tmp_path, bodies, rest, ignore_names=())
    ours = newton.solvers.SolverMuJoCo(builder.finalize(device="cpu"), use_mujoco_cpu=True).mj_model
    assert (ours.hfield_nrow[0], ours.hfield_ncol[0]) == (5, 7)
    own, their = (m.hfield_data * m.hfield_size[0, 2] for m in (ours, theirs))
    np.testing.assert_allclose(own, their, atol=1e-6)
