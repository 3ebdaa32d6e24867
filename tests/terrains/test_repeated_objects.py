# SPDX-License-Identifier: Apache-2.0
"""Tiles with repeated objects: their surfaces against a linear program, their places, and the difficulty."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from stripe_newton.configclass import ConfigError
from stripe_newton.isaaclab import terrains as dialect
from stripe_newton.terrains import repeated_objects, sub_terrain_heights
from tests.helpers.terrain_kinds import KINDS, SIZE, STEP

REPEATED = ("boxes", "cylinders", "pyramids")


def tile(name: str, difficulty: float, seed: int = 0, **changes) -> np.ndarray:
    cfg = KINDS[name].replace(size=SIZE, horizontal_scale=STEP, **changes)
    return sub_terrain_heights(cfg, difficulty, np.random.default_rng(seed))


@pytest.mark.parametrize("name", REPEATED)
def test_the_surface_of_an_object_is_the_highest_point_above_each_place(name):
    rng = np.random.default_rng(3)
    normals, offsets = KINDS[name].faces(0.7, 0.6, rng)
    turn = Rotation.from_euler("zyx", [0.8, 0.3, -0.25]).as_matrix()
    normals = normals @ turn.T
    x, y = np.meshgrid(np.linspace(-0.7, 0.7, 15), np.linspace(-0.7, 0.7, 15))
    found = repeated_objects._top(x, y, normals, offsets)
    for (i, j), height in np.ndenumerate(found):
        # The largest z of a point (x, y, z) within all faces.
        left = offsets - normals[:, :2] @ [x[i, j], y[i, j]]
        best = linprog([-1.0], A_ub=normals[:, 2:], b_ub=left, bounds=[(None, None)])
        assert height == pytest.approx(max(-best.fun, 0.0) if best.success else 0.0, abs=1e-9)
    assert 10 < (found > 0.0).sum() < 220


def test_sizes_are_those_of_the_config():
    rng = np.random.default_rng(0)
    normals, offsets = KINDS["boxes"].faces(0.5, 0.4, rng)
    corners = np.array([[a, b, c] for a in (-0.25, 0.25) for b in (-0.175, 0.175) for c in (-0.2, 0.2)])
    np.testing.assert_allclose((corners @ normals.T - offsets).max(axis=1), 0.0, atol=1e-12)
    normals, offsets = KINDS["pyramids"].faces(0.0, 0.3, rng)
    sides = len(normals) - 1
    angle = np.pi / sides  # a corner of the base is between two flanks
    for point in ([0.0, 0.0, 0.3], [0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.0]):
        assert (normals @ point - offsets).max() == pytest.approx(0.0, abs=1e-12)
    normals, offsets = KINDS["cylinders"].faces(1.0, 0.5, rng)
    assert offsets.max() == pytest.approx(0.3)
    assert offsets[-2:] == pytest.approx([0.25, 0.25])


@pytest.mark.parametrize("name", REPEATED)
def test_objects_lie_around_the_platform(name):
    easy, hard = (tile(name, difficulty) for difficulty in (0.0, 1.0))
    middle = tuple(n // 2 for n in easy.shape)
    platform = KINDS[name].platform_height
    assert easy[middle] == pytest.approx(0.05 if platform < 0 else 0.0)
    assert hard[middle] == pytest.approx(0.25 if platform < 0 else 0.0)
    assert easy.min() == hard.min() == 0.0
    assert hard.max() > 2.0 * easy.max() > 0.05
    covered = (hard > 0.0).mean()
    assert 0.05 < covered < 0.9
    assert not np.array_equal(hard, tile(name, 1.0, seed=1))
    np.testing.assert_array_equal(hard, tile(name, 1.0))


def test_level_boxes_are_as_high_as_half_of_them():
    params = KINDS["boxes"].object_params_start
    found = tile("boxes", 0.0, object_params_end=params, platform_width=0.0)
    assert set(np.unique(found).round(9)) == {0.0, 0.05}
    assert (found > 0.0).sum() * STEP**2 < 20 * 0.6 * 0.4 * 1.3  # objects may overlap


def test_other_fields_of_isaac_lab():
    params = KINDS["boxes"].object_params_start
    cfg = dialect.MeshRepeatedBoxesTerrainCfg(object_params_start=params, object_params_end=params)
    cfg.validate()
    made = cfg.replace(size=SIZE, horizontal_scale=STEP)
    assert sub_terrain_heights(made, 0.0, np.random.default_rng(0)).max() == pytest.approx(0.05)
    with pytest.raises(ConfigError, match=r"max_height_noise: .* abs_height_noise to \(-0.1, 0.1\)"):
        cfg.replace(max_height_noise=0.1).validate()
    with pytest.raises(ConfigError, match="object_type: is set"):
        cfg.replace(object_type="cone").validate()
