# SPDX-License-Identifier: Apache-2.0
"""Ground from files: the surface of a USD or mesh file, sampled from above as a height field."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import trimesh
import warp as wp
from pxr import Usd, UsdGeom, UsdPhysics

from stripe_kernels.rasterize import rasterize_from_above
from stripe_newton.usd import open_stage

from .ground import Ground
from .ground_usd import ground_prims, read_ground

__all__ = ["ground_from_file", "rasterize"]

_USD = (".usd", ".usda", ".usdc", ".usdz")
_MAX_HEIGHTS = 50_000_000
"""Most heights of a field: 200 MB in float32, several times on the device."""
_NOTABLE_DEPTH = 0.02
"""Depth below the highest surface from which lost surfaces are a warning [m]."""
_Z_UP = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float)
"""Matrix that turns rows of coordinates with y up to z up."""


def ground_from_file(path: str, spacing: float, device: str) -> Ground:
    """Sample the highest surface of a file on a grid.

    A height field that a scene of this package exported is read as it is.

    Args:
        path: USD file, or a mesh file in metres with z up.
        spacing: Distance between neighbouring heights [m]; adjusted so that whole cells fill the extent.
        device: Device on which the rays are cast.

    Raises:
        ValueError: if the file has no surface, or more heights would be needed than fit.
    """
    file = Path(path).expanduser()
    if file.suffix.lower() not in _USD:
        try:
            mesh = trimesh.load(file, force="mesh", process=False)
        except Exception as error:  # trimesh's readers raise all kinds
            raise ValueError(f"terrain '{path}': {error}") from error
        if not len(mesh.faces):
            raise ValueError(f"terrain '{path}': has no triangles")
        return rasterize(mesh, spacing, device, path)
    stage = open_stage(file)
    fields = ground_prims(stage)
    if len(fields) == 1:  # exact, with its tiles, where sampling would blur walls
        return read_ground(fields[0])
    return rasterize(_stage_mesh(stage, path), spacing, device, path)


def rasterize(mesh: trimesh.Trimesh, spacing: float, device: str, where: str) -> Ground:
    """Sample the highest surface of a mesh by rays from above; warn of overhangs and holes, which are lost.

    Raises:
        ValueError: if more heights would be needed than fit.
    """
    points = np.asarray(mesh.vertices, dtype=np.float32)
    low, high = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
    if not min(high[:2] - low[:2]) > 0.0:
        raise ValueError(f"terrain '{where}': has no extent in x or y; z must point up")
    ncol, nrow = (max(2, round(extent / spacing) + 1) for extent in high[:2] - low[:2])
    if ncol * nrow > _MAX_HEIGHTS:
        raise ValueError(
            f"terrain '{where}': {ncol} by {nrow} heights at horizontal_scale {spacing} m are too many; "
            f"its extent is {high[0] - low[0]:g} m by {high[1] - low[1]:g} m, set a greater horizontal_scale"
        )
    shrink = 1.0e-5 * (high - low)  # a ray exactly on the edge may miss the mesh
    x, y = (np.linspace(low[i] + shrink[i], high[i] - shrink[i], n) for i, n in ((0, ncol), (1, nrow)))
    with wp.ScopedDevice(device):
        surface = wp.Mesh(
            wp.array(points, dtype=wp.vec3), wp.array(np.asarray(mesh.faces, dtype=np.int32).reshape(-1), dtype=int)
        )
        heights, lost = wp.zeros((nrow, ncol), dtype=float), wp.zeros((nrow, ncol), dtype=float)
        bottom = float(low[2]) - 1.0  # value of the heights where the ray hits nothing
        rows = [wp.array(values.astype(np.float32), dtype=float) for values in (x, y)]
        wp.launch(
            rasterize_from_above,
            dim=(nrow, ncol),
            inputs=[surface.id, *rows, float(high[2]) + 1.0, bottom],
            outputs=[heights, lost],
        )
        found, depth = heights.numpy(), lost.numpy()
    missed = found <= bottom + 0.5
    if missed.all():
        raise ValueError(f"terrain '{where}': no surface can be seen from above")
    if missed.any():  # a height field has no holes
        found = np.where(missed, found[~missed].min(), found)
        warnings.warn(
            f"terrain '{where}': nothing is below {missed.mean():.1%} of its extent, which becomes level ground at its "
            "lowest height",
            stacklevel=3,
        )
    if (depth > _NOTABLE_DEPTH).any():
        row, col = np.unravel_index(int(depth.argmax()), depth.shape)
        warnings.warn(
            f"terrain '{where}': {(depth > _NOTABLE_DEPTH).mean():.1%} of it has an overhang; a height field has the "
            f"highest surface alone, what is below is lost, up to {depth.max():.2f} m below at x = {x[col]:.2f} m, "
            f"y = {y[row]:.2f} m",
            stacklevel=3,
        )
    cell = (high[0] - low[0]) / (ncol - 1), (high[1] - low[1]) / (nrow - 1)
    return Ground(found, (float(low[0]), float(low[1])), (float(cell[0]), float(cell[1])))


def _stage_mesh(stage: Usd.Stage, where: str) -> trimesh.Trimesh:
    """All static geometry of a stage as one mesh in the world frame, z up: the colliders, or everything without any."""
    geometry = [p for p in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()) if p.IsA(UsdGeom.Gprim)]
    moving = [p for p in geometry if _in_body(p)]
    fixed = [p for p in geometry if not _in_body(p)]
    colliders = [p for p in fixed if p.HasAPI(UsdPhysics.CollisionAPI)]
    parts, left = [], [str(p.GetPath()) for p in moving]
    cache, metres = UsdGeom.XformCache(), UsdGeom.GetStageMetersPerUnit(stage)
    y_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y
    for prim in colliders or [p for p in fixed if _is_drawn(p)]:
        part = _triangles(prim)
        if part is None:
            left.append(str(prim.GetPath()))
            continue
        points, faces = part
        matrix = np.array(cache.GetLocalToWorldTransform(prim))  # of rows, the last one the translation
        points = (points @ matrix[:3, :3] + matrix[3, :3]) * metres
        if y_up:
            points = points @ _Z_UP
        # A mirror turns triangles inside out.
        mirrored = np.linalg.det(matrix[:3, :3]) < 0.0
        parts.append(trimesh.Trimesh(points, faces[:, ::-1] if mirrored else faces, process=False))
    if left:
        warnings.warn(
            f"terrain '{where}': left out as no ground: {', '.join(left[:5])}" + (" ..." if len(left) > 5 else ""),
            stacklevel=4,
        )
    if not parts:
        raise ValueError(f"terrain '{where}': has no mesh, cube, sphere, cylinder, cone or capsule that stands still")
    return trimesh.util.concatenate(parts)


def _in_body(prim: Usd.Prim) -> bool:
    """Whether a prim belongs to a rigid body, and so may move."""
    while prim and not prim.IsPseudoRoot():
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            return True
        prim = prim.GetParent()
    return False


def _is_drawn(prim: Usd.Prim) -> bool:
    image = UsdGeom.Imageable(prim)
    return image.ComputeVisibility() != UsdGeom.Tokens.invisible and image.ComputePurpose() != UsdGeom.Tokens.guide


def _triangles(prim: Usd.Prim) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices and triangles of a prim in its own frame; None for a type of prim that is not supported."""
    if prim.IsA(UsdGeom.Mesh):
        mesh = UsdGeom.Mesh(prim)
        points = np.array(mesh.GetPointsAttr().Get(), dtype=float).reshape(-1, 3)
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get(), dtype=int)
        indices = np.array(mesh.GetFaceVertexIndicesAttr().Get(), dtype=int)
        # A face of n vertices becomes a fan of n - 2 triangles around its first vertex.
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)
        each = np.maximum(counts - 2, 0)
        fans = np.repeat(starts, each)
        within = np.arange(each.sum()) - np.repeat(np.cumsum(each) - each, each) + 1
        faces = np.stack([indices[fans], indices[fans + within], indices[fans + within + 1]], axis=1)
        if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            faces = faces[:, ::-1]
        return points, faces
    made = _primitive(prim)
    if made is None:
        return None
    # The primitive was made along z: a cyclic change of the axes turns it without mirroring it.
    axis = {"X": (1, 2, 0), "Y": (2, 0, 1)}.get(str(prim.GetAttribute("axis").Get() or "Z"), (0, 1, 2))
    points = np.empty_like(made.vertices)
    for k, i in enumerate(axis):
        points[:, i] = made.vertices[:, k]
    return points, np.asarray(made.faces)


def _primitive(prim: Usd.Prim) -> trimesh.Trimesh | None:
    """A primitive shape as a mesh, along z; None for other types of prims."""

    def value(name: str) -> float:
        return float(prim.GetAttribute(name).Get())

    if prim.IsA(UsdGeom.Cube):
        return trimesh.creation.box(extents=[value("size")] * 3)
    if prim.IsA(UsdGeom.Sphere):
        return trimesh.creation.icosphere(subdivisions=4, radius=value("radius"))
    if prim.IsA(UsdGeom.Cylinder):
        return trimesh.creation.cylinder(radius=value("radius"), height=value("height"), sections=64)
    if prim.IsA(UsdGeom.Capsule):
        return trimesh.creation.capsule(radius=value("radius"), height=value("height"), count=[64, 64])
    if prim.IsA(UsdGeom.Cone):
        cone = trimesh.creation.cone(radius=value("radius"), height=value("height"), sections=64)
        cone.vertices -= (0.0, 0.0, 0.5 * value("height"))  # USD's is centred, trimesh's stands on its base
        return cone
    return None
