# SPDX-License-Identifier: Apache-2.0
"""Pieces of rubble: fitting capsules, poses at rest, and the ground below."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stripe_newton.specifications import SphereMesh, TerrainInstance
from stripe_newton.terrains import Ground
from stripe_tasks.rubble.library import kinds
from stripe_tasks.rubble.pieces import Loose
from stripe_tasks.rubble.rafts import MOST, raft
from stripe_tasks.rubble.relief import REPOSE, Building, repose, street_map
from stripe_tasks.rubble.resting import Support, spread
from tests.helpers.rubble_geometry import corners, distance

# -- rafts


@pytest.mark.parametrize("size", [(1.5, 0.7, 0.22), (0.5, 1.1, 0.3), (0.12, 0.0575, 0.07), (1.0, 0.1, 0.2)])
def test_raft_follows_the_box(size):
    half_x, half_y, thick = size
    made, r = raft(*size), 0.5 * thick
    assert 1 <= len(made) <= MOST
    half = np.array([half_x, half_y, r])
    rng = np.random.default_rng(0)
    for c in made:  # none stands out of the box
        ends = Rotation.from_quat(c.rot).apply([[0, 0, -c.size[1]], [0, 0, c.size[1]]]) + c.pos
        assert (np.abs(ends) + c.size[0] <= half + 1e-9).all()
    axis = 1 if half_x >= half_y else 0
    gap = np.diff(sorted(c.pos[axis] for c in made)).max(initial=0.0)
    assert gap <= 2.0 * r + 0.05  # a foot cannot fall through
    if gap < 2.0 * r:
        inner = half - r
        top = rng.uniform(-1, 1, (2000, 3)) * inner
        top[:, 2] = r
        dip = math.hypot(0.5 * gap, r) - r  # between two axes, the plane's distance from both less a radius
        error = distance(made, top)
        assert error.min() >= -1e-9
        assert error.max() <= dip + 1e-9
        if len(made) > 1 and inner[axis] > 0.5 * gap:
            assert error.max() == pytest.approx(dip, rel=0.1)
    box = rng.uniform(-1, 1, (3000, 3)) * half
    side = rng.integers(0, 3, 3000)
    box[np.arange(3000), side] = np.sign(box[np.arange(3000), side]) * half[side]
    assert distance(made, box).max() <= (math.sqrt(3.0) - 1.0) * r + 0.05  # corners are round


def test_raft_refuses_a_plate_thicker_than_wide():
    with pytest.raises(ValueError, match=r"thickness is 0\.5, .* at most the width, 0\.4"):
        raft(1.0, 0.2, 0.5)


def test_raft_is_cut_by_its_outline():
    outline = np.array([(-1.0, -0.5), (0.2, -0.5), (1.0, 0.5), (-1.0, 0.5)])  # slanted on the right
    made = raft(1.0, 0.5, 0.2, outline)
    tips = np.array([[c.pos[1], c.pos[0] + c.size[1] + c.size[0]] for c in made])
    edge = 0.6 + 0.8 * tips[:, 0]  # x of the slanted side there
    assert (tips[:, 1] <= edge).all()
    assert (tips[:, 1] >= edge - 0.1).all()
    assert all(c.pos[0] - c.size[1] - c.size[0] == pytest.approx(-1.0) for c in made)


# -- pieces


def test_pieces_are_made_of_capsules_that_fit_them():
    names = Counter(mesh.name for meshes in kinds().values() for mesh in meshes)
    assert max(names.values()) == 1
    for kind, meshes in kinds().items():
        for mesh in meshes:
            assert mesh.semantic == kind
            assert kind == "debris" or 1 <= len(mesh.colliders()) <= (MOST if kind != "wall" else 40)
            assert {c.kind for c in mesh.colliders()} <= {"capsule"}
            if kind in ("debris", "rebar"):
                continue
            found = corners(mesh)
            low, high = found.min(axis=0), found.max(axis=0)
            loose = 0.12 if kind == "wall" else 0.05  # a brick more or less
            for c in mesh.colliders():
                ends = Rotation.from_quat(c.rot).apply([[0, 0, -c.size[1]], [0, 0, c.size[1]]]) + c.pos
                assert (ends - c.size[0] > low - loose).all(), mesh.name
                assert (ends + c.size[0] < high + loose).all(), mesh.name
            away = distance(mesh.colliders(), mesh.samples)
            assert np.quantile(away, 0.95) < 0.17, mesh.name
            assert np.abs(np.median(away)) < 0.05, mesh.name


def test_slabs_are_closed_broken_and_reinforced():
    for mesh in kinds()["slab"]:
        found = corners(mesh)
        thick = np.ptp(found[:, 2])
        assert 0.15 < thick < 0.3
        plan = found[:, :2]
        area = 4.0 * np.abs(plan).max(axis=0).prod()
        covered = len(np.unique(np.rint(mesh.samples[:, :2] / 0.1), axis=0)) * 0.01
        assert 0.6 * area < covered < 1.25 * area
        assert len(mesh.stubs) > 0
        reach = np.array([np.linalg.norm(plan[np.abs(plan[:, 1] - s[0][1]) < 0.25], axis=1).max() for s in mesh.stubs])
        assert (np.linalg.norm(mesh.stubs[:, 0, :2], axis=1) < reach + 0.05).all()  # bars begin in the concrete


# -- ground


def test_repose_is_the_highest_surface_that_is_not_too_steep():
    x = np.arange(-30, 31) * 0.2
    away = np.hypot(*np.meshgrid(x, x))
    flat_cone, steep_cone = np.clip(2.0 - 0.4 * away, 0.0, None), np.clip(3.0 - 2.0 * away, 0.0, None)
    np.testing.assert_allclose(repose(flat_cone, (0.2, 0.2)), flat_cone, atol=1e-6)
    low = repose(steep_cone, (0.2, 0.2))
    assert (low <= steep_cone + 1e-9).all()
    steps = np.abs(np.diff(low, axis=0)) / 0.2, np.abs(np.diff(low, axis=1)) / 0.2
    assert max(s.max() for s in steps) <= math.tan(REPOSE) + 1e-4
    np.testing.assert_allclose(repose(low, (0.2, 0.2)), low, atol=1e-5)


def test_street_map():
    town = [Building((2.0, 1.0), 0.5 * math.pi, (3.0, 1.0))]
    x, y = np.array([2.0, 2.0, 3.6, 5.0]), np.array([1.0, 3.9, 1.0, 1.0])
    np.testing.assert_allclose(street_map(x, y, town, 1.2), [0.0, 0.0, 0.5, 1.0], atol=1e-9)
    assert town[0].world(1.0, 0.0) == pytest.approx((2.0, 2.0))


def test_a_block_rests_on_a_plane_and_on_another():
    x = np.arange(41) * 0.1
    tilted = 0.2 * x[None] - 0.1 * x[:, None]
    support = Support(TerrainInstance(Ground(tilted, (-2.0, -2.0), (0.1, 0.1))))
    mesh = kinds()["beam"][0]
    position, turn = support.rest(mesh, np.zeros(2), 0.7, sunk=0.0)
    up = np.array([-0.2, 0.1, 1.0])
    np.testing.assert_allclose(Rotation.from_quat(turn).apply([0, 0, 1]), up / np.linalg.norm(up), atol=1e-2)
    bottom = position + Rotation.from_quat(turn).apply(mesh.feet)
    below = tilted[20, 20] + 0.2 * bottom[:, 0] - 0.1 * bottom[:, 1]
    assert (bottom[:, 2] - below < 0.0).mean() == pytest.approx(0.33, abs=0.05)
    first = Loose("it", "beam").create_instance("first", mesh, position, turn)
    support.add(first)
    higher, _ = support.rest(mesh, np.zeros(2), 0.7, sunk=0.0)
    assert higher[2] - position[2] == pytest.approx(0.34, abs=0.08)  # its height


def test_bad_pieces():
    with pytest.raises(ValueError, match="kind is 'boulder', must be one of slab"):
        Loose("it", "boulder")
    with pytest.raises(ValueError, match="density is 0 everywhere"):
        spread(np.zeros((3, 3)), (1.0, 1.0), 2, 0.1, np.random.default_rng(0))
    flat = TerrainInstance(Ground(np.zeros((5, 5)), (-2.0, -2.0), (1.0, 1.0)))
    with pytest.raises(ValueError, match="must be a RubbleTerrain"):
        list(Loose("it", "slab", count=1).generate(flat, np.random.default_rng(0)))


def test_foreign_assets_are_left_alone():
    terrain = TerrainInstance(Ground(np.zeros((5, 5)), (-2.0, -2.0), (1.0, 1.0)))
    ball = Loose("it", "slab").create_instance("ball", SphereMesh("ball", (0.5,)), (0.0, 0.0, 0.0))
    terrain.placed["balls"] = [ball]
    assert (Support(terrain).heights == 0.0).all()
