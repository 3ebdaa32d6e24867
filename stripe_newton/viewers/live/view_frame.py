# SPDX-License-Identifier: Apache-2.0
"""View frame: where the world stands in the scene that browsers show, as the camera follows a robot."""

from __future__ import annotations

import math

import numpy as np

from stripe_newton.viewers.poses import compose

__all__ = ["VIEW", "WORLD", "ViewFrame"]

WORLD = "/world"
"""Node of the world frame, which moves against what the camera follows.

A browser moves a node at once, but applies poses of instances one picture later. Below this node is therefore only
what may lead by a picture: scenery of many instances, and what users add.
"""
VIEW = "/view"
"""Node that does not move. What is below it has poses in the scene: robots, ground and drawings move together."""


class ViewFrame:
    """The world in the scene: a turn about the upright axis, around the point that the camera follows.

    The camera stays where the user put it; the world moves instead.
    """

    def __init__(self) -> None:
        self.center = np.zeros(3)
        """Point of the world that stands at the scene's origin [m], shape ``(3,)``."""
        self.turn = 0.0
        """Angle of the world in the scene about the upright axis [rad]."""

    @property
    def rotation(self) -> np.ndarray:
        """Rotation of the world about the upright axis, shape ``(2, 2)``."""
        c, s = math.cos(self.turn), math.sin(self.turn)
        return np.array([[c, -s], [s, c]])

    @property
    def wxyz(self) -> tuple[float, float, float, float]:
        """The same rotation as a quaternion (w, x, y, z)."""
        return math.cos(0.5 * self.turn), 0.0, 0.0, math.sin(0.5 * self.turn)

    @property
    def position(self) -> tuple[float, float, float]:
        """The world's origin in the scene [m]."""
        x, y = (float(v) for v in -self.rotation @ self.center[:2])
        return x, y, -float(self.center[2])

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points of the world in the scene [m], ``(3,)`` or ``(n, 3)``."""
        return _turn(np.asarray(points, dtype=float) - self.center, self.rotation)

    def ways(self, ways: np.ndarray) -> np.ndarray:
        """Vectors of the world in the scene, ``(3,)`` or ``(n, 3)``."""
        return _turn(np.asarray(ways, dtype=float), self.rotation)

    def poses(self, poses: np.ndarray) -> np.ndarray:
        """Poses of the world in the scene, (x, y, z, qx, qy, qz, qw), ``(n, 7)``."""
        w, x, y, z = self.wxyz
        return compose(np.array([[*self.position, x, y, z, w]]), np.asarray(poses, dtype=float))

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points of the scene in the world [m], ``(3,)`` or ``(n, 3)``."""
        return _turn(np.asarray(points, dtype=float), self.rotation.T) + self.center


def _turn(points: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Points ``(..., 3)`` turned about the upright axis by ``rotation``, ``(2, 2)``."""
    return np.concatenate([points[..., :2] @ rotation.T, points[..., 2:]], axis=-1)
