# SPDX-License-Identifier: Apache-2.0
"""Surround: ground from the edges of a height field to the horizon, which pictures show and nothing touches."""

from __future__ import annotations

import newton
import numpy as np

__all__ = ["add_surround", "surround_mesh"]

_RINGS = (1.0, 1.01, 1.03, 1.07, 1.15, 1.3, 1.6, 2.2, 4.0, 10.0, 40.0)
"""Sizes of the rings around the field, as multiples of its own; one more lies at the horizon."""
_HORIZON = 20_000.0
"""Distance of the last ring [m]."""
_FLATTEN = 0.25
"""Distance over which the heights of the edge level out, as a share of the field's half size."""


def add_surround(builder: newton.ModelBuilder, count: int) -> int | None:
    """Add the surround of the only height field among the first ``count`` shapes, the static scene.

    Returns:
        Its shape; None, and nothing is added, without a height field, with several, or with an endless plane.
    """
    fields = [i for i in range(count) if int(builder.shape_type[i]) == int(newton.GeoType.HFIELD)]
    fields = [i for i in fields if int(builder.shape_flags[i]) & int(newton.ShapeFlags.VISIBLE)]
    endless = any(
        int(builder.shape_type[i]) == int(newton.GeoType.PLANE) and not any(builder.shape_scale[i][:2])
        for i in range(builder.shape_count)
    )
    if len(fields) != 1 or endless:
        return None
    field = fields[0]
    mesh = surround_mesh(builder.shape_source[field])
    mesh.surround = True  # no attribute of Newton's: SceneryTracer gives it the colours of the ground
    body, pose = int(builder.shape_body[field]), builder.shape_transform[field]
    return builder.add_shape_mesh(body, xform=pose, mesh=mesh, color=builder.shape_color[field])


def surround_mesh(field: newton.Heightfield) -> newton.Mesh:
    """Rings of triangles from the edge of a height field outwards, in its frame [m].

    The first ring has the heights of the edge, so that there is no gap; farther out they level out to their mean.
    """
    data = np.asarray(field.data, dtype=np.float64).reshape(field.nrow, field.ncol)
    heights = field.min_z + data * (field.max_z - field.min_z)
    rim = _rim(field, heights)
    size = max(field.hx, field.hy)
    rings = np.array([*_RINGS, max(_HORIZON / size, 2.0 * _RINGS[-1])])
    # Scaled about the middle: the rings of a rectangle are rectangles, without a special case for its corners.
    level = rim[:, 2].mean()
    rise = np.exp(-((rings - 1.0) / _FLATTEN))[:, None] * (rim[:, 2] - level)
    points = np.concatenate([rings[:, None, None] * rim[:, :2], (level + rise)[..., None]], axis=2)
    ring, at = np.meshgrid(np.arange(len(rings) - 1), np.arange(len(rim)), indexing="ij")
    after = (at + 1) % len(rim)
    a, b = ring * len(rim) + at, ring * len(rim) + after
    faces = np.stack([a, a + len(rim), b + len(rim), a, b + len(rim), b], axis=-1)
    return newton.Mesh(points.reshape(-1, 3).astype(np.float32), faces.reshape(-1), compute_inertia=False)


def _rim(field: newton.Heightfield, heights: np.ndarray) -> np.ndarray:
    """Points of the field's edge, counterclockwise from above, each once, shape ``(n, 3)``."""
    x = np.linspace(-field.hx, field.hx, field.ncol)
    y = np.linspace(-field.hy, field.hy, field.nrow)
    grid = np.stack([*np.meshgrid(x, y), heights], axis=-1)
    return np.concatenate([grid[0, :-1], grid[:-1, -1], grid[-1, :0:-1], grid[:0:-1, 0]])
