# SPDX-License-Identifier: Apache-2.0
"""Camera framing: camera axes, automatic framing of points, and following a robot. NumPy, world frame, metres."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

__all__ = ["USUAL_AZIMUTH", "Follower", "camera_axes", "frame_points", "good_azimuth", "good_elevation", "views_around"]

USUAL_AZIMUTH = math.radians(-55.0)
"""Direction from the scene to a camera that frames itself, about +Z from +X [rad]."""
_USUAL_ELEVATION, _OVER_WALLS = math.radians(13.0), math.radians(40.0)


def camera_axes(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Right, up and backward unit vectors of a camera at ``eye`` that looks at ``target``, as columns (3, 3).

    Z is up in the picture. For a camera that looks straight up or down, Y is up.

    Raises:
        ValueError: ``eye`` and ``target`` are the same point, or not finite.
    """
    back = np.asarray(eye, dtype=float) - np.asarray(target, dtype=float)
    length = float(np.linalg.norm(back))
    if not math.isfinite(length) or length < 1e-9:
        raise ValueError(f"camera: eye {tuple(eye)} and target {tuple(target)} must be two different, finite points")
    back = back / length
    # Straight down, z gives no direction for the picture's upper edge.
    up = np.array([0.0, 0.0, 1.0]) if abs(back[2]) < 0.9999 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)


def frame_points(
    points: np.ndarray, azimuth: float, elevation: float, fov: float, aspect: float, margin: float
) -> tuple[np.ndarray, np.ndarray]:
    """Eye and target [m] that show all ``points``, shape (n, 3), in the middle of the picture.

    Args:
        points: Points that must be visible, world frame. Without any, the origin is seen from three metres.
        azimuth: Direction from the target to the camera, about +Z from +X [rad].
        elevation: Angle of that direction above the horizon [rad].
        fov: Vertical field of view [rad].
        aspect: Width of the picture over its height.
        margin: Size of the picture relative to the points in it.
    """
    towards = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    if len(points) == 0:
        return 3.0 * towards, np.zeros(3)
    target = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes = camera_axes(target + towards, target)
    tan_y = math.tan(0.5 * fov) / margin
    tan_x = tan_y * aspect
    distance = 1.0
    # The distance that fits the points moves their middle in the picture, as near ones look larger. Centring them
    # changes the distance again: a fixed point that four rounds reach to a fraction of a pixel.
    for _ in range(4):
        seen = (points - target) @ axes
        distance = max(float((np.abs(seen[:, 0]) / tan_x + seen[:, 2]).max()), 1e-3)
        distance = max(distance, float((np.abs(seen[:, 1]) / tan_y + seen[:, 2]).max()))
        depth = distance - seen[:, 2]
        flat = seen[:, :2] / depth[:, None]
        middle = 0.5 * (flat.min(axis=0) + flat.max(axis=0)) * distance
        target = target + axes[:, 0] * middle[0] + axes[:, 1] * middle[1]
    distance = max(distance, 0.3)
    return target + distance * towards, target


def views_around(
    eye: np.ndarray, target: np.ndarray, turns: Sequence[float], elevations: Sequence[float]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Eye and target of cameras at the same distance from a target, from other sides and from higher up.

    Args:
        eye: Position of the first camera [m], shape ``(3,)``.
        target: What they look at [m], shape ``(3,)``.
        turns: Angles from its direction, about +Z [deg].
        elevations: Least angles above the horizon [deg], each with all turns; that of the first camera if it is higher.
    """
    away = np.asarray(eye, dtype=float) - target
    distance, azimuth = float(np.linalg.norm(away)), math.atan2(away[1], away[0])
    own = math.asin(away[2] / distance)
    views = []
    for least in elevations:
        up = max(own, math.radians(least))
        for turn in turns:
            at = azimuth + math.radians(turn)
            towards = [math.cos(up) * math.cos(at), math.cos(up) * math.sin(at), math.sin(up)]
            views.append((target + distance * np.array(towards), np.asarray(target, dtype=float)))
    return views


def good_azimuth(points: np.ndarray) -> float:
    """Azimuth of the camera [rad] that shows ``points``, shape (n, 3), well: long things show their long side."""
    if len(points) < 2:
        return USUAL_AZIMUTH
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    sizes, directions = np.linalg.eigh(flat.T @ flat)
    if sizes[1] < 25.0 * max(float(sizes[0]), 1e-12):  # variances: less than five times as long as wide
        return USUAL_AZIMUTH
    # eigh() sorts: the last direction is that of the largest extent. Of the four views from 65 degrees beside it, the
    # one nearest to the usual direction.
    axis = math.atan2(directions[1, 1], directions[0, 1])
    choices = [axis + side * math.radians(65.0) + turn for side in (-1, 1) for turn in (0.0, math.pi)]
    return min(choices, key=lambda a: 1.0 - math.cos(a - USUAL_AZIMUTH))


def good_elevation(points: np.ndarray, moves: bool) -> float:
    """Elevation of the camera [rad] that shows ``points``, shape (n, 3), well: over the walls into rooms.

    Args:
        points: What the picture shows.
        moves: Whether something in the scene moves; then the picture shows that, and not the rooms around it.
    """
    if moves or len(points) < 2:
        return _USUAL_ELEVATION
    width, depth, height = np.ptp(points, axis=0)
    return _OVER_WALLS if height < 0.4 * min(width, depth) else _USUAL_ELEVATION


class Follower:
    """A point that follows another smoothly, without lag behind one that moves at constant speed.

    A critically damped alpha-beta filter: position and speed are estimated together.

    Args:
        time: Time constant in frames, one or one for each axis; 0 follows rigidly.
        jump: Distance in one frame from which a move counts as a new episode and is not smoothed [m].
    """

    def __init__(self, time: float | np.ndarray, jump: float):
        times = np.maximum(np.broadcast_to(np.asarray(time, dtype=float), 3), 1.0e-3)
        self._fade = np.exp(-1.0 / times)  # of the smallest time: 0
        self._jump = jump
        self._at: np.ndarray | None = None
        self._speed = np.zeros(3)
        self._last = np.zeros(3)

    def follow(self, point: np.ndarray) -> np.ndarray:
        """The smoothed position after one more frame in which the target is at ``point``, shape (3,)."""
        point = np.asarray(point, dtype=float)
        if not np.isfinite(point).all():  # a world that diverged: stay where the target was last
            return np.zeros(3) if self._at is None else self._at
        if self._at is None or float(np.linalg.norm(point - self._last)) > self._jump:
            self._at, self._speed = point.copy(), np.zeros(3)
        else:
            # Gains of a critically damped filter with a double pole at exp(-1 / time).
            ahead = self._at + self._speed
            error = point - ahead
            self._at = ahead + (1.0 - self._fade**2) * error
            self._speed = self._speed + (1.0 - self._fade) ** 2 * error
        self._last = point
        return self._at
