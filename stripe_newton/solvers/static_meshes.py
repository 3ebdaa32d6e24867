# SPDX-License-Identifier: Apache-2.0
"""Static meshes: marks of the colliders that do not move, and that things touch by their triangles."""

from __future__ import annotations

from collections.abc import Collection

import newton
import numpy as np
import warp as wp
from newton import GeoType, Model, ShapeFlags

__all__ = [
    "FOUND_KINDS", "MAY", "MUST", "add_triangles_attribute", "count_marks", "has_triangles", "mark_triangles",
    "marks_of", "moves_other_kinds",
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
