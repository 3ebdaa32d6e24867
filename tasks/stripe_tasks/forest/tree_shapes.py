# SPDX-License-Identifier: Apache-2.0
"""Tree shapes: the pieces of trees, many at a time: tapered tubes, ragged clumps, leaves and drooping fronds.

Every function returns ``(vertices, faces)``, float64 ``(V, 3)`` [m] and int ``(F, 3)``, counterclockwise from outside.
Leaves and fronds, which have no inside, face along the given normal or upwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import trimesh

__all__ = ["Piece", "clumps", "fronds", "join", "leaves", "patches", "tubes", "unit"]

Piece = tuple[np.ndarray, np.ndarray]


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length one along the last axis."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def join(pieces: Sequence[Piece]) -> Piece:
    """Join several pieces into one."""
    if not pieces:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    starts = np.cumsum([0] + [len(v) for v, _ in pieces[:-1]])
    return (
        np.concatenate([v for v, _ in pieces]),
        np.concatenate([f + start for (_, f), start in zip(pieces, starts)]),
    )


def _copies(vertices: np.ndarray, faces: np.ndarray) -> Piece:
    """One piece of the vertices ``(B, V, 3)`` of B copies, all with the same faces."""
    count, each = vertices.shape[:2]
    return vertices.reshape(-1, 3), (faces[None] + each * np.arange(count)[:, None, None]).reshape(-1, 3)


@lru_cache(maxsize=32)
def _tube_faces(rings: int, sides: int) -> np.ndarray:
    ring, side = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij")
    a, b = ring * sides + side, ring * sides + (side + 1) % sides
    wall = np.stack([a, b, b + sides, a, b + sides, a + sides], axis=-1).reshape(-1, 3)
    last = (rings - 1) * sides + np.arange(sides)
    tip = np.column_stack([last, np.roll(last, -1), np.full(sides, rings * sides)])
    rest = np.arange(1, sides - 1)
    foot = np.column_stack([np.zeros_like(rest), rest + 1, rest])
    return np.concatenate([wall, tip, foot])


def tubes(
    paths: np.ndarray, radii: np.ndarray, sides: int, lobes: np.ndarray | None = None, turn: float = 0.0
) -> Piece:
    """Closed tubes that end in a point.

    Args:
        paths: Points of each tube's middle line, ``(B, K, 3)`` [m], the last one its tip.
        radii: At all points but the last, ``(B, K - 1)`` [m]: of the circle that has the area of the cross-section.
        sides: Corners of a cross-section.
        lobes: Factors on the radius of each corner, ``(B, K - 1, sides)``.
        turn: Angle of the first corner [rad].
    """
    rings = paths.shape[1] - 1
    along = unit(np.gradient(paths, axis=1))
    span = paths[:, -1] - paths[:, 0]
    across = np.stack([-span[:, 1], span[:, 0], np.zeros(len(span))], axis=-1)
    # an upright tube has no horizontal direction of its own: x serves instead
    upright = np.linalg.norm(span[:, :2], axis=1) < 0.2 * np.linalg.norm(span, axis=1)
    across = np.where(upright[:, None], [1.0, 0.0, 0.0], across)[:, None]
    u = unit(across - (across * along).sum(axis=-1, keepdims=True) * along)[:, :-1]
    w = np.cross(along[:, :-1], u)
    angle = 2.0 * np.pi * np.arange(sides) / sides + turn
    # a polygon has less area than its circle: corners lie farther out to make up for it
    reach = radii / np.sqrt(0.5 * sides / np.pi * np.sin(2.0 * np.pi / sides))
    reach = reach[..., None] * (1.0 if lobes is None else lobes)
    ring = reach[..., None] * (np.cos(angle)[:, None] * u[:, :, None] + np.sin(angle)[:, None] * w[:, :, None])
    ring = ring + paths[:, :-1, None]
    vertices = np.concatenate([ring.reshape(len(paths), -1, 3), paths[:, -1:]], axis=1)
    return _copies(vertices, _tube_faces(rings, sides))


@lru_cache(maxsize=4)
def _ball(level: int) -> tuple[np.ndarray, np.ndarray]:
    ball = trimesh.creation.icosphere(level, 1.0)
    return np.asarray(ball.vertices, dtype=np.float64), np.asarray(ball.faces)


def clumps(
    centers: np.ndarray,
    radii: np.ndarray,
    rng: np.random.Generator,
    rough: float = 0.2,
    floor: float = 0.5,
    level: int = 0,
) -> Piece:
    """Ragged balls whose lower side is cut off.

    Args:
        centers: ``(B, 3)`` [m].
        radii: Half axes, ``(B, 3)`` [m].
        rng: Generator of all random numbers.
        rough: Largest displacement of corners, as a share of the radius.
        floor: Depth below the middle at which they are cut off, as a share of the radius.
        level: 0 for 20 triangles each, 1 for 80.
    """
    ball, faces = _ball(level)
    turn = rng.uniform(0.0, 2.0 * np.pi, len(centers))
    cos, sin = np.cos(turn)[:, None], np.sin(turn)[:, None]
    x, y, z = (np.broadcast_to(c, (len(centers), len(ball))) for c in ball.T)
    points = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
    points = points * (1.0 + rough * rng.uniform(-1.0, 1.0, points.shape[:2]))[..., None]
    # what is below the floor is pushed up to a quarter of its depth: a ragged, nearly level underside
    low = points[..., 2] < -floor
    points[..., 2] = np.where(low, -floor + 0.25 * (points[..., 2] + floor), points[..., 2])
    return _copies(points * radii[:, None] + centers[:, None], faces)


def leaves(centers: np.ndarray, normals: np.ndarray, length: np.ndarray, width: np.ndarray, along: np.ndarray) -> Piece:
    """One triangle for each bunch of leaves.

    Args:
        centers: ``(N, 3)`` [m].
        normals: Where they face, ``(N, 3)``, any length.
        length: From the middle of the base to the tip, ``(N,)`` [m].
        width: Of the base, ``(N,)`` [m].
        along: Where the tips point, ``(N, 3)``; the share of it that lies in the leaf counts.
    """
    up = unit(normals)
    tip = unit(along - (along * up).sum(axis=1, keepdims=True) * up)
    side = np.cross(up, tip)
    base = centers - tip * (length / 3.0)[:, None]
    half = side * (0.5 * width)[:, None]
    vertices = np.stack([base - half, centers + tip * (2.0 * length / 3.0)[:, None], base + half], axis=1)
    return _copies(vertices, np.array([[0, 1, 2]]))


def fronds(
    base: np.ndarray, azimuth: np.ndarray, length: np.ndarray, drop: np.ndarray, width: np.ndarray, hang: np.ndarray
) -> Piece:
    """Branches of a conifer as roofs of four triangles: a ridge from the trunk to the tip, and sides that hang.

    Args:
        base: Where they start, ``(N, 3)`` [m].
        azimuth: Direction about z, ``(N,)`` [rad].
        length: Horizontal reach, ``(N,)`` [m].
        drop: How far the tip lies below the base, ``(N,)`` [m].
        width: From side to side, ``(N,)`` [m].
        hang: How far the sides lie below the ridge, ``(N,)`` [m].
    """
    out = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)])
    side = np.column_stack([-out[:, 1], out[:, 0], out[:, 2]])
    down = np.array([0.0, 0.0, -1.0])
    ridge = base + 0.55 * length[:, None] * out + (0.45 * drop)[:, None] * down
    tip = base + length[:, None] * out + drop[:, None] * down
    edge = ridge + (0.08 * length)[:, None] * out + hang[:, None] * down
    half = 0.5 * width[:, None] * side
    vertices = np.stack([base, ridge, tip, edge + half, edge - half], axis=1)
    return _copies(vertices, np.array([[0, 1, 3], [1, 2, 3], [0, 4, 1], [1, 4, 2]]))


def patches(
    rings: np.ndarray, ring: np.ndarray, side: np.ndarray, low: np.ndarray, high: np.ndarray, lift: float
) -> Piece:
    """Pieces of bark on the sides of a tube, two triangles each.

    Args:
        rings: Corners of its cross-sections, ``(K, sides, 3)`` [m].
        ring: Above which cross-section each piece lies, ``(N,)``.
        side: On which side, ``(N,)``.
        low: Where it begins on the way to the next cross-section, in [0, 1], ``(N, 2)`` for its two edges.
        high: Where it ends, likewise.
        lift: Its distance in front of the tube [m].
    """
    after = (side + 1) % rings.shape[1]
    left, right = rings[:, side], rings[:, after]
    index = np.arange(len(ring))
    corners = []
    for edge, column in ((left, 0), (right, 1)):
        foot, head = edge[ring, index], edge[ring + 1, index]
        out = foot - rings[ring].mean(axis=1)
        out = lift * unit(out * [1.0, 1.0, 0.0])
        corners += [foot + share[:, column, None] * (head - foot) + out for share in (low, high)]
    vertices = np.stack(corners, axis=1)
    return _copies(vertices, np.array([[0, 2, 3], [0, 3, 1]]))
