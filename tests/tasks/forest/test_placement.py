# SPDX-License-Identifier: Apache-2.0
"""Placement in the forest: blue-noise scatter and poses on the ground."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from stripe_tasks.forest.maps import height_at
from stripe_tasks.forest.placement import (
    ground_slope,
    lie_on_slope,
    patch_map,
    sample_map,
    scatter,
    stand_on_ground,
)

SIZE = (40.0, 30.0)
X, Y = np.meshgrid(np.linspace(-20.0, 20.0, 161), np.linspace(-15.0, 15.0, 121))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def gaps(xy: np.ndarray, radii: np.ndarray, others: np.ndarray, widths: np.ndarray) -> np.ndarray:
    """Distances between the rims of discs, by brute force."""
    return np.linalg.norm(xy[:, None] - others[None], axis=-1) - radii[:, None] - widths[None]


def ends(position: np.ndarray, quaternion: np.ndarray, length: float) -> np.ndarray:
    """Both ends of a log and points between them, ``(..., 41, 3)``."""
    axis = Rotation.from_quat(quaternion).apply([1.0, 0.0, 0.0])
    return position[..., None, :] + np.linspace(-0.5, 0.5, 41)[:, None] * length * axis[..., None, :]


def test_a_map_is_read_where_it_lies():
    xy = rng().uniform(-1.0, 1.0, (50, 2)) * [20.0, 15.0]
    np.testing.assert_allclose(sample_map(2.0 * X - 3.0 * Y + 1.0, SIZE, xy), 2.0 * xy[:, 0] - 3.0 * xy[:, 1] + 1.0)
    corner = np.zeros((3, 5))
    corner[2, 0] = 1.0
    assert sample_map(corner, SIZE, np.array([-20.0, 15.0])) == 1.0
    assert sample_map(corner, SIZE, np.array([-15.0, 15.0])) == pytest.approx(0.5)


@pytest.mark.parametrize("radius", [0.3, (0.05, 0.6), (0.1, 1.3)])
@pytest.mark.parametrize("weighted", [False, True])
def test_discs_never_overlap(radius, weighted):
    others, widths = rng(1).uniform(-1.0, 1.0, (30, 2)) * [20.0, 15.0], rng(2).uniform(0.1, 3.0, 30)
    weight = np.maximum(X, 0.0) if weighted else None
    xy, radii = scatter(SIZE, rng(), count=60, weight=weight, radius=radius, avoid=(others, widths))
    assert xy.shape == (60, 2)
    own = gaps(xy, radii, xy, radii)
    np.fill_diagonal(own, np.inf)
    assert own.min() >= 0.0
    assert gaps(xy, radii, others, widths).min() >= 0.0
    assert (np.abs(xy) <= [20.0, 15.0]).all()
    low, high = (radius, radius) if isinstance(radius, float) else radius
    assert radii.min() >= low
    assert radii.max() <= high
    if isinstance(radius, tuple):
        assert radii.mean() == pytest.approx(0.5 * (low + high), rel=0.15)  # large ones are not left out


def test_density_is_per_square_metre():
    xy, radii = scatter(SIZE, rng(), density=0.5)
    assert xy.shape == (600, 2)
    assert (radii == 0.0).all()
    empty, none = scatter(SIZE, rng(), count=0)
    assert empty.shape == (0, 2)
    assert none.shape == (0,)


def test_points_are_blue_noise():
    xy, _ = scatter(SIZE, rng(), count=1200)
    apart = np.linalg.norm(xy[:, None] - xy[None], axis=-1)
    np.fill_diagonal(apart, np.inf)
    mean = 0.5 * math.sqrt(SIZE[0] * SIZE[1] / 1200)  # to the nearest of points at random
    assert apart.min() > mean
    blocks = np.histogram2d(xy[:, 0], xy[:, 1], (8, 6), ((-20.0, 20.0), (-15.0, 15.0)))[0]
    assert blocks.var() < 0.6 * blocks.mean()  # 1 for points at random


@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_densities_follow_the_map(radius):
    weight = 1.0 + 0.1 * (X + 20.0) + 0.05 * (Y + 15.0)
    xy, _ = scatter(SIZE, rng(4), count=1500, weight=weight, radius=radius)
    counts = np.histogram2d(xy[:, 0], xy[:, 1], (8, 6), ((-20.0, 20.0), (-15.0, 15.0)))[0]
    cx, cy = np.meshgrid(np.arange(-17.5, 20.0, 5.0), np.arange(-12.5, 15.0, 5.0), indexing="ij")
    share = 1.0 + 0.1 * (cx + 20.0) + 0.05 * (cy + 15.0)
    expected = 1500 * share / share.sum()
    statistic = ((counts - expected) ** 2 / expected).sum()
    assert statistic < chi2.ppf(0.99, 47)
    flat = ((counts - 1500 / 48) ** 2 / (1500 / 48)).sum()
    assert flat > chi2.ppf(0.9999, 47)  # the test can tell the map from a flat one


def test_nothing_lies_where_the_weight_is_zero():
    weight = np.where(X > 5.0, 1.0, 0.0)
    xy, _ = scatter(SIZE, rng(), count=300, weight=weight)
    assert xy[:, 0].min() > 4.75 - 1e-9  # the edge of the last cell of zeros
    assert xy[:, 0].max() > 19.0


def test_patches_cover_what_is_asked_for_and_clump():
    patches = patch_map((301, 401), SIZE, rng(), patch=4.0, cover=0.3)
    assert patches.shape == (301, 401)
    assert np.mean(patches > 0.0) == pytest.approx(0.3, abs=0.01)
    assert patches.max() == 1.0
    finer = patch_map((301, 401), SIZE, rng(), patch=1.0, cover=0.3)
    edges, more_edges = (np.abs(np.diff(m > 0.0, axis=1)).sum() for m in (patches, finer))
    assert more_edges > 2.0 * edges
    grass, _ = scatter(SIZE, rng(), count=2000, weight=patches)
    counts = np.histogram2d(grass[:, 0], grass[:, 1], (20, 15), ((-20.0, 20.0), (-15.0, 15.0)))[0]
    assert counts.var() > 3.0 * counts.mean()  # of points at random they are equal


def test_scatter_depends_on_its_generator_alone():
    args = {"count": 200, "radius": (0.1, 0.4), "weight": np.maximum(X, 0.1)}
    first, again, other = (scatter(SIZE, rng(seed), **args) for seed in (7, 7, 8))
    assert first[0].tobytes() == again[0].tobytes()
    assert first[1].tobytes() == again[1].tobytes()
    assert first[0].tobytes() != other[0].tobytes()


def test_the_order_of_what_is_avoided_does_not_matter():
    others, widths = rng(1).uniform(-1.0, 1.0, (50, 2)) * [20.0, 15.0], rng(2).uniform(0.1, 2.0, 50)
    order = rng(3).permutation(50)
    a, _ = scatter(SIZE, rng(), count=80, radius=0.2, avoid=(others, widths))
    b, _ = scatter(SIZE, rng(), count=80, radius=0.2, avoid=(others[order], widths[order]))
    np.testing.assert_array_equal(a, b)


def test_what_does_not_fit_is_counted():
    with pytest.raises(ValueError, match=r"only (\d+) of 400 discs of radius 1 to 1 m fit") as error:
        scatter(SIZE, rng(), count=400, radius=1.0)
    fitted = int(str(error.value).split("only ")[1].split()[0])
    assert 0.5 < fitted * math.pi / ((SIZE[0] + 1.0) * (SIZE[1] + 1.0)) < 0.65  # random packing: 0.547 and the rim
    scatter(SIZE, rng(), count=fitted - 40, radius=1.0)


@pytest.mark.parametrize(
    ("args", "says"),
    [
        ({}, "either density"),
        ({"count": 3, "density": 1.0}, "either density"),
        ({"count": -3}, "count must be 0 or more"),
        ({"density": math.nan}, "density must be 0 or more"),
        ({"count": 3, "radius": (2.0, 1.0)}, r"radius is \(2.0, 1.0\)"),
        ({"count": 3, "weight": -np.ones((3, 3))}, "weight must be 0 or more"),
        ({"count": 3, "weight": np.zeros((3, 3))}, "positive somewhere"),
        ({"count": 3, "weight": np.full((3, 3), np.nan)}, "all finite"),
        ({"count": 3, "avoid": (np.zeros((4, 2)), np.zeros(3))}, r"avoid: positions \(4, 2\) and radii \(3,\)"),
        ({"count": 3, "avoid": (np.zeros((1, 2)), -np.ones(1))}, "radii 0 or more"),
    ],
)
def test_scatter_refuses_what_makes_no_sense(args, says):
    with pytest.raises(ValueError, match=says):
        scatter(SIZE, rng(), **args)
    with pytest.raises(ValueError, match="size is"):
        scatter((0.0, 1.0), rng(), count=1)
    with pytest.raises(ValueError, match=r"cover 0\.0"):
        patch_map((5, 5), SIZE, rng(), 1.0, 0.0)


def test_what_stands_stands_on_the_ground():
    xy = rng().uniform(-14.0, 14.0, (3, 20, 2))
    placed = stand_on_ground(0.1 * X + 0.2 * Y, SIZE, xy, 0.05)
    np.testing.assert_allclose(placed[..., 2], 0.1 * xy[..., 0] + 0.2 * xy[..., 1] - 0.05)
    np.testing.assert_array_equal(placed[..., :2], xy)


def test_slope_is_the_angle_of_the_normal():
    xy = np.concatenate([rng().uniform(-15.0, 15.0, (20, 2)), [[-20.0, -15.0], [20.0, 15.0]]])
    normal = np.array([-0.3, -0.4, 1.0])
    expected = math.acos(1.0 / np.linalg.norm(normal))
    np.testing.assert_allclose(ground_slope(0.3 * X + 0.4 * Y, SIZE, xy), expected, atol=1e-9)


@pytest.mark.parametrize(("a", "b"), [(0.0, 0.0), (0.3, 0.0), (-0.5, 0.7), (1.5, -0.2)])
def test_a_log_lies_on_a_plane_with_its_whole_length(a, b):
    plane = (a * X + b * Y).astype(np.float32)
    xy, yaw = rng().uniform(-10.0, 10.0, (25, 2)), rng(1).uniform(-4.0, 4.0, 25)
    position, quaternion = lie_on_slope(plane, SIZE, xy, yaw, 5.0)
    points = ends(position, quaternion, 5.0)
    ground = a * points[..., 0] + b * points[..., 1]
    np.testing.assert_allclose(points[..., 2], ground, atol=2e-3)
    np.testing.assert_allclose(position[:, :2], xy)
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=-1), 1.0)
    axis = Rotation.from_quat(quaternion).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(np.arctan2(axis[:, 1], axis[:, 0]), np.arctan2(np.sin(yaw), np.cos(yaw)), atol=1e-9)
    side = Rotation.from_quat(quaternion).apply([0.0, 1.0, 0.0])
    np.testing.assert_allclose(side[:, 2], 0.0, atol=1e-9)  # it is not rolled


def test_a_thick_log_lies_its_radius_above_the_line_it_rests_on():
    thin, quaternion = lie_on_slope(0.5 * X, SIZE, np.array([1.0, 2.0]), 0.4, 3.0)
    thick, same = lie_on_slope(0.5 * X, SIZE, np.array([1.0, 2.0]), 0.4, 3.0, 0.2)
    np.testing.assert_array_equal(quaternion, same)
    np.testing.assert_allclose(Rotation.from_quat(same).inv().apply(thick - thin), [0.0, 0.0, 0.2], atol=1e-12)


def test_a_log_rests_on_two_points_of_rough_ground():
    rough = 0.4 * np.sin(0.9 * X) * np.cos(0.7 * Y) + 0.15 * np.sin(2.1 * Y + X) + 0.2 * X
    xy, yaw = rng().uniform(-10.0, 10.0, (60, 2)), rng(1).uniform(-4.0, 4.0, 60)
    position, quaternion = lie_on_slope(rough, SIZE, xy, yaw, 4.0)
    points = ends(position, quaternion, 4.0)
    clearance = points[..., 2] - height_at(rough, SIZE, points[..., :2])
    assert clearance.min() > -0.03  # never in the ground by more than lies between two of its points
    assert clearance[:, :21].min(axis=1).max() < 0.03  # touches on the one side of its middle
    assert clearance[:, 20:].min(axis=1).max() < 0.03  # and on the other


def test_a_log_bridges_a_ditch_and_rides_a_ridge():
    ditch = np.where(np.abs(X) < 1.0, -2.0, 0.0)
    position, quaternion = lie_on_slope(ditch, SIZE, np.zeros(2), 0.0, 4.0)
    np.testing.assert_allclose(position, 0.0, atol=1e-9)
    np.testing.assert_allclose(quaternion, [0.0, 0.0, 0.0, 1.0], atol=1e-9)
    ridge = -0.5 * np.abs(X)
    position, quaternion = lie_on_slope(ridge, SIZE, np.zeros(2), 0.0, 4.0)
    assert position[2] == pytest.approx(0.0, abs=0.04)
    np.testing.assert_allclose(quaternion, [0.0, 0.0, 0.0, 1.0], atol=1e-9)


def test_a_log_needs_a_length():
    with pytest.raises(ValueError, match="length must be positive"):
        lie_on_slope(X, SIZE, np.zeros(2), 0.0, 0.0)
    with pytest.raises(ValueError, match=r"xy has the shape \(3,\)"):
        lie_on_slope(X, SIZE, np.zeros(3), 0.0, 1.0)
