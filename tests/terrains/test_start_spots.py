# SPDX-License-Identifier: Apache-2.0
"""Places to start: level, clear and on floors that are large enough, compared with NumPy and trimesh."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import trimesh
import warp as wp
from scipy.spatial import cKDTree

from stripe_kernels import start_spots as kernels
from stripe_newton.terrains import StartSpotsCfg
from stripe_newton.terrains.collider_mesh import collider_mesh, triangles_of
from stripe_newton.terrains.start_spots import _verdicts, choose_spots, find_floors
from tests.helpers.stage_triangles import ray_lengths, stage_triangles, surface_points
from tools.authoring.author_flat import GALLERY, author_flat

RADIUS, HEIGHT = 0.4, 0.5
BOUNDS = np.array([[-5.0, -3.5, -0.2], [5.0, 3.5, 4.0]])


def world(*boxes: tuple, device: str = "cpu") -> wp.Mesh:
    """A world of boxes, each by its lower and upper corner."""
    made = [trimesh.creation.box(bounds=[box[:3], box[3:]]) for box in boxes]
    every = trimesh.util.concatenate(made)
    return collider_mesh(np.asarray(every.vertices), np.asarray(every.faces), device)


def verdict(mesh: wp.Mesh, *points: tuple, radius: float = 0.3, tolerance: float = 0.03) -> list[int]:
    return _verdicts(mesh, np.array(points, dtype=np.float32), radius, tolerance, HEIGHT, tolerance).tolist()


@pytest.fixture(scope="module")
def flat(tmp_path_factory) -> tuple[np.ndarray, wp.Mesh]:
    """Corners of the triangles of the flat, and the mesh of the very same."""
    corners = stage_triangles(author_flat(tmp_path_factory.mktemp("flat") / "flat.usda"))
    return corners, collider_mesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), "cpu")


def test_verdicts_of_a_point_beside_thin_tall_and_large_things():
    floor, pole = (-5, -5, -0.2, 5, 5, 0), (1.0, 0.0, 0.0, 1.01, 0.01, 3.0)
    mesh = world(floor, pole, (-3, -3, 0, -1, -1, 2.0), (3, 3, 0, 4, 4, 0.02), (-4, 3, 0.45, -3, 4, 0.5))
    ahead = wp.vec3(1.0, 0.0, 0.0)
    assert verdict(mesh, ahead - wp.vec3(0.305, 0, 0), ahead - wp.vec3(0.295, 0, 0)) == [
        kernels.CLEAR,
        kernels.OBSTRUCTED,
    ]
    # The inside of a box of 2 m, whose sides are all too far away to be seen.
    assert verdict(mesh, (-2.0, -2.0, 0.0)) == [kernels.INSIDE]
    # A rug is level enough; a ledge below is, one above is not.
    assert verdict(mesh, (3.5, 3.5, 0.02), (3.1, 3.5, 0.02)) == [kernels.CLEAR, kernels.CLEAR]
    assert verdict(mesh, (3.1, 3.5, 0.02), tolerance=0.015) == [kernels.UNEVEN]
    assert verdict(mesh, (4.8, 0.0, 0.0), (4.6, 0.0, 0.0)) == [
        kernels.UNEVEN,
        kernels.CLEAR,
    ]  # 0.2 m and 0.4 m to the edge
    # A shelf lower than the robot, over the middle of it and over its edge.
    assert verdict(mesh, (-3.5, 3.5, 0.0), (-3.5, 2.75, 0.0), (-3.5, 2.65, 0.0)) == [1 + 1, 1 + 1, 0]


def test_the_distance_of_a_triangle_is_that_of_points_on_it(flat):
    """Random cylinders in the flat: obstructed exactly where a point of a surface lies in them."""
    corners, mesh = flat
    rng = np.random.default_rng(3)
    points = rng.uniform((-5.0, -3.5, 0.0), (5.0, 3.5, 3.2), (300, 3)).astype(np.float32)
    found = np.array(_verdicts(mesh, points, 0.3, 0.03, HEIGHT, -1.0)) == kernels.OBSTRUCTED
    surface = surface_points(corners)
    near = cKDTree(surface[:, :2]).query_ball_point(points[:, :2], 0.36)
    seen = np.zeros((2, len(points)), dtype=bool)
    for i, (point, indices) in enumerate(zip(points, near, strict=True)):
        away = surface[indices] - point
        far, up = np.linalg.norm(away[:, :2], axis=1), away[:, 2]
        # A point in the cylinder is proof. Points are 2 cm apart: what they do not show is within 6 cm of it.
        seen[0, i] = ((far < 0.299) & (up > 0.031) & (up < HEIGHT - 0.001)).any()
        seen[1, i] = ((up > -0.03) & (up < HEIGHT + 0.06)).any()
    assert found[seen[0]].all()
    assert not found[~seen[1]].any()
    assert min(seen[0].sum(), (~seen[1]).sum()) > 50


def test_places_in_a_flat_have_room_and_are_on_both_storeys(flat):
    corners, mesh = flat
    cfg = StartSpotsCfg(num_spots=200)
    floors = find_floors(mesh, BOUNDS, cfg, RADIUS, HEIGHT)
    spots = choose_spots(mesh, floors, cfg, 16).astype(float)
    assert len(np.unique(spots, axis=0)) == 200
    down, up = np.array([[0.0, 0.0, -1.0]] * 200), np.array([[0.0, 0.0, 1.0]] * 200)
    raised = spots + (0.0, 0.0, 0.05)
    np.testing.assert_allclose(ray_lengths(corners, raised, down), 0.05, atol=1e-5)
    assert ray_lengths(corners, raised, up).min() > HEIGHT - 0.05
    # Nothing else is in the cylinder over them, and the ground below its rim is there.
    surface = surface_points(corners)
    for spot, near in zip(spots, cKDTree(surface[:, :2]).query_ball_point(spots[:, :2], RADIUS - 0.001), strict=True):
        up = surface[near, 2] - spot[2]
        assert not ((up > 0.031) & (up < HEIGHT)).any()
    for angle in (0.0, 2.0, 4.0):
        rim = raised + RADIUS * np.array([np.cos(angle), np.sin(angle), 0.0])
        assert np.abs(ray_lengths(corners, rim, down) - 0.05).max() <= 0.031
    heights = spots[:, 2]
    low, high = np.abs(heights) < 0.011, np.abs(heights - GALLERY) < 0.001  # of them the rug is 1 cm high
    assert (low | high).all()
    assert low.sum() > 60
    assert high.sum() > 40
    # Under the table, in the bedroom, on the gallery; spread so that no place of the flat is far from one.
    assert ((np.abs(spots - (-2.6, -1.1, 0.0)) < (0.5, 0.2, 0.1)).all(axis=1)).any()
    assert ((spots[:, 0] > 1.6) & low).any()
    on_stairs = (floors.points[:, 2] > 0.1) & (floors.points[:, 2] < GALLERY - 0.1)
    assert cKDTree(spots).query(floors.points[~on_stairs])[0].max() < 2.2  # the nook before the stairs


def test_the_same_seed_gives_the_same_places_and_another_one_others(flat):
    _, mesh = flat

    def spots(seed: int) -> np.ndarray:
        cfg = StartSpotsCfg(num_spots=20, seed=seed)
        return choose_spots(mesh, find_floors(mesh, BOUNDS, cfg, RADIUS, HEIGHT), cfg, 4)

    np.testing.assert_array_equal(spots(1), spots(1))
    assert not np.array_equal(spots(1), spots(2))


def test_stairs_connect_floors_and_a_roof_is_left_out_by_what_can_be_reached(flat):
    _, mesh = flat
    every = find_floors(mesh, BOUNDS, StartSpotsCfg(), RADIUS, HEIGHT)
    assert len(every.areas) == 1
    assert every.area > 60.0  # of 70 m^2 below and 28 m^2 above
    flat_robot = StartSpotsCfg(max_step=0.05)
    floors = find_floors(mesh, BOUNDS, flat_robot, RADIUS, HEIGHT)
    assert len(floors.areas) == 2  # no step of 14 cm
    below = find_floors(mesh, BOUNDS, flat_robot.replace(reachable_from=(0.0, 0.0, 0.0)), RADIUS, HEIGHT)
    assert len(below.areas) == 1
    assert below.points[:, 2].max() < 0.1
    boxed = find_floors(mesh, BOUNDS, StartSpotsCfg(upper=(0.0, 5.0, 2.0)), RADIUS, HEIGHT)
    assert boxed.points[:, 0].max() <= 0.0
    assert boxed.points[:, 2].max() < 2.0
    with pytest.raises(ValueError, match=r"reachable_from is \(9.0, 0.0, 0.0\), where no floor is within"):
        find_floors(mesh, BOUNDS, flat_robot.replace(reachable_from=(9.0, 0.0, 0.0)), RADIUS, HEIGHT)


def test_too_few_places_say_how_many_and_why(flat):
    _, mesh = flat
    cfg = StartSpotsCfg(min_spots=3)
    floors = find_floors(mesh, BOUNDS, cfg, 2.4, HEIGHT)
    with pytest.raises(ValueError, match=r"no places to start with 2.40 m around .* are too close to something"):
        choose_spots(mesh, floors, cfg, 4)
    tables = world((0, 0, 0, 1, 1, 0.7), (3, 0, 0, 4, 1, 0.7))
    bounds = np.array([[0.0, 0.0, 0.0], [4.0, 1.0, 0.7]])
    floors = find_floors(tables, bounds, cfg, RADIUS, HEIGHT)
    with pytest.raises(ValueError, match=r"have free space, none of them on a floor of 4 m\^2 or more"):
        choose_spots(tables, floors, cfg, 4)


def test_triangles_of_shapes_have_their_volumes_and_places():
    builder = newton.ModelBuilder()
    turned = wp.transform(wp.vec3(1.0, 2.0, 3.0), wp.quat_rpy(0.3, -0.4, 0.5))
    builder.add_shape_box(-1, xform=turned, hx=0.5, hy=0.4, hz=0.3)
    builder.add_shape_sphere(-1, xform=turned, radius=0.5)
    builder.add_shape_capsule(-1, xform=turned, radius=0.2, half_height=0.6)
    builder.add_shape_cylinder(-1, xform=turned, radius=0.3, half_height=0.5)
    builder.add_shape_cone(-1, xform=turned, radius=0.3, half_height=0.5)
    box = trimesh.creation.box()
    mesh = newton.Mesh(np.array(box.vertices), np.array(box.faces).reshape(-1))
    builder.add_shape_mesh(-1, xform=turned, mesh=mesh, scale=(1.0, 2.0, -3.0))  # mirrored
    sizes = [1.0 * 0.8 * 0.6, np.pi / 6, np.pi * 0.04 * 1.2 + np.pi * 0.032 / 3, np.pi * 0.09, np.pi * 0.03, 6.0]
    for shape, size in enumerate(sizes):
        points, faces = triangles_of(builder, [shape])
        made = trimesh.Trimesh(points, faces)
        assert made.is_watertight or shape == 1  # a sphere has a seam
        assert made.volume == pytest.approx(size, rel=0.02)  # 32 facets lose 1 %
        if shape != 4:  # a cone's centre of mass is not its origin
            np.testing.assert_allclose(made.center_mass, (1.0, 2.0, 3.0), atol=1e-4)
    field = newton.Heightfield(np.array([[0.0, 1.0, 2.0], [3.0, 5.0, 4.0]]), 2, 3, hx=1.0, hy=0.5)
    builder.add_shape_heightfield(heightfield=field)
    points, faces = triangles_of(builder, [len(sizes)])
    np.testing.assert_allclose(points[4], (0.0, 0.5, 5.0), atol=1e-6)
    assert len(faces) == 4
