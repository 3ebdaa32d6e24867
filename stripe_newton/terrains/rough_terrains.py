# SPDX-License-Identifier: Apache-2.0
"""``ROUGH_TERRAINS_CFG``: a ready-made grid of tiles with stairs, blocks, random ground and slopes."""

from __future__ import annotations

from .hf_terrains import HfInvertedPyramidSlopedTerrainCfg, HfPyramidSlopedTerrainCfg, HfRandomUniformTerrainCfg
from .mesh_terrains import MeshInvertedPyramidStairsTerrainCfg, MeshPyramidStairsTerrainCfg, MeshRandomGridTerrainCfg
from .terrain_generator import TerrainGeneratorCfg

__all__ = ["ROUGH_TERRAINS_CFG"]

ROUGH_TERRAINS_CFG = TerrainGeneratorCfg(
    size=(8.0, 8.0),
    border_width=20.0,
    num_rows=10,
    num_cols=20,
    horizontal_scale=0.1,
    vertical_scale=0.005,
    sub_terrains={
        "pyramid_stairs": MeshPyramidStairsTerrainCfg(
            proportion=0.2, step_height_range=(0.05, 0.23), step_width=0.3, platform_width=3.0, border_width=1.0
        ),
        "pyramid_stairs_inv": MeshInvertedPyramidStairsTerrainCfg(
            proportion=0.2, step_height_range=(0.05, 0.23), step_width=0.3, platform_width=3.0, border_width=1.0
        ),
        "boxes": MeshRandomGridTerrainCfg(
            proportion=0.2, grid_width=0.45, grid_height_range=(0.05, 0.2), platform_width=2.0
        ),
        "random_rough": HfRandomUniformTerrainCfg(
            proportion=0.2, noise_range=(0.02, 0.10), noise_step=0.02, border_width=0.25
        ),
        "hf_pyramid_slope": HfPyramidSlopedTerrainCfg(
            proportion=0.1, slope_range=(0.0, 0.4), platform_width=2.0, border_width=0.25
        ),
        "hf_pyramid_slope_inv": HfInvertedPyramidSlopedTerrainCfg(
            proportion=0.1, slope_range=(0.0, 0.4), platform_width=2.0, border_width=0.25
        ),
    },
)
"""Ten levels of twenty tiles of 8 m, with the kinds and values of Isaac Lab's config of this name.

Set ``curriculum`` for levels that get harder. Blocks are 0.45 m wide in cells of 0.1 m, so they come out 0.4 or 0.5 m
wide.
"""
