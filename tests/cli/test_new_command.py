# SPDX-License-Identifier: Apache-2.0
"""``stripe-newton new``: the packages that it makes run their own tests and train."""

from __future__ import annotations

import ast
import importlib
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from stripe_newton.cli import main

ROOT = Path(__file__).parents[2]
PATH = os.pathsep.join(str(ROOT / part) for part in (".", "kernels", "tasks"))
ARM = """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 1">
<joint name="shoulder" type="hinge" axis="0 1 0" range="0.5 1.5" limited="true"/>
<geom type="capsule" size=".05 .2"/></body></worldbody></mujoco>"""
SLED = """<mujoco model="sled"><worldbody><body name="sled" pos="0 0 1"><freejoint/><geom type="box" size=".3 .2 .1"/>
<body name="mast" pos="0 0 .1"><joint name="mast" type="hinge" axis="0 1 0" range="-1 1" limited="true"/>
<geom type="capsule" size=".03 .1" pos="0 0 .15"/></body></body></worldbody>
<actuator><position name="mast" joint="mast" kp="20" kv="2"/></actuator></mujoco>"""
PENDULUM = """<robot name="pendulum"><link name="base"><inertial><mass value="2"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="bob"><inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 -.5"/><geometry><sphere radius=".1"/></geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="base"/>
<child link="bob"/><axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="5" velocity="5"/></joint></robot>"""


def make(*argv: str) -> None:
    assert main(["new", *argv]) == 0


def run(folder: str, *argv: str) -> str:
    """Run Python in a made folder, as its user does; returns the output."""
    process = subprocess.run(
        [sys.executable, *argv], cwd=folder, env=os.environ | {"PYTHONPATH": PATH}, capture_output=True, text=True
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def train(name: str, task: str) -> str:
    small = ("--num-envs", "4", "--max-iterations", "1", "--final-video", "False")
    return run(name, "-m", "stripe_newton.cli", "train", task, "--import", name, *small)


@pytest.mark.parametrize("kind", ["--direct", "--manager", "--scene"])
def test_a_package_is_complete_and_says_what_comes_next(kind, capsys):
    make("my_robot", kind)
    written = capsys.readouterr().out
    assert "stripe-newton train MyRobot-v0 --import my_robot" in written
    files = [path for path in Path("my_robot").rglob("*") if path.is_file()]
    assert {"pyproject.toml", "README.md", ".gitignore", "__init__.py", "test_my_robot.py"} <= {f.name for f in files}
    assert all(str(path) in written for path in files)
    assert not any("@" in path.name for path in files)
    for path in files:
        text = path.read_text(encoding="utf-8")
        assert "@NAME@" not in text
        assert "@CLASS@" not in text
        if path.suffix == ".py":
            ast.parse(text)
            assert max(map(len, text.splitlines())) <= 120
    readme = Path("my_robot/README.md").read_text(encoding="utf-8")
    assert all(f"`my_robot/{path.name}`" in readme for path in Path("my_robot/my_robot").iterdir())


def test_the_template_of_no_kind_is_the_direct_one():
    make("xyz")
    make("zyx", "--direct")
    texts = [Path(n, n, "env.py").read_text().replace(n.title(), "X").replace(n, "x") for n in ("xyz", "zyx")]
    assert texts[0] == texts[1]


@pytest.mark.parametrize("kind", ["direct", "manager"])
def test_the_tests_of_a_package_pass(kind, monkeypatch):
    """In this process, whose imports are done; the slow tests below run them as their user does."""
    make(f"new_{kind}", f"--{kind}")
    monkeypatch.syspath_prepend(str(Path(f"new_{kind}").resolve()))
    argv = ["-q", "-p", "no:cacheprovider", "-c", f"new_{kind}/pyproject.toml", f"new_{kind}/tests"]
    assert pytest.main(argv) == pytest.ExitCode.OK


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["--direct", "--manager", "--scene"])
def test_a_package_trains_and_its_tests_pass(kind):
    make("my_robot", kind)
    assert "stripe-newton play MyRobot-v0" in train("my_robot", "MyRobot-v0")
    assert "passed" in run("my_robot", "-m", "pytest", "-q", "tests")


@pytest.mark.slow
def test_the_scene_of_a_package_runs_without_its_task():
    make("my_field", "--scene")
    assert "tensor" in run("my_field", "-m", "my_field.sim", "3")
    assert Path("my_field/my_field_3.png").read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
@pytest.mark.parametrize(("file", "text"), [("arm.xml", ARM), ("sled.xml", SLED), ("pendulum.urdf", PENDULUM)])
def test_the_package_of_a_robot_trains_and_its_tests_pass(file, text):
    Path(file).write_text(text)
    make("my_robot", "--robot", file)
    assert "stripe-newton play MyRobot-v0" in train("my_robot", "MyRobot-v0")
    assert "passed" in run("my_robot", "-m", "pytest", "-q", "tests")


def robot_source(file: str, text: str, name: str, *argv: str) -> str:
    Path(file).write_text(text)
    make(name, "--robot", file, *argv)
    return Path(name, name, "robot.py").read_text()


def robot_cfg(name: str, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(name).resolve()))
    return importlib.import_module(f"{name}.robot").ROBOT_CFG


def test_a_held_robot_without_gains_gets_guessed_ones(capsys, monkeypatch):
    source = robot_source("arm.xml", ARM, "new_arm")
    assert "arm: the base is held" in capsys.readouterr().out
    assert "a guess from its efforts or its weight" in source
    cfg = robot_cfg("new_arm", monkeypatch)
    assert cfg.init_state.joint_pos == {"shoulder": 1.0}  # zero is out of its range
    assert cfg.actuators["all"].stiffness > 0.0
    assert "bad_orientation" not in Path("new_arm/new_arm/env_cfg.py").read_text()


def test_a_floating_robot_starts_above_the_ground(capsys, monkeypatch):
    robot_source("sled.xml", SLED, "new_sled")
    assert "sled: the base floats" in capsys.readouterr().out
    cfg = robot_cfg("new_sled", monkeypatch)
    assert cfg.init_state.pos[2] == pytest.approx(0.1 + 0.01, abs=1e-3)  # half a side, and a centimetre
    assert cfg.actuators == {}  # the file has a servo
    assert "bad_orientation" in Path("new_sled/new_sled/env_cfg.py").read_text()


LEG = """
<mujoco model="leg">
  <compiler angle="radian"/>
  <worldbody>
    <body name="trunk">
      <freejoint/>
      <geom type="box" size="0.1 0.1 0.05" mass="2"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0" range="-1.5 3.0"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.3"/>
        <body name="shank" pos="0 0 -0.2">
          <joint name="knee" axis="0 1 0" range="-2.6 -0.6"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.2"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def test_a_leg_with_a_knee_starts_with_its_foot_below_the_hip(monkeypatch):
    robot_source("leg.xml", LEG, "new_leg")
    cfg = robot_cfg("new_leg", monkeypatch)
    assert cfg.init_state.joint_pos == {"hip": 0.8, "knee": -1.6}
    height = 2.0 * 0.2 * math.cos(0.8) + 0.02
    assert cfg.init_state.pos[2] == pytest.approx(height + 0.01, abs=0.02)  # by the box around the capsule


def test_joints_without_a_drive_get_no_action(capsys, monkeypatch):
    """As the springs of a tail, in a file whose other joints have servos."""
    driven = LEG.replace("</worldbody>", '</worldbody><actuator><position joint="hip" kp="20"/></actuator>')
    robot_source("leg.xml", driven, "half_driven")
    assert "; knee of its joints has no drive and no action" in capsys.readouterr().out
    (pattern,) = re.findall(r'joint_names=\["(.*?)"\]', Path("half_driven/half_driven/env_cfg.py").read_text())
    assert [name for name in ("hip", "knee", "knee_2") if re.fullmatch(pattern, name)] == ["hip", "knee_2"]
    robot_source("whole.xml", LEG, "guessed")
    assert 'joint_names=[".*"]' in Path("guessed/guessed/env_cfg.py").read_text()


def test_a_urdf_file_does_not_say_whether_its_base_floats(capsys, monkeypatch):
    robot_source("pendulum.urdf", PENDULUM, "new_held")
    assert "the base is held (the file does not say; --floating lets it float)" in capsys.readouterr().out
    cfg = robot_cfg("new_held", monkeypatch)
    assert cfg.spawn.fix_base is True
    assert cfg.init_state.pos[2] == pytest.approx(0.6 + 0.01, abs=1e-3)  # else its bob would be in the ground
    robot_source("pendulum.urdf", PENDULUM, "new_floating", "--floating")
    assert "the base floats" in capsys.readouterr().out
    cfg = robot_cfg("new_floating", monkeypatch)
    assert cfg.spawn.fix_base is False
    assert cfg.init_state.pos[2] == pytest.approx(0.6 + 0.01, abs=1e-3)


def test_the_package_has_a_copy_of_a_file_that_stands_alone():
    source = robot_source("arm.xml", ARM, "alone")
    assert Path("alone/alone/arm.xml").read_text() == ARM
    assert 'FILE = Path(__file__).parent / "arm.xml"' in source
    Path("stone.obj").write_text("v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    mesh = '<asset><mesh name="stone" file="stone.obj"/></asset><worldbody>'
    meshed = ARM.replace("<worldbody>", mesh).replace('type="capsule" size=".05 .2"', 'type="mesh" mesh="stone"')
    source = robot_source("meshed.xml", meshed, "with_mesh")
    assert f'FILE = Path("{Path("meshed.xml").resolve()}")' in source
    assert not Path("with_mesh/with_mesh/meshed.xml").exists()


@pytest.mark.parametrize(
    ("argv", "word"),
    [
        (["My-Robot"], "must be the name of a Python package"),
        (["class"], "must be the name of a Python package"),
        (["json"], "Python has a package of this name"),
        (["there"], "exists already"),
        (["new_mine", "--direct", "--scene"], "--direct and --scene: give one of them"),
        (["new_mine", "--robot", "nowhere.xml"], "nowhere.xml: does not exist"),
        (["new_mine", "--robot", "notes.txt"], "notes.txt"),
        (["new_mine", "--robot", "stone.xml"], "no joint that moves"),
        (["new_mine", "--floating"], "--floating: only with --robot"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_made_is_one_line(argv, word, capsys):
    Path("there").mkdir()
    Path("notes.txt").write_text("robots\n")
    Path("stone.xml").write_text(
        '<mujoco><worldbody><body name="a"><freejoint/><geom size=".1"/></body></worldbody></mujoco>'
    )
    assert main(["new", *argv]) != 0
    error = capsys.readouterr().err
    assert word in error
    assert len(error.strip().splitlines()) == 1
    assert not Path("new_mine").exists()
