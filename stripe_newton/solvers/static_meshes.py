# SPDX-License-Identifier: Apache-2.0
"""Static meshes: colliders that do not move, as triangles that the fused step finds contacts with."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Collection, Sequence

import mujoco
import newton
import numpy as np
import warp as wp
from newton import GeoType, Model

from stripe_newton.shape_mesh import shape_mesh

from .contact_pairs import MESH_KINDS, ContactPair
from .mesh_grid import TriangleMesh

__all__ = ["MAY", "MUST", "add_triangles_attribute", "group_static_meshes", "has_triangles", "mark_triangles"]

MAY, MUST = 1, 2
"""Marks of static shapes: of those that may collide by their triangles, and of concave ones, of which the hull is not
the same."""
_ROUND = GeoType.CYLINDER, GeoType.CONE, GeoType.ELLIPSOID
_MANY = 16
"""Static shapes from which on boxes are taken for their triangles, rather than for pairs with each geom of a robot."""
_NAMESPACE, _NAME = "stripe", "triangles"


def add_triangles_attribute(builder: newton.ModelBuilder) -> None:
    """Declare the attribute of shapes that :func:`mark_triangles` sets, 0 at first."""
    shapes = Model.AttributeFrequency.SHAPE
    builder.add_custom_attribute(
        newton.ModelBuilder.CustomAttribute(
            name=_NAME, namespace=_NAMESPACE, frequency=shapes, dtype=wp.int32, default=0
        )
    )


def mark_triangles(builder: newton.ModelBuilder, first: int, concave: Collection[str]) -> None:
    """Mark static shapes from shape ``first`` on that things touch by their triangles.

    All meshes are, and round shapes that MuJoCo's general routine for convex shapes would be asked for; boxes if there
    are many static shapes.

    Args:
        builder: The builder.
        first: First shape.
        concave: Labels of the meshes that are not their hull.
    """
    values = builder.custom_attributes[f"{_NAMESPACE}:{_NAME}"].values
    static = [shape for shape in range(first, builder.shape_count) if builder.shape_body[shape] < 0]
    kinds = {GeoType.MESH, GeoType.CONVEX_MESH, *_ROUND, *([GeoType.BOX] if len(static) >= _MANY else [])}
    for shape in static:
        if builder.shape_type[shape] in kinds:
            values[shape] = MUST if builder.shape_label[shape] in concave else MAY


def has_triangles(model: newton.Model, least: int = MAY) -> bool:
    """Whether a shape has a mark, ``MAY`` or above."""
    marks = getattr(getattr(model, _NAMESPACE, None), _NAME, None)
    return marks is not None and bool((marks.numpy() >= least).any())


def group_static_meshes(
    model: mujoco.MjModel, newton_model: newton.Model, shape_of_geom: np.ndarray, pairs: Sequence[ContactPair]
) -> tuple[list[ContactPair], list[list[TriangleMesh]], list[ContactPair], float]:
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
        meshes of each group; the pairs of concave meshes with geoms that the kernel has no routine for; and the largest
        radius of the others, with their margins [m].
    """
    by_geom: dict[int, list[ContactPair]] = defaultdict(list)
    rest: list[ContactPair] = []
    lacking: list[ContactPair] = []
    shapes = _Shapes(newton_model)
    wanted = {
        g
        for g, shape in enumerate(shape_of_geom.tolist())
        if shape >= 0 and shapes.mark[shape] and shapes.body[shape] < 0 and model.geom_bodyid[g] == 0
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
            if shapes.mark[shape_of_geom[geom]] == MUST:
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
    met_geoms = {p.geom2 for own in by_geom.values() for p in own if p.kind != MESH_KINDS[mujoco.mjtGeom.mjGEOM_BOX]}
    margins = model.geom_margin.max(initial=0.0) * 2.0
    return rest, meshes, lacking, max((float(model.geom_size[g, 0]) for g in met_geoms), default=0.0) + margins


class _Shapes:
    """Shapes of a model on the host."""

    def __init__(self, model: newton.Model):
        self.mark = model.stripe.triangles.numpy()
        self.body, self.world, self.type = (a.numpy() for a in (model.shape_body, model.shape_world, model.shape_type))
        self.scale, self.pose = (a.numpy().astype(float) for a in (model.shape_scale, model.shape_transform))
        self.source, self.label = model.shape_source, model.shape_label

    def in_frame_of(self, model: mujoco.MjModel, frame: int, geom: int, shape: int) -> TriangleMesh:
        """Triangles of a static shape in the frame of a geom of the world."""
        vertices, faces = shape_mesh(self.type[shape], self.scale[shape], self.source[shape], self.label[shape])
        x, y, z, w = self.pose[shape, 3:]
        world = vertices @ _matrix(np.array([w, x, y, z])).T + self.pose[shape, :3]
        return TriangleMesh((world - model.geom_pos[frame]) @ _matrix(model.geom_quat[frame]), faces, geom)


def _matrix(quat: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quat / np.linalg.norm(quat))
    return matrix.reshape(3, 3)
