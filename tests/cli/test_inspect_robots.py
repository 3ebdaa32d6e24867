# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton inspect`` of URDF and MJCF files, and of files that are something else."""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium
import newton.examples
import pytest

from stripe_newton.cli import main

SERVO = """<mujoco><worldbody><body name="arm"><joint name="elbow" range="-1 1" limited="true"/>
<geom size=".1 .2" type="capsule"/></body></worldbody><sensor><jointpos joint="elbow"/></sensor>
<actuator><position name="servo" joint="elbow" kp="40" kv="2" forcerange="-5 5"/>
<motor name="motor" joint="elbow" gear="3" ctrlrange="-1 1"/>
<velocity name="speed" joint="elbow" kv="7"/></actuator></mujoco>"""


def test_an_mjcf_file_is_shown_with_its_actuators(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(SERVO)
    assert main(["inspect", "arm.xml", "--out", "pictures"]) == 0
    text = capsys.readouterr().out
    assert "Actuators of the file (3)" in text
    lines = {line.split()[0]: line.split()[1:] for line in text.splitlines() if line.startswith("  ")}
    assert lines["servo"] == ["position", "joint", "elbow", "40", "2", "1", "-5", "..", "5"]
    assert lines["motor"] == ["motor", "joint", "elbow", "0", "0", "3", "-1", "..", "1"]
    assert lines["speed"] == ["velocity", "joint", "elbow", "0", "7", "1"]
    assert "1 sensor  not read" in text
    assert Path("pictures/arm.png").read_bytes()[:4] == b"\x89PNG"


def test_an_mjcf_file_as_json(tmp_path, capsys):
    (tmp_path / "arm.xml").write_text(SERVO)
    assert main(["inspect", "arm.xml", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["format"], content["base"]) == ("MJCF", "fixed")
    assert content["actuators"][0] == {
        "name": "servo", "kind": "position", "target": "joint elbow", "stiffness": 40.0, "damping": 2.0, "gear": 1.0,
        "control_range": None, "force_range": [-5.0, 5.0],
    }  # fmt: skip
    (report,) = content["reports"]
    assert report["joints"][0]["max_force"] == 3.0  # the least of the file's ranges
    assert Path(content["picture"]).is_file()


def test_a_urdf_file_and_a_robot_that_floats(capsys):
    assert main(["inspect", newton.examples.get_asset("quadruped.urdf"), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["format"], content["base"]) == ("URDF", "fixed")
    assert ["base", "root link"] in [row[:2] for row in content["reports"][0]["ignored"]]
    ant = Path(gymnasium.__file__).parent / "envs/mujoco/assets/ant.xml"
    assert main(["inspect", str(ant), "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["base"], len(content["reports"][0]["bodies"])) == ("floating", 13)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("hand.dae", "<COLLADA/>", "hand.dae is a Collada mesh; name it in the <mesh> of a URDF or MJCF file"),
        ("world.sdf", "<sdf/>", "world.sdf is an SDF file of Gazebo, which is not read; convert it"),
        ("hand.stl", "solid hand", "hand.stl is an STL mesh"),
        ("far.urdf", "version https://git-lfs.github.com/spec/v1\n", "far.urdf is a pointer of git LFS"),
        ("robot.xacro", '<robot xmlns:a="http://www.ros.org/wiki/xacro"><a:x/></robot>', "robot.xacro is a xacro file"),
        ("arm.urdf", '<robot name="a"><link/></robot>', "'arm.urdf': 1 <link> without a name"),
        ("arm.xml", SERVO.replace('kp="40"', 'kp="inf"'), "<position> 'servo': kp is infinite (inf), must be finite"),
    ],
)
def test_what_is_no_robot_is_called_what_it_is(tmp_path, capsys, name, content, message):
    (tmp_path / name).write_text(content)
    assert main(["inspect", name]) != 0
    assert message in capsys.readouterr().err


def test_a_file_that_is_not_there(capsys):
    assert main(["inspect", "none.urdf"]) != 0
    assert "none.urdf: does not exist" in capsys.readouterr().err
