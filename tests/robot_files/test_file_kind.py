# SPDX-License-Identifier: Apache-2.0
"""File kind: files are what their content says, and a config of another kind says what a file is."""

from __future__ import annotations

import io
import os
import zipfile

import pytest

from stripe_newton.assets import ArticulationCfg
from stripe_newton.robot_files import RobotFileError, file_kind, inspect_robot_file
from stripe_newton.sim import MjcfFileCfg, UrdfFileCfg
from tests.helpers.small_scenes import make_scene


def zipped() -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as file:
        file.writestr("a.txt", "text")
    return stream.getvalue()


XACRO = b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="a" value="1"/></robot>'
KINDS = {
    "robot.urdf": (b'<?xml version="1.0"?>\n<robot name="a"/>', "urdf", "is a URDF file"),
    "used.urdf": (b'<robot xmlns:xacro="http://www.ros.org/wiki/xacro"/>', "urdf", "is a URDF file"),
    "model.xml": (b"\n<!-- a model --><mujoco/>", "mjcf", "is an MJCF file"),
    "stage.usd": (b"#usda 1.0\n", "usd", "is a USD stage"),
    "crate.usd": (b"PXR-USDC\0\0", "usd", "is a USD stage"),
    "robot.urdf.xacro": (XACRO, "", "is a xacro file, a template of a URDF file; expand it with 'xacro robot.urdf.x"),
    "part.xml": (b"<mujocoinclude/>", "", "is a part of an MJCF file"),
    "world.sdf": (b"<sdf version='1.6'/>", "", "is an SDF file of Gazebo"),
    "hand.dae": (b'<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"/>', "mesh", "is a Collada mesh; name"),
    "hand.stl": (b"solid hand\n", "mesh", "is an STL mesh; name it in the <mesh> of a URDF or MJCF file"),
    "binary.stl": (b"\0" * 84, "mesh", "is an STL mesh"),
    "hand.obj": (b"v 0 0 0\n", "mesh", "is an OBJ mesh"),
    "hand.glb": (b"glTF\2\0\0\0", "mesh", "is a glTF mesh"),
    "package.xml": (b"<package/>", "", "is the manifest of a ROS package"),
    "page.xml": (b"<html></html>", "", "is an XML file with the root <html>, no <robot> (URDF) or <mujoco> (MJCF)"),
    "broken.urdf": (b"<robot><link></robot>", "", "is not well-formed XML: mismatched tag"),
    "robot.zip": (zipped(), "", "is a zip archive; unpack it"),
    "empty.urdf": (b" \n", "", "is empty"),
    "notes.urdf": (b"hello\nworld", "", "is no USD, URDF or MJCF file: it begins with 'hello'"),
    "far.urdf": (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "", "is a pointer of git LFS"),
}


def test_a_pipe_is_not_read(tmp_path):
    os.mkfifo(tmp_path / "robot.urdf")
    assert file_kind(tmp_path / "robot.urdf").description == "is a pipe"
    assert file_kind(tmp_path).description == "is a folder"
    with pytest.raises(RobotFileError, match="is a pipe"):
        inspect_robot_file(tmp_path / "robot.urdf")


@pytest.mark.parametrize("name", KINDS)
def test_a_file_is_what_its_content_says(tmp_path, name):
    content, kind, description = KINDS[name]
    (tmp_path / name).write_bytes(content)
    found = file_kind(tmp_path / name)
    assert found.name == kind
    assert found.description.startswith(description)


@pytest.mark.parametrize(
    ("cfg", "name", "message"),
    [
        (UrdfFileCfg, "model.xml", "is an MJCF file"),
        (UrdfFileCfg, "robot.urdf.xacro", "is a xacro file.*expand it with 'xacro robot.urdf.xacro > robot.urdf'"),
        (MjcfFileCfg, "robot.urdf", "is a URDF file"),
        (MjcfFileCfg, "far.urdf", r"is a pointer of git LFS.*'git lfs pull'"),
    ],
)
def test_a_config_for_another_kind_says_what_the_file_is(tmp_path, cfg, name, message):
    (tmp_path / name).write_bytes(KINDS[name][0])
    spawn = cfg(asset_path=str(tmp_path / name))
    with pytest.raises(ValueError, match=rf"asset_path '.*{name}' {message}"):
        make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})
