# SPDX-License-Identifier: Apache-2.0
"""MJCF arenas as USD stages: each shape is where MuJoCo has it, and what the stage lacks has a row."""

from __future__ import annotations

from pathlib import Path

import mujoco
import newton
import numpy as np
import pytest
import warp as wp
from newton import GeoType, ShapeFlags
from pxr import Usd, UsdGeom

from stripe_newton.robot_files import RobotFileError, mjcf_stage
from stripe_newton.usd import load_stage
from tests.helpers.stage_triangles import ray_lengths

WEDGE = "0 0 0  0.6 0 0  0 0.4 0  0 0 0.3"
ARENA = f"""<mujoco><asset><mesh name="wedge" vertex="{WEDGE}"/><material name="red" rgba="1 0 0 1"/>
<hfield name="hills" nrow="3" ncol="4" size="2 1 0.5 0.1" elevation="0 .2 .4 0  1 .5 .3 .2  0 0 .1 .6"/></asset>
<worldbody><light pos="0 0 3"/><geom name="ground" type="plane" size="5 5 .1"/>
<body name="room" pos="1 2 0.3" euler="10 20 30">
<geom name="box" type="box" size=".1 .2 .3" pos="0 1 0" euler="0 40 0" friction="0.7 .005 .0001" material="red"/>
<geom name="ball" size=".2" pos="0 2 0"/><geom name="pill" type="capsule" size=".1 .4" euler="30 0 0"/>
<geom name="tin" type="cylinder" size=".1 .4" pos="1 0 0"/><geom name="seen" size="9" contype="0" conaffinity="0"/>
<geom name="wedge" type="mesh" mesh="wedge" pos="0 0 1" euler="0 0 50"/></body>
<geom name="hills" type="hfield" hfield="hills" pos="8 0 0"/>
<body name="cart"><freejoint/><geom name="cart" size=".1"/></body></worldbody></mujoco>"""


@pytest.fixture
def arena(tmp_path: Path) -> tuple[mujoco.MjModel, mujoco.MjData, Usd.Stage, list[tuple[str, str, str]]]:
    path = tmp_path / "arena.xml"
    path.write_text(ARENA)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data, *mjcf_stage(path)


def test_shapes_are_where_mujoco_has_them(arena):
    model, data, stage, rows = arena
    builder = newton.ModelBuilder()
    load_stage(builder, stage, allow_static=True)
    solid = {
        builder.shape_label[s].rpartition("/")[2]: s
        for s in range(builder.shape_count)
        if builder.shape_flags[s] & ShapeFlags.COLLIDE_SHAPES
    }
    assert solid.keys() == {"ground", "box", "ball", "pill", "tin", "wedge", "hills"}
    kinds = {"box": GeoType.BOX, "ball": GeoType.SPHERE, "pill": GeoType.CAPSULE, "tin": GeoType.CYLINDER}
    for name, kind in kinds.items():
        shape, geom = solid[name], model.geom(name).id
        assert builder.shape_type[shape] == kind
        pose = np.array(builder.shape_transform[shape])
        np.testing.assert_allclose(pose[:3], data.geom_xpos[geom], atol=1e-5)
        turn = np.array(wp.quat_to_matrix(wp.quat(*pose[3:].tolist()))).reshape(3, 3)
        used = {"box": 3, "ball": 1, "pill": 2, "tin": 2}[name]
        if name != "ball":
            np.testing.assert_allclose(turn, data.geom_xmat[geom].reshape(3, 3), atol=1e-5)
        np.testing.assert_allclose(np.array(builder.shape_scale[shape])[:used], model.geom_size[geom][:used], rtol=1e-5)
    assert builder.shape_material_mu[solid["box"]] == pytest.approx(0.7)
    assert builder.shape_material_mu[solid["ball"]] == pytest.approx(1.0)
    assert UsdGeom.Gprim(stage.GetPrimAtPath("/Arena/box")).GetDisplayColorAttr().Get()[0] == (1, 0, 0)
    said = {what: where for where, what, _ in rows}
    assert said == {"moves": "cart", "not read": "1 lights"}


@pytest.mark.parametrize("name", ["wedge", "hills"])
def test_rays_end_where_mujocos_end(arena, name):
    model, data, stage, _ = arena
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/Arena/{name}"))
    matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(mesh.GetPrim()))
    points = np.array(mesh.GetPointsAttr().Get(), dtype=float) @ matrix[:3, :3] + matrix[3, :3]
    corners = points[np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)]
    geom, random, found = model.geom(name).id, np.random.default_rng(0), 0
    for _ in range(60):
        x, y = random.uniform(points[:, :2].min(axis=0), points[:, :2].max(axis=0))
        start, down = np.array([x, y, 5.0]), np.array([0.0, 0.0, -1.0])
        if name == "wedge":
            length = mujoco.mj_rayMesh(model, data, geom, start, down, None)
        else:
            length = mujoco.mj_rayHfield(model, data, geom, start, down, None)
        own = ray_lengths(corners, start[None], down[None])[0]
        # The sides and the base of a height field are not part of the surface.
        assert (length >= 0.0) == np.isfinite(own)
        if length >= 0.0:
            found += 1
            assert own == pytest.approx(length, abs=1e-5)
    assert found > 20


def test_a_robot_alone_is_no_arena(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text('<mujoco><worldbody><body><freejoint/><geom size="1"/></body></worldbody></mujoco>')
    with pytest.raises(RobotFileError, match="nothing with a shape stands still in it: load it as an asset"):
        mjcf_stage(path)
