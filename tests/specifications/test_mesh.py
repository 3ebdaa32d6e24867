# SPDX-License-Identifier: Apache-2.0
"""Asset meshes: their content, colliders around them, files of other programs."""

from __future__ import annotations

from pathlib import Path

import mujoco_warp
import newton.usd
import numpy as np
import pytest
import trimesh
from newton.examples import get_asset
from pxr import Usd, UsdGeom
from scipy.spatial.transform import Rotation

from stripe_newton.specifications import (
    BoxMesh,
    CapsuleMesh,
    Collider,
    ConeMesh,
    CylinderMesh,
    MeshPart,
    SphereMesh,
    UniversalMesh,
    USDMesh,
    fit_collider,
)


def distance(collider: Collider, points: np.ndarray) -> np.ndarray:
    """Signed distance of points from a primitive, or a bound of it that is negative inside [m]."""
    local = Rotation.from_quat(collider.rot).inv().apply(np.asarray(points, dtype=float) - collider.pos)
    size = collider.size
    if collider.kind == "box":
        return (np.abs(local) - size).max(axis=1)
    if collider.kind == "sphere":
        return np.linalg.norm(local, axis=1) - size[0]
    if collider.kind == "cylinder":
        return np.maximum(np.linalg.norm(local[:, :2], axis=1) - size[0], np.abs(local[:, 2]) - size[1])
    along = np.clip(local[:, 2], -size[1], size[1])
    return np.linalg.norm(local - np.outer(along, [0.0, 0.0, 1.0]), axis=1) - size[0]


@pytest.mark.parametrize("kind", ["auto", "sphere", "capsule", "cylinder", "box"])
@pytest.mark.parametrize("seed", range(4))
def test_a_fitted_primitive_holds_all_points_and_touches_some(kind, seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(200, 3)) * rng.uniform(0.2, 2.0, 3)
    points = Rotation.random(random_state=seed).apply(points) + rng.normal(size=3)
    collider = fit_collider(points, kind)
    assert kind in ("auto", collider.kind)
    found = distance(collider, points)
    assert found.max() < 1e-6
    assert found.max() > -1e-3


@pytest.mark.parametrize(
    ("mesh", "kind", "size"),
    [
        (trimesh.creation.box((0.4, 1.0, 2.0)), "box", (0.2, 0.5, 1.0)),
        (trimesh.creation.icosphere(3, 0.7), "sphere", (0.7,)),
        (trimesh.creation.cylinder(0.3, 2.0, sections=64), "cylinder", (0.3, 1.0)),
        (trimesh.creation.capsule(3.0, 0.25, count=(32, 32)), "capsule", (0.25, 1.5)),
    ],
)
def test_the_tightest_primitive_of_a_shape_is_that_shape(mesh, kind, size):
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.random.default_rng(1).random(3)))
    collider = fit_collider(mesh.vertices)
    assert collider.kind == kind
    np.testing.assert_allclose(np.sort(collider.size), np.sort(size), rtol=0.02)


@pytest.mark.parametrize(
    "mesh",
    [
        BoxMesh("m", (0.2, 0.3, 0.4)),
        SphereMesh("m", (0.3,)),
        CapsuleMesh("m", (0.1, 0.5)),
        CylinderMesh("m", (0.2, 0.6)),
        ConeMesh("m", (0.2, 0.6)),
    ],
    ids=lambda mesh: type(mesh).__name__,
)
def test_a_primitive_stands_on_the_ground_and_is_its_own_collider(mesh):
    (part,), (collider,) = mesh.parts(), mesh.colliders()
    assert part.vertices[:, 2].min() == pytest.approx(0.0, abs=1e-6)
    found = distance(collider, part.vertices)
    assert found.max() < 1e-5
    assert trimesh.Trimesh(part.vertices, part.faces).volume > 0.0  # faces look outward


def test_a_mesh_file_of_others():
    path = next((Path(mujoco_warp.__file__).parent / "test_data").rglob("*.stl"))
    mesh, whole = UniversalMesh(path, scale=0.5), trimesh.load(path, force="mesh")
    vertices = np.concatenate([p.vertices for p in mesh.parts()])
    np.testing.assert_allclose(np.stack([vertices.min(axis=0), vertices.max(axis=0)]), 0.5 * whole.bounds, atol=1e-5)
    (collider,) = mesh.colliders()
    assert distance(collider, vertices).max() < 1e-5
    assert not UniversalMesh(path, collider=None).colliders()


def test_a_usd_file_of_others_in_metres_and_z_up():
    path = get_asset("bunny.usd")
    mesh = USDMesh(path)
    stage = Usd.Stage.Open(path)
    prim = next(p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh))
    expected = np.asarray(newton.usd.get_mesh(prim).vertices)
    matrix = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim))
    expected = (expected @ matrix[:3, :3] + matrix[3, :3]) * UsdGeom.GetStageMetersPerUnit(stage)
    if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
        expected = np.stack([expected[:, 0], -expected[:, 2], expected[:, 1]], axis=1)
    vertices = mesh.parts()[0].vertices
    np.testing.assert_allclose(vertices.min(axis=0), expected.min(axis=0), atol=1e-4)
    np.testing.assert_allclose(vertices.max(axis=0), expected.max(axis=0), atol=1e-4)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: UniversalMesh("nowhere.obj"), "'nowhere.obj' does not exist"),
        (lambda: UniversalMesh(get_asset("bunny.usd")).parts(), "use USDMesh"),
        (lambda: BoxMesh("b", (0.1, -1.0, 1.0)), "lengths must be positive"),
        (lambda: Collider("tube", (1.0,)), "must be one of sphere, capsule"),
        (lambda: Collider("capsule", (1.0,)), "must be 2 lengths"),
        (lambda: MeshPart("p", np.zeros((3, 2)), np.zeros((1, 3))), "must be (V, 3)"),
        (lambda: MeshPart("p", np.zeros((3, 3)), np.array([[0, 1, 3]])), "must be (F, 3) and name its 3 vertices"),
        (lambda: fit_collider(np.zeros((10, 3))), "span no volume"),
        (lambda: fit_collider(np.eye(4)[:, :3], "cone"), "kind is 'cone'"),
    ],
)
def test_what_is_wrong_is_said(make, text):
    with pytest.raises((ValueError, FileNotFoundError)) as error:
        make()
    assert text in str(error.value)
