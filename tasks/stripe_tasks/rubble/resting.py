# SPDX-License-Identifier: Apache-2.0
"""Rest of pieces on the ground and on pieces that lie there already."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import distance_transform_edt, map_coordinates
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from stripe_newton.specifications import AssetInstance, DynamicMesh, TerrainInstance

__all__ = ["Piece", "Support", "spread"]

STEEPEST = math.radians(40.0)
"""Steepest ground on which a piece lies still [rad]."""


@dataclass(eq=False)
class Piece(DynamicMesh):
    """Piece of rubble.

    Attributes:
        samples: Points of its surface, so dense that others can rest on them, ``(N, 3)`` [m].
        feet: Points of its underside, ``(M, 3)`` [m].
        upright: Whether it stands, so that nothing rests on it.
        stubs: Points [m] and directions in which reinforcement sticks out of it, ``(K, 2, 3)``.
    """

    samples: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    feet: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    stubs: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 3)))
    upright: bool = False


class Support:
    """Support of pieces: the highest surface of the ground and of all pieces on it, on a grid.

    Args:
        terrain: Terrain with all earlier pieces in ``terrain.placed``.
        cell: Spacing [m].
    """

    def __init__(self, terrain: TerrainInstance, cell: float = 0.1):
        ground = terrain.ground
        shape = [round(s / cell) + 1 for s in ground.size]
        self._lower = np.array(ground.lower)
        self._cell = np.array(ground.size) / (np.array(shape) - 1.0)
        x, y = (low + np.arange(n) * c for low, n, c in zip(ground.lower, shape, self._cell, strict=True))
        self.heights = ground.height_at(*np.meshgrid(x, y))
        self.taken = np.zeros(self.heights.shape, dtype=bool)
        for placed in terrain.placed.values():
            for instance in placed:
                self.add(instance)

    def at(self, xy: np.ndarray) -> np.ndarray:
        """Height at places ``(N, 2)`` [m]."""
        col, row = ((xy - self._lower) / self._cell).T
        return np.asarray(map_coordinates(self.heights, [row, col], order=1, mode="nearest"))

    def add(self, instance: AssetInstance) -> None:
        """Add an instance: later pieces rest on it, or stay clear of it if it stands. Only a :class:`Piece` counts."""
        if not isinstance(instance.mesh, Piece):
            return
        turn = Rotation.from_quat(instance.rotation)
        points = np.array(instance.position) + instance.scale * turn.apply(instance.mesh.samples)
        row, col, inside = self._cells(points[:, :2])
        if instance.mesh.upright:
            self.taken[row, col] = True
        else:
            np.maximum.at(self.heights, (row, col), points[inside, 2])

    def _cells(self, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows and columns of the places that lie in the field, and the mask of those places."""
        col, row = np.rint((xy - self._lower) / self._cell).astype(int).T
        inside = (row >= 0) & (col >= 0) & (row < self.heights.shape[0]) & (col < self.heights.shape[1])
        return row[inside], col[inside], inside

    def room(self, xy: np.ndarray) -> np.ndarray:
        """Distance of places ``(N, 2)`` in the field from standing pieces [m]."""
        if not self.taken.any():
            return np.full(len(xy), np.inf)
        away = distance_transform_edt(~self.taken, sampling=self._cell[::-1])
        col, row = np.rint((xy - self._lower) / self._cell).astype(int).T
        return np.asarray(away[row, col])

    def crossed(self, piece: Piece, position: np.ndarray, turn: np.ndarray, scale: float = 1.0) -> int:
        """Number of points of a piece at a pose that lie in standing pieces."""
        if not self.taken.any():
            return 0
        points = position[:2] + scale * Rotation.from_quat(turn).apply(piece.samples)[:, :2]
        row, col, _ = self._cells(points)
        return int(self.taken[row, col].sum())

    def rest(
        self, piece: Piece, xy: np.ndarray, yaw: float, scale: float = 1.0, raised: float = 0.0, sunk: float = 0.02
    ) -> tuple[np.ndarray, np.ndarray]:
        """Pose of a piece at rest on the plane fitted to the surface below it, sunk in a little.

        A part of its underside is below the surface: a third where it lies flat, less where one end of it is raised.

        Args:
            piece: Piece to lay down.
            xy: Its place [m].
            yaw: Direction of its x axis [rad].
            scale: Factor on its size.
            raised: Angle by which one end is raised, about its y axis; the other end is in the heap [rad].
            sunk: Further depth [m].

        Returns:
            Position [m] and orientation, xyzw.
        """
        about = Rotation.from_euler("z", yaw)
        flat = scale * about.apply(piece.feet)
        below = self.at(flat[:, :2] + xy)
        # plane through the surface below the feet, by least squares
        basis = np.column_stack([np.ones(len(flat)), flat[:, :2]])
        _, along_x, along_y = np.linalg.lstsq(basis, below, rcond=None)[0]
        tilt = math.atan(math.hypot(along_x, along_y))
        axis = np.array([along_y, -along_x, 0.0]) / max(math.hypot(along_x, along_y), 1.0e-9)
        turn = Rotation.from_rotvec(min(tilt, STEEPEST) * axis) * about * Rotation.from_euler("y", -raised)
        points = scale * turn.apply(piece.feet)
        gap = points[:, 2] - self.at(points[:, :2] + xy)
        # the height at which that share of the feet is below the surface
        share = 0.33 if raised == 0.0 else 0.28
        return np.array([*xy, -np.quantile(gap, share) - sunk]), turn.as_quat()


def spread(
    weight: np.ndarray,
    size: tuple[float, float],
    count: int,
    apart: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Draw points of a density map that keep a distance, ``(count, 2)`` [m]; a shorter one if there is no room.

    Args:
        weight: Density, ``(rows, cols)`` over the extent, rows along y.
        size: Extent in x and y, centred on the origin [m].
        count: Number of points.
        apart: Least distance [m].
        rng: Generator of all random numbers.

    Raises:
        ValueError: If the density is 0 everywhere.
    """
    if count and not weight.any():
        raise ValueError(f"spread: {count} points have no room, the density is 0 everywhere")
    share = (weight / max(float(weight.sum()), 1.0e-300)).ravel()
    kept = np.zeros((0, 2))
    while len(kept) < count:
        cell = rng.choice(weight.size, 3 * count + 16, p=share)
        row, col = np.divmod(cell, weight.shape[1])
        more = (np.column_stack([col, row]) + rng.random((len(cell), 2))) / weight.shape[::-1]
        points = np.concatenate([kept, (more - 0.5) * size])
        free = np.ones(len(points), dtype=bool)
        pairs = cKDTree(points).query_pairs(apart, output_type="ndarray")
        # in the order of their drawing, earlier points go first: points kept so far stay
        for first, second in pairs[np.lexsort(pairs.T[::-1])]:
            if free[first]:
                free[second] = False
        kept, apart = points[free][:count], 0.8 * apart
    return kept
