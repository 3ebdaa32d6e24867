# SPDX-License-Identifier: Apache-2.0
"""Mesh levels: the triangles of a mesh in ever coarser versions, for pictures whose pixels are larger than triangles.

A coarser version is made by vertex clustering with quadrics (Rossignac and Borrel 1993; Lindstrom 2000): space is cut
into cubes, and the vertices in a cube become the point that is nearest to the planes of their triangles. How far the
two surfaces are apart is measured; a camera takes the coarsest version for which that is less than a share of a pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from stripe_kernels.sensors.mesh_distance import measure_distances

__all__ = ["FEWEST_TRIANGLES", "Triangles", "cluster_vertices", "coarser_versions", "join", "surface_distance"]

FEWEST_TRIANGLES = 1000
"""Number of triangles below which a mesh has no coarser versions."""
_FEWEST_OF_A_PART = 60
"""Number below which a part of a mesh stays as it is."""
_MOST_TRIANGLES = 300_000
"""Number above which it has none either: they would take seconds, and such meshes are grounds, which are near."""
_EDGES = (1 / 128, 1 / 64, 1 / 32, 1 / 16, 1 / 8)
"""Edges of the cubes, the shortest first, as shares of the mesh's diagonal."""
_WORTHWHILE = 0.75
"""Share of the triangles of the version before that a version has at most."""
_SAMPLES = 2000
"""Number of vertices of the original, at most, from which the distance of a version is measured."""
_STIFFNESS = 0.01
"""Weight of the distance from the mean of the vertices, relative to that from the planes: flat surfaces need it."""


@dataclass
class Triangles:
    """Triangles with normals of their vertices.

    Attributes:
        vertices: Positions, shape ``(V, 3)``.
        faces: Indices of vertices, shape ``(F, 3)``.
        normals: Unit normals of the vertices, shape ``(V, 3)``; None for those of the faces.
        part: Number of the part that a face is of, shape ``(F,)``.
        error: Distance between this surface and the original.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None
    part: np.ndarray
    error: float = 0.0


def join(parts: list[Triangles]) -> Triangles:
    """Several meshes as one, whose parts have the numbers of the list. They must all have normals, or none."""
    first = np.cumsum([0, *(len(p.vertices) for p in parts)])
    faces = [p.faces + at for p, at in zip(parts, first, strict=False)]
    normals = [p.normals for p in parts if p.normals is not None]
    return Triangles(
        np.concatenate([p.vertices for p in parts]),
        np.concatenate(faces),
        np.concatenate(normals) if len(normals) == len(parts) else None,
        np.repeat(np.arange(len(parts)), [len(f) for f in faces]),
        max(p.error for p in parts),
    )


def coarser_versions(parts: list[Triangles], device: wp.Device) -> list[Triangles]:
    """Coarser versions of a mesh, the finest first, each with far fewer triangles than the one before.

    Args:
        parts: The meshes that it consists of. Each becomes coarser on its own, so that colours keep their places.
        device: Where distances are measured.
    """
    count = sum(len(part.faces) for part in parts)
    found: list[Triangles] = []
    if count < FEWEST_TRIANGLES:
        return found
    ladders = [[part, *_versions(part, device)] for part in parts]
    for error in sorted({version.error for ladder in ladders for version in ladder[1:]}):
        chosen = [[v for v in ladder if v.error <= error][-1] for ladder in ladders]
        if sum(len(version.faces) for version in chosen) <= _WORTHWHILE * count:
            found.append(join(chosen))
            count = len(found[-1].faces)
    return found


def _versions(mesh: Triangles, device: wp.Device) -> list[Triangles]:
    """Coarser versions of one part, by growing error."""
    found: list[Triangles] = []
    count = len(mesh.faces)
    if not _FEWEST_OF_A_PART <= count <= _MOST_TRIANGLES or not np.isfinite(mesh.vertices).all():
        return found
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    original = _tree(mesh, device)
    places = np.unique(_cubes(mesh.vertices, 1.0e-5 * diagonal)).size
    for edge in (share * diagonal for share in _EDGES):
        if np.unique(_cubes(mesh.vertices, edge)).size > _WORTHWHILE * places:
            continue
        made = cluster_vertices(mesh, edge)
        if not len(made.faces):
            break
        if len(made.faces) > _WORTHWHILE * count:
            continue
        made.error = surface_distance(mesh, original, made, _tree(made, device))
        if found and made.error <= found[-1].error:
            found.pop()
        found.append(made)
        count = len(made.faces)
    return found


def cluster_vertices(mesh: Triangles, edge: float) -> Triangles:
    """The mesh with the vertices in each cube of an ``edge`` moved to one place.

    Triangles of which two corners then meet are left out. Vertices that meet keep normals of their own where those
    point in different directions (by the axis that is next to each): edges stay sharp, and no cracks open.
    """
    place = np.unique(_cubes(mesh.vertices, edge), return_inverse=True)[1].reshape(-1)
    at = _best_places(mesh, place, edge)
    vertex, normals = place, None
    if mesh.normals is not None:
        axis = np.abs(mesh.normals).argmax(axis=1)
        side = 2 * axis + (np.take_along_axis(mesh.normals, axis[:, None], axis=1)[:, 0] < 0.0)
        _, first, vertex = np.unique(6 * place + side, return_index=True, return_inverse=True)
        vertex = vertex.reshape(-1)
        total = _sums(vertex, mesh.normals)
        normals = total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1.0e-12)
        at = at[place[first]]
    corners = np.sort(place[mesh.faces], axis=1)
    kept = np.flatnonzero((np.diff(corners, axis=1) > 0).all(axis=1))
    # Both sides of a thin plate may have come to lie in one place: one of them is enough, as surfaces have two sides.
    kept = kept[np.unique(corners[kept], axis=0, return_index=True)[1]]
    return Triangles(at, vertex[mesh.faces[kept]], normals, mesh.part[kept])


def _cubes(vertices: np.ndarray, edge: float) -> np.ndarray:
    """Number of the cube that each vertex is in."""
    cell = np.floor((vertices - vertices.min(axis=0)) / edge).astype(np.int64)
    count = cell.max(axis=0) + 1
    return (cell[:, 0] * count[1] + cell[:, 1]) * count[2] + cell[:, 2]


def _best_places(mesh: Triangles, place: np.ndarray, edge: float) -> np.ndarray:
    """Point of each cube that is nearest to the planes of the triangles with a corner in it, shape ``(cubes, 3)``."""
    mean = _sums(place, mesh.vertices) / np.bincount(place)[:, None]
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    size = np.maximum(np.linalg.norm(normal, axis=1), 1.0e-30)
    normal = normal / np.sqrt(size)[:, None]  # a square of it weighs as much as the triangle's area
    owner, normal, start = place[mesh.faces].reshape(-1), np.repeat(normal, 3, axis=0), np.repeat(a, 3, axis=0)
    away = (normal * (start - mean[owner])).sum(axis=1)
    products = (normal[:, :, None] * normal[:, None, :]).reshape(-1, 9)
    matrix = np.stack([np.bincount(owner, products[:, k], len(mean)) for k in range(9)], axis=1).reshape(-1, 3, 3)
    right = _sums(owner, normal * away[:, None], len(mean))
    weight = _STIFFNESS * np.trace(matrix, axis1=1, axis2=2) + 1.0e-30
    move = np.linalg.solve(matrix + weight[:, None, None] * np.eye(3), right[..., None])[..., 0]
    length = np.linalg.norm(move, axis=1, keepdims=True)
    return mean + move * np.minimum(1.0, edge / np.maximum(length, 1.0e-30))


def _sums(index: np.ndarray, rows: np.ndarray, count: int = 0) -> np.ndarray:
    """Sums of the rows of each index, shape ``(indices, 3)``."""
    return np.stack([np.bincount(index, rows[:, k], count) for k in range(3)], axis=1)


def _tree(mesh: Triangles, device: wp.Device) -> wp.Mesh:
    points = wp.array(mesh.vertices.astype(np.float32), dtype=wp.vec3, device=device)
    return wp.Mesh(points, wp.array(mesh.faces.reshape(-1).astype(np.int32), dtype=int, device=device))


def surface_distance(mesh: Triangles, tree: wp.Mesh, other: Triangles, other_tree: wp.Mesh) -> float:
    """Largest distance of a vertex of either surface from the other one; of some thousands of a large mesh.

    Args:
        mesh: One surface.
        tree: Its triangles on a device.
        other: The other one.
        other_tree: Its triangles.
    """
    largest = 0.0
    for source, target in ((mesh, other_tree), (other, tree)):
        used = np.unique(source.faces)
        points = source.vertices[used[:: -(-len(used) // _SAMPLES)]].astype(np.float32)
        found = wp.empty(len(points), dtype=float, device=target.device)
        inputs = [target.id, wp.array(points, dtype=wp.vec3, device=target.device)]
        wp.launch(measure_distances, dim=len(points), inputs=inputs, outputs=[found], device=target.device)
        largest = max(largest, float(found.numpy().max()))
    return largest
