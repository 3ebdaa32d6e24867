# SPDX-License-Identifier: Apache-2.0
"""Shapes of broken things: outlines, plates, bars and tubes, as corners ``(V, 3)`` and faces ``(F, 3)``."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import Delaunay

from stripe_newton.specifications import MeshPart

__all__ = ["Surface", "bar", "boxes", "broken_outline", "joined", "plate", "toned", "tube"]

Surface = tuple[np.ndarray, np.ndarray]
_BOX = np.array([[i, j, k] for i in (-1.0, 1.0) for j in (-1.0, 1.0) for k in (-1.0, 1.0)])
_BOX_FACES = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
     (1, 5, 7), (1, 7, 3)]
)  # fmt: skip


def broken_outline(
    half_x: float, half_y: float, broken: tuple[float, float, float, float], rng: np.random.Generator
) -> np.ndarray:
    """Corners of a rectangle with some broken sides, counterclockwise, ``(K, 2)`` [m].

    Args:
        half_x: Half extent along x [m].
        half_y: Half extent along y [m].
        broken: Depth of the break of the sides at -y, +x, +y, -x [m]; 0 for an intact side.
        rng: Generator of all random numbers.
    """
    corners = np.array([(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)])
    inward = np.array([(0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0)])
    found = []
    for side in range(4):
        start, end, deep = corners[side], corners[(side + 1) % 4], broken[side]
        pieces = max(2, round(np.linalg.norm(end - start) / 0.16)) if deep else 1
        # a random walk with some noise: breaks have large bays and small teeth
        walk = np.cumsum(rng.uniform(-1.0, 1.0, pieces + 1))
        walk = 0.5 * (walk - walk.min()) / max(np.ptp(walk), 1.0e-9) + 0.5 * rng.random(pieces + 1)
        share = np.linspace(0.0, 1.0, pieces + 1)
        share[1:-1] += rng.uniform(-0.3, 0.3, pieces - 1) / pieces
        points = start + share[:, None] * (end - start) + (deep * walk)[:, None] * inward[side]
        before, after = broken[side - 1], broken[(side + 1) % 4]
        points[0] += (0.5 * before + 0.3 * deep) * inward[side - 1] if before or deep else 0.0
        points[-1] += (0.5 * after + 0.3 * deep) * inward[(side + 1) % 4] if after or deep else 0.0
        found.append(points if deep else points[[0, -1]])
    outline = np.concatenate(found)
    # sorted by angle, the outline is star-shaped, which its triangulation and its raft need
    turn = np.arctan2(outline[:, 1] / half_y, outline[:, 0] / half_x)
    outline = outline[np.argsort(turn)]
    apart = np.linalg.norm(outline - np.roll(outline, 1, axis=0), axis=1) > 0.02
    return outline[apart]


def plate(outline: np.ndarray, thickness: float, ragged: float, rng: np.random.Generator) -> tuple[Surface, Surface]:
    """Faces and rim of a plate between ``z = -thickness / 2`` and ``thickness / 2``.

    Args:
        outline: Its corners, star-shaped about the origin, ``(K, 2)`` [m].
        thickness: Thickness [m].
        ragged: Displacement of the rim, in and out [m].
        rng: Generator of all random numbers.
    """
    high, count, half = outline.max(axis=0), len(outline), 0.5 * thickness
    points = rng.uniform(-1.0, 1.0, (max(8, round(12.0 * float(high.prod()))), 2)) * high
    points = points[_inside(points, outline, 0.88)]
    flat = np.concatenate([outline, points])
    faces = Delaunay(flat).simplices
    middle = flat[faces].mean(axis=1)
    a, b, c = np.moveaxis(flat[faces], 1, 0)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    faces = np.where((area > 0.0)[:, None], faces, faces[:, ::-1])[
        _inside(middle, outline, 1.0) & (np.abs(area) > 1e-6)
    ]
    shrunk = 1.0 - ragged * rng.random(count) / np.linalg.norm(outline, axis=1)
    top = np.column_stack([flat, half + rng.uniform(-0.004, 0.004, len(flat))])
    low = np.column_stack([np.concatenate([outline * shrunk[:, None], points]), np.full(len(flat), -half)])
    faced = np.concatenate([top, low]), np.concatenate([faces, faces[:, ::-1] + len(flat)])
    # a third ring between top and underside makes the rim uneven across the thickness too
    out = 1.0 + ragged * rng.uniform(-0.4, 0.5, count) / np.linalg.norm(outline, axis=1)
    waist = np.column_stack([outline * out[:, None], half * rng.uniform(-0.4, 0.4, count)])
    ring = np.concatenate([low[:count], waist, top[:count]])
    i = np.arange(count)
    j = (i + 1) % count
    rows = [[(i + k, j + k, j + k + count), (i + k, j + k + count, i + k + count)] for k in (0, count)]
    rim = np.concatenate([np.column_stack(t) for row in rows for t in row])
    return faced, (ring, rim)


def _inside(points: np.ndarray, outline: np.ndarray, share: float) -> np.ndarray:
    """Mask of the points inside an outline that is scaled by ``share`` about the origin."""
    turn = np.arctan2(outline[:, 1], outline[:, 0])
    order = np.argsort(turn)
    edge, turn = outline[order], turn[order]
    at = np.searchsorted(turn, np.arctan2(points[:, 1], points[:, 0]))
    a, b = edge[at - 1], edge[at % len(edge)]
    cross = (b - a)[:, 0] * (points - share * a)[:, 1] - (b - a)[:, 1] * (points - share * a)[:, 0]
    return np.asarray(cross >= -1.0e-9)


def boxes(middle: np.ndarray, half: np.ndarray, rng: np.random.Generator, jitter: float = 0.0) -> Surface:
    """Boxes with middles ``(N, 3)`` and half extents ``(N, 3)``, their corners moved by up to ``jitter`` [m]."""
    corners = middle[:, None] + half[:, None] * _BOX
    corners = corners + rng.uniform(-jitter, jitter, corners.shape)
    faces = _BOX_FACES + 8 * np.arange(len(middle))[:, None, None]
    return corners.reshape(-1, 3), faces.reshape(-1, 3)


def tube(radius: float, inner: float, length: float, sides: int = 14) -> Surface:
    """Hollow tube along x, whose middle is the origin [m]."""
    turn = 2.0 * math.pi * np.arange(sides) / sides
    ring = np.column_stack([0.0 * turn, np.cos(turn), np.sin(turn)])
    ends = [(-0.5, radius), (0.5, radius), (0.5, inner), (-0.5, inner)]
    corners = np.concatenate([ring * (0.0, r, r) + (length * x, 0.0, 0.0) for x, r in ends])
    i = np.arange(sides)
    j = (i + 1) % sides
    faces = []
    for k in range(4):
        a, b = k * sides, (k + 1) % 4 * sides
        faces += [np.column_stack([i + a, b + i, b + j]), np.column_stack([i + a, b + j, a + j])]
    return corners, np.concatenate(faces)[:, ::-1]


def bar(line: np.ndarray, radius: float, sides: int = 5) -> Surface:
    """Round bar along a line ``(K, 3)`` [m], closed at its ends."""
    ahead = np.gradient(line, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    # any direction that the bar nowhere has
    other = np.array([0.0, 0.0, 1.0]) if abs(ahead[:, 2]).max() < 0.9 else np.array([0.31, 0.95, 0.05])
    side = np.cross(ahead, other)
    side /= np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1.0e-9)
    up = np.cross(side, ahead)
    turn = 2.0 * math.pi * np.arange(sides) / sides
    rings = line[:, None] + radius * (np.cos(turn)[:, None] * side[:, None] + np.sin(turn)[:, None] * up[:, None])
    i = np.arange(sides)
    j = (i + 1) % sides
    walls = np.concatenate([np.column_stack([i, j, j + sides]), np.column_stack([i, j + sides, i + sides])])
    faces = [walls + sides * k for k in range(len(line) - 1)]
    cap = np.array([(0, k + 1, k) for k in range(1, sides - 1)])
    faces += [cap, cap[:, ::-1] + sides * (len(line) - 1)]
    return rings.reshape(-1, 3), np.concatenate(faces)


def joined(surfaces: list[Surface]) -> Surface:
    """Join several surfaces into one."""
    first = np.cumsum([0, *(len(v) for v, _ in surfaces)])
    faces = [f + n for (_, f), n in zip(surfaces, first[:-1], strict=True)]
    return np.concatenate([v for v, _ in surfaces]), np.concatenate(faces)


def toned(
    name: str, surface: Surface, tone: np.ndarray, tones: list[tuple[float, float, float]], roughness: float = 0.95
) -> list[MeshPart]:
    """Split a surface into parts of several colours, by an index for each face."""
    found = []
    for index, color in enumerate(tones):
        faces = surface[1][tone == index]
        if len(faces):
            used, where = np.unique(faces, return_inverse=True)
            found.append(MeshPart(f"{name}_{index}", surface[0][used], where.reshape(-1, 3), color, roughness))
    return found
