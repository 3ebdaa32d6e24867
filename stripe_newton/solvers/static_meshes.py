# SPDX-License-Identifier: Apache-2.0
"""Static meshes: colliders that do not move, as triangles that the fused step finds contacts with."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Sequence

import mujoco
import newton
import numpy as np
import warp as wp
from newton import GeoType, Model

from .mesh_grid import TriangleMesh
from .model_tables import MESH_KINDS, ContactPair

__all__ = ["add_triangles_attribute", "group_static_meshes", "has_triangles", "mark_triangles"]

_TYPES = GeoType.MESH, GeoType.CONVEX_MESH, GeoType.BOX
"""Shapes that can be taken for their triangles."""
_NAMESPACE, _NAME = "stripe", "triangles"


def add_triangles_attribute(builder: newton.ModelBuilder) -> None:
    """Declare the attribute of shapes that :func:`mark_triangles` sets, False at first."""
    shapes = Model.AttributeFrequency.SHAPE
    builder.add_custom_attribute(
        newton.ModelBuilder.CustomAttribute(
            name=_NAME, namespace=_NAMESPACE, frequency=shapes, dtype=wp.bool, default=False
        )
    )


def mark_triangles(builder: newton.ModelBuilder, first: int) -> None:
    """Mark static meshes and boxes from shape ``first`` on: things are to touch their triangles, not their hulls."""
    values = builder.custom_attributes[f"{_NAMESPACE}:{_NAME}"].values
    for shape in range(first, builder.shape_count):
        if builder.shape_body[shape] < 0 and builder.shape_type[shape] in _TYPES:
            values[shape] = True


def has_triangles(model: newton.Model) -> bool:
    """Whether a shape is marked."""
    marked = getattr(getattr(model, _NAMESPACE, None), _NAME, None)
    return marked is not None and bool(marked.numpy().any())


def group_static_meshes(
    model: mujoco.MjModel, newton_model: newton.Model, shape_of_geom: np.ndarray, pairs: Sequence[ContactPair]
) -> tuple[list[ContactPair], list[list[TriangleMesh]], list[ContactPair]]:
    """Put static meshes together that meet the same geoms in the same way.

    A pair of such a group and a geom stands for the pairs of all its meshes with that geom. The group is in the frame
    of the mesh that is the first geom of the pair.

    Args:
        model: The compiled model.
        newton_model: The model that it was compiled from.
        shape_of_geom: Newton's shape of each geom, -1 for none, shape ``(ngeom,)``.
        pairs: Pairs of geoms that may touch.

    Returns:
        The pairs, in which those of groups replace those of their meshes and have the group as their ``mesh``; the
        meshes of each group; and of the pairs those of which the kernel does not find contacts with triangles.
    """
    by_geom: dict[int, list[ContactPair]] = defaultdict(list)
    rest: list[ContactPair] = []
    lacking: list[ContactPair] = []
    shapes = _Shapes(newton_model)
    wanted = {
        g
        for g, shape in enumerate(shape_of_geom.tolist())
        if shape >= 0 and shapes.marked[shape] and shapes.body[shape] < 0 and model.geom_bodyid[g] == 0
    }
    for pair in pairs:
        geom = next((g for g in (pair.geom1, pair.geom2) if g in wanted), -1)
        if geom < 0 or pair.explicit >= 0:
            rest.append(pair)
            continue
        rule = pair.rule
        if geom == pair.geom2:  # the mesh comes first
            rule = {"OF_FIRST": "OF_SECOND", "OF_SECOND": "OF_FIRST"}.get(rule, rule)
        other = pair.geom2 if geom == pair.geom1 else pair.geom1
        kind = MESH_KINDS.get(int(model.geom_type[other]))
        if kind is None:
            rest.append(pair)
            lacking.append(pair)
            continue
        by_geom[geom].append(ContactPair(geom, other, kind, pair.dim, rule))
    groups: dict[tuple, list[int]] = defaultdict(list)
    for geom, own in sorted(by_geom.items()):
        met = frozenset((p.geom2, p.kind, p.dim, p.rule) for p in own)
        world = int(shapes.world[shape_of_geom[geom]])
        groups[world, float(model.geom_margin[geom]), met].append(geom)
    meshes: list[list[TriangleMesh]] = []
    for geoms in groups.values():
        rest += [dataclasses.replace(pair, mesh=len(meshes)) for pair in by_geom[geoms[0]]]
        meshes.append([shapes.in_frame_of(model, geoms[0], g, int(shape_of_geom[g])) for g in geoms])
    return rest, meshes, lacking


class _Shapes:
    """Shapes of a model on the host."""

    def __init__(self, model: newton.Model):
        self.marked = model.stripe.triangles.numpy().astype(bool)
        self.body, self.world, self.type = (a.numpy() for a in (model.shape_body, model.shape_world, model.shape_type))
        self.scale, self.pose = (a.numpy().astype(float) for a in (model.shape_scale, model.shape_transform))
        self.source = model.shape_source

    def in_frame_of(self, model: mujoco.MjModel, frame: int, geom: int, shape: int) -> TriangleMesh:
        """Triangles of a static shape in the frame of a geom of the world."""
        vertices, faces = self.triangles(shape)
        x, y, z, w = self.pose[shape, 3:]
        world = vertices @ _matrix(np.array([w, x, y, z])).T + self.pose[shape, :3]
        return TriangleMesh((world - model.geom_pos[frame]) @ _matrix(model.geom_quat[frame]), faces, geom)

    def triangles(self, shape: int) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [m], shape ``(vertices, 3)``, in the frame of a shape of a marked shape, and triangles."""
        scale = self.scale[shape]
        if self.type[shape] == GeoType.BOX:
            return _CORNERS * scale, _SIDES
        mesh = self.source[shape]
        if self.type[shape] == GeoType.CONVEX_MESH:
            mesh = mesh.compute_convex_hull()
        faces = np.array(mesh.indices).reshape(-1, 3)
        if np.prod(scale) < 0:  # a mirrored mesh is seen from outside the other way round
            faces = faces[:, ::-1]
        return np.array(mesh.vertices, dtype=float) * scale, faces


def _matrix(quat: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat / np.linalg.norm(quat))
    return matrix.reshape(3, 3)


_CORNERS = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], dtype=float)
_SIDES = np.array(
    [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6], [0, 6, 2],
     [1, 3, 7], [1, 7, 5]]
)  # fmt: skip
