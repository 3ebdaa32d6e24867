# SPDX-License-Identifier: Apache-2.0
"""Static meshes: colliders that do not move, as triangles that the fused step finds contacts with."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence

import mujoco
import newton
import numpy as np
import warp as wp
from newton import GeoType, Model, ShapeFlags

from stripe_newton.shape_mesh import shape_mesh

from .contact_pairs import MESH_KINDS, ContactPair
from .mesh_grid import TriangleMesh

__all__ = [
    "FOUND_KINDS", "MAY", "MUST", "add_triangles_attribute", "count_marks", "group_static_meshes", "has_triangles",
    "mark_triangles", "marks_of", "moves_other_kinds",
]  # fmt: skip

MAY, MUST = 1, 2
"""Marks of static shapes: of those that may collide by their triangles, and of concave ones, of which the hull is not
the same."""
_ROUND = GeoType.CYLINDER, GeoType.CONE, GeoType.ELLIPSOID
_MANY = 16
"""Static shapes from which on boxes are taken for their triangles, rather than for pairs with each geom of a robot."""
FOUND_KINDS = GeoType.SPHERE, GeoType.CAPSULE, GeoType.BOX
"""Shapes of which the fused step finds contacts with triangles."""
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
    return bool((marks_of(model) >= least).any())


def marks_of(model: newton.Model) -> np.ndarray:
    """Mark of each shape, 0 for none, shape ``(shape_count,)``."""
    marks = getattr(getattr(model, _NAMESPACE, None), _NAME, None)
    return np.zeros(model.shape_count, dtype=int) if marks is None else marks.numpy()


def count_marks(builder: newton.ModelBuilder, least: int = MAY) -> int:
    """Number of shapes of a builder that have a mark, ``MAY`` or above."""
    attribute = builder.custom_attributes.get(f"{_NAMESPACE}:{_NAME}")
    return 0 if attribute is None else sum(mark >= least for mark in attribute.values.values())


def moves_other_kinds(builder: newton.ModelBuilder) -> bool:
    """Whether a collider that moves is of a kind of which the fused step does not find contacts with triangles."""
    shapes = zip(builder.shape_body, builder.shape_flags, builder.shape_type, strict=True)
    return any(b >= 0 and f & ShapeFlags.COLLIDE_SHAPES and kind not in FOUND_KINDS for b, f, kind in shapes)


def group_static_meshes(
    model: mujoco.MjModel,
    newton_model: newton.Model,
    shape_of_geom: np.ndarray,
    pairs: Sequence[ContactPair],
    hidden: Mapping[int, Sequence[tuple[int, int]]],
) -> tuple[list[ContactPair], list[list[TriangleMesh]], list[ContactPair], float]:
    """Put static meshes together that meet the same geoms in the same way.

    A pair of such a group and a geom stands for the pairs of all its meshes with that geom. The group is in the frame
    of the mesh that is the first geom of the pair.

    Args:
        model: The compiled model.
        newton_model: The model that it was compiled from.
        shape_of_geom: Newton's shape of each geom, -1 for none, shape ``(ngeom,)``.
        pairs: Pairs of geoms that may touch.
        hidden: Shapes that are no geoms by the geom that stands for them: a number in the place of a geom, and the
            shape.

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
        own = [(g, int(shape_of_geom[g])) for g in geoms]
        every = [member for g, shape in own for member in ((g, shape), *hidden.get(g, ()))]
        meshes.append([shapes.in_frame_of(model, geoms[0], g, shape) for g, shape in every])
    met_geoms = {p.geom2 for own in by_geom.values() for p in own if p.kind != MESH_KINDS[mujoco.mjtGeom.mjGEOM_BOX]}
    margins = model.geom_margin.max(initial=0.0) * 2.0
    return rest, meshes, lacking, max((float(model.geom_size[g, 0]) for g in met_geoms), default=0.0) + margins


class _Shapes:
    """Shapes of a model on the host."""

    def __init__(self, model: newton.Model):
        self.mark = marks_of(model)
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
