# SPDX-License-Identifier: Apache-2.0
"""Creases: vertex normals that are smooth over flat angles and sharp at edges, for meshes without any."""

from __future__ import annotations

import math

import newton
import numpy as np

from stripe_newton.usd.mesh_copies import with_geometry

__all__ = ["CREASE_ANGLE", "corner_normals", "crease_builder", "crease_model", "creased"]

CREASE_ANGLE = 40.0
"""Angle between two faces from which the edge between them stays sharp [deg]."""
_MOST_FACES = 1_000_000
"""Number of faces above which a mesh is drawn as it is: finding its creases would take seconds."""
_SAME = 1.0e-5
"""Distance within which vertices count as one, as a share of the mesh's size."""
_SAME_NORMAL = 0.999
"""Cosine from which two normals count as the same."""


def creased(mesh: newton.Mesh, angle: float = CREASE_ANGLE) -> newton.Mesh:
    """The mesh with vertices split at its creases, for drawing; itself if its own normals keep them or it is huge.

    Importers give meshes without authored normals either those of the faces, which shows every facet of a cylinder, or
    means over all faces around a vertex, which makes boxes look inflated.

    Args:
        mesh: Triangles, with or without normals. It is not changed: shapes may share it, also for collisions.
        angle: See :data:`CREASE_ANGLE`.
    """
    vertices = np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3)
    faces = np.asarray(mesh.indices).reshape(-1, 3)
    if not 0 < len(faces) <= _MOST_FACES or not np.isfinite(vertices).all():
        return mesh
    place = _welded(vertices)
    flat = _face_normals(vertices, faces)
    if mesh.normals is not None and _are_authored(np.asarray(mesh.normals), faces, place, flat):
        return mesh
    normals, group = _grouped(vertices, faces, place, flat, angle)
    # A vertex for each vertex of the file and each group of faces that meet in it smoothly: texture seams stay.
    pairs = faces.reshape(-1).astype(np.int64) * (int(group.max()) + 1) + group
    _, first, index = np.unique(pairs, return_index=True, return_inverse=True)
    source = faces.reshape(-1)[first]
    uvs = None if mesh.uvs is None or len(mesh.uvs) != len(vertices) else np.asarray(mesh.uvs)[source]
    return with_geometry(mesh, vertices[source], index.reshape(-1), normals[group[first]], uvs)


def crease_builder(builder: newton.ModelBuilder) -> None:
    """Draw the visible meshes of a builder that nothing simulates with their creases."""
    for i, source in enumerate(builder.shape_source):
        if _is_drawn(builder.shape_type[i], builder.shape_flags[i], source):
            builder.shape_source[i] = _known_creased(source)


def crease_model(model: newton.Model) -> None:
    """Draw the visible meshes of a model with their creases, other than those that collide: physics has those."""
    if not model.shape_count:
        return
    kinds, flags = model.shape_type.numpy(), model.shape_flags.numpy()
    pointers, changed = model.shape_source_ptr.numpy(), False
    for i, source in enumerate(model.shape_source):
        if flags[i] & newton.ShapeFlags.COLLIDE_SHAPES or not _is_drawn(kinds[i], flags[i], source):
            continue
        made = _known_creased(source)
        if made is not source:
            pointers[i], changed = made.finalize(device=model.device), True
            model.shape_source[i] = made
    if changed:
        model.shape_source_ptr.assign(pointers)


def _is_drawn(kind: int, flags: int, source: object) -> bool:
    """Whether a shape is a visible triangle mesh."""
    visible = int(flags) & int(newton.ShapeFlags.VISIBLE)
    return bool(visible) and int(kind) == int(newton.GeoType.MESH) and isinstance(source, newton.Mesh)


def _known_creased(mesh: newton.Mesh) -> newton.Mesh:
    """:func:`creased`, once for each mesh."""
    # Kept on the mesh itself: it is shared by many shapes, and by the renderers of several pictures.
    known = getattr(mesh, "_creased", None)
    if known is None:
        known = mesh._creased = creased(mesh)
        known._creased = known
    return known


def corner_normals(vertices: np.ndarray, faces: np.ndarray, angle: float = CREASE_ANGLE) -> np.ndarray:
    """Unit normal of each corner of each face: the mean over the faces that meet there without a crease between them.

    Args:
        vertices: Shape ``(V, 3)``; those in one place count as one.
        faces: Shape ``(F, 3)``.
        angle: See :data:`CREASE_ANGLE`.

    Returns:
        Shape ``(F, 3, 3)``.
    """
    vertices = np.asarray(vertices, dtype=np.float64)
    normals, group = _grouped(vertices, faces, _welded(vertices), _face_normals(vertices, faces), angle)
    return normals[group].reshape(-1, 3, 3)


def _welded(vertices: np.ndarray) -> np.ndarray:
    """For each vertex, a number that it shares with those in the same place."""
    size = float(np.ptp(vertices, axis=0).max()) or 1.0
    cells = np.round((vertices - vertices.min(axis=0)) / (_SAME * size)).astype(np.int64)
    # One number for three coordinates of up to 1e5: sorting numbers is far faster than sorting rows.
    keys = (cells[:, 0] * 200_003 + cells[:, 1]) * 200_003 + cells[:, 2]
    return np.unique(keys, return_inverse=True)[1].reshape(-1)


def _face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals of faces, as long as their double areas, shape ``(F, 3)``."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1.0e-30)


def _are_authored(normals: np.ndarray, faces: np.ndarray, place: np.ndarray, flat: np.ndarray) -> bool:
    """Whether normals say which edges are sharp: neither those of the faces nor one for each place."""
    normals, area = _unit(normals.reshape(-1, 3).astype(np.float64)), np.linalg.norm(flat, axis=1)
    solid = area > 1.0e-12 * max(float(area.max()), 1.0e-30)  # slivers have any normal
    faceted = np.einsum("fkj,fj->fk", normals[faces], _unit(flat)).min(axis=1)[solid] > _SAME_NORMAL
    if faceted.all():
        return False
    first = np.zeros(place.max() + 1, dtype=np.int64)
    first[place] = np.arange(len(place))
    one = (normals * normals[first[place]]).sum(axis=1) > _SAME_NORMAL
    return not one[faces].all()


def _grouped(
    vertices: np.ndarray, faces: np.ndarray, place: np.ndarray, flat: np.ndarray, angle: float
) -> tuple[np.ndarray, np.ndarray]:
    """Normals of groups of corners that meet smoothly ``(G, 3)``, and the group of each corner ``(3 F,)``."""
    count, at = len(faces), place[faces]
    # Each edge of each face with the corners at its two ends, which are 3 f + k.
    tail = np.arange(3 * count)
    head = tail.reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    a, b = at.reshape(-1)[tail], at.reshape(-1)[head]
    swap = a > b
    low, high = np.where(swap, head, tail), np.where(swap, tail, head)
    key = np.minimum(a, b).astype(np.int64) * (int(place.max()) + 1) + np.maximum(a, b)
    order = np.argsort(key, kind="stable")
    same = key[order][1:] == key[order][:-1]
    one, two = order[:-1][same], order[1:][same]
    normal = _unit(flat)
    smooth = (normal[one // 3] * normal[two // 3]).sum(axis=1) > math.cos(math.radians(angle))
    one, two = one[smooth], two[smooth]
    ends = np.concatenate([low[one], high[one]]), np.concatenate([low[two], high[two]])
    from scipy.sparse import coo_array  # here, as both take long to import
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(ends[0]), dtype=bool), ends), shape=(3 * count, 3 * count))
    groups, group = connected_components(graph, directed=False)
    # By the angle of the corner (Thurmer and Wuethrich 1998): how a face is cut into triangles does not matter then.
    corners = vertices[faces]
    out, back = _unit(np.roll(corners, -1, axis=1) - corners), _unit(np.roll(corners, 1, axis=1) - corners)
    wide = np.arccos(np.clip((out * back).sum(axis=-1), -1.0, 1.0)).reshape(-1)
    weighted = np.repeat(normal, 3, axis=0) * wide[:, None]
    total = np.stack([np.bincount(group, weighted[:, k], groups) for k in range(3)], axis=1)
    return _unit(total), group
