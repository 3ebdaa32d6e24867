# SPDX-License-Identifier: Apache-2.0
"""Rough plane of the Isaac Lab dialect: a square of bumpy ground in the place of NVIDIA's file."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics, Vt

from stripe_newton.configclass import configclass
from stripe_newton.sim import SpawnerCfg
from stripe_newton.sim.scene_context import authored_path, current_stage
from stripe_newton.sim.spawners.spawner_cfg import finish, place

__all__ = ["RoughPlaneCfg", "rough_heights", "spawn_rough_plane"]

SIDE = 20.0
"""Edge of the square [m]."""
CELLS = 80
"""Cells along an edge."""
HIGHEST = 0.15
"""Height of the highest bump, and depth of the deepest hollow [m]."""


def rough_heights() -> np.ndarray:
    """Heights of the vertices [m]: waves of random directions, the same in each run, ``(CELLS + 1, CELLS + 1)``."""
    random = np.random.default_rng(0)
    x, y = np.meshgrid(*2 * (np.linspace(-0.5, 0.5, CELLS + 1) * SIDE,))
    heights = np.zeros_like(x)
    for length in (4.0, 2.5, 1.6, 1.0):
        for angle, phase in random.uniform(0.0, 2.0 * np.pi, (3, 2)):
            along = x * np.cos(angle) + y * np.sin(angle)
            heights += length * np.sin(2.0 * np.pi * along / length + phase)
    return heights * (HIGHEST / np.abs(heights).max())


def spawn_rough_plane(
    prim_path: str,
    cfg: RoughPlaneCfg,
    translation: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Usd.Prim:
    """Author the ground, a static mesh ``mesh`` below the prim."""
    stage, path = current_stage(), authored_path(prim_path)
    root = UsdGeom.Xform.Define(stage, path).GetPrim()
    mesh = UsdGeom.Mesh.Define(stage, f"{path}/mesh")
    x, y = np.meshgrid(*2 * (np.linspace(-0.5, 0.5, CELLS + 1) * SIDE,))
    points = np.stack((x, y, rough_heights()), axis=-1).reshape(-1, 3)
    corners = np.arange((CELLS + 1) ** 2).reshape(CELLS + 1, CELLS + 1)
    a, b, c, d = (corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1])
    faces = np.stack((a, b, c, a, c, d), axis=-1).reshape(-1, 3)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.reshape(-1).astype(np.int32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, dtype=np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr([Gf.Vec3f(0.35, 0.35, 0.35)])
    UsdPhysics.CollisionAPI.Apply(mesh.GetPrim())
    UsdPhysics.MeshCollisionAPI.Apply(mesh.GetPrim()).CreateApproximationAttr(UsdPhysics.Tokens.none)
    place(root, translation, orientation)
    return finish(root, cfg)


@configclass
class RoughPlaneCfg(SpawnerCfg):
    """Spawner of the rough plane."""

    func: Callable[..., Usd.Prim] = spawn_rough_plane
    """Function that authors the prims."""
