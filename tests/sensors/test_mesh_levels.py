# SPDX-License-Identifier: Apache-2.0
"""Coarser versions of meshes: how far their surfaces move, and what pictures show of it."""

from __future__ import annotations

import newton
import numpy as np
import warp as wp

from stripe_newton.sensors import CameraCfg, PinholeCameraCfg
from stripe_newton.sensors.mesh_levels import FEWEST_TRIANGLES, Triangles, cluster_vertices, coarser_versions
from tests.helpers.ray_world import place, ray_scene
from tests.helpers.small_scenes import DT

DEVICE = wp.get_device("cpu")


def torus(across: int, around: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A ring of radius 0.3 and thickness 0.1 about z: vertices, faces and normals."""
    u, v = (2.0 * np.pi * np.arange(n) / n for n in (across, around))
    u, v = np.meshgrid(u, v, indexing="ij")
    normals = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=-1).reshape(-1, 3)
    middle = np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(across), np.arange(around), indexing="ij")
    after, up = (i + 1) % across, (j + 1) % around
    a, b, c, d = i * around + j, after * around + j, after * around + up, i * around + up
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return 0.3 * middle + 0.1 * normals, faces, normals


def ring(across: int = 96, around: int = 48) -> Triangles:
    vertices, faces, normals = torus(across, around)
    return Triangles(vertices, faces, normals, np.zeros(len(faces), dtype=np.int64))


def points_on(mesh: Triangles, count: int) -> np.ndarray:
    """Random points on the faces of a mesh."""
    rng = np.random.default_rng(1)
    share = rng.dirichlet(np.ones(3), count)
    return (mesh.vertices[mesh.faces[rng.integers(0, len(mesh.faces), count)]] * share[..., None]).sum(axis=1)


def test_versions_of_a_ring_are_as_near_to_it_as_they_say():
    versions = coarser_versions([ring()], DEVICE)
    assert len(versions) >= 3
    counts, errors = [len(v.faces) for v in versions], [v.error for v in versions]
    assert counts == sorted(counts, reverse=True)
    assert counts[0] <= 0.75 * 2 * 96 * 48
    assert errors == sorted(errors)
    for version in versions:
        # The formula of the ring rather than its triangles.
        points = points_on(version, 4000)
        apart = np.abs(np.hypot(np.hypot(points[:, 0], points[:, 1]) - 0.3, points[:, 2]) - 0.1)
        assert apart.max() <= 1.5 * version.error + 5e-4
        assert version.error < 0.15
        np.testing.assert_allclose(np.linalg.norm(version.normals, axis=1), 1.0, atol=1e-9)


def test_a_box_keeps_its_corners_and_stays_closed():
    grid = np.linspace(-1.0, 1.0, 23)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    i, j = (a.ravel() for a in np.meshgrid(np.arange(22), np.arange(22), indexing="ij"))
    a = i * 23 + j
    side = np.concatenate([np.stack([a, a + 23, a + 24], 1), np.stack([a, a + 24, a + 1], 1)])
    vertices, faces, normals = [], [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            flat = np.stack([x.ravel(), y.ravel(), np.full(x.size, sign)], axis=1)
            faces.append(side + 529 * len(vertices))
            vertices.append(np.roll(flat, axis, axis=1))
            normals.append(np.broadcast_to(np.roll([0.0, 0.0, sign], axis), (529, 3)))
    box = Triangles(*map(np.concatenate, (vertices, faces, normals)), np.zeros(len(faces) * len(side), dtype=np.int64))
    coarse = cluster_vertices(box, 0.45)
    assert len(coarse.faces) < 0.1 * len(box.faces)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    apart = np.linalg.norm(coarse.vertices[None] - corners[:, None], axis=-1).min(axis=1)
    assert apart.max() < 0.02  # a mean of the vertices would be 0.1 to 0.3 from it
    assert np.abs(coarse.normals).max(axis=1).min() > 0.999  # sharp edges: each normal is that of one side
    # Each edge, by the places of its ends, belongs to two triangles.
    spots = np.unique(coarse.vertices.round(6), axis=0, return_inverse=True)[1].reshape(-1)[coarse.faces]
    edges = np.sort(np.concatenate([spots[:, [0, 1]], spots[:, [1, 2]], spots[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_small_meshes_stay_as_they_are():
    small = ring(20, 10)
    assert len(small.faces) < FEWEST_TRIANGLES
    assert coarser_versions([small], DEVICE) == []


def add_rings(template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
    """Two linked rings on the body, which nothing collides with, and a floor."""
    static.add_shape_plane(plane=(0.0, 0.0, 1.0, 1.0), width=0.0, length=0.0, label="/World/ground/plane")
    vertices, faces, normals = torus(96, 48)
    look = newton.ModelBuilder.ShapeConfig(has_shape_collision=False, density=0.0)
    for name, at, scale in (("one", (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), ("two", (0.3, 0.0, 0.1), (1.2, 0.8, 1.0))):
        mesh = newton.Mesh(vertices, faces.ravel(), normals=normals, compute_inertia=False)
        pose = wp.transform(at, wp.quat_rpy(0.5, 0.3, 0.2))
        color = (0.9, 0.4, 0.2) if name == "one" else (0.2, 0.5, 0.9)
        template.add_shape_mesh(0, mesh=mesh, xform=pose, scale=scale, cfg=look, color=color, label=f"/{name}")


def pictures(detail: float, height: float):
    """The camera, and its images, of two rings from above."""
    camera = CameraCfg(
        prim_path="{ENV_REGEX_NS}/eye", width=64, height=64, mesh_detail=detail,
        data_types=["rgb", "depth", "normals", "instance_id_segmentation"], shadows=True,
        spawn=PinholeCameraCfg(focal_length=24.0, horizontal_aperture=24.0, clipping_range=(0.05, 9.0)),
        offset=CameraCfg.OffsetCfg(pos=(0.1, 0.0, height), rot=(1.0, 0.0, 0.0, 0.0)),
    )  # fmt: skip
    scene = ray_scene(camera, add_rings, 2)
    place(scene, np.array([[0.0, 0, 0, 0, 0, 0, 1], [0.1, -0.1, 0.1, 0.3, 0.1, 0.0, 0.94]]))
    eye = scene.sensors["rays"]
    eye.update(DT)
    return eye, {name: image.numpy().astype(float) for name, image in eye.data.output.items()}


def neighbours(image: np.ndarray) -> np.ndarray:
    """Values of each pixel and of the eight around it, shape ``(9, envs, height, width, channels)``."""
    wide = np.pad(image, ((0, 0), (1, 1), (1, 1), (0, 0)), mode="edge")
    rows, cols = image.shape[1:3]
    return np.stack([wide[:, i : i + rows, j : j + cols] for i in range(3) for j in range(3)])


def test_a_picture_shows_the_same_with_a_quarter_of_the_triangles():
    eye, coarse = pictures(0.5, height=1.6)
    plain, exact = pictures(0.0, height=1.6)
    renderer = eye.renderer
    assert "1 of them part of others" in renderer.describe()
    assert "part of others" not in plain.renderer.describe()
    drawn = renderer.triangles()
    assert 0 < drawn.max() < 0.3 * plain.renderer.triangles().min()
    # Each pixel is within the values that the picture of all triangles has there and in the pixels beside it.
    for name, limit in (("depth", 0.005), ("rgb", 12.0), ("normals", 0.1)):
        beside = neighbours(exact[name])
        apart = np.maximum(beside.min(axis=0) - coarse[name], coarse[name] - beside.max(axis=0)).max(axis=-1)
        assert (apart <= limit).mean() > 0.995, name
    labels = coarse["instance_id_segmentation"]
    assert len(np.unique(labels)) == 4  # floor, cube and both rings, though one slot has the rings
    assert (neighbours(exact["instance_id_segmentation"]) == labels).any(axis=0).mean() > 0.999
    assert (exact["instance_id_segmentation"] == labels).mean() > 0.98
    changed = np.abs(exact["rgb"] - coarse["rgb"]).max(axis=-1) > 1.0
    assert 0.0 < changed.mean() < 0.15


def test_a_mesh_is_drawn_with_all_triangles_from_near():
    near, close = pictures(0.5, height=0.35)
    plain, exact = pictures(0.0, height=0.35)
    assert near.renderer.triangles().max() > 0.5 * plain.renderer.triangles().max()
    assert np.abs(close["depth"] - exact["depth"]).max() < 0.02
