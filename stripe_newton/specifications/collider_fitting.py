# SPDX-License-Identifier: Apache-2.0
"""Collider fitting: the smallest primitive around points."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from .asset_mesh import SIZES, Collider

__all__ = ["fit_collider"]


def fit_collider(points: np.ndarray, kind: str = "auto") -> Collider:
    """Fit a primitive that contains all points.

    Boxes, cylinders and capsules are aligned with the principal axes of the points, so they are small but not always
    the smallest possible.

    Args:
        points: Shape ``(N, 3)`` [m].
        kind: ``"sphere"``, ``"capsule"``, ``"cylinder"``, ``"box"``, or ``"auto"`` for the one of least volume.

    Raises:
        ValueError: for another kind, or without four points that span a volume.
    """
    points = np.asarray(points, dtype=float)
    if kind != "auto" and kind not in SIZES:
        raise ValueError(f"collider: kind is '{kind}', must be 'auto' or one of {', '.join(SIZES)}")
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4:
        raise ValueError(f"collider: points are {points.shape}, must be (N, 3) with at least 4")
    centre = points.mean(axis=0)
    axes = np.linalg.svd(points - centre, full_matrices=False)[2]
    if np.linalg.det(axes) < 0.0:  # a mirror has no quaternion
        axes[2] = -axes[2]
    local = (points - centre) @ axes.T
    # In the frame of the principal axes, with the mean as origin.
    low, high = local.min(axis=0), local.max(axis=0)
    half = 0.5 * (high - low)
    # Relative to the size: a millimetre is thin for a house, not for a screw.
    if half.min() < 1.0e-6 * max(half.max(), 1.0e-9):
        raise ValueError("collider: the points lie in a plane, they span no volume")
    middle = 0.5 * (low + high)
    pos = _place(centre + middle @ axes)
    found = [Collider("box", _lengths(half), pos, _quat(axes.T))]
    reach = np.linalg.norm(local - middle, axis=1).max()
    found.append(Collider("sphere", (float(reach),), pos))
    for axis in range(3):  # each principal axis as the primitive's z
        others = [(axis + 1) % 3, (axis + 2) % 3]
        quat = _quat(np.stack([axes[others[0]], axes[others[1]], axes[axis]], axis=1))
        along, across = (local - middle)[:, axis], np.linalg.norm((local - middle)[:, others], axis=1)
        radius = float(across.max())
        found.append(Collider("cylinder", (radius, float(half[axis])), pos, quat))
        # Beside the axis a cap extends less far: the straight part must cover what the cap leaves of each point.
        caps = np.sqrt(np.maximum(radius**2 - across**2, 0.0))
        stretch = max(float((np.abs(along) - caps).max()), 1.0e-4)
        found.append(Collider("capsule", (radius, stretch), pos, quat))
    wanted = [c for c in found if kind in ("auto", c.kind)]
    return min(wanted, key=_volume)


def _volume(collider: Collider) -> float:
    size = collider.size
    if collider.kind == "box":
        return 8.0 * size[0] * size[1] * size[2]
    ball = 4.0 / 3.0 * np.pi * size[0] ** 3
    if collider.kind == "sphere":
        return ball
    return 2.0 * np.pi * size[0] ** 2 * size[1] + (ball if collider.kind == "capsule" else 0.0)


def _lengths(half: np.ndarray) -> tuple[float, ...]:
    return tuple(float(h) for h in half)


def _place(point: np.ndarray) -> tuple[float, float, float]:
    return float(point[0]), float(point[1]), float(point[2])


def _quat(matrix: np.ndarray) -> tuple[float, float, float, float]:
    x, y, z, w = Rotation.from_matrix(matrix).as_quat()
    return float(x), float(y), float(z), float(w)
