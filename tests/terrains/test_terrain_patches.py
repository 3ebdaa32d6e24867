# SPDX-License-Identifier: Apache-2.0
"""Flat patches of terrains."""

from __future__ import annotations

import numpy as np
import pytest

from stripe_newton import terrains
from stripe_newton.terrains import FlatPatchSamplingCfg, TerrainGenerator, TerrainGeneratorCfg
from tests.helpers.terrain_kinds import KINDS, SIZE, STEP


def test_level_patches_are_level_within_their_ranges_and_on_their_tile():
    sampling = {
        "target": FlatPatchSamplingCfg(num_patches=12, patch_radius=[0.2, 0.4], max_height_diff=0.02),
        "init_pos": FlatPatchSamplingCfg(
            num_patches=5, patch_radius=0.3, max_height_diff=0.02, x_range=(-1.0, 1.0), z_range=(-0.01, 0.01)
        ),
    }
    kinds = {"stairs": KINDS["stairs"].replace(flat_patch_sampling=sampling), "flat": KINDS["flat"].copy()}
    cfg = TerrainGeneratorCfg(size=SIZE, num_rows=2, num_cols=2, curriculum=True, sub_terrains=kinds)
    ground = TerrainGenerator(cfg).ground
    assert ground.patches["target"].shape == (2, 2, 12, 3)
    x = ground.lower[0] + STEP * np.arange(ground.heights.shape[1])
    y = ground.lower[1] + STEP * np.arange(ground.heights.shape[0])
    for row in range(2):
        origin = ground.origins[row, 0]
        for name, radius in (("target", 0.4), ("init_pos", 0.3)):
            points = ground.patches[name][row, 0]
            assert len(np.unique(points, axis=0)) == len(points)
            for point in points:
                near = np.hypot(x[None, :] - point[0], y[:, None] - point[1]) <= radius + 1e-6
                assert np.ptp(ground.heights[near]) <= 0.02 + 1e-5
                assert abs(ground.heights[near].mean() - point[2]) < 0.02
            assert (abs(points[:, :2] - origin[:2]) <= np.array(SIZE) / 2 - radius + 1e-6).all()
        start = ground.patches["init_pos"][row, 0] - origin
        assert (abs(start[:, 0]) <= 1.0 + 1e-6).all()
        assert (abs(start[:, 2]) <= 0.01 + 1e-6).all()
        np.testing.assert_array_equal(ground.patches["target"][row, 1], np.tile(ground.origins[row, 1], (12, 1)))


def test_a_tile_without_a_level_place_is_an_error_that_says_which():
    sampling = {"target": FlatPatchSamplingCfg(num_patches=1, patch_radius=0.5, max_height_diff=0.01)}
    kinds = {"wave": terrains.HfWaveTerrainCfg(amplitude_range=(0.4, 0.5), flat_patch_sampling=sampling)}
    kinds["wave"].flat_patch_sampling["target"].x_range = (-1.0, 1.0)
    kinds["wave"].flat_patch_sampling["target"].y_range = (-1.0, 1.0)
    with pytest.raises(ValueError, match=r"'wave', row 0, column 0, 'target': no place of radius 0.5 m is level"):
        TerrainGenerator(TerrainGeneratorCfg(size=SIZE, sub_terrains=kinds))
