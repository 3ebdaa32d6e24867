# SPDX-License-Identifier: Apache-2.0
"""Triangles of a USD stage and rays through them, by NumPy and trimesh, to compare results of the importer with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh
from pxr import Usd, UsdGeom, UsdPhysics


def stage_triangles(path: str | Path) -> np.ndarray:
    """Corners of the triangles of all static colliders of a stage [m], ``(triangles, 3, 3)``; z is up."""
    stage, found = Usd.Stage.Open(str(path)), []
    cache, metres = UsdGeom.XformCache(), UsdGeom.GetStageMetersPerUnit(stage)
    for prim in stage.Traverse():
        if not prim.HasAPI(UsdPhysics.CollisionAPI) or prim.HasAPI(UsdPhysics.RigidBodyAPI):
            continue
        corners = _corners(prim)
        matrix = np.array(cache.GetLocalToWorldTransform(prim))
        found.append((corners @ matrix[:3, :3] + matrix[3, :3]) * metres)
    corners = np.concatenate(found)
    if UsdGeom.GetStageUpAxis(stage) == "Y":
        corners = np.stack([corners[..., 0], -corners[..., 2], corners[..., 1]], axis=-1)
    return corners


def _corners(prim: Usd.Prim) -> np.ndarray:
    if prim.IsA(UsdGeom.Mesh):
        mesh = UsdGeom.Mesh(prim)
        points = np.array(mesh.GetPointsAttr().Get(), dtype=float)
        quads = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 4)
        return points[np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]])]
    if prim.IsA(UsdGeom.Cube):
        made = trimesh.creation.box(extents=[UsdGeom.Cube(prim).GetSizeAttr().Get()] * 3)
    elif prim.IsA(UsdGeom.Sphere):
        made = trimesh.creation.icosphere(subdivisions=4, radius=UsdGeom.Sphere(prim).GetRadiusAttr().Get())
    else:
        tube = UsdGeom.Cylinder(prim)
        made = trimesh.creation.cylinder(tube.GetRadiusAttr().Get(), tube.GetHeightAttr().Get(), sections=256)
    return np.asarray(made.triangles, dtype=float)


def ray_lengths(corners: np.ndarray, starts: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Length of each ray up to the nearest triangle [m], infinite where it meets none.

    Source: T. Moeller and B. Trumbore, "Fast, Minimum Storage Ray/Triangle Intersection", 1997.
    """
    a, ab, ac = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    lengths = np.full(len(starts), np.inf)
    for i, (start, direction) in enumerate(zip(starts, directions, strict=True)):
        p = np.cross(direction, ac)
        det = (ab * p).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            away = start - a
            u = (away * p).sum(axis=1) / det
            q = np.cross(away, ab)
            v = (q @ direction) / det
            t = (ac * q).sum(axis=1) / det
            hit = (np.abs(det) > 1e-12) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        if hit.any():
            lengths[i] = t[hit].min()
    return lengths


def surface_points(corners: np.ndarray, spacing: float = 0.02, seed: int = 0) -> np.ndarray:
    """Random points on triangles, about one for each square of side ``spacing``, and all corners, ``(points, 3)``."""
    rng = np.random.default_rng(seed)
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    each = np.maximum(1, (areas / spacing**2).astype(int))
    u, v = rng.random((2, each.sum()))
    flip = u + v > 1.0
    u[flip], v[flip] = 1.0 - u[flip], 1.0 - v[flip]
    which = np.repeat(np.arange(len(corners)), each)
    a, b, c = (corners[which, k] for k in range(3))
    return np.concatenate([a + u[:, None] * (b - a) + v[:, None] * (c - a), corners.reshape(-1, 3)])
