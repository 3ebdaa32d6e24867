# SPDX-License-Identifier: Apache-2.0
"""Terrain files: meshes become height fields; warnings and errors about others."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from tests.helpers.terrain_world import yard


def wavy(n: int = 21) -> trimesh.Trimesh:
    x = np.linspace(-3.0, 3.0, n)
    grid = np.stack([*np.meshgrid(x, x), 0.2 * np.sin(x)[None, :] + 0.1 * np.cos(2.0 * x)[:, None]], axis=-1)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    return trimesh.Trimesh(grid.reshape(-1, 3), faces, process=False)


def test_a_mesh_file_becomes_a_height_field(tmp_path):
    path = tmp_path / "hills.obj"
    wavy().export(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = yard(terrain_type="usd", terrain_generator=None, usd_path=str(path), horizontal_scale=0.3, build=True)
    ground = scene.terrain.ground
    assert ground.heights.shape == (21, 21)
    np.testing.assert_allclose(ground.heights, wavy().vertices[:, 2].reshape(21, 21), atol=1e-4)
    assert ground.lower == pytest.approx((-3.0, -3.0))
    np.testing.assert_allclose(scene.env_origins[:, 2], ground.height_at(*scene.env_origins[:, :2].T), atol=1e-6)


def stage_with_steps(path: Path, up: str, unit: float) -> None:
    """A floor, a mesh of four corners, and two cubes on it, one mirrored, in a stage of other units or axes."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, unit)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    floor = UsdGeom.Mesh.Define(stage, "/World/floor")
    flat = np.array([[-4, -2, 0], [4, -2, 0], [4, 2, 0], [-4, 2, 0]], dtype=float) / unit
    turn = (lambda p: p) if up == "Z" else (lambda p: np.stack([p[..., 0], p[..., 2], -p[..., 1]], axis=-1))
    floor.CreatePointsAttr([Gf.Vec3f(*map(float, p)) for p in turn(flat)])
    floor.CreateFaceVertexCountsAttr([4])
    floor.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    for name, x, height, mirror in (("low", -2.0, 0.2, 1.0), ("high", 2.0, 0.5, -1.0)):
        cube = UsdGeom.Cube.Define(stage, f"/World/steps/{name}")
        cube.CreateSizeAttr(1.0)
        cube.AddTranslateOp().Set(Gf.Vec3d(*map(float, turn(np.array([x, 0.0, height - 0.5]) / unit))))
        cube.AddScaleOp().Set(Gf.Vec3f(mirror / unit, 1.0 / unit, 1.0 / unit))
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Gprim):
            UsdPhysics.CollisionAPI.Apply(prim)
    ball = UsdGeom.Sphere.Define(stage, "/World/decoration")  # no collider, so no ground
    ball.CreateRadiusAttr(1.0 / unit)
    stage.GetRootLayer().Save()


@pytest.mark.parametrize(("up", "unit"), [("Z", 1.0), ("Y", 1.0), ("Z", 0.01)])
def test_a_usd_file_of_several_meshes_becomes_one_height_field(tmp_path, up, unit):
    path = tmp_path / "steps.usda"
    stage_with_steps(path, up, unit)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        terrain = yard(1, terrain_type="usd", terrain_generator=None, usd_path=str(path), env_spacing=0.0).terrain
    assert not [w for w in caught if "terrain" in str(w.message) and "overhang" in str(w.message)]
    ground = terrain.ground
    assert ground.size == pytest.approx((8.0, 4.0), abs=1e-4)
    places = np.array([[-2.0, 0.0], [2.0, 0.1], [0.0, 0.0], [-2.3, 0.3], [3.5, -1.5]])
    np.testing.assert_allclose(ground.height_at(*places.T), [0.2, 0.5, 0.0, 0.2, 0.0], atol=1e-4)


def test_overhangs_and_holes_are_warned_of(tmp_path):
    up = trimesh.transformations.translation_matrix([0.0, 0.0, 1.0])
    roof = trimesh.creation.box(extents=(1.0, 1.0, 0.1), transform=up)
    path = tmp_path / "roof.stl"
    trimesh.util.concatenate([wavy(), roof]).export(path)
    with pytest.warns(UserWarning, match=r"has an overhang; .* up to 1\.\d\d m below"):
        terrain = yard(1, terrain_type="usd", terrain_generator=None, usd_path=str(path), env_spacing=0.0).terrain
    assert terrain.ground.height_at(np.array([0.0]), np.array([0.0]))[0] == pytest.approx(1.05, abs=1e-4)
    pillars = [
        trimesh.creation.box(extents=(1.0, 1.0, 0.4), transform=trimesh.transformations.translation_matrix([x, 0, 0]))
        for x in (-1.0, 1.0)
    ]
    path = tmp_path / "pillars.ply"
    trimesh.util.concatenate(pillars).export(path)
    with pytest.warns(UserWarning, match=r"nothing is below 3\d.\d% of its extent"):
        yard(1, terrain_type="usd", terrain_generator=None, usd_path=str(path), env_spacing=0.0)


def test_files_that_are_no_ground_are_refused(tmp_path):
    path = tmp_path / "empty.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.Xform.Define(stage, "/World")
    stage.GetRootLayer().Save()
    with pytest.raises(ValueError, match="has no mesh, cube, sphere"):
        yard(1, terrain_type="usd", terrain_generator=None, usd_path=str(path))
    mesh = tmp_path / "wall.obj"
    wavy().apply_transform(trimesh.transformations.scale_matrix(0.0, direction=[1, 0, 0])).export(mesh)
    with pytest.raises(ValueError, match="no extent in x or y"):
        yard(1, terrain_type="usd", terrain_generator=None, usd_path=str(mesh))
    wavy().export(mesh)
    with pytest.raises(ValueError, match="set a greater horizontal_scale"):
        yard(1, terrain_type="usd", terrain_generator=None, usd_path=str(mesh), horizontal_scale=1e-4)
    with pytest.raises(ValueError, match="the stage holds no height field there"):
        yard(1, terrain_type="stage", terrain_generator=None)
