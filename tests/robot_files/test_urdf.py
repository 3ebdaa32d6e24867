# SPDX-License-Identifier: Apache-2.0
"""URDF files: read as they are written, with a row for what is not, or refused by the names of their elements."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import newton.examples
import numpy as np
import pytest
import trimesh

from stripe_newton.assets import ArticulationCfg
from stripe_newton.assets.articulation import Articulation
from stripe_newton.robot_files import RobotFileError, inspect_robot_file, urdf_checks
from stripe_newton.sim import UrdfFileCfg
from stripe_newton.usd import StageError
from tests.helpers.small_scenes import make_scene

BODY = '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
ARM = f"""<link name="base">{BODY}</link><link name="tip">{BODY}</link>
<joint name="elbow" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""
HELD = """<link name="world"/>{arm}
<joint name="stand" type="{kind}"><parent link="world"/><child link="base"/></joint>"""


def urdf(folder: Path, content: str) -> Path:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="robot">{content}</robot>')
    return path


def robot(folder: Path, links: str, fix_base: bool | None) -> Articulation:
    spawn = UrdfFileCfg(asset_path=str(urdf(folder, links)), fix_base=fix_base)
    scene = make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})
    return scene.articulations["robot"]


def rows(folder: Path, content: str) -> dict[tuple[str, str], str]:
    """Reasons of the rows of a report by place and subject, but for the root that floats or not."""
    report = inspect_robot_file(urdf(folder, content))
    return {(where, what): why for where, what, why in report.ignored if what != "root link"}


# -- whether the base floats


@pytest.mark.parametrize(
    ("links", "fix_base", "fixed"),
    [(ARM, True, True), (ARM, False, False), (HELD.format(arm=ARM, kind="fixed"), None, True)],
    ids=["set fixed", "set floating", "held by the link world"],
)
def test_the_base_is_as_the_config_or_the_file_says(tmp_path, links, fix_base, fixed):
    assert robot(tmp_path, links, fix_base).is_fixed_base is fixed


@pytest.mark.parametrize(
    ("links", "fix_base", "message"),
    [
        (ARM, None, "does not say whether its root link 'base' floats.*set fix_base=False, or fix_base=True"),
        (f'{ARM}<link name="hat">{BODY}</link>', True, "links 'base', 'hat' are the child of no joint: one must be"),
        (HELD.format(arm=ARM, kind="floating"), None, "joint 'stand': is of type 'floating'.*set fix_base=False"),
    ],
    ids=["nobody says", "two roots", "a floating joint"],
)
def test_what_does_not_say_it_is_refused(tmp_path, links, fix_base, message):
    with pytest.raises(ValueError, match=rf"robot\.urdf.*{message}"):
        robot(tmp_path, links, fix_base)


@pytest.mark.parametrize(("name", "root"), [("quadruped", "base"), ("cartpole", "slider")])
def test_files_of_newton_do_not_say_it(name, root):
    spawn = UrdfFileCfg(asset_path=str(newton.examples.get_asset(f"{name}.urdf")))
    with pytest.raises(ValueError, match=f"whether its root link '{root}' floats"):
        make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})


# -- what is refused


def link(inertial: str = BODY, parts: str = "") -> str:
    return f'<link name="base">{inertial}{parts}</link>'


def collider(shape: str) -> str:
    return link(parts=f"<collision><geometry>{shape}</geometry></collision>")


REFUSED = {
    "mass -1": (link(BODY.replace('mass value="1"', 'mass value="-1"')), "link 'base': value of <mass> is -1, must be"),
    "mass nan": (link(BODY.replace('mass value="1"', 'mass value="nan"')), "link 'base': value of <mass> is not a num"),
    "mass inf": (link(BODY.replace('mass value="1"', 'mass value="inf"')), "link 'base': value of <mass> is infinite"),
    "no mass": (link("<inertial/>"), "link 'base': <inertial> has no <mass"),
    "negative inertia": (link(BODY.replace('ixx=".1"', 'ixx="-.1"')), "link 'base': <inertia> has the principal mom"),
    "inertia nan": (link(BODY.replace('ixx=".1"', 'ixx="nan"')), "link 'base': ixx of <inertia> is not a number"),
    "negative radius": (collider('<sphere radius="-1"/>'), "<collision>: radius of <sphere> is -1, must be positive"),
    "size of words": (collider('<box size="big"/>'), "<collision>: size of <box> is 'big', must be 3 numbers"),
    "size of two": (collider('<box size="1 2"/>'), "size of <box> is '1 2', must be 3 numbers"),
    "no radius": (collider('<sphere size="1"/>'), "<sphere> has no radius"),
    "unknown shape": (collider("<cone/>"), "<cone> is no shape of URDF; use box, sphere, cylinder, capsule, mesh"),
    "no shape": (collider(""), "has 0 shapes in its <geometry>, must have one"),
    "scale 0": (collider('<mesh filename="a.stl" scale="1 0 1"/>'), "scale of <mesh> is '1 0 1', must not be 0"),
    "limits crossed": (
        ARM.replace('lower="-1" upper="1"', 'lower="2" upper="1"'),
        "'elbow': its lower limit 2 is above",
    ),
    "limit nan": (ARM.replace('lower="-1"', 'lower="nan"'), "joint 'elbow': lower of <limit> is not a number"),
    "negative effort": (ARM.replace('effort="1"', 'effort="-1"'), "'elbow': effort of <limit> is -1, must be at least"),
    "axis 0": (ARM.replace("0 1 0", "0 0 0"), "joint 'elbow': its axis is 0 0 0, must have a direction"),
    "axis too short": (
        ARM.replace("0 1 0", "0 0 1e-30"),
        "joint 'elbow': its axis is 0 0 1e-30, must have a direction",
    ),
    "unknown type": (ARM.replace('"revolute"', '"screw"'), "joint 'elbow': is of type 'screw', must be revolute"),
    "unknown child": (ARM.replace('child link="tip"', 'child link="top"'), "'elbow': its child 'top' is no link of"),
    "a world that is not there": (
        ARM + '<joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint>',
        "robot.urdf': joint 'weld': its parent 'world' is no link of the file; add <link name=\"world\"/>",
    ),
    "two parents": (
        ARM + '<joint name="weld" type="fixed"><parent link="base"/><child link="tip"/></joint>',
        "link 'tip': is the child of joints 'elbow', 'weld', must be that of one: URDF has no loops",
    ),
    "twice a link": (ARM + '<link name="tip"/>', "link 'tip': there are 2 of this name"),
    "damping inf": (
        ARM.replace("<axis", '<dynamics damping="inf"/><axis'),
        "joint 'elbow': damping of <dynamics> is infinite",
    ),
    "origin": (ARM.replace("<axis", '<origin xyz="0 0"/><axis'), "xyz of <origin> is '0 0', must be 3 numbers"),
    "no type": (ARM.replace('type="revolute"', ""), "joint 'elbow': has no type, must be revolute"),
    "mimic of nothing": (ARM.replace("<axis", "<mimic/><axis"), "joint 'elbow': <mimic> has no joint; name the joint"),
    "mimic of a fixed joint": (
        HELD.format(arm=ARM.replace("<axis", '<mimic joint="stand"/><axis'), kind="fixed"),
        "joint 'elbow': mimics 'stand', a fixed joint; it can follow one that is revolute",
    ),
    "mimic": (ARM.replace("<axis", '<mimic joint="knee"/><axis'), "'elbow': mimics 'knee', which is no joint of"),
    "no mass that moves": (
        ARM.replace(f'<link name="tip">{BODY}', '<link name="tip">'),
        "body 'tip': moves and has no mass; give it mass and inertia",
    ),
    "web": (collider('<mesh filename="https://a.b/c.stl"/>'), "'https://a.b/c.stl' is on the web, which is not read"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_is_refused_by_the_names_of_its_elements(tmp_path, case):
    content, message = REFUSED[case]
    with pytest.raises(RobotFileError) as error:
        inspect_robot_file(urdf(tmp_path, content))
    assert message in str(error.value)
    assert "robot.urdf" in str(error.value)


def test_a_fixed_joint_that_mimics_stays_fixed(tmp_path):
    stand = HELD.format(arm=ARM, kind="fixed").replace("</joint>", '<mimic joint="elbow"/></joint>')
    stand = stand.replace('<mimic joint="elbow"/></joint>', "</joint>", 1)  # of the elbow itself
    assert rows(tmp_path, stand) == {("stand", "<mimic>"): "left out: a fixed joint does not move"}


def test_what_no_check_foresaw_is_told_by_the_path_of_the_joint(tmp_path, monkeypatch):
    """MuJoCo's own error names it ``_World_envs_env_0_Robot_robot_elbow``."""
    monkeypatch.setattr(urdf_checks, "_SHORTEST_AXIS", 0.0)
    with pytest.raises(StageError) as error:
        robot(tmp_path, ARM.replace("0 1 0", "0 0 1e-30"), fix_base=True)
    assert error.value.prim == "/World/envs/env_0/Robot/robot/elbow"
    assert "the solver does not take it: Error: axis too small in joint" in str(error.value)


def test_everything_that_is_wrong_is_said_at_once(tmp_path):
    with pytest.raises(RobotFileError) as error:
        inspect_robot_file(urdf(tmp_path, REFUSED["mass -1"][0] + REFUSED["unknown type"][0].replace("base", "b")))
    assert len(error.value.problems) == 3
    assert [p.split(":")[0] for p in error.value.problems] == [
        "link 'base'",
        "joint 'elbow'",
        "links 'base', 'b' are the child of no joint",
    ]


# -- meshes and packages


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A ROS package ``arm`` with a mesh of half a metre, outside the folder of the robot's file."""
    for variable in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(variable, raising=False)
    folder = tmp_path / "elsewhere" / "arm"
    (folder / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.5, 0.5, 0.5)).export(folder / "meshes/box.stl")
    return folder


MESH = collider('<mesh filename="package://arm/meshes/box.stl"/>')


def test_a_package_is_found_by_config_and_by_ros(tmp_path, package, monkeypatch):
    path = urdf(tmp_path, MESH)
    with pytest.raises(RobotFileError, match=r"'base': <collision>: mesh .*package 'arm' is neither.*set packages"):
        inspect_robot_file(path)
    spawn = UrdfFileCfg(asset_path=str(path), fix_base=True, packages={"arm": str(package)})
    scene = make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/R", spawn=spawn, actuators={})})
    assert np.ptp(scene.sim.template.shape_source[0].vertices) == pytest.approx(0.5)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{package.parent}")
    assert len(inspect_robot_file(path).shapes) == 1
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(package))
    assert len(inspect_robot_file(path).shapes) == 1
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    share = tmp_path / "prefix/share"
    share.mkdir(parents=True)
    package.rename(share / "arm")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "prefix"))
    assert len(inspect_robot_file(path).shapes) == 1


def test_a_package_is_found_above_the_file(package):
    (package / "urdf").mkdir()
    path = urdf(package / "urdf", MESH)
    assert len(inspect_robot_file(path).shapes) == 1
    other = package.rename(package.parent / "arm-2.1")  # the manifest has the name then
    with pytest.raises(RobotFileError, match="package 'arm' is neither"):
        inspect_robot_file(other / "urdf/robot.urdf")
    (other / "package.xml").write_text("<package><name>arm</name></package>")
    assert len(inspect_robot_file(other / "urdf/robot.urdf").shapes) == 1


def test_a_folder_of_a_package_that_is_not_there_is_a_problem_of_the_config(tmp_path):
    cfg = UrdfFileCfg(asset_path=str(urdf(tmp_path, ARM)), packages={"arm": "/nowhere"})
    assert list(cfg.problems()) == [("packages['arm']", "'/nowhere' is no folder")]


def test_meshes_that_cannot_be_read_are_named(tmp_path, monkeypatch):
    def refused(name: str) -> str:
        with pytest.raises(RobotFileError) as error:
            inspect_robot_file(urdf(tmp_path, collider(f'<mesh filename="{name}"/>')))
        return error.value.problems[0]

    gone = refused("gone.stl")
    assert gone == f"link 'base': <collision>: mesh '{tmp_path / 'gone.stl'}' does not exist"
    (tmp_path / "far.stl").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n")
    assert "far.stl' is a pointer of git LFS" in refused("far.stl")
    assert refused("/dev/zero").endswith("mesh '/dev/zero' is a device")
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    assert "part.step' is none of .stl" in refused("part.step")
    (tmp_path / "hand.dae").write_text("<COLLADA/>")
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "collada" else found(name))
    assert refused("hand.dae").endswith("needs pycollada: pip install pycollada")


def test_a_visual_mesh_that_is_missing_is_left_out_and_said(tmp_path):
    visual = "<visual><geometry>{}</geometry></visual>"
    content = link(parts=visual.format('<mesh filename="gone.stl"/>') + visual.format('<sphere radius="1"/>'))
    path = urdf(tmp_path, content)
    report = inspect_robot_file(path)
    assert len(report.shapes) == 1
    assert ("base", "<visual>", f"left out: mesh '{tmp_path / 'gone.stl'}' does not exist") in report.ignored


def test_a_link_of_which_no_visual_is_left_is_drawn_by_its_colliders(tmp_path):
    gone = '<visual><geometry><mesh filename="gone.stl"/></geometry></visual>'
    box = '<collision><origin xyz="0 0 1"/><geometry><box size="1 2 3"/></geometry></collision>'
    sphere = '<visual><geometry><sphere radius="1"/></geometry></visual>'
    hand = link(parts=sphere + box).replace("base", "hand")
    joint = '<joint name="weld" type="fixed"><parent link="base"/><child link="hand"/></joint>'
    report = inspect_robot_file(urdf(tmp_path, link(parts=gone + box) + hand + joint))
    shapes = {(s.body.split("/")[-1], s.type, s.visible, s.collides) for s in report.shapes}
    assert {("base", "box", True, False), ("base", "box", False, True), ("hand", "sphere", True, False)} <= shapes
    assert ("hand", "box", True, False) not in shapes


# -- what is read otherwise has a row


def test_what_is_not_read_has_a_row(tmp_path):
    extra = '<transmission name="t"/><transmission name="u"/><gazebo/>'
    found = rows(tmp_path, extra + ARM.replace("<axis", '<safety_controller k_velocity="1"/><axis'))
    assert set(found) == {("robot (2)", "<transmission>"), ("robot (1)", "<gazebo>"), ("elbow", "<safety_controller>")}


UNREAD = {
    ("tip", "<contact>"): ('"tip">', '"tip"><contact><lateral_friction value="0.1"/></contact>'),
    ("robot", "<cable>"): ("<joint", '<cable length="1"/><joint'),
    ("elbow", "xzy of <axis>"): ("xyz", "xzy"),
    ("elbow", "spring_stiffness of <dynamics>"): ("</joint>", '<dynamics damping="1" spring_stiffness="9"/></joint>'),
    ("base", "<density>"): ("</inertial>", '<density value="3"/></inertial>'),
}


@pytest.mark.parametrize("row", UNREAD)
def test_what_is_no_part_of_urdf_has_a_row(tmp_path, row):
    found = rows(tmp_path, ARM.replace(*UNREAD[row], 1))
    assert list(found) == [row]
    assert row[1] != "<contact>" or "physics_material" in found[row]


def test_attributes_that_newton_reads_and_those_of_another_namespace_have_no_row(tmp_path):
    shape = '<collision><geometry condim="4"><sphere radius="1"/></geometry></collision>'
    other = 'xmlns:drake="http://drake.mit.edu" drake:kind="x"><drake:properties/>'
    found = rows(tmp_path, ARM.replace("><inertial", f" {other}{shape}<inertial", 1))
    assert list(found) == [("base", "<properties>")]


def test_a_capsule_may_have_a_length(tmp_path):
    shape = '<collision><geometry><capsule radius="0.1" length="0.6"/></geometry></collision>'
    capsules = [s.size for s in inspect_robot_file(urdf(tmp_path, link(parts=shape))).shapes]
    assert np.array(capsules) == pytest.approx(np.array([(0.1, 0.3)] * len(capsules)))


def test_limits_of_a_continuous_joint_are_left_out(tmp_path):
    content = ARM.replace('"revolute"', '"continuous"')
    report = inspect_robot_file(urdf(tmp_path, content))
    assert ("elbow", "limits", "a continuous joint turns without end; they are left out") in report.ignored
    row = next(j for j in report.joints if j.path.endswith("elbow"))
    assert row.upper - row.lower > 4.0 * math.pi


@pytest.mark.parametrize(
    ("content", "row"),
    [
        (ARM.replace('effort="1"', 'effort="0"'), ("elbow", "effort limit 0")),
        (ARM.replace('lower="-1" upper="1"', ""), ("elbow", "no limits")),
        (ARM.replace("0 1 0", "0 2 0"), ("elbow", "axis")),
        (link("", '<collision><geometry><sphere radius="1"/></geometry></collision>'), ("base", "no <inertial>")),
        (link(BODY.replace('ixx=".1"', 'ixx=".9"')), ("base", "inertia")),
        (ARM + '<material name="grey"><color rgba="0.5, 0.5, 0.5, 1"/></material>', ("grey", "<color>")),
    ],
)
def test_what_is_odd_has_a_row(tmp_path, content, row):
    assert rows(tmp_path, ARM) == {}
    assert list(rows(tmp_path, content)) == [row]


def test_equal_rows_are_one_with_their_number(tmp_path):
    legs = "".join(
        f'<link name="leg{k}">{BODY}</link><joint name="hip{k}" type="revolute"><parent link="base"/>'
        f'<child link="leg{k}"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="0" velocity="1"/></joint>'
        for k in range(12)
    )
    assert list(rows(tmp_path, link() + legs)) == [("hip0 (+11 more)", "effort limit 0")]


def test_the_rows_reach_the_report_of_a_scene(tmp_path):
    spawn = UrdfFileCfg(asset_path=str(urdf(tmp_path, ARM + "<gazebo/>")), fix_base=True)
    scene = make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})
    report = scene.builder.reports[0]
    assert ("/World/envs/env_0/Robot/robot (1)", "<gazebo>", "Gazebo's extensions are not read") in report.ignored
    assert [row.path.rsplit("/", 1)[-1] for row in report.bodies] == ["base", "tip"]


def test_a_link_without_inertial_has_no_mass_if_it_is_fixed_to_one_that_has(tmp_path):
    """As the root of ANYmal D, whose colliders would weigh as much as the robot at the density of water."""
    box = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    links = f'<link name="base">{box}</link><link name="core"><inertial><mass value="3"/>{inertia}</inertial></link>'
    weld = '<joint name="weld" type="fixed"><parent link="base"/><child link="core"/></joint>'
    report = inspect_robot_file(urdf(tmp_path, links + weld))
    assert {body.path.rpartition("/")[2]: body.mass for body in report.bodies} == {"base": 0.0, "core": 3.0}
    assert ("base", "no <inertial>") in [(row[0].rpartition("/")[2], row[1]) for row in report.ignored]
    alone = inspect_robot_file(urdf(tmp_path, f'<link name="base">{box}</link>'))
    assert alone.bodies[0].mass == pytest.approx(1000.0)
