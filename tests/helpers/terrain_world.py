# SPDX-License-Identifier: Apache-2.0
"""Field of heights with a reference for its height at a point in float64, and a scene of a few tiles."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import warp as wp

from stripe_kernels.terrain import TerrainData
from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import Simulation, SimulationCfg
from stripe_newton.terrains import (
    FlatPatchSamplingCfg,
    Ground,
    MeshPlaneTerrainCfg,
    MeshPyramidStairsTerrainCfg,
    TerrainGeneratorCfg,
    TerrainImporterCfg,
)
from stripe_tasks.robots import CARTPOLE_CFG


@functools.cache
def hills() -> Ground:
    """A rough field that is neither square nor in the middle of the world, its cells neither."""
    rng = np.random.default_rng(1)
    return Ground(rng.uniform(-0.3, 0.4, (31, 41)), (-7.0, 2.0), (0.4, 0.3))


def ground_data(ground: Ground) -> TerrainData:
    """The struct of a field, without tiles."""
    data = TerrainData()
    data.heights = wp.array(ground.heights, dtype=float)
    data.lower, data.cell = wp.vec2(*ground.lower), wp.vec2(*ground.cell)
    return data


def reference_height(ground: Ground, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights at which upright lines meet the triangles, by barycentric coordinates of each triangle of the cell."""
    nrow, ncol = ground.heights.shape
    u = np.clip((x - ground.lower[0]) / ground.cell[0], 0.0, ncol - 1)
    v = np.clip((y - ground.lower[1]) / ground.cell[1], 0.0, nrow - 1)
    found = np.full(len(x), np.nan)
    for i in range(len(x)):
        col, row = min(int(u[i]), ncol - 2), min(int(v[i]), nrow - 2)
        for corners in (((0, 0), (0, 1), (1, 0)), ((0, 1), (1, 1), (1, 0))):
            matrix = np.array([[c, r, 1.0] for r, c in corners]).T
            weights = np.linalg.solve(matrix, [u[i] - col, v[i] - row, 1.0])
            if (weights >= -1e-9).all():
                found[i] = sum(w * float(ground.heights[row + r, col + c]) for w, (r, c) in zip(weights, corners))
    return found


PATCHES = {"target": FlatPatchSamplingCfg(num_patches=4, patch_radius=0.2, max_height_diff=0.02)}
TINY = TerrainGeneratorCfg(
    size=(4.0, 4.0),
    border_width=1.0,
    num_rows=3,
    num_cols=2,
    curriculum=True,
    sub_terrains={
        "stairs": MeshPyramidStairsTerrainCfg(
            step_height_range=(0.05, 0.2), step_width=0.3, platform_width=1.0, flat_patch_sampling=PATCHES
        ),
        "flat": MeshPlaneTerrainCfg(flat_patch_sampling=PATCHES),
    },
)


@configclass
class YardCfg(InteractiveSceneCfg):
    """A ground and a cart on it."""

    terrain: Any = None
    robot: ArticulationCfg = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")


def yard(num_envs: int = 8, build: bool = False, **fields: Any) -> InteractiveScene:
    fields = {"prim_path": "/World/ground", "terrain_generator": TINY} | fields
    cfg = YardCfg(num_envs=num_envs, env_spacing=2.0, terrain=TerrainImporterCfg(**fields))
    scene = InteractiveScene(cfg, Simulation(SimulationCfg(device="cpu")))
    if build:
        scene.build()
    return scene
