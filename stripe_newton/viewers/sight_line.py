# SPDX-License-Identifier: Apache-2.0
"""Sight line: how far along the way from a camera to what it looks at walls and other fixed shapes are in between."""

from __future__ import annotations

import numpy as np

from .poses import rotate

__all__ = ["SightLine"]

_MOST_TRIANGLES = 50_000
"""Triangles up to which they are looked at: that takes some milliseconds, a few times a second."""
_PARALLEL = 1.0e-12


class SightLine:
    """Triangles of shapes that do not move, and where a line of sight leaves the last of them.

    With more than 50,000 triangles, as a wood has them, nothing is ever in between.
    """

    def __init__(self) -> None:
        self._parts: list[np.ndarray] = []
        self._count = 0
        self._corners: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    @property
    def is_free(self) -> bool:
        """Whether nothing is ever in between."""
        return not self._parts

    def add(self, vertices: np.ndarray, faces: np.ndarray, sizes: np.ndarray, poses: np.ndarray) -> None:
        """Add instances of a mesh.

        Args:
            vertices: Corners of the mesh [m], shape ``(v, 3)``.
            faces: Its triangles, shape ``(f, 3)``.
            sizes: Factors of each instance along x, y and z, shape ``(n, 3)``.
            poses: Poses of the instances in the world, shape ``(n, 7)``.
        """
        self._count += len(faces) * len(poses)
        self._corners = None
        if self._count > _MOST_TRIANGLES:
            self._parts = []
            return
        for size, pose in zip(sizes, poses, strict=True):
            corners = np.asarray(vertices, dtype=float) * size
            turns = np.broadcast_to(pose[3:].astype(float), (len(corners), 4))
            self._parts.append((rotate(turns, corners) + pose[:3])[np.asarray(faces)])

    def blocked_until(self, eye: np.ndarray, target: np.ndarray) -> float:
        """Distance from the eye at which the last shape between it and its target lies [m]; 0 where there is none.

        Args:
            eye: Place of the camera in the world [m], shape ``(3,)``.
            target: What it looks at [m], shape ``(3,)``.
        """
        if self.is_free or not (np.isfinite(eye).all() and np.isfinite(target).all()):
            return 0.0
        if self._corners is None:
            triangles = np.concatenate(self._parts)
            first = triangles[:, 0]
            self._corners = first, triangles[:, 1] - first, triangles[:, 2] - first
        first, side, other = self._corners
        way = np.asarray(target, dtype=float) - eye
        across = np.cross(way, other)  # the test of Moeller and Trumbore, for all triangles at once
        volume = np.einsum("ij,ij->i", side, across)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(np.abs(volume) > _PARALLEL, 1.0 / volume, np.nan)
            start = eye - first
            u = scale * np.einsum("ij,ij->i", start, across)
            turned = np.cross(start, side)
            v = scale * (turned @ way)
            share = scale * np.einsum("ij,ij->i", other, turned)
            is_hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (share > 0.0) & (share < 1.0)
        return float(share[is_hit].max(initial=0.0)) * float(np.linalg.norm(way))
