# SPDX-License-Identifier: Apache-2.0
"""Hulls: the convex hulls of meshes as polytopes, whose contacts the fused step finds."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import warp as wp

if TYPE_CHECKING:
    from .contact_pairs import ContactPair

__all__ = ["CAP_SIDES", "Hull", "HullTables", "hull_numbers", "sides_of_pairs", "suits_hulls"]

_LEAST_FOR_GRAPH = 10
"""Vertices of a mesh from which on MuJoCo climbs its graph, rather than to look at all of them."""
_MOST_EDGES = 2**18
"""Products of the numbers of edges of two hulls for which the kernel tries all pairs of them."""
CAP_SIDES = 16
"""Sides of the polygon that stands for a cap of a cylinder, as in MuJoCo."""
_MOST_SIDES = 40
"""Sides of two faces together, of which a thread holds the polygon that both share."""
_RECORD = np.dtype(
    [
        *((name, np.uint64) for name in ("vertices", "planes", "neighbours", "faces", "edges", "corners")),
        *((name, np.int32) for name in ("num_vertices", "num_faces", "num_edges", "climbs")),
        ("centre", np.float32, 3),
        ("half", np.float32, 3),
    ],
    align=True,
)
"""Struct ``Hull`` of hulls.h."""


@dataclass(frozen=True)
class Hull:
    """A convex polytope. Faces have their vertices counterclockwise, seen from outside, as MuJoCo has them."""

    vertices: np.ndarray
    """Shape ``(vertices, 3)`` [m]."""
    normals: np.ndarray
    """Shape ``(faces, 3)``."""
    faces: tuple[tuple[int, ...], ...]
    corners: tuple[tuple[tuple[int, int], ...], ...]
    """Faces at each vertex, and the vertex before it in each, in MuJoCo's order."""
    neighbours: tuple[tuple[int, ...], ...] = ()
    """Neighbours of each vertex, in the order in which MuJoCo climbs; none where it looks at all vertices."""

    @classmethod
    def of_mesh(cls, model: mujoco.MjModel, mesh: int) -> Hull:
        """The hull of a mesh, as MuJoCo's compiler found it.

        Args:
            model: The compiled model.
            mesh: The mesh.
        """
        first, count = int(model.mesh_polyadr[mesh]), int(model.mesh_polynum[mesh])
        polygons = range(first, first + count)
        lists = [_slice(model.mesh_polyvert, model.mesh_polyvertadr[p], model.mesh_polyvertnum[p]) for p in polygons]
        graph = _graph(model, mesh)
        names = graph[0] if graph else sorted({v for vertices in lists for v in vertices})
        number = {v: i for i, v in enumerate(names)}
        faces = tuple(tuple(number[v] for v in vertices) for vertices in lists)
        at = int(model.mesh_vertadr[mesh])
        of_vertex = [
            _slice(model.mesh_polymap, model.mesh_polymapadr[at + v], model.mesh_polymapnum[at + v]) for v in names
        ]
        corners = tuple(tuple((f, _before(faces[f], v)) for f in of_vertex[v]) for v in range(len(names)))
        vertices = model.mesh_vert[at + np.array(names, dtype=int)].astype(float)
        return cls(vertices, model.mesh_polynormal[polygons].astype(float), faces, corners, graph[1] if graph else ())

    @classmethod
    def cube(cls) -> Hull:
        """The cube of half extents 1, of which every box is a scaled one, in MuJoCo's order of corners and faces."""
        signs = [(1 if v & 1 else -1, 1 if v & 2 else -1, 1 if v & 4 else -1) for v in range(8)]
        clockwise = ((7, 3, 1, 5), (2, 6, 4, 0), (2, 3, 7, 6), (4, 5, 1, 0), (6, 7, 5, 4), (3, 2, 0, 1))
        corners = tuple(tuple((2 * i + (s[i] < 0), v ^ (1 << i)) for i in range(3)) for v, s in enumerate(signs))
        normals = [sign * np.eye(3)[i] for i in range(3) for sign in (1.0, -1.0)]
        return cls(np.array(signs, dtype=float), np.array(normals), tuple(f[::-1] for f in clockwise), corners)

    @cached_property
    def edges(self) -> np.ndarray | None:
        """Two vertices of each edge and the faces on its left and right, ``(edges, 4)``; None if it is not closed."""
        left = {(u, v): f for f, face in enumerate(self.faces) for u, v in zip(face, (*face[1:], face[0]), strict=True)}
        if not all((v, u) in left for u, v in left):
            return None
        return np.array([[u, v, f, left[v, u]] for (u, v), f in left.items() if u < v], dtype=np.int32)

    @property
    def sides(self) -> int:
        """Sides of the face that has most."""
        return max(map(len, self.faces), default=0)


class HullTables:
    """The hulls of some meshes on a device, after that of a box.

    Attributes:
        array: The hulls, as bytes of structs ``Hull`` of hulls.h.
    """

    def __init__(
        self, model: mujoco.MjModel, pairs: Iterable[ContactPair], device: str | wp.Device, double: bool = False
    ):
        """Copy the hulls that pairs need, in the order of :func:`hull_numbers`.

        Args:
            model: The compiled model.
            pairs: Pairs of geoms.
            device: The device.
            double: Whether numbers have double precision.
        """
        self._device, self._real = device, np.float64 if double else np.float32
        self._arrays: list[wp.array] = []
        hulls = [Hull.cube(), *(Hull.of_mesh(model, mesh) for mesh in hull_numbers(model, pairs))]
        self.array = self._keep(np.concatenate([self._record(hull) for hull in hulls]).view(np.uint8))

    def _record(self, hull: Hull) -> np.ndarray:
        heights = [(hull.vertices[list(face)] @ n).max() for face, n in zip(hull.faces, hull.normals, strict=True)]
        low, high = hull.vertices.min(axis=0), hull.vertices.max(axis=0)
        record = np.zeros(1, _RECORD)
        arrays = {
            "vertices": hull.vertices.astype(self._real),
            "planes": np.column_stack([hull.normals, heights]).astype(self._real),
            "neighbours": _lists([[*n, -1] for n in hull.neighbours]),
            "faces": _lists(hull.faces),
            "edges": np.array(hull.edges, dtype=np.int32),
            "corners": _lists([[n for corner in own for n in corner] for own in hull.corners]),
        }
        for name, array in arrays.items():
            record[name] = self._keep(array).ptr or 0
        record["num_vertices"], record["num_faces"] = len(hull.vertices), len(hull.faces)
        record["num_edges"], record["climbs"] = len(arrays["edges"]), bool(hull.neighbours)
        record["centre"], record["half"] = (low + high) / 2, (high - low) / 2
        return record

    def _keep(self, array: np.ndarray) -> wp.array:
        self._arrays.append(wp.array(array.ravel(), device=self._device))
        return self._arrays[-1]


def hull_numbers(model: mujoco.MjModel, pairs: Iterable[ContactPair]) -> dict[int, int]:
    """Numbers of the meshes whose hulls pairs need; 0 is a box's.

    Args:
        model: The compiled model.
        pairs: Pairs of geoms.
    """
    geoms = {g for pair in pairs if pair.kind.endswith("HULL") for g in (pair.geom1, pair.geom2)}
    meshes = sorted({int(model.geom_dataid[g]) for g in geoms if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH})
    return {mesh: i for i, mesh in enumerate(meshes, 1)}


def sides_of_pairs(model: mujoco.MjModel, pairs: Iterable[ContactPair]) -> int:
    """Most sides of two faces together, one of each geom of a pair of hulls.

    Args:
        model: The compiled model.
        pairs: Pairs of geoms.
    """
    hulls = [pair for pair in pairs if pair.kind in ("CYLINDER_HULL", "BOX_HULL", "HULL_HULL")]
    return max((_counts(model, p.geom1).sides + _counts(model, p.geom2).sides for p in hulls), default=0)


def suits_hulls(model: mujoco.MjModel, kind: str, geom1: int, geom2: int, margin: float) -> bool:
    """Whether the kernel finds the contacts of a pair of which the second geom, or both, are meshes with hulls.

    Args:
        model: The compiled model.
        kind: Kind of the pair.
        geom1: First geom.
        geom2: Second geom.
        margin: Margin of the pair [m]. Hulls that do not overlap have no contacts.
    """
    second = _counts(model, geom2)
    if kind in ("PLANE_HULL", "SPHERE_HULL", "CAPSULE_HULL", "ELLIPSOID_HULL") or not second.is_closed:
        return second.is_closed
    first = _counts(model, geom1)
    if kind == "CYLINDER_HULL":
        return second.sides <= _MOST_SIDES
    few = first.edges * second.edges <= _MOST_EDGES and first.sides + second.sides <= _MOST_SIDES
    return first.is_closed and few and margin <= 0.0


@dataclass(frozen=True)
class _Counts:
    """Numbers of edges, and of sides of the largest face, of a hull."""

    edges: int
    sides: int
    is_closed: bool
    """Whether each edge has two faces."""


def _counts(model: mujoco.MjModel, geom: int) -> _Counts:
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        return _Counts(12, 4, True)
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _Counts(48, CAP_SIDES, True)
    mesh = int(model.geom_dataid[geom])
    first, faces = int(model.mesh_polyadr[mesh]), int(model.mesh_polynum[mesh])
    if not faces:
        return _Counts(0, 0, False)
    sides = model.mesh_polyvertnum[first : first + faces]
    vertices = np.unique(_slice(model.mesh_polyvert, model.mesh_polyvertadr[first], sides.sum()))
    edges = len(vertices) + faces - 2  # L. Euler's formula; each is a side of two faces
    return _Counts(edges, int(sides.max()), 2 * edges == int(sides.sum()))


def _graph(model: mujoco.MjModel, mesh: int) -> tuple[list[int], tuple[tuple[int, ...], ...]] | None:
    """Vertices of a mesh in its graph, and the neighbours of each among these; None where MuJoCo does not climb.

    Source: MuJoCo's documentation of ``mesh_graph``: numbers of vertices and faces, start of each vertex's list, names
    of vertices, and the lists, each of which ends with -1.
    """
    start = int(model.mesh_graphadr[mesh])
    if start < 0 or model.mesh_vertnum[mesh] < _LEAST_FOR_GRAPH:
        return None
    count = int(model.mesh_graph[start])
    lists = model.mesh_graph[start + 2 + 2 * count :]
    starts = model.mesh_graph[start + 2 : start + 2 + count].tolist()
    names = _slice(model.mesh_graph, start + 2 + count, count)
    return names, tuple(
        tuple(itertools.takewhile(lambda n: n >= 0, lists[at : at + count + 1].tolist())) for at in starts
    )


def _before(face: Sequence[int], vertex: int) -> int:
    return face[face.index(vertex) - 1]


def _slice(array: np.ndarray, first: int, count: int) -> list[int]:
    return array[int(first) : int(first) + int(count)].tolist()


def _lists(lists: Sequence[Sequence[int]]) -> np.ndarray:
    """Where each list starts, one more for the end, and behind these the lists."""
    starts = np.cumsum([0, *map(len, lists)]) + len(lists) + 1
    return np.array([*starts, *(n for own in lists for n in own)], dtype=np.int32)
