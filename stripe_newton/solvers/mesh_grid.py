# SPDX-License-Identifier: Apache-2.0
"""Mesh grid: faces and edges of meshes that do not move, in grids that the fused step searches."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import warp as wp

from stripe_kernels.clearance import measure_clearance

from .level_cells import Cells, level_cells

__all__ = ["DEPTH", "MeshGrids", "TriangleMesh"]

DEPTH = 0.05
"""Depth in a solid, beyond a radius, at which a centre is still found, as in meshes.h [m]."""

_SAME = 1e-6
"""Distance within which vertices are the same, in extents of the mesh."""
_LEVEL = 1e-5
"""Height of the other face's third corner below which an edge is no bend [m]."""
_CELLS = 0.1, 0.2
"""Sizes of a cell at first, of faces and of edges: those of a robot's feet and of its links [m]."""
_LEAST_CELL = 0.05
_MANY_ITEMS = 24
"""Faces of a cell on average, of those that have some, from which on cells are made smaller."""
_MOST_CELLS, _MOST_ALONG = 4_000_000, 32_000
"""Cells of a grid, and of it along an axis: they are numbered by two bytes."""
_CLEAR_CELL, _MOST_CLEAR_CELLS = 0.1, 1_000_000
"""Size of a cell that has a distance [m], unless there would be more of them."""
_WIDTH = 1e-4
"""Width of the triangles that stand for edges [m]."""
_UNIT = 0.01
"""Unit of the distances, which are up to 255 of it [m]."""
_BLOCK = 2_000_000
"""Cells that are looked at at once, for memory."""

_GRID = np.dtype(
    [("low", "3f4"), ("cells_per_metre", "f4"), ("size", "3i4"), ("reach", "f4"),
     ("cells", "u8"), ("items", "u8"), ("things", "u8"), ("planes", "u8")]
)  # fmt: skip
"""As struct Grid of search.h."""
_CLEARANCE = np.dtype(
    [
        ("low", "3f4"),
        ("cells_per_metre", "f4"),
        ("size", "3i4"),
        ("unit", "f4"),
        ("cells", "u8"),
        ("metres_per_cell", "f4"),
        ("none", "f4"),
    ]
)
"""As struct Clearance of search.h."""
_FACE = np.dtype(
    [("normal", "3f4"), ("geom", "i4"), ("a", "3f4"), ("is_solid", "i4"), ("b", "3f4"), ("none1", "i4"), ("c", "3f4"),
     ("none2", "i4")]
)  # fmt: skip
"""As struct MeshFace of meshes.h."""
_EDGE = np.dtype([("corners", "(4,3)f4"), ("geom", "i4"), ("is_solid", "i4"), ("none", "2i4")])
"""As struct MeshEdge of meshes.h: its ends, and the third corners of the faces on both sides."""


@dataclass(frozen=True)
class TriangleMesh:
    """A mesh by its triangles."""

    vertices: np.ndarray
    """Shape ``(vertices, 3)`` [m], in a frame that the meshes of a grid share."""
    faces: np.ndarray
    """Indices of three vertices, counterclockwise seen from outside, shape ``(faces, 3)``."""
    geom: int
    """Geom of MuJoCo's model whose mesh it is."""


@dataclass
class MeshGrids:
    """Grids of some groups of meshes, each of which has a frame, on a device.

    Meshes that are closed, and whose faces are seen from outside, are solid: what is inside is pushed out through the
    nearest face. Faces of others have two outsides.
    """

    groups: Iterable[Iterable[TriangleMesh]]
    reach: float
    """Distance from a point within which the lists of its cell have all faces [m]."""
    device: str | wp.Device
    array: wp.array = field(init=False)
    """The grids of faces, of edges and of distances of each group, as bytes of structs ``Mesh`` of search.h."""

    def __post_init__(self) -> None:
        self._arrays: list[wp.array] = []
        records = [grid.view(np.uint8) for group in self.groups for grid in self._grids(list(group))]
        self.array = self._keep(np.concatenate(records))

    def _grids(self, meshes: list[TriangleMesh]) -> Iterable[np.ndarray]:
        faces, edges, goes_on = _faces_and_edges(meshes)
        yield self._grid(faces, _corners(faces), _CELLS[0], self.reach, goes_on)
        yield self._grid(edges, edges["corners"][:, :2], _CELLS[1], 0.0)
        yield self._clearance(faces, edges)

    def _grid(
        self, things: np.ndarray, corners: np.ndarray, cell: float, reach: float, goes_on: np.ndarray | None = None
    ) -> np.ndarray:
        """The record of a grid; corners are those of a triangle, or the ends of an edge, of each thing."""
        low, size, cell, first, items = _sort_into_cells(corners.astype(float), cell, reach)
        record = np.zeros(1, _GRID)
        record["low"], record["cells_per_metre"], record["size"], record["reach"] = low, 1.0 / cell, size, reach
        arrays = {"cells": first, "items": items, "things": things.view(np.uint8)}
        if goes_on is not None:
            cells = Cells(low, size, cell, first, items)
            arrays["planes"] = level_cells(cells, corners, things["normal"], things["geom"], goes_on)
        for name, array in arrays.items():
            record[name] = self._keep(array).ptr or 0
        return record

    def _clearance(self, faces: np.ndarray, edges: np.ndarray) -> np.ndarray:
        """The record of the grid of distances to the nearest face and the nearest edge."""
        points = _corners(faces).reshape(-1, 3).astype(float)
        low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.zeros(3))
        cell = _CLEAR_CELL
        while np.prod(_cells(low, high, cell), dtype=float) > _MOST_CLEAR_CELLS:
            cell *= 1.25
        size = _cells(low, high, cell)
        cells = wp.full((int(np.prod(size)), 2), value=wp.uint8(255), dtype=wp.uint8, device=self.device)
        if len(points):
            corners = wp.array(points.astype(np.float32), dtype=wp.vec3, device=self.device)
            indices = wp.array(np.arange(len(points), dtype=np.int32), device=self.device)
            solid = wp.array(faces["is_solid"].copy(), device=self.device)
            mesh = wp.Mesh(corners, indices)  # by name, as nothing else keeps it during the launch
            bends = self._as_triangles(edges) if len(edges) else None
            inputs = [mesh.id, bends.id if bends else 0, solid, wp.vec3(*low), cell, int(size[0]), int(size[1]), _UNIT]
            wp.launch(measure_clearance, len(cells), inputs, [cells], device=self.device)
        self._arrays.append(cells)
        record = np.zeros(1, _CLEARANCE)
        record["low"], record["cells_per_metre"], record["size"], record["unit"] = low, 1.0 / cell, size, _UNIT
        record["cells"], record["metres_per_cell"] = cells.ptr, cell
        return record

    def _as_triangles(self, edges: np.ndarray) -> wp.Mesh:
        """Edges as narrow triangles; those without an area are not found."""
        corners = edges["corners"][:, [0, 1, 1]].astype(float)
        along = corners[:, 1] - corners[:, 0]
        across = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
        corners[:, 2] += _WIDTH / np.linalg.norm(across, axis=1, keepdims=True) * across
        points = wp.array(corners.reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device=self.device)
        return wp.Mesh(points, wp.array(np.arange(3 * len(corners), dtype=np.int32), device=self.device))

    def _keep(self, array: np.ndarray) -> wp.array:
        kept = wp.array(array, device=self.device)
        self._arrays.append(kept)
        return kept


def _faces_and_edges(meshes: list[TriangleMesh]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Records of the faces of meshes, and of the edges that can touch before faces do, mesh by mesh.

    Also whether the surface goes on in the plane of each face beyond each of its edges, shape ``(faces, 3)``.
    """
    vertices, of_vertex, faces, of_face = _welded(meshes)
    geoms = np.array([mesh.geom for mesh in meshes], dtype=int)
    neighbours = _neighbours(faces)
    is_open = np.bincount(of_face, _has_open_edge(faces), len(meshes)) > 0
    solid = (~is_open & (_volumes(vertices, of_vertex, faces, of_face, len(meshes)) > 0.0))[of_face]
    made = np.zeros(len(faces), _FACE)
    made["geom"], made["is_solid"] = geoms[of_face], solid
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    made["a"], made["b"], made["c"] = a, b, c
    made["normal"] = _normals(a, b, c)

    face, side = np.nonzero(neighbours < np.arange(len(faces))[:, None])  # each edge once, borders too
    other = neighbours[face, side]
    ends = np.stack([faces[face, side], faces[face, (side + 1) % 3]], axis=1)
    left = faces[face, (side + 2) % 3]
    across = faces[other]  # of a border anything: it is not used
    is_end = (across[:, :, None] == ends[:, None, :]).any(axis=2)
    right = np.where(other >= 0, across[np.arange(len(other)), is_end.argmin(axis=1)], left)
    a, b, c = (vertices[faces[face, k]] for k in range(3))
    height = np.einsum("ij,ij->i", vertices[right] - vertices[ends[:, 0]], _normals(a, b, c))
    goes_on = np.zeros((len(faces), 3), dtype=bool)
    level = (other >= 0) & (np.abs(height) <= _LEVEL)
    back = (neighbours[other] == face[:, None]) & (other >= 0)[:, None]
    goes_on[face, side] = level
    edge, its_side = np.nonzero(back)
    goes_on[other[edge], its_side] = level[edge]
    # Of a solid the edges at which it bends down; of an open mesh, all at which it bends or ends.
    bends = (other < 0) | (height < -_LEVEL) | ((height > _LEVEL) & ~solid[face])
    edges = np.zeros(int(bends.sum()), _EDGE)
    points = np.concatenate([ends, left[:, None], right[:, None]], axis=1)[bends]
    edges["corners"], edges["geom"], edges["is_solid"] = (
        vertices[points],
        geoms[of_face[face[bends]]],
        solid[face[bends]],
    )
    return made, edges, goes_on


def _corners(faces: np.ndarray) -> np.ndarray:
    """Corners of records of faces, shape ``(faces, 3, 3)``."""
    return np.stack([faces[name] for name in ("a", "b", "c")], axis=1)


def _normals(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Normals of triangles by their corners, shape ``(triangles, 3)``."""
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def _volumes(
    vertices: np.ndarray, of_vertex: np.ndarray, faces: np.ndarray, of_face: np.ndarray, count: int
) -> np.ndarray:
    """Six times the volume within the faces of each of some meshes, negative inside out [m^3], shape ``(count,)``."""
    of_mesh = np.maximum(np.bincount(of_vertex, minlength=count), 1)
    centers = np.stack([np.bincount(of_vertex, vertices[:, k], count) / of_mesh for k in range(3)], axis=1)
    a, b, c = (vertices[faces[:, k]] - centers[of_face] for k in range(3))
    return np.bincount(of_face, np.einsum("ij,ij->i", np.cross(a, b), c), count)


def _welded(meshes: list[TriangleMesh]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices of meshes, one for all of a mesh at a place, and faces with an area; each with the mesh it is of."""
    counts, lengths = [len(mesh.vertices) for mesh in meshes], [len(mesh.faces) for mesh in meshes]
    of_vertex, of_face = (np.repeat(np.arange(len(meshes)), numbers) for numbers in (counts, lengths))
    vertices = np.concatenate([mesh.vertices.astype(float) for mesh in meshes])
    extents = [float(np.ptp(mesh.vertices, axis=0).max()) if len(mesh.vertices) else 0.0 for mesh in meshes]
    extent = np.maximum(extents, 1e-9)
    places = np.round(vertices / (_SAME * extent[of_vertex, None]))
    order = np.lexsort((*places.T[::-1], of_vertex))
    keys = np.concatenate([of_vertex[order, None], places[order]], axis=1)
    is_new = np.append(True, (keys[1:] != keys[:-1]).any(axis=1))[: len(keys)]
    same = np.empty(len(vertices), dtype=int)
    same[order] = np.cumsum(is_new) - 1
    first = order[is_new]
    start = np.repeat(np.cumsum([0, *counts[:-1]]), lengths)
    faces = same[np.concatenate([np.asarray(m.faces, dtype=int).reshape(-1, 3) for m in meshes]) + start[:, None]]
    vertices, of_vertex = vertices[first], of_vertex[first]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    i, j, k = faces.T
    proper = (i != j) & (j != k) & (k != i) & (area > 1e-12 * extent[of_face] ** 2)
    return vertices, of_vertex, faces[proper], of_face[proper]


def _neighbours(faces: np.ndarray) -> np.ndarray:
    """The face across each edge of each face, shape ``(faces, 3)``; -1 where there is none or more than one.

    Faces that share an edge go along it in opposite directions, else one of them is seen from inside.
    """
    start, end = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    count = int(faces.max(initial=-1)) + 1
    forward, backward = start.astype(np.int64) * count + end, end.astype(np.int64) * count + start
    keys, first, times = np.unique(forward, return_index=True, return_counts=True)
    place = np.minimum(np.searchsorted(keys, backward), max(len(keys) - 1, 0))
    found = (keys[place] == backward) & (times[place] == 1) & (times[np.searchsorted(keys, forward)] == 1)
    return np.where(found, first[place] // 3, -1).reshape(-1, 3) if len(keys) else np.zeros((0, 3), dtype=int)


def _has_open_edge(faces: np.ndarray) -> np.ndarray:
    """Whether a mesh ends at an edge of each face: more faces go along it in one direction than in the other.

    There may be more than two: boxes that stand side by side in one mesh share their edges, and each is closed.
    """
    start, end = faces.reshape(-1).astype(np.int64), np.roll(faces, -1, axis=1).reshape(-1).astype(np.int64)
    edges = np.minimum(start, end) * (int(faces.max(initial=-1)) + 1) + np.maximum(start, end)
    _, edge = np.unique(edges, return_inverse=True)
    balance = np.bincount(edge, np.where(start < end, 1.0, -1.0))
    return (balance[edge] != 0.0).reshape(-1, 3).any(axis=1)


def _sort_into_cells(
    corners: np.ndarray, cell: float, reach: float
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray]:
    """Lowest corner, cells along each axis, their size [m], first item of each cell and one beyond, and the items."""
    points = corners.reshape(-1, 3)
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) else (np.zeros(3), np.zeros(3))
    low, high = low - 1e-3 - reach, high + 1e-3 + reach
    while np.prod(_cells(low, high, cell), dtype=float) > _MOST_CELLS or _cells(low, high, cell).max() > _MOST_ALONG:
        cell *= 1.25
    while True:
        size = _cells(low, high, cell)
        cells, items = _overlaps(corners, low, size, cell, reach)
        many = len(items) > _MANY_ITEMS * max(1, len(np.unique(cells)))
        if not many or cell <= _LEAST_CELL or np.prod(_cells(low, high, cell / 2), dtype=float) > _MOST_CELLS:
            break
        if _cells(low, high, cell / 2).max() > _MOST_ALONG:
            break
        cell /= 2.0
    order = np.lexsort((items, cells))
    first = np.zeros(int(np.prod(size)) + 1, dtype=np.int32)
    np.cumsum(np.bincount(cells, minlength=len(first) - 1), out=first[1:])
    return low, size, cell, first, items[order].astype(np.int32)


def _cells(low: np.ndarray, high: np.ndarray, cell: float) -> np.ndarray:
    return np.maximum(1, np.ceil((high - low) / cell)).astype(int)


def _overlaps(
    corners: np.ndarray, low: np.ndarray, size: np.ndarray, cell: float, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a cell and an item that may be so near to it: by its bounding box, and of a triangle also by its plane
    and its distance from the ball around the cell.
    """
    from_, to = (
        np.clip(np.floor((bound - low) / cell).astype(int), 0, size - 1)
        for bound in (corners.min(axis=1) - 1e-4 - reach, corners.max(axis=1) + 1e-4 + reach)
    )
    counts = np.prod(to - from_ + 1, axis=1)
    ends = np.cumsum(counts)
    found: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros(0, dtype=int), np.zeros(0, dtype=int))]
    start = 0
    while start < len(corners):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + _BLOCK)))
        item = np.repeat(np.arange(start, stop), counts[start:stop])
        k = np.arange(len(item)) - np.repeat(ends[start:stop] - counts[start:stop] - before, counts[start:stop])
        extent = (to - from_ + 1)[item]
        place = from_[item] + np.stack(
            [k % extent[:, 0], k // extent[:, 0] % extent[:, 1], k // (extent[:, 0] * extent[:, 1])], axis=1
        )
        if corners.shape[1] == 3:
            near = _meets_plane(corners[item], low + (place + 0.5) * cell, cell, reach)
            item, place = item[near], place[near]
            away = _distances(corners[item], low + (place + 0.5) * cell)
            near = away <= reach + 0.5 * np.sqrt(3.0) * cell + 2e-4
            item, place = item[near], place[near]
        found.append(((place[:, 2] * size[1] + place[:, 1]) * size[0] + place[:, 0], item))
        start = stop
    cells, items = (np.concatenate([pair[i] for pair in found]) for i in range(2))
    return cells, items


def _meets_plane(triangles: np.ndarray, centers: np.ndarray, cell: float, reach: float) -> np.ndarray:
    """Whether the plane of each triangle comes so near to a cube around a centre."""
    normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    distance = np.abs(np.einsum("ij,ij->i", centers - triangles[:, 0], normal))
    return distance <= 0.5 * cell * np.abs(normal).sum(axis=1) + (reach + 2e-4) * np.linalg.norm(normal, axis=1)


def _distances(triangles: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of each triangle from a point, shape ``(triangles,)``."""
    corners = triangles - points[:, None]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    nearest, is_inside = np.full(len(points), np.inf), np.ones(len(points), dtype=bool)
    for k in range(3):
        start, along = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        share = -np.einsum("ij,ij->i", start, along) / np.einsum("ij,ij->i", along, along)
        offset = start + np.clip(share, 0.0, 1.0)[:, None] * along
        nearest = np.minimum(nearest, np.einsum("ij,ij->i", offset, offset))
        is_inside &= np.einsum("ij,ij->i", np.cross(start, along), normal) >= 0.0
    above = np.einsum("ij,ij->i", corners[:, 0], normal) ** 2 / np.einsum("ij,ij->i", normal, normal)
    return np.sqrt(np.where(is_inside, above, nearest))
