# SPDX-License-Identifier: Apache-2.0
"""Flat meshes: mesh colliders without thickness, of which MuJoCo makes no hull."""

from __future__ import annotations

from collections.abc import Iterator

import newton
import numpy as np
from newton import GeoType, ShapeFlags

from .mesh_copies import with_geometry
from .stage_access import StageError

__all__ = ["thicken_flat_meshes"]

_FLAT = 2.0e-6
"""Thickness in extents below which MuJoCo's solver takes a mesh for flat, and a little more."""
_THICKNESS = 0.02
"""Thickness that a flat static mesh gets, behind its front side [m]."""


def thicken_flat_meshes(builder: newton.ModelBuilder, first: int, name: str) -> Iterator[tuple[str, str, str]]:
    """Give the flat static meshes from shape ``first`` on a thickness: the front stays where it is.

    Yields:
        A row ``(path, what, why)`` for each of them.

    Raises:
        StageError: all points are on one line, or a mesh on a moving body is flat.
    """
    for shape in range(first, builder.shape_count):
        collides = builder.shape_flags[shape] & ShapeFlags.COLLIDE_SHAPES
        if builder.shape_type[shape] not in (GeoType.MESH, GeoType.CONVEX_MESH) or not collides:
            continue
        mesh = builder.shape_source[shape]
        points = np.array(mesh.vertices, dtype=float) * np.array(builder.shape_scale[shape], dtype=float)
        normal, thickness, width = _plane(points)
        extent = float(np.linalg.norm(np.ptp(points, axis=0)))
        if thickness > _FLAT * extent:
            continue
        label = builder.shape_label[shape]
        if width <= _FLAT * extent:
            raise StageError(name, label, "is a mesh collider whose points are all on one line; give it an area")
        if builder.shape_body[shape] >= 0:
            reason = (
                "is a flat mesh collider on a rigid body, of which MuJoCo makes no hull; use a box, or a thick mesh"
            )
            raise StageError(name, label, reason)
        builder.shape_source[shape] = _thickened(mesh, points, normal)
        builder.shape_scale[shape] = (1.0, 1.0, 1.0)
        why = f"of a flat mesh MuJoCo makes no hull: it is made {_THICKNESS:g} m thick, behind its front side"
        yield label, "flat mesh collider", why


def _plane(points: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Normal of the plane that fits points best, their reach along it, and along the second narrowest axis."""
    centred = points - points.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1]  # by growing extent
    reach = np.ptp(centred @ axes, axis=0)
    return axes[:, 0], float(reach[0]), float(reach[1])


def _thickened(mesh: newton.Mesh, points: np.ndarray, normal: np.ndarray) -> newton.Mesh:
    """A plate: the faces of a flat mesh, the same behind them, and walls around."""
    faces = np.array(mesh.indices, dtype=np.int32).reshape(-1, 3)
    corners = points[faces]
    front = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    back = -normal if float(front @ normal) >= 0.0 else normal
    count = len(points)
    # Files repeat points for each normal: edges between two faces are found by the places of their ends.
    _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
    welded = first[same.reshape(-1)][faces]
    edges = np.concatenate([welded[:, [0, 1]], welded[:, [1, 2]], welded[:, [2, 0]]])
    _, where, times = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    rim = edges[where[times == 1]]
    a, b = rim[:, 0], rim[:, 1]
    walls = np.concatenate([np.stack([b, a, a + count], axis=1), np.stack([b, a + count, b + count], axis=1)])
    return with_geometry(
        mesh,
        np.concatenate([points, points + back * _THICKNESS]),
        np.concatenate([faces, faces[:, ::-1] + count, walls]).reshape(-1),
        normals=None,
        uvs=None if mesh.uvs is None or len(mesh.uvs) != count else np.concatenate([mesh.uvs, mesh.uvs]),
    )
