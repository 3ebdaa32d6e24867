# SPDX-License-Identifier: Apache-2.0
"""Lofts: smooth closed surfaces through superelliptic rings, for the robots that these tools author."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Surface", "loft", "puck", "rounded", "smooth"]


@dataclass
class Surface:
    """Smooth surface: points [m] and normals of shape ``(n, 3)``, faces of three or four indices that face outward."""

    points: np.ndarray
    normals: np.ndarray
    faces: list[tuple[int, ...]]


def loft(axis: str, rings: np.ndarray, sides: int = 32, columns: tuple[int, int] | None = None) -> Surface:
    """Tube through rings, closed by a point at each end.

    A ring is the superellipse ``|u / a|^p + |v / b|^p = 1`` about its centre, in the plane across ``axis``.

    Args:
        axis: ``"x"``, ``"y"`` or ``"z"``: the direction of the tube. (u, v) are the next two axes of x, y, z, x, y.
        rings: Rows ``(position along the axis, centre u, centre v, a, b, p)``, the positions rising.
        sides: Points of each ring.
        columns: Keep only the faces between these two columns of points; column 0 is at +u, the next one towards +v.
    """
    at, centre_u, centre_v, a, b, power = np.asarray(rings, dtype=float).T[:, :, None]
    angle = 2.0 * np.pi * np.arange(sides) / sides
    c, s = np.cos(angle), np.sin(angle)
    u = centre_u + a * np.sign(c) * np.abs(c) ** (2.0 / power)
    v = centre_v + b * np.sign(s) * np.abs(s) ** (2.0 / power)
    first = "xyz".index(axis)
    order = [(first + k) % 3 for k in range(3)]
    grid = np.empty((len(rings), sides, 3))
    for k, values in zip(order, (np.broadcast_to(at, u.shape), u, v)):
        grid[:, :, k] = values
    poles = grid[[0, -1]].mean(axis=1)
    points = np.concatenate([grid.reshape(-1, 3), poles])
    start, end, last = len(points) - 2, len(points) - 1, (len(rings) - 1) * sides
    strips = []
    for j in range(sides):
        k = (j + 1) % sides
        strip: list[tuple[int, ...]] = [(start, k, j), (end, last + j, last + k)]
        for i in range(0, last, sides):
            strip.append((i + j, i + k, i + sides + k, i + sides + j))
        strips.append(strip)
    # normals of the whole tube, so that two parts of it meet without an edge
    normals = _normals(points, [f for strip in strips for f in strip])
    chosen = range(sides) if columns is None else [j % sides for j in range(columns[0], columns[1])]
    return _compact(points, normals, [f for j in chosen for f in strips[j]])


def _normals(points: np.ndarray, faces: list[tuple[int, ...]]) -> np.ndarray:
    """Unit normals of the points: the mean over the faces around each, weighted by area."""
    normals = np.zeros_like(points)
    for face in faces:
        p = points[list(face)]
        area = np.cross(p[2] - p[0], p[-1] - p[1]) if len(face) == 4 else np.cross(p[1] - p[0], p[2] - p[0])
        normals[list(face)] += area
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _compact(points: np.ndarray, normals: np.ndarray, faces: list[tuple[int, ...]]) -> Surface:
    """Drop the points that no face uses."""
    used = sorted({i for face in faces for i in face})
    new = {old: i for i, old in enumerate(used)}
    return Surface(points[used], normals[used], [tuple(new[i] for i in face) for face in faces])


def puck(
    axis: str, low: float, high: float, radius: float, centre: tuple[float, float] = (0.0, 0.0), fillet: float = 0.006
) -> Surface:
    """Disc with rounded edges, from ``low`` to ``high`` along ``axis``."""
    turn = np.linspace(0.0, 0.5 * np.pi, 4)
    fillet = min(fillet, 0.49 * (high - low))
    rise, inset = fillet * (1.0 - np.cos(turn)), fillet * (1.0 - np.sin(turn))
    at = [low, *(low + rise), *(high - rise[::-1]), high]
    size = [radius - 1.6 * fillet, *(radius - inset), *(radius - inset[::-1]), radius - 1.6 * fillet]
    rings = [(x, *centre, r, r, 2.0) for x, r in zip(at, size)]
    return loft(axis, np.array(rings), 28)


def rounded(
    axis: str,
    profile: np.ndarray,
    start: float,
    end: float,
    power: float,
    sides: int = 32,
    columns: tuple[int, int] | None = None,
) -> Surface:
    """Loft whose ends are rounded over the lengths ``start`` and ``end`` [m].

    Args:
        axis: Direction of the tube.
        profile: Rows ``(position, centre u, centre v, half u, half v)``, interpolated between.
        start: Length of the rounding at the low end.
        end: Length of the rounding at the high end.
        power: Exponent of the rings and of the ends.
        sides: Points of each ring.
        columns: Columns to keep, as of :func:`loft`.
    """
    low, high = profile[0, 0], profile[-1, 0]
    turn = np.linspace(0.0, 0.5 * np.pi, 6)[1:]
    at = [*(low + start * (1.0 - np.cos(turn))), *profile[1:-1, 0], *(high - end * (1.0 - np.cos(turn[::-1])))]
    at = np.unique(np.round([x for x in at if low < x < high], 6))
    near = np.clip(np.minimum((at - low) / start, (high - at) / end), 0.0, 1.0)
    shrink = (1.0 - (1.0 - near) ** power) ** (1.0 / power)
    u, v, a, b = (np.interp(at, profile[:, 0], profile[:, k]) for k in range(1, 5))
    rings = np.stack([at, u, v, a * shrink, b * shrink, np.full_like(at, power)], axis=1)
    return loft(axis, rings, sides, columns)


def smooth(profile: list[tuple[float, ...]], count: int = 25) -> np.ndarray:
    """Rows between the given ones by cubic steps, so that the outline has no corners."""
    rows = np.array(profile)
    at = np.linspace(rows[0, 0], rows[-1, 0], count)
    which = np.clip(np.searchsorted(rows[:, 0], at, side="right") - 1, 0, len(rows) - 2)
    t = (at - rows[which, 0]) / (rows[which + 1, 0] - rows[which, 0])
    t = (t * t * (3.0 - 2.0 * t))[:, None]
    return np.column_stack([at, rows[which, 1:] * (1.0 - t) + rows[which + 1, 1:] * t])
