# SPDX-License-Identifier: Apache-2.0
"""Sub-terrain of every kind."""

from __future__ import annotations

from stripe_newton import terrains
from stripe_newton.terrains import (
    SubTerrainBaseCfg,
)

SIZE, STEP = (8.0, 6.0), 0.1
BOX = terrains.MeshRepeatedBoxesTerrainCfg.ObjectCfg
CYLINDER = terrains.MeshRepeatedCylindersTerrainCfg.ObjectCfg
PYRAMID = terrains.MeshRepeatedPyramidsTerrainCfg.ObjectCfg
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
    "boxes": terrains.MeshRepeatedBoxesTerrainCfg(
        object_params_start=BOX(num_objects=20, height=0.1, size=(0.6, 0.4)),
        object_params_end=BOX(num_objects=40, height=0.5, size=(0.4, 0.3), max_yx_angle=25.0),
    ),
    "cylinders": terrains.MeshRepeatedCylindersTerrainCfg(
        object_params_start=CYLINDER(num_objects=20, height=0.1, radius=0.5),
        object_params_end=CYLINDER(num_objects=30, height=0.5, radius=0.3, max_yx_angle=0.4, degrees=False),
        abs_height_noise=(-0.05, 0.05),
    ),
    "pyramids": terrains.MeshRepeatedPyramidsTerrainCfg(
        object_params_start=PYRAMID(num_objects=20, height=0.1, radius=0.5),
        object_params_end=PYRAMID(num_objects=20, height=0.4, radius=0.7),
        rel_height_noise=(0.8, 1.2),
        platform_height=0.0,
    ),
    "star": terrains.MeshStarTerrainCfg(num_bars=6, bar_width_range=(0.3, 0.8), bar_height_range=(0.1, 0.6)),
}
"""One of each kind."""
