# SPDX-License-Identifier: Apache-2.0
"""Rafts: capsules side by side in place of a box, as collider slots hold only capsules."""

from __future__ import annotations

import math

import numpy as np

from stripe_newton.specifications import Collider

__all__ = ["MOST", "raft", "upright"]

MOST = 8
"""Largest number of capsules in a raft."""
_ALONG_X = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))
_ALONG_Y = (-math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))


def raft(
    half_x: float, half_y: float, thickness: float, outline: np.ndarray | None = None, spacing: float = 1.7
) -> tuple[Collider, ...]:
    """Parallel capsules side by side that fill a plate, whose middle is the origin.

    They are as thick as the plate and lie along its longer side. Between two of them at a distance ``s``, the surface
    is too low by ``r - sqrt(r^2 - s^2 / 4)``, where ``r`` is half the thickness. Corners are round. No capsule stands
    out of the plate.

    Args:
        half_x: Half the length [m].
        half_y: Half the width [m].
        thickness: Thickness of the plate, at most its width and length [m].
        outline: Corners of a plate that is no rectangle, star-shaped around the origin, ``(K, 2)`` [m]; each capsule is
            as long as the plate is over the middle half of the capsule's width.
        spacing: Largest distance between two axes, in radii; more where :data:`MOST` capsules do not suffice.

    Raises:
        ValueError: If the plate is thicker than wide.
    """
    radius = 0.5 * thickness
    if not 0.0 < radius <= min(half_x, half_y) + 1.0e-9:
        raise ValueError(
            f"raft: thickness is {thickness}, must be above 0 and at most the width, {2.0 * min(half_x, half_y)} [m]"
        )
    along = half_x >= half_y
    long, wide = (half_x, half_y) if along else (half_y, half_x)
    corners = outline if along or outline is None else outline[:, ::-1]
    first, last = (-wide, wide) if corners is None else _wide_enough(corners, long, wide)
    # outermost axes a radius inside, or capsules would stand out of the plate
    first, last = min(first + radius, 0.0), max(last - radius, 0.0)
    count = min(MOST, 1 + math.ceil((last - first) / (spacing * radius) - 1.0e-6))
    found = []
    for y in np.linspace(first, last, count) if count > 1 else (0.5 * (first + last),):
        low, high = -long, long
        if corners is not None:
            cuts = np.array([_cut(corners, y + share * radius) for share in (-0.5, 0.0, 0.5)])
            low, high = cuts[:, 0].max(), cuts[:, 1].min()
        half = 0.5 * (high - low) - radius
        if half > 0.0:
            middle = 0.5 * (low + high)
            at = (middle, y, 0.0) if along else (y, middle, 0.0)
            place = float(at[0]), float(at[1]), 0.0
            found.append(
                Collider("capsule", (radius, max(float(half), 1.0e-4)), place, _ALONG_X if along else _ALONG_Y)
            )
    return tuple(found)


def _wide_enough(corners: np.ndarray, long: float, wide: float) -> tuple[float, float]:
    """Range across a plate where it is at least a third as long as its rectangle [m]; all of it if it nowhere is."""
    across = np.linspace(-wide, wide, 81)
    fair = across[[np.ptp(_cut(corners, y)) > 0.67 * long for y in across]]
    return (float(fair.min()), float(fair.max())) if len(fair) else (-wide, wide)


def _cut(corners: np.ndarray, across: float) -> tuple[float, float]:
    """Begin and end of an outline on a line along its first axis [m]."""
    start, end = corners, np.roll(corners, -1, axis=0)
    crossed = (start[:, 1] - across) * (end[:, 1] - across) <= 0.0
    start, end = start[crossed], end[crossed]
    if not len(start):
        return 0.0, 0.0
    rise = end[:, 1] - start[:, 1]
    share = np.where(np.abs(rise) > 1.0e-12, (across - start[:, 1]) / np.where(rise == 0.0, 1.0, rise), 0.5)
    x = start[:, 0] + share * (end[:, 0] - start[:, 0])
    left, right = x[x <= 0.0], x[x > 0.0]
    return float(left.max(initial=-np.inf) if len(left) else 0.0), float(right.min() if len(right) else 0.0)


def upright(x: float, low: float, high: float, radius: float) -> Collider:
    """Upright capsule at ``(x, 0)`` from one height to another [m], caps included."""
    half = max(0.5 * (high - low) - radius, 1.0e-4)
    return Collider("capsule", (radius, half), (float(x), 0.0, float(0.5 * (low + high))))
