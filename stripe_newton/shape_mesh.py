# SPDX-License-Identifier: Apache-2.0
"""Shape mesh: the triangles of a shape, as contacts, rays and the search for places to start take it."""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary, WeakSet

import newton
import numpy as np
from newton import GeoType

__all__ = ["shape_mesh"]

_ENDLESS = 1000.0
"""Half the extent that a plane without a width or a length gets [m]."""
_SAGITTA = 1e-4
"""Distance of the facets of round shapes from their surface [m]."""
_FACETS = 12, 256
"""Least and most facets around a round shape."""
_SUPPORTING = 1e-6
"""Height of a corner above a face, in extents of the mesh, up to which the face is one of the hull."""
_HULLS: WeakKeyDictionary[newton.Mesh, newton.Mesh] = WeakKeyDictionary()
"""Hulls of meshes, as each is asked for several times."""
_OWN_HULLS: WeakSet[newton.Mesh] = WeakSet()
"""Meshes that are their own hull, as of a stage that asks for hulls."""
_PLAIN = {"compute_normals": False, "compute_uvs": False, "compute_inertia": False}


def shape_mesh(
    kind: int, scale: np.ndarray, source: Any, label: str, sagitta: float = _SAGITTA
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a shape in its frame. Facets of round shapes are within 0.1 mm of them, up to 256 around.

    Args:
        kind: Its ``GeoType``.
        scale: Its scale or sizes [m], shape ``(3,)``.
        source: Its mesh or height field, if it has one.
        label: Its label, for the error.
        sagitta: Distance of the facets of round shapes from their surface [m].

    Returns:
        Vertices [m], shape ``(vertices, 3)``, and indices of three vertices, counterclockwise seen from outside, shape
        ``(faces, 3)``.

    Raises:
        ValueError: for a kind of shape that has no mesh.
    """
    mesh, factor = _mesh_of(GeoType(int(kind)), np.asarray(scale, dtype=float), source, label, sagitta)
    faces = np.asarray(mesh.indices, dtype=int).reshape(-1, 3)
    if np.prod(np.sign(factor)) < 0.0:  # a mirror turns triangles inside out
        faces = faces[:, ::-1]
    return np.asarray(mesh.vertices, dtype=float) * factor, faces


def _mesh_of(
    kind: GeoType, scale: np.ndarray, source: Any, label: str, sagitta: float
) -> tuple[newton.Mesh, np.ndarray]:
    """Mesh of a shape, and the factors on its coordinates."""
    a, b, c = scale.tolist()
    one, along_z = np.ones(3), newton.Axis.Z
    if kind == GeoType.MESH:
        return source, scale
    if kind == GeoType.CONVEX_MESH:
        return _hull(source), scale
    if kind == GeoType.HFIELD:
        return _field_mesh(source), scale
    if kind == GeoType.PLANE:
        return newton.Mesh.create_plane(a or 2.0 * _ENDLESS, b or 2.0 * _ENDLESS, **_PLAIN), one
    if kind == GeoType.BOX:
        return newton.Mesh.create_box(a, b, c, **_PLAIN), one
    count = _facets(max(a, b, c) if kind == GeoType.ELLIPSOID else a, sagitta)
    if kind in (GeoType.SPHERE, GeoType.ELLIPSOID):
        sphere = newton.Mesh.create_sphere(1.0, num_latitudes=count, num_longitudes=count, **_PLAIN)
        return sphere, scale if kind == GeoType.ELLIPSOID else a * one
    makers = {GeoType.CAPSULE: newton.Mesh.create_capsule, GeoType.CYLINDER: newton.Mesh.create_cylinder,
              GeoType.CONE: newton.Mesh.create_cone}  # fmt: skip
    if kind in makers:
        return makers[kind](a, b, up_axis=along_z, segments=count, **_PLAIN), one
    raise ValueError(f"'{label}': is a {kind.name}, which has no triangles")


def _hull(mesh: newton.Mesh) -> newton.Mesh:
    """The convex hull of a mesh, itself if it is one."""
    if mesh in _OWN_HULLS:
        return mesh
    if mesh not in _HULLS:
        if _is_hull(np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.indices).reshape(-1, 3), mesh.maxhullvert):
            _OWN_HULLS.add(mesh)
            return mesh
        _HULLS[mesh] = mesh.compute_convex_hull()
    return _HULLS[mesh]


def _is_hull(corners: np.ndarray, faces: np.ndarray, most: int) -> bool:
    """Whether triangles are those of a convex hull with all of its corners, at most so many; -1 for any number."""
    count = len(corners)
    if count < 4 or 0 < most < count or len(faces) != 2 * count - 4:
        return False
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    codes = np.sort(edges[:, 0] * count + edges[:, 1])
    closed = np.array_equal(codes, np.sort(edges[:, 1] * count + edges[:, 0])) and (np.diff(codes) > 0).all()
    if not closed or not np.bincount(faces.reshape(-1), minlength=count).all():
        return False
    a, b, c = corners[faces[:, 0]], corners[faces[:, 1]], corners[faces[:, 2]]
    normals = np.cross(b - a, c - a)
    heights = normals @ corners.T - (normals * a).sum(axis=1)[:, None]
    return bool(
        (heights.max(axis=1) <= _SUPPORTING * np.ptp(corners, axis=0).max() * np.linalg.norm(normals, axis=1)).all()
    )


def _facets(radius: float, sagitta: float) -> int:
    """Facets around a circle whose middles are within the sagitta of it."""
    share = min(sagitta / max(radius, sagitta), 1.0)
    return int(np.clip(np.ceil(np.pi / np.arccos(1.0 - share)), *_FACETS))


def _field_mesh(field: newton.Heightfield) -> newton.Mesh:
    """The surface of a height field; cells are cut from (row + 1, column) to (row, column + 1), as for contacts."""
    heights = field.min_z + np.asarray(field.data, dtype=float) * (field.max_z - field.min_z)
    nrow, ncol = heights.shape
    x, y = np.meshgrid(np.linspace(-field.hx, field.hx, ncol), np.linspace(-field.hy, field.hy, nrow))
    first = (np.arange(nrow - 1)[:, None] * ncol + np.arange(ncol - 1)).reshape(-1)
    faces = np.stack([first, first + 1, first + ncol, first + 1, first + ncol + 1, first + ncol], axis=1)
    points = np.stack([x, y, heights], axis=-1).reshape(-1, 3).astype(np.float32)
    return newton.Mesh(points, faces.reshape(-1).astype(np.int32), compute_inertia=False)
