# SPDX-License-Identifier: Apache-2.0
"""Concave meshes: colliders whose convex hull is another shape, which MuJoCo's collision detection takes for them."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import newton
import numpy as np
from newton import GeoType, ShapeFlags
from pxr import Usd, UsdGeom, UsdPhysics

from .ignored_rows import Ignored
from .stage_access import labelled_prim

__all__ = [
    "authored_hull_rows",
    "concave_colliders",
    "concave_mesh_rows",
    "concave_meshes",
    "hollow_depth",
    "rows_by_distance",
    "rows_by_triangles",
]

_HOLLOW = 0.01
"""Depth of a hollow below the hull that counts, in extents of the mesh: less is a bevel or a round hole."""
_SAME = 1e-5
"""Distance within which points are the same, in extents of the mesh."""
_PRODUCTS = 4_000_000
"""Distances of faces and points that are computed at once, for memory."""
_DIRECTIONS = 2000
"""Points of a mesh that stand for all of them, the farthest in so many directions: within 0.1 % of the hull."""
_WHAT, _BUT = "concave mesh collider", "its convex hull collides, but it "
"""How rows begin that say so."""
_SPLIT = (
    "split it into convex parts, or author physics:approximation = 'convexDecomposition' (pip install coacd) or 'sdf' "
    "(slower)"
)
_TRIANGLES = "its triangles collide"
_AUTHORED = "physics:approximation asks for it: its hollows and openings are filled"
_BY_NEWTON = (
    ", and as it moves Newton's collision detection finds all contacts of the scene, which is slower; "
    "'convexDecomposition' leaves them to the solver"
)


def concave_meshes(builder: newton.ModelBuilder, first: int = 0) -> Iterator[tuple[int, float]]:
    """Mesh colliders from shape ``first`` on that are not their convex hull: the shape, and :func:`hollow_depth`.

    A mesh that was approximated by a hull as its stage says is none of them.

    Args:
        builder: The builder.
        first: First shape.
    """
    depths: dict[int, float | None] = {}  # instances share a mesh
    for shape in range(first, builder.shape_count):
        mesh = builder.shape_source[shape]
        if builder.shape_type[shape] != GeoType.MESH or not builder.shape_flags[shape] & ShapeFlags.COLLIDE_SHAPES:
            continue
        if id(mesh) not in depths:
            depths[id(mesh)] = hollow_depth(np.array(mesh.vertices), np.array(mesh.indices).reshape(-1, 3))
        depth = depths[id(mesh)]
        if depth is not None:
            yield shape, depth


def concave_mesh_rows(
    builder: newton.ModelBuilder, first: int, static_triangles: bool
) -> Iterator[tuple[str, str, str]]:
    """Rows ``(path, what, why)`` of the mesh colliders from shape ``first`` on that are not their convex hull.

    Args:
        builder: The builder.
        first: First shape.
        static_triangles: The triangles of static ones collide; otherwise the hulls, as MuJoCo has it.
    """
    found = list(concave_meshes(builder, first))
    for shape, depth in found:
        triangles = static_triangles and builder.shape_body[shape] < 0
        how = "is open" if depth == 0.0 else f"has hollows of {100 * depth:.0f} % of its size or more"
        row = builder.shape_label[shape], _WHAT, f"{_BUT}{how}; {_SPLIT}"
        yield _by_triangles(row) if triangles else row


def authored_hull_rows(builder: newton.ModelBuilder, first: int, stage: Usd.Stage) -> Iterator[tuple[str, str, str]]:
    """Rows of the meshes from shape ``first`` on whose approximation is ``convexHull`` although they are concave.

    Args:
        builder: The builder, into which Newton read the hulls.
        first: First shape.
        stage: The stage that was read, whose prims have the faces.
    """
    concave: dict[int, bool] = {}  # instances share a hull
    for shape in range(first, builder.shape_count):
        if (
            builder.shape_type[shape] != GeoType.CONVEX_MESH
            or not builder.shape_flags[shape] & ShapeFlags.COLLIDE_SHAPES
        ):
            continue
        prim, hull = labelled_prim(stage, builder.shape_label[shape]), id(builder.shape_source[shape])
        if not prim or not prim.IsA(UsdGeom.Mesh):
            continue
        if UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() != UsdPhysics.Tokens.convexHull:
            continue
        if hull not in concave:
            mesh = newton.usd.get_mesh(prim, compute_inertia=False, load_visual_materials=False)
            faces = np.array(mesh.indices).reshape(-1, 3)
            concave[hull] = hollow_depth(np.array(mesh.vertices), faces) is not None
        if concave[hull]:
            yield builder.shape_label[shape], "convex hull of a concave mesh", _AUTHORED


def concave_colliders(rows: Ignored) -> set[str]:
    """Paths of the mesh colliders that are not their hull, by the rows of a report."""
    return {path for path, what, _ in rows if what == _WHAT}


def rows_by_triangles(rows: Ignored) -> Ignored:
    """Rows of a report, once Newton's collision detection is that of all shapes, those that move included.

    The meshes of a robot's file are hulls for it, too.
    """
    return [_by_triangles(row) if row[1] == _WHAT and row[2].startswith(_BUT) else row for row in rows]


def rows_by_distance(rows: Ignored, paths: Collection[str]) -> Ignored:
    """Rows of a report, of concave meshes that move and collide as they are, as their approximation is ``sdf``."""
    return [_by_triangles(row, _BY_NEWTON) if row[1] == _WHAT and row[0] in paths else row for row in rows]


def _by_triangles(row: tuple[str, str, str], how_found: str = "") -> tuple[str, str, str]:
    how = row[2].removeprefix(_BUT).removesuffix(f"; {_SPLIT}")
    if how.startswith("has hollows"):  # how deep is of no matter here, and a scene has one row for all such meshes
        how = "has hollows"
    return row[0], row[1], f"it {how}: {_TRIANGLES}{how_found}"


def hollow_depth(points: np.ndarray, faces: np.ndarray) -> float | None:
    """How deep the hollows of a mesh are, in extents of it; 0 for a convex shell with a hole, None for a convex mesh.

    A mesh is convex if it is closed, and all its points are on one side of each of its faces. The depth is that of a
    point on the other side: the search ends where it finds one that counts.

    Args:
        points: Vertices, shape ``(points, 3)``.
        faces: Triangles, indices of three points, shape ``(faces, 3)``.
    """
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    faces = _welded(points, faces, _SAME * max(extent, 1e-30))
    corners = points[faces].astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    proper = areas > 1e-9 * max(extent, 1e-30) ** 2  # the normal of a sliver is noise
    normals, offsets = normals[proper] / areas[proper, None], corners[proper, 0]
    outermost = _outermost(points[np.unique(faces)].astype(float))
    rows = max(1, _PRODUCTS // max(1, len(outermost)))
    for start in range(0, len(normals), rows):
        n, o = normals[start : start + rows], offsets[start : start + rows]
        distance = n @ outermost.T - (n * o).sum(axis=1)[:, None]
        depth = float(np.minimum(distance.max(axis=1), -distance.min(axis=1)).max())
        if depth > _HOLLOW * extent:
            return depth / extent
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, times = np.unique(edges, axis=0, return_counts=True)
    return 0.0 if (times == 1).any() else None


def _outermost(points: np.ndarray) -> np.ndarray:
    """The points; of many, the farthest in directions all around, as no other is the farthest from a face."""
    if len(points) <= _DIRECTIONS:
        return points
    i = np.arange(_DIRECTIONS)
    height, turn = 1.0 - (2.0 * i + 1.0) / _DIRECTIONS, i * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - height**2)
    directions = np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1)
    best, which = np.full(_DIRECTIONS, -np.inf), np.zeros(_DIRECTIONS, dtype=int)
    for start in range(0, len(points), _PRODUCTS // _DIRECTIONS):
        along = directions @ points[start : start + _PRODUCTS // _DIRECTIONS].T
        index = along.argmax(axis=1)
        value = along[i, index]
        which, best = np.where(value > best, index + start, which), np.maximum(value, best)
    return points[np.unique(which)]


def _welded(points: np.ndarray, faces: np.ndarray, within: float) -> np.ndarray:
    """Faces with one index for all points at a place: files repeat points for each normal or texture coordinate."""
    places = np.round(points.astype(float) / within)
    _, first, same = np.unique(places, axis=0, return_index=True, return_inverse=True)
    welded = first[same.reshape(-1)][faces]
    a, b, c = welded.T
    return welded[(a != b) & (b != c) & (c != a)]
