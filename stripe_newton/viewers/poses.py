# SPDX-License-Identifier: Apache-2.0
"""Poses on the host: products of many poses at once, and viser's order of quaternions."""

from __future__ import annotations

import numpy as np

__all__ = ["compose", "rotate", "wxyz", "yaw_of"]


def rotate(quaternions: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors ``(n, 3)`` rotated by quaternions (x, y, z, w), ``(n, 4)``."""
    cross = 2.0 * np.cross(quaternions[:, :3], vectors)
    return vectors + quaternions[:, 3:] * cross + np.cross(quaternions[:, :3], cross)


def compose(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Poses of frames given in other frames: ``first * second``, each ``(n, 7)``: position and (x, y, z, w)."""
    a, b = first[:, 3:], second[:, 3:]
    xyz = a[:, 3:] * b[:, :3] + b[:, 3:] * a[:, :3] + np.cross(a[:, :3], b[:, :3])
    w = a[:, 3] * b[:, 3] - (a[:, :3] * b[:, :3]).sum(axis=1)
    return np.column_stack([first[:, :3] + rotate(a, second[:, :3]), xyz, w])


def wxyz(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (x, y, z, w), ``(n, 4)``, as viser has them: (w, x, y, z), float32."""
    return np.ascontiguousarray(quaternions[:, [3, 0, 1, 2]], dtype=np.float32)


def yaw_of(quaternion: np.ndarray) -> float:
    """Turn of a quaternion (x, y, z, w) about the upright axis [rad]."""
    x, y, z, w = (float(q) for q in quaternion)
    return float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
