# SPDX-License-Identifier: Apache-2.0
"""MJCF files: refused by the names of their elements, or read with a row for what is not as the file says."""

from __future__ import annotations

import os
from pathlib import Path

import newton
import pytest

from stripe_newton.assets import ArticulationCfg
from stripe_newton.robot_files import RobotFileError, inspect_robot_file
from stripe_newton.robot_files.importer_warnings import warnings_as_rows
from stripe_newton.robot_files.mjcf import MjcfStart
from stripe_newton.robot_files.mjcf_checks import compile_mjcf
from stripe_newton.robot_files.mjcf_rows import mjcf_rows
from stripe_newton.sim import MjcfFileCfg
from tests.helpers.robot_files import ROBOTS, robot_file
from tests.helpers.small_scenes import make_scene

BODY = '<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>'


def mjcf(folder: Path, joint: str = "", rest: str = "", body: str = BODY) -> Path:
    path = folder / "robot.xml"
    path.write_text(
        f'<mujoco>{rest}<worldbody><body name="b"><joint name="j" {joint}/>{body}</body></worldbody></mujoco>'
    )
    return path


SERVO = "<actuator><position name='s' joint='j' kp='{}'/></actuator>"
KEY = '<keyframe><key name="home" qpos="0" qvel="{}"/></keyframe>'
REFUSED = {
    "stiffness inf": ({"joint": 'stiffness="inf"'}, "<joint> 'j': stiffness is infinite (inf), must be finite"),
    "stiffness nan": ({"joint": 'stiffness="nan"'}, "<joint> 'j': stiffness is not a number (nan), must be finite"),
    "damping inf": ({"joint": 'damping="-inf"'}, "<joint> 'j': damping is infinite (-inf), must be finite"),
    "damping nan": ({"joint": 'damping="NaN"'}, "<joint> 'j': damping is not a number (NaN), must be finite"),
    "damping of a class": (
        {"rest": '<default><default class="c"><joint damping="inf"/></default></default>'},
        "<joint> of <default> 'c': damping is infinite",
    ),
    "velocity": ({"rest": KEY.format("inf")}, "<key> 'home': qvel is infinite (inf), must be finite"),
    "velocity nan": ({"rest": KEY.format("nan")}, "<key> 'home': qvel is not a number (nan), must be finite"),
    "gravity inf": ({"rest": '<option gravity="0 0 -inf"/>'}, "<option> of <mujoco>: gravity is infinite (0 0 -inf)"),
    "gravity nan": ({"rest": '<option gravity="0 nan 0"/>'}, "<option> of <mujoco>: gravity is not a number (0 nan 0)"),
    "gain inf": ({"rest": SERVO.format("inf")}, "<position> 's': kp is infinite (inf), must be finite"),
    "range nan": ({"joint": 'range="nan 1"'}, "<joint> 'j': range is not a number (nan 1)"),
    "range": ({"joint": 'range="30 20"'}, "<joint> 'j': range is 30 20, the wrong way round; exchange them"),
    "force range": (
        {"rest": SERVO.format(1).replace("kp", "forcerange='5 -5' kp")},
        "<position> 's': forcerange is 5 -5, the wrong way round",
    ),
    "negative mass": ({"body": BODY.replace('mass="1"', 'mass="-1"')}, "MuJoCo refuses it: mass and inertia"),
    "missing mesh": (
        {"rest": '<asset><mesh name="m" file="gone.stl"/></asset>', "body": BODY + '<geom type="mesh" mesh="m"/>'},
        "gone.stl",
    ),
    "unknown element": ({"rest": "<robots/>"}, "MuJoCo refuses it: Schema violation: unrecognized element"),
    "replicate": (
        {"body": BODY + '<replicate count="2" offset="1 0 0"><geom size=".1"/></replicate>'},
        "<replicate> of <body> 'b': Newton's importer does not read copies of a body",
    ),
    "ball and slide": (
        {"joint": 'type="ball"', "body": BODY + '<joint type="slide"/>'},
        "<body> 'b': has a ball joint and 1 more, which Newton's importer cannot merge; use a freejoint",
    ),
    "include": ({"rest": '<include file="gone.xml"/>'}, "gone.xml' does not exist"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_file_is_refused_by_the_names_of_its_elements(tmp_path, case):
    content, message = REFUSED[case]
    with pytest.raises(RobotFileError) as error:
        inspect_robot_file(mjcf(tmp_path, **content))
    assert message in str(error.value)
    assert "robot.xml" in str(error.value)


def test_included_files_are_looked_at_too(tmp_path):
    (tmp_path / "part.xml").write_text('<mujocoinclude><option gravity="0 0 inf"/></mujocoinclude>')
    with pytest.raises(RobotFileError, match=r"<option> of <mujocoinclude>: gravity is infinite"):
        inspect_robot_file(mjcf(tmp_path, rest='<include file="part.xml"/>'))


def test_a_mesh_that_is_a_pointer_of_git_lfs_is_named(tmp_path):
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets/far.stl").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n")
    rest = '<compiler meshdir="assets"/><asset><mesh file="far.stl"/></asset>'
    with pytest.raises(RobotFileError, match=r"<mesh> 'far': '.*far\.stl' is a pointer of git LFS.*'git lfs pull'"):
        inspect_robot_file(mjcf(tmp_path, rest=rest, body=BODY + '<geom type="mesh" mesh="far"/>'))


@pytest.mark.parametrize(
    ("rest", "message"),
    [
        ('<include file="pipe"/>', r"<include>: '.*pipe' is a pipe"),
        ('<include file="/dev/zero"/>', r"<include>: '/dev/zero' is a device"),
        ('<asset><hfield name="h" file="pipe"/></asset>', r"<hfield> 'h': '.*pipe' is a pipe"),
        ('<asset><texture name="t" type="cube" fileup="/dev/zero"/></asset>', r"<texture> 't': '/dev/zero' is a dev"),
        ('<compiler meshdir=".."/><asset><mesh name="m" file="{folder}/pipe"/></asset>', r"<mesh> 'm': .* is a pipe"),
    ],
)
def test_pipes_and_devices_are_not_read(tmp_path, rest, message):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RobotFileError, match=message):
        inspect_robot_file(mjcf(tmp_path, rest=rest.format(folder=tmp_path.name)))


def test_a_range_that_does_not_hold_may_be_of_any_kind(tmp_path):
    inspect_robot_file(mjcf(tmp_path, joint='limited="false" range="30 20"'))


def test_limits_without_end_and_names_of_any_kind_are_no_mistake(tmp_path):
    path = mjcf(tmp_path, rest="<actuator><motor name='nan' joint='j' ctrlrange='-inf inf'/></actuator>")
    assert len(inspect_robot_file(path).bodies) == 1


def test_what_is_not_read_has_a_row(tmp_path):
    rest = '<option timestep="0.004" gravity="0 0 -1.6"/><sensor><jointpos joint="j"/></sensor>' + KEY.format("0")
    path = mjcf(tmp_path, rest=rest, body=BODY + '<camera name="c"/>')
    found = {(where, what) for where, what, _ in inspect_robot_file(path).ignored}
    assert found == {
        ("1 sensor", "not read"), ("1 camera", "not read"), ("keyframes", "not used"), ("option", "timestep 0.004"),
        ("option", "gravity (0, 0, -1.6)"), ("option", "integrator implicitfast"),
    }  # fmt: skip
    spawn = MjcfFileCfg(asset_path=str(path), keyframe="home")
    scene = make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})
    rows = scene.builder.reports[0].ignored
    assert "/World/envs/env_0/Robot/1 sensor" in [row[0] for row in rows]
    assert not [row for row in rows if "keyframes" in row[0]]  # it is used


@pytest.mark.parametrize(
    ("named", "row"),
    [("", "MuJoCo reads euler"), ("Euler", ""), ("implicitfast", ""), ("RK4", "")],
)
def test_a_file_without_an_integrator_gets_another_one_and_a_row(tmp_path, named, row):
    path = mjcf(tmp_path, rest=f'<option integrator="{named}"/>' if named else "")
    spawn = MjcfFileCfg(asset_path=str(path))
    scene = make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})
    rows = [why for _, what, why in scene.builder.reports[0].ignored if what == "integrator implicitfast"]
    assert [why.partition(";")[0] for why in rows] == ([row] if row else [])
    # The row is true: these are the integrators that the solver has, and that MuJoCo's own reading has.
    steps_by = scene.sim.solver.mjw_model.opt.integrator
    assert (steps_by == compile_mjcf(path).opt.integrator) == (not row)


@pytest.mark.parametrize(
    ("array", "what"),
    [("joint_damping", "damping"), ("joint_armature", "armature"), ("joint_limit_upper", "upper limit")],
)
def test_a_joint_that_newton_reads_otherwise_than_mujoco_has_a_row(tmp_path, array, what):
    path = mjcf(tmp_path, 'damping="2" armature="0.1" range="-1 1" limited="true"')
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    start = MjcfStart(builder)
    builder.add_mjcf(str(path))
    model = compile_mjcf(path)
    before = mjcf_rows(builder, start, model, {})
    getattr(builder, array)[-1] *= 1.5
    assert [row[:2] for row in mjcf_rows(builder, start, model, {}) if row not in before] == [("j", what)]
    builder.body_mass[-1] = 7.0
    assert ("b", "mass", "MuJoCo reads 1 kg, Newton 7") in mjcf_rows(builder, start, model, {})


@pytest.mark.parametrize("name", [n for n in ROBOTS if n != "quadruped"])
def test_robots_of_others_are_read_as_mujoco_reads_them(name):
    whats = {what for _, what, _ in inspect_robot_file(robot_file(name)).ignored}
    options = ("timestep", "integrator")
    assert {what for what in whats if not what.startswith(options)} <= {"not read", "not used", "left out", "tendon"}


def test_equal_warnings_are_one_row_with_their_number():
    import warnings

    rows: list[tuple[str, str, str]] = []
    with warnings_as_rows(rows):
        for name in ("FR", "FL", "RR"):
            warnings.warn(f"Geom '{name}': negative margin", newton.NewtonWarning, stacklevel=1)
        warnings.warn("something else", newton.NewtonWarning, stacklevel=1)
    assert rows == [
        ("FR (+2 more)", "warning of Newton", "Geom 'FR': negative margin"),
        ("", "warning of Newton", "something else"),
    ]


def test_what_free_and_ball_joints_lose_has_a_row(tmp_path):
    joint = '<joint name="f" type="free" damping="0.3"/><geom size="0.1"/>'
    ball = '<body name="c" pos="0 0 1"><joint type="ball" range="0 90"/><geom size="0.1"/></body>'
    path = tmp_path / "robot.xml"
    path.write_text(f'<mujoco><worldbody><body name="a">{joint}{ball}</body></worldbody></mujoco>')
    rows = {row[:2]: row[2] for row in inspect_robot_file(path).ignored}
    assert rows["f", "damping"] == "0.3 in the file is not read: free joints have none"
    assert rows["joint of c", "range"] == "not read: ball joints have no limits"


@pytest.mark.parametrize("part", ["mesh", "include", "hfield", "texture"])
def test_a_pipe_in_the_place_of_a_file_is_not_read(tmp_path, part):
    os.mkfifo(tmp_path / "pipe")
    assets = {"mesh": '<mesh name="m" file="pipe"/>', "hfield": '<hfield name="m" file="pipe" size="1 1 1 1"/>',
              "texture": '<texture name="m" type="2d" file="pipe"/>'}  # fmt: skip
    rest = '<include file="pipe"/>' if part == "include" else f"<asset>{assets[part]}</asset>"
    with pytest.raises(RobotFileError, match=rf"<{part}>.*pipe' is a pipe"):
        inspect_robot_file(mjcf(tmp_path, rest=rest))
