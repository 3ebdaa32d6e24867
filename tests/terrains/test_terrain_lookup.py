# SPDX-License-Identifier: Apache-2.0
"""Terrain look-up of heights: against triangles, Newton's rays and MuJoCo Warp's contacts."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import warp as wp

from stripe_kernels.terrain import TerrainData, terrain_height, terrain_max_height, terrain_normal
from stripe_newton.sim import MuJoCoSolverCfg
from stripe_newton.terrains import Ground
from tests.helpers.terrain_world import ground_data, hills, reference_height


@wp.kernel(enable_backward=False)
def look_up(
    terrain: TerrainData,
    point: wp.array[wp.vec2],
    reach: float,
    height: wp.array[float],
    normal: wp.array[wp.vec3],
    top: wp.array[float],
):
    i = wp.tid()
    height[i] = terrain_height(terrain, point[i][0], point[i][1])
    normal[i] = terrain_normal(terrain, point[i][0], point[i][1])
    top[i] = terrain_max_height(terrain, point[i][0], point[i][1], reach)


def looked_up(ground: Ground, points: np.ndarray, reach: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    data = ground_data(ground)
    out = [wp.zeros(len(points), dtype=t) for t in (float, wp.vec3, float)]
    where = wp.array(points.astype(np.float32), dtype=wp.vec2)
    wp.launch(look_up, dim=len(points), inputs=[data, where, reach], outputs=out)
    height, normal, top = (a.numpy() for a in out)
    return height, normal, top


def random_points(count: int, inside: float = 0.0, seed: int = 4) -> np.ndarray:
    ground = hills()
    lower, size = np.array(ground.lower), np.array(ground.size)
    points = np.random.default_rng(seed).uniform(lower + inside, lower + size - inside, (count, 2))
    return points.astype(np.float32).astype(float)


def test_the_height_is_that_of_the_triangle_below():
    points = random_points(500)
    height, _, _ = looked_up(hills(), points)
    np.testing.assert_allclose(height, reference_height(hills(), *points.T), atol=2e-6)
    np.testing.assert_allclose(hills().height_at(*points.T), reference_height(hills(), *points.T), atol=1e-9)


def test_beyond_the_edge_the_ground_goes_on_level():
    ground = hills()
    lower, upper = np.array(ground.lower), np.array(ground.lower) + ground.size
    points = np.array([lower - 5.0, upper + 5.0, [lower[0] - 1.0, 5.0], [0.0, upper[1] + 9.0], [np.nan, np.nan]])
    height, _, _ = looked_up(ground, points)
    np.testing.assert_allclose(height[[0, 1]], [ground.heights[0, 0], ground.heights[-1, -1]], atol=1e-6)
    np.testing.assert_allclose(height[2:4], reference_height(ground, *points[2:4].T), atol=2e-6)
    assert np.isfinite(height).all()


def test_the_normal_is_that_of_the_slope():
    points = random_points(400, inside=0.01)
    _, normal, _ = looked_up(hills(), points)
    ground, h = hills(), 1e-5
    x, y = points.T
    slope = [
        (ground.height_at(x + h * dx, y + h * dy) - ground.height_at(x - h * dx, y - h * dy)) / (2.0 * h)
        for dx, dy in ((1, 0), (0, 1))
    ]
    expected = np.stack([-slope[0], -slope[1], np.ones(len(x))], axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    error = abs(normal - expected).max(axis=1)
    assert (error < 1e-3).mean() > 0.99  # a difference across an edge is none
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("reach", [0.0, 0.15, 0.7])
def test_the_greatest_height_about_a_point(reach):
    ground, points = hills(), random_points(200)
    height, _, top = looked_up(ground, points, reach)
    if reach == 0.0:
        np.testing.assert_array_equal(top, height)
        return
    offsets = np.linspace(-reach, reach, 15)
    for i, (x, y) in enumerate(points):
        dense = ground.height_at(x + offsets[None, :], y + offsets[:, None]).max()
        wide = ground.height_at(
            x + np.linspace(-reach - 0.4, reach + 0.4, 60)[None, :],
            y + np.linspace(-reach - 0.3, reach + 0.3, 60)[:, None],
        ).max()
        assert dense - 1e-5 <= top[i] <= max(wide, dense) + 0.05


def test_rays_of_newton_find_the_same_surface():
    ground = hills()
    builder = newton.ModelBuilder()
    builder.add_shape_heightfield(
        xform=wp.transform(wp.vec3(*ground.middle, 0.0), wp.quat_identity()), heightfield=ground.source
    )
    model = builder.finalize(device="cpu")
    points = random_points(300, inside=0.02)

    mesh = model.heightfield_meshes[0]
    hits = wp.zeros(len(points), dtype=float)
    starts = np.column_stack([points - ground.middle, np.full(len(points), 5.0)]).astype(np.float32)
    wp.launch(cast_down, dim=len(points), inputs=[mesh.id, wp.array(starts, dtype=wp.vec3)], outputs=[hits])
    height, _, _ = looked_up(ground, points)
    np.testing.assert_allclose(hits.numpy(), height, atol=2e-5)


@wp.kernel(enable_backward=False)
def cast_down(mesh: wp.uint64, start: wp.array[wp.vec3], height: wp.array[float]):
    i = wp.tid()
    query = wp.mesh_query_ray(mesh, start[i], wp.vec3(0.0, 0.0, -1.0), 100.0)
    height[i] = wp.where(query.result, start[i][2] - query.t, -1.0e9)


def test_contacts_find_the_same_surface():
    """Spheres are pressed 1 mm into the ground that was looked up, along its normal: MuJoCo Warp is to say so."""
    x, y = np.arange(41) * 0.4, np.arange(31) * 0.3
    waves = 0.4 * np.sin(0.9 * x)[None, :] * np.cos(1.1 * y)[:, None]
    ground = Ground(waves + 0.02 * np.random.default_rng(7).uniform(size=(31, 41)), (-7.0, 2.0), (0.4, 0.3))
    radius, depth = 0.02, 0.001
    columns, rows = np.meshgrid(np.arange(2, 38, 4), np.arange(2, 28, 4))
    upper = np.arange(columns.size) % 2 == 1  # a third of a cell from the corner of either triangle
    share = np.where(upper, 0.7, 0.3)
    points = np.column_stack([x[columns.ravel()] + 0.4 * share - 7.0, y[rows.ravel()] + 0.3 * share + 2.0])
    height, normal, _ = looked_up(ground, points)
    centres = np.column_stack([points, height]) + (radius - depth) * normal
    world = newton.ModelBuilder()
    MuJoCoSolverCfg().register(world)
    for centre in centres:
        body = world.add_body(xform=wp.transform(wp.vec3(*map(float, centre)), wp.quat_identity()))
        world.add_shape_sphere(body, radius=radius)
    field = wp.transform(wp.vec3(*ground.middle, 0.0), wp.quat_identity())
    world.add_shape_heightfield(xform=field, heightfield=ground.source)
    model = world.finalize(device="cpu")
    solver = MuJoCoSolverCfg(nconmax=400, njmax=1600).create(model)
    state = model.state()
    solver.step(state, state, model.control(), None, 1e-6)
    found = solver.mjw_data.contact
    count = int(solver.mjw_data.nacon.numpy()[0])
    assert count == len(points)
    order = np.argsort(found.geom.numpy()[:count].max(axis=1))
    np.testing.assert_allclose(found.dist.numpy()[order], -depth, atol=1e-5)
    np.testing.assert_allclose(found.frame.numpy()[order, 0], normal, atol=1e-4)
