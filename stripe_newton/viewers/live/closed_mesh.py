# SPDX-License-Identifier: Apache-2.0
"""Closed mesh: whether a mesh bounds a solid, so that a browser may leave its inner sides out."""

from __future__ import annotations

import numpy as np

__all__ = ["is_closed"]

_MOST_FACES = 300_000
"""Faces up to which a mesh is looked at: it takes a tenth of a second."""
_SAME = 1.0e-5
"""Distance of corners that count as one, as a share of the mesh's size."""


def is_closed(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether triangles bound a solid and face outwards: each edge belongs to one triangle in either direction.

    Args:
        vertices: Corners [m], shape ``(n, 3)``; several may be at one place.
        faces: Corners of each triangle by number, shape ``(m, 3)``.
    """
    vertices, faces = np.asarray(vertices, dtype=float).reshape(-1, 3), np.asarray(faces).reshape(-1, 3)
    if not 4 <= len(faces) <= _MOST_FACES or not np.isfinite(vertices).all():
        return False
    places = vertices - vertices.mean(axis=0)
    step = _SAME * max(float(np.abs(places).max()), 1.0e-12)
    _, corner = np.unique(np.round(places / step).astype(np.int64), axis=0, return_inverse=True)
    corners = corner.reshape(-1)[faces].astype(np.int64)
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]  # triangles without area bound nothing
    begin, end = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    forth, back = np.sort(begin * len(vertices) + end), np.sort(end * len(vertices) + begin)
    if not len(forth) or (np.diff(forth) == 0).any() or not np.array_equal(forth, back):
        return False
    a, b, c = (places[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) > 0.0
