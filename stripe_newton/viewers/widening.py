# SPDX-License-Identifier: Apache-2.0
"""Widening view: a camera that moves back where a robot on a fixed base reaches out of the picture."""

from __future__ import annotations

import math

import numpy as np

from .camera_framing import Follower, camera_axes, frame_points

__all__ = ["WideningView"]

_EDGE = 0.94
"""Share of the picture's half size beyond which a point counts as out of it."""
_FARTHEST = 4.0
"""Distance of a point from the first ones, relative to their radius, from which it is left out: a world diverged."""


class WideningView:
    """Eye and target that show all points so far. The view only gets wider, so that it comes to rest.

    A robot on a fixed base is framed in its first pose, in which an arm may hang or be folded.

    Args:
        points: The first points, shape (n, 3) [m].
        view: Direction and size of the picture: azimuth, elevation and field of view [rad], aspect, margin. See
            :func:`frame_points`.
        time: Time constant of the motion in frames; 0 moves at once.
    """

    def __init__(self, points: np.ndarray, view: tuple[float, float, float, float, float], time: float):
        self._view = view
        self._low, self._high = points.min(axis=0), points.max(axis=0)
        self._middle = 0.5 * (self._low + self._high)
        self._limit = _FARTHEST * max(0.5 * float(np.linalg.norm(self._high - self._low)), 0.1)
        self._goal = frame_points(points, *view)
        # No jump counts as a new episode: the view is calm, whatever the robot does.
        self._followers = Follower(time, jump=1.0e9), Follower(time, jump=1.0e9)

    def show(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Eye and target [m] of the next frame, in which ``points``, shape (n, 3), should be seen."""
        near = np.linalg.norm(points - self._middle, axis=1) < self._limit
        if (points := points[near]).size and not self._has(points):
            self._low = np.minimum(self._low, points.min(axis=0))
            self._high = np.maximum(self._high, points.max(axis=0))
            corners = np.stack(np.meshgrid(*zip(self._low, self._high, strict=True)), axis=-1).reshape(-1, 3)
            self._goal = frame_points(corners, *self._view)
        (eye, target), (near_eye, near_target) = self._goal, self._followers
        return near_eye.follow(eye), near_target.follow(target)

    def _has(self, points: np.ndarray) -> bool:
        """Whether points are in the picture that the view is moving to."""
        _, _, fov, aspect, _ = self._view
        eye, target = self._goal
        seen = (points - eye) @ camera_axes(eye, target)
        half = _EDGE * math.tan(0.5 * fov) * np.maximum(-seen[:, 2], 0.0)
        return bool((np.abs(seen[:, 1]) <= half).all() and (np.abs(seen[:, 0]) <= aspect * half).all())
