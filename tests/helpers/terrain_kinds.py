# SPDX-License-Identifier: Apache-2.0
"""Sub-terrain of every kind."""

from __future__ import annotations

from stripe_newton import terrains
from stripe_newton.terrains import (
    SubTerrainBaseCfg,
)

SIZE, STEP = (8.0, 6.0), 0.1
KINDS: dict[str, SubTerrainBaseCfg] = {
    "flat": terrains.MeshPlaneTerrainCfg(),
    "random": terrains.HfRandomUniformTerrainCfg(noise_range=(0.0, 0.1), noise_step=0.01, downsampled_scale=0.2),
    "slope": terrains.HfPyramidSlopedTerrainCfg(slope_range=(0.1, 0.5), platform_width=2.0, border_width=0.3),
    "slope_inv": terrains.HfInvertedPyramidSlopedTerrainCfg(slope_range=(0.1, 0.5), platform_width=2.0),
    "hf_stairs": terrains.HfPyramidStairsTerrainCfg(step_height_range=(0.05, 0.2), step_width=0.3, platform_width=2.0),
    "hf_stairs_inv": terrains.HfInvertedPyramidStairsTerrainCfg(step_height_range=(0.05, 0.2), step_width=0.3),
    "obstacles": terrains.HfDiscreteObstaclesTerrainCfg(
        obstacle_width_range=(0.4, 1.0), obstacle_height_range=(0.05, 0.3), num_obstacles=40, platform_width=1.5
    ),
    "wave": terrains.HfWaveTerrainCfg(amplitude_range=(0.05, 0.4), num_waves=3),
    "stones": terrains.HfSteppingStonesTerrainCfg(
        stone_height_max=0.05,
        stone_width_range=(0.3, 0.9),
        stone_distance_range=(0.1, 0.4),
        holes_depth=-1.0,
        border_width=0.4,
    ),
    "perlin": terrains.HfPerlinTerrainCfg(amplitude_range=(0.05, 0.5)),
    "stairs": terrains.MeshPyramidStairsTerrainCfg(
        step_height_range=(0.05, 0.23), step_width=0.3, platform_width=2.0, border_width=0.5
    ),
    "stairs_inv": terrains.MeshInvertedPyramidStairsTerrainCfg(step_height_range=(0.05, 0.23), step_width=0.4),
    "grid": terrains.MeshRandomGridTerrainCfg(grid_width=0.4, grid_height_range=(0.02, 0.2), platform_width=1.2),
    "grid_holes": terrains.MeshRandomGridTerrainCfg(grid_width=0.4, grid_height_range=(0.02, 0.2), holes=True),
    "rails": terrains.MeshRailsTerrainCfg(rail_thickness_range=(0.1, 0.3), rail_height_range=(0.05, 0.25)),
    "pit": terrains.MeshPitTerrainCfg(pit_depth_range=(0.1, 0.6), platform_width=2.0, double_pit=True),
    "box": terrains.MeshBoxTerrainCfg(box_height_range=(0.1, 0.6), platform_width=2.0, double_box=True),
    "gap": terrains.MeshGapTerrainCfg(gap_width_range=(0.3, 1.0), platform_width=2.0),
    "star": terrains.MeshStarTerrainCfg(num_bars=6, bar_width_range=(0.3, 0.8), bar_height_range=(0.1, 0.6)),
}
"""One of each kind."""
