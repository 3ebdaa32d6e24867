# SPDX-License-Identifier: Apache-2.0
"""Leaf meshes: the triangles of foliage as pictures trace them, and the leaves that each of them stands for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import newton
import numpy as np
import warp as wp

from stripe_kernels.picture_leaves import LeafStyle

__all__ = ["LEAF_STYLES", "leaf_mesh", "leaf_styles", "widened"]

LEAF_STYLES: Mapping[str, dict[str, float]] = MappingProxyType(
    {
        "": {},
        "leaves": {"length": 0.13, "width": 0.075, "rise": -0.5, "spread": math.pi, "margin": 0.07},
        "spruce": {"length": 0.34, "width": 0.075, "rise": -0.55, "spread": 0.75, "needles": 1, "margin": 0.11},
        "pine": {"length": 0.20, "width": 0.070, "rise": 0.6, "spread": 1.1, "needles": 1, "margin": 0.09},
    }
)
"""Fields of :class:`LeafStyle` of each kind of foliage, see ``MeshPart.foliage``."""


def leaf_styles() -> list[LeafStyle]:
    """Styles in the order of :data:`LEAF_STYLES`."""
    styles = []
    for fields in LEAF_STYLES.values():
        style = LeafStyle()
        for name, value in fields.items():
            setattr(style, name, value)
        styles.append(style)
    return styles


def leaf_mesh(source: newton.Mesh, device: wp.Device) -> wp.Mesh:
    """The triangles of a mesh with foliage in the same order, each by itself and widened by its style's margin."""
    # Kept on the mesh itself: it is shared by thousands of shapes, and by the renderers of several pictures.
    known: dict[str, wp.Mesh] = source.__dict__.setdefault("_leaf_meshes", {})
    if str(device) not in known:
        corners = np.asarray(source.vertices, dtype=np.float64)[np.asarray(source.indices).reshape(-1, 3)]
        points = widened(corners, LEAF_STYLES[source.foliage]["margin"]).reshape(-1, 3).astype(np.float32)
        index = np.arange(len(points), dtype=np.int32)
        make = {"device": device}
        known[str(device)] = wp.Mesh(wp.array(points, dtype=wp.vec3, **make), wp.array(index, dtype=int, **make))
    return known[str(device)]


def widened(corners: np.ndarray, margin: float) -> np.ndarray:
    """Triangles ``(F, 3, 3)`` whose edges lie farther out by a margin, but at most three times as large."""
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, -2, axis=1), axis=2)
    around = np.maximum(sides.sum(axis=1), 1.0e-12)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middle = (corners * sides[:, :, None]).sum(axis=1) / around[:, None]
    inner = area / around  # radius of the inscribed circle
    factor = np.minimum(1.0 + margin / np.maximum(inner, 1.0e-9), 3.0)
    return middle[:, None] + factor[:, None, None] * (corners - middle[:, None])
