# SPDX-License-Identifier: Apache-2.0
"""Collision tables: what Newton's collision detection wants to know of convex meshes, left out where nobody asks it."""

from __future__ import annotations

from collections.abc import Callable

import newton
import numpy as np
import warp as wp
from newton import GeoType, ShapeFlags

__all__ = ["finalize_without_tables"]


def finalize_without_tables(
    builder: newton.ModelBuilder,
    device: str | wp.Device | None,
    finalize: Callable[[newton.ModelBuilder], newton.Model] | None = None,
) -> newton.Model:
    """Make a model without the neighbours of the corners of convex meshes.

    Newton finds them for the support map of its own collision detection, a millisecond for each mesh of some dozen
    corners: half of the time that a stage of many meshes takes. Nothing else reads them, and without them that
    detection looks at all corners.

    Args:
        builder: The builder; it stays as it is.
        device: Device of the model.
        finalize: Makes the model of the builder, on that device; by default ``ModelBuilder.finalize``.
    """
    flags = builder.shape_flags
    kept = np.array(flags, dtype=np.int32)
    convex = np.array(builder.shape_type, dtype=int) == GeoType.CONVEX_MESH
    builder.shape_flags = np.where(convex, kept & ~int(ShapeFlags.COLLIDE_SHAPES), kept).tolist()
    try:
        model = finalize(builder) if finalize else builder.finalize(device=device)
    finally:
        builder.shape_flags = flags
    model.shape_flags = wp.array(kept, dtype=wp.int32, device=model.device)
    return model
