# SPDX-License-Identifier: Apache-2.0
# ruff: noqa: NPY002  # functions of Isaac Lab draw from the state of numpy.random
"""Terrains that a project defines by Isaac Lab's signatures: height fields and meshes."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from stripe_newton.isaaclab.configclass import configclass
from stripe_newton.isaaclab.terrains import HfTerrainBaseCfg
from stripe_newton.isaaclab.user_terrains import SubTerrainBaseCfg, height_field_to_mesh, make_border, make_plane
from stripe_newton.terrains import sub_terrain_heights


@height_field_to_mesh
def ridge(difficulty: float, cfg: HfTerrainBaseCfg) -> np.ndarray:
    """A ridge along y at the quarter of x, as high as the difficulty, and a little noise."""
    counts = [int(length / cfg.horizontal_scale) for length in cfg.size]
    heights = np.zeros(counts, dtype=np.int16)
    heights[counts[0] // 4] = round(difficulty / cfg.vertical_scale)
    heights[-1, -1] = np.random.randint(1, 100)
    return heights


def block(difficulty: float, cfg: SubTerrainBaseCfg) -> tuple[list[trimesh.Trimesh], np.ndarray]:
    ground = make_plane(cfg.size, 0.0, center_zero=False)
    ring = make_border((3.0, 2.0), (1.0, 1.0), difficulty, (2.0, 1.5, 0.5 * difficulty))
    return [ground, *ring], np.array([2.0, 1.5, 0.0])


@configclass
class RidgeCfg(HfTerrainBaseCfg):
    function = ridge


@configclass
class BlockCfg(SubTerrainBaseCfg):
    function = block


def test_a_height_field_of_a_project_has_its_axes_border_and_scale():
    cfg = RidgeCfg(size=(4.0, 3.0), horizontal_scale=0.1, vertical_scale=0.005, border_width=0.5)
    heights = sub_terrain_heights(cfg, 0.4, np.random.default_rng(0))
    assert heights.shape == (31, 41)  # rows along y
    column = 6 + (41 - 12) // 4  # the border has 6 vertices
    assert heights[6:-6, column] == pytest.approx(0.4, abs=1e-6)
    assert np.abs(heights[:6]).max() == 0.0
    assert cfg.size == (4.0, 3.0)


def test_draws_follow_from_the_generator_of_the_ground():
    cfg = RidgeCfg(size=(4.0, 3.0), horizontal_scale=0.1)
    np.random.seed(7)
    before = np.random.get_state()[1].copy()
    one, same, other = (sub_terrain_heights(cfg, 0.4, np.random.default_rng(seed))[-2, -2] for seed in (1, 1, 2))
    assert one == same != other
    assert (np.random.get_state()[1] == before).all()


def test_meshes_of_a_project_become_heights():
    heights = sub_terrain_heights(BlockCfg(size=(4.0, 3.0), horizontal_scale=0.1), 0.3, np.random.default_rng(0))
    assert heights.shape == (31, 41)
    assert heights[15, [2, 8, 20, 32, 38]] == pytest.approx([0.0, 0.3, 0.0, 0.3, 0.0], abs=1e-6)  # along x
    assert heights[[2, 7, 15, 23, 28], 20] == pytest.approx([0.0, 0.3, 0.0, 0.3, 0.0], abs=1e-6)  # along y
