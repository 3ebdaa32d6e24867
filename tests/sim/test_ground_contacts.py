# SPDX-License-Identifier: Apache-2.0
"""Ground contacts from the triangles of height fields: against brute force, planes, and MuJoCo Warp's routine."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import newton
import numpy as np
import pytest
import trimesh
import warp as wp

from stripe_kernels.heightfield import Field, Touches, add_touch, sphere_touch
from stripe_newton.sim import MuJoCoSolverCfg
from stripe_newton.sim.ground_contacts import use_triangles

DT = 0.004
HALF = 2.0


@wp.kernel(enable_backward=False)
def find_touches(
    field: Field,
    centre: wp.array[wp.vec3],
    radius: float,
    found: wp.array2d[int],
    dist: wp.array2d[float],
    point: wp.array2d[wp.vec3],
    normal: wp.array2d[wp.vec3],
):
    i = wp.tid()
    touches = Touches()
    for slot in range(3):
        touch = sphere_touch(field, centre[i], radius, 0.0, touches)
        if touch.found:
            touches = add_touch(touches, touch)
            found[i, slot] = 1
            dist[i, slot] = touch.dist
            point[i, slot] = touch.point
            normal[i, slot] = touch.normal


def surface(heights: np.ndarray, half: float = HALF) -> trimesh.Trimesh:
    """The triangles that MuJoCo makes of a square field."""
    n = len(heights)
    x = np.linspace(-half, half, n)
    grid = np.stack([*np.meshgrid(x, x), heights], axis=-1).reshape(-1, 3)
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    return trimesh.Trimesh(grid, faces, process=False)


def touches_of(heights: np.ndarray, centres: np.ndarray, radius: float) -> tuple[np.ndarray, ...]:
    field, n = Field(), len(heights)
    scale = float(heights.max())
    field.heights = wp.array((heights / scale).astype(np.float32).ravel(), dtype=float)
    field.nrow = field.ncol = n
    field.size = wp.vec4(HALF, HALF, scale, 0.1)
    shape = (len(centres), 3)
    out = [wp.zeros(shape, dtype=t) for t in (int, float, wp.vec3, wp.vec3)]
    centre = wp.array(centres.astype(np.float32), dtype=wp.vec3)
    wp.launch(find_touches, dim=len(centres), inputs=[field, centre, radius], outputs=out)
    return tuple(a.numpy() for a in out)


def test_the_nearest_touch_is_the_nearest_point_of_the_surface():
    rng = np.random.default_rng(0)
    heights = rng.uniform(0.0, 0.3, (21, 21))
    mesh, radius = surface(heights), 0.1
    centres = np.column_stack([rng.uniform(-1.8, 1.8, (1500, 2)), rng.uniform(0.05, 0.45, 1500)])
    found, dist, point, normal = touches_of(heights, centres, radius)
    nearest, gap, _ = trimesh.proximity.closest_point_naive(mesh, centres)
    above = ~mesh_covers(mesh, centres)
    touching = above & (gap < radius)
    assert touching.sum() > 100
    assert (~above).sum() > 100
    clear = above & (np.abs(gap - radius) > 1e-5)
    np.testing.assert_array_equal(found[clear, 0] == 1, touching[clear])
    np.testing.assert_allclose(dist[touching, 0], gap[touching] - radius, atol=2e-6)
    np.testing.assert_allclose(point[touching, 0], nearest[touching], atol=2e-4)
    away = (centres - nearest)[touching] / gap[touching, None]
    np.testing.assert_allclose(normal[touching, 0], away, atol=2e-2)
    assert (found[~above, 0] == 1).all()
    assert (found[~above, 1] == 0).all()
    np.testing.assert_array_less(dist[~above, 0], -radius + 1e-6)
    assert np.median(np.abs(dist[~above, 0] + radius + gap[~above])) < 1e-6


def mesh_covers(mesh: trimesh.Trimesh, points: np.ndarray) -> np.ndarray:
    """Whether points lie below a surface, by the barycentric coordinates of the triangle over them."""
    tri = mesh.triangles
    below = np.zeros(len(points), dtype=bool)
    for i, p in enumerate(points):
        near = np.abs(tri[:, :, :2].mean(axis=1) - p[:2]).max(axis=1) < 0.2
        flat = tri[near].copy()
        flat[:, :, 2] = 0.0
        share = trimesh.triangles.points_to_barycentric(flat, np.tile([*p[:2], 0.0], (len(flat), 1)))
        inside = (share >= -1e-9).all(axis=1)
        below[i] = p[2] < (share[inside] * tri[near][inside][:, :, 2]).sum(axis=1).max()
    return below


def test_a_level_surface_has_one_touch_and_a_corner_two():
    heights = np.full((41, 41), 0.2)
    heights[:, 21:] = 0.6  # a wall, one cell thick
    centres = np.array([[-1.03, 0.02, 0.25], [-0.05, 0.02, 0.25], [-0.05, 0.33, 0.25]])
    found, dist, _, normal = touches_of(heights, centres, 0.07)
    assert found.sum(axis=1).tolist() == [1, 2, 2]
    np.testing.assert_allclose(dist[:, 0], -0.02, atol=1e-6)
    np.testing.assert_allclose(normal[:, 0], [[0, 0, 1]] * 3, atol=1e-6)
    wall = np.array([-4.0, 0.0, 1.0]) / math.sqrt(17.0)  # 0.4 m over a cell of 0.1 m
    np.testing.assert_allclose(normal[1:, 1], [wall] * 2, atol=1e-6)


# -- in the simulation


def simulate(ground: Any, body: str, starts: np.ndarray, steps: int, **options: Any) -> tuple[np.ndarray, Any]:
    """Poses of a free body in worlds that start at ``starts``, shape ``(steps, worlds, 7)``, and the solver."""
    solver = newton.solvers.SolverMuJoCo
    whole, one = newton.ModelBuilder(), newton.ModelBuilder()
    for builder in (whole, one):
        solver.register_custom_attributes(builder)
        builder.default_shape_cfg.mu = 0.6
    ground(whole)
    index = one.add_body()
    if body == "sphere":
        one.add_shape_sphere(index, radius=0.08)
    elif body == "capsule":
        one.add_shape_capsule(index, radius=0.05, half_height=0.12)
    elif body == "box":
        one.add_shape_box(index, hx=0.15, hy=0.1, hz=0.06)
    else:
        one.add_shape_cylinder(index, radius=0.08, half_height=0.1)
    whole.replicate(one, len(starts))
    model = whole.finalize(device="cpu")
    made = MuJoCoSolverCfg(**{"nconmax": 40, "njmax": 200} | options).create(model)
    state, control, poses = model.state(), model.control(), []
    state.joint_q.assign(starts.astype(np.float32).ravel())
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    for _ in range(steps):
        made.step(state, state, control, None, DT)
        poses.append(state.joint_q.numpy().reshape(-1, 7).copy())
    return np.array(poses), made


def field(heights: np.ndarray) -> Any:
    data, n = heights.astype(np.float32), len(heights)
    made = newton.Heightfield(data=data, nrow=n, ncol=n, hx=HALF, hy=HALF)
    return lambda builder: builder.add_shape_heightfield(heightfield=made)


def plane(slope: float) -> Any:
    angle = math.atan(slope)
    normal = (-math.sin(angle), 0.0, math.cos(angle))
    return lambda builder: builder.add_shape_plane(plane=(*normal, 0.0), width=0.0, length=0.0)


def thrown(slope: float = 0.0, count: int = 6) -> np.ndarray:
    rng = np.random.default_rng(3)
    turn = rng.normal(size=(count, 4))
    xy = rng.uniform(-0.6, 0.6, (count, 2))
    return np.column_stack([xy, slope * xy[:, 0] + 0.3, turn / np.linalg.norm(turn, axis=1, keepdims=True)])


def sloping(slope: float) -> np.ndarray:
    heights = np.tile(slope * np.linspace(-HALF, HALF, 41), (41, 1))
    if slope == 0.0:
        heights[0, 0] = -1.0e-3  # a field without any relief has no scale
    return heights


def laid(slope: float, count: int = 6) -> np.ndarray:
    """Bodies a little above the slope, turned about its normal alone."""
    starts, angle = thrown(slope, count), -math.atan(slope)
    starts[:, 2] += -0.3 + 0.17
    yaw = np.random.default_rng(5).uniform(-3.0, 3.0, count)
    lean = trimesh.transformations.quaternion_about_axis(angle, (0, 1, 0))
    for row, turn in zip(starts, yaw, strict=True):
        spin = trimesh.transformations.quaternion_about_axis(turn, (0, 0, 1))
        level = trimesh.transformations.quaternion_about_axis(math.pi / 2, (0, 1, 0))
        w, *xyz = trimesh.transformations.quaternion_multiply(
            lean, trimesh.transformations.quaternion_multiply(spin, level)
        )
        row[3:] = *xyz, w
    return starts


@pytest.mark.parametrize("slope", [0.0, 0.3])
@pytest.mark.parametrize(("body", "tolerance"), [("sphere", 1e-4), ("capsule", 5e-3), ("box", 5e-3)])
def test_a_slope_of_triangles_is_a_plane(body, tolerance, slope):
    starts = thrown(slope) if body == "sphere" else laid(slope)
    ours, _ = simulate(field(sloping(slope)), body, starts, 200)
    same, _ = simulate(plane(slope), body, starts, 200)
    assert np.abs(ours - same)[..., :3].max() < tolerance
    assert np.ptp(ours[:, :, 2], axis=0).min() > 0.01  # they fell


def test_a_box_stays_on_a_level_field():
    """The general routine lets it through: the prisms are as thin as the field."""
    poses, _ = simulate(field(sloping(0.0)), "box", thrown(), 200)
    assert poses[-1, :, 2].min() > 0.055


@pytest.mark.slow
def test_a_ball_comes_to_rest_where_the_general_routine_puts_it():
    x = np.linspace(-HALF, HALF, 81)
    valley = 0.5 * np.abs(x)[None, :] + 0.4 * np.abs(x)[:, None]  # a pit with four walls
    starts = thrown()
    starts[:, 2] = 0.5 * np.abs(starts[:, 0]) + 0.4 * np.abs(starts[:, 1]) + 0.12
    drag = {"density": 60.0, "viscosity": 1.5}  # else it rolls to and fro for long
    ours, _ = simulate(field(valley), "sphere", starts, 900, **drag)
    general, _ = simulate(field(valley), "sphere", starts, 900, triangle_contacts=False, **drag)
    assert np.abs(ours[-1, :, :3] - general[-1, :, :3]).max() < 0.01
    assert np.abs(ours[-1, :, :2]).max() < 0.01  # the bottom


def stairs(step: float = 0.1, tread: float = 0.5, n: int = 81) -> np.ndarray:
    x = np.linspace(-HALF, HALF, n)
    return np.tile(step * np.floor((x + HALF + 1e-9) / tread), (n, 1))


def test_a_ball_rolls_down_stairs_as_with_the_general_routine():
    starts = thrown(count=4)
    starts[:, 0] = [1.30, 0.84, 0.30, -0.20]
    starts[:, 2] = 0.1 * np.floor((starts[:, 0] + HALF) / 0.5) + 0.0801
    ours, _ = simulate(tilted(stairs()), "sphere", starts, 500)
    general, _ = simulate(tilted(stairs()), "sphere", starts, 500, triangle_contacts=False)
    assert np.abs(ours - general)[:60, :, :3].max() < 0.01
    np.testing.assert_allclose(ours[-1, :, 2], general[-1, :, 2], atol=0.02)  # the same tread
    np.testing.assert_allclose(ours[-1, :, 0], general[-1, :, 0], atol=0.1)


def tilted(heights: np.ndarray) -> Any:
    """Treads that lean 2 % outwards, so that a ball rolls, to a wall that stops it."""
    n = len(heights)
    leaning = heights + 0.02 * np.linspace(-HALF, HALF, n)[None, :]
    leaning[:, :5] += 1.0
    return field(leaning)


def test_other_shapes_keep_the_general_routine():
    solver = simulate(field(stairs()), "cylinder", thrown(), 1, fused=False)[1]
    assert solver.mjw_model.callback.contactfilter is None
    solver = simulate(field(stairs()), "sphere", thrown(), 1, fused=False)[1]
    assert solver.mjw_model.callback.contactfilter is not None
    assert len(solver.mjw_model.nxn_geom_pair_filtered) == 0
    solver = simulate(field(stairs()), "sphere", thrown(), 1, triangle_contacts=False, fused=False)[1]
    assert len(solver.mjw_model.nxn_geom_pair_filtered) == 1
    assert use_triangles(solver.mjw_model) == 1
    solver = simulate(plane(0.0), "sphere", thrown(), 1, fused=False)[1]
    assert solver.mjw_model.callback.contactfilter is None


def test_contacts_that_do_not_fit_are_reported():
    low = thrown() - np.array([0, 0, 0.25, 0, 0, 0, 0])
    solver = simulate(field(sloping(0.0)), "box", low, 1, fused=False)[1]
    model, data = solver.model, solver.mjw_data
    data.naconmax = 3
    state, seen = model.state(), solver.observables({"overflow"})
    state.joint_q.assign(low.astype(np.float32).ravel())
    solver.mjw_model.opt.warn_overflow = 0
    solver.step(state, state, model.control(), None, DT, observables=seen)
    assert int(data.nacon.numpy()[0]) > 3
    assert seen.overflow.numpy().any()


def test_many_geoms_keep_the_general_routine_and_say_so():
    from mujoco_warp._src.types import BroadphaseType, GeomType

    kinds = wp.array([int(GeomType.HFIELD)] + [int(GeomType.SPHERE)] * 3, dtype=int, device="cpu")
    model = SimpleNamespace(geom_type=kinds, opt=SimpleNamespace(broadphase=BroadphaseType.SAP_TILE))
    with pytest.warns(UserWarning, match="4 geoms are too many"):
        assert use_triangles(model) == 0
