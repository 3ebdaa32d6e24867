# SPDX-License-Identifier: Apache-2.0
"""Represented files: what a stage of somebody else's keeps with its prims is checked, and named where it is wrong."""

from __future__ import annotations

import json

import newton
import pytest
from pxr import Usd, UsdGeom, UsdPhysics

from stripe_newton.scene import InteractiveScene
from stripe_newton.scene.represented_files import rename_prims, represented_files
from stripe_newton.sim import SimulationCfg
from stripe_newton.sim.spawners.from_files import FILE_KEY
from stripe_newton.sim.spawners.model_names import NAMES_KEY
from stripe_newton.usd import StageError

BODY = (
    '<robot name="r"><link name="{name}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    'iyz="0"/></inertial><collision name="ball"><geometry><sphere radius="0.1"/></geometry></collision></link></robot>'
)
LONG = "a" * 64


def stage_with(folder, file=None, names=None) -> str:
    """A stage with a collider, and custom data that are given as text or as what JSON can express."""
    (folder / "robot.urdf").write_text(BODY.format(name=LONG))
    path = str(folder / "scene.usda")
    stage = Usd.Stage.CreateNew(path)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    prim = UsdGeom.Xform.Define(stage, "/World/thing").GetPrim()
    UsdPhysics.CollisionAPI.Apply(UsdGeom.Cube.Define(stage, "/World/thing/cube").GetPrim())
    for key, value in ((FILE_KEY, file), (NAMES_KEY, names)):
        if isinstance(value, dict) and value.get("path") == "robot":
            value = {**value, "path": str(folder / "robot.urdf")}
        if value is not None:
            prim.SetCustomDataByKey(key, json.dumps(value) if isinstance(value, (dict, list)) else value)
    stage.GetRootLayer().Save()
    return path


def read(path: str) -> newton.ModelBuilder:
    """What a scene does with the files of a stage."""
    stage, builder = Usd.Stage.Open(path), newton.ModelBuilder()
    for file in represented_files(stage, "/", ()):
        file.add_to(builder)
    rename_prims(builder, stage, "/", ())
    return builder


GOOD = {"format": "urdf", "path": "robot", "floating": True}


@pytest.mark.parametrize(
    ("file", "names", "message"),
    [
        (3, None, "is 3, must be a JSON object"),
        ("{", None, "must be a JSON object"),
        ("[" * 100_000, None, "must be a JSON object"),
        ([1], None, "must be a JSON object"),
        ({"path": "robot"}, None, "format: is None, must be one of urdf, mjcf"),
        ({"format": "urdf"}, None, "asset_path: is missing"),
        ({"format": "urdf", "path": 3}, None, "asset_path: is 3"),
        ({"format": "urdf", "path": "/no/robot.urdf"}, None, "'/no/robot.urdf' does not exist"),
        ({"format": "mjcf", "path": "/dev/zero"}, None, "'/dev/zero' is a device"),
        ({**GOOD, "builder": 1}, None, "builder: "),
        ({**GOOD, "func": "os:system"}, None, "'func' is not known"),
        ({**GOOD, "rigid_props": {"func": "os:system"}}, None, "rigid_props"),
        ({**GOOD, "floating": "x"}, None, "fix_base: is 'x'"),
        ({**GOOD, "scale": "x"}, None, "scale: is 'x'"),
        ({**GOOD, "format": "mjcf", "fixed_tendons": {"a": {"coefficients": 3}}}, None, "coefficients: is 3"),
        (None, [1], "must be a JSON object"),
        (None, {"bodies": [1]}, "bodies: is [1]"),
        (None, {"bodies": {"(": "x"}}, "is no regular expression"),
        (None, {"links": {".*": ["x", "y"]}}, "shapes of a USD file stay with their bodies"),
        (GOOD, {"bodies": {"(a|aa)*Q": "x"}}, "may take hours to match"),
        (GOOD, {"links": {".*": ["foot", "(b|ba)*Q"]}}, "may take hours to match"),
        (GOOD, {"bodies": {".*": r"\9"}}, "is no name for what '.*' matches"),
        (GOOD, {"bodies": {".*": "../x"}}, "is no name"),
    ],
)  # fmt: skip
def test_wrong_custom_data_are_named(tmp_path, file, names, message):
    with pytest.raises(ValueError) as caught:
        read(stage_with(tmp_path, file, names))
    assert message in str(caught.value)
    assert "/World/thing" in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_a_file_and_its_names_are_read(tmp_path):
    builder = read(stage_with(tmp_path, GOOD, {"bodies": {"a*": "trunk"}, "links": {"a+": ["foot", "shape_0"]}}))
    assert {label.rpartition("/")[2] for label in builder.body_label} == {"trunk", "foot"}


def test_a_scene_of_a_wrong_stage_names_file_and_prim(tmp_path):
    path = stage_with(tmp_path, {**GOOD, "scale": "x"})
    with pytest.raises(StageError, match=f"^{path}: /World/thing: custom data 'stripeNewton:file': scale: "):
        InteractiveScene.from_usd(path, sim_cfg=SimulationCfg(device="cpu"))
