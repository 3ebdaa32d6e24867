# SPDX-License-Identifier: Apache-2.0
"""Stones: meshes of boulders with colliders fitted to their surface; also helpers for other meshes.

A generator in the same state gives the same mesh.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull, HalfspaceIntersection

from stripe_newton.specifications import Collider, DynamicMesh, MeshPart

__all__ = [
    "capsule_between",
    "check_positive",
    "face_normals",
    "reach_on_ground",
    "rock",
    "split_faces",
    "tinted",
    "tube",
]

_STONES = ((0.20, 0.195, 0.185), (0.165, 0.165, 0.17), (0.20, 0.175, 0.145), (0.15, 0.135, 0.115))
_MOSS = (0.075, 0.097, 0.026)
_FACES = 40  # planes that cut a boulder
_SUNK = 0.25  # share of its height below the ground
_BURIED = 0.35  # weight of the surface below the ground in the fit of the colliders


def check_positive(function: str, **sizes: float) -> None:
    """Raise a ValueError for the first size [m] that is not positive and finite."""
    for name, value in sizes.items():
        if not (math.isfinite(value) and value > 0.0):
            raise ValueError(f"{function}: {name} is {value}, must be a positive number [m]")


def tinted(color: Sequence[float], rng: np.random.Generator, spread: float = 0.18) -> tuple[float, float, float]:
    """Vary a colour: lighter or darker by up to ``spread`` of it, each channel by a sixth of that."""
    light = 1.0 + spread * rng.uniform(-1.0, 1.0)
    red, green, blue = np.clip(np.array(color) * light * (1.0 + spread / 6.0 * rng.uniform(-1.0, 1.0, 3)), 0.0, 1.0)
    return float(red), float(green), float(blue)


def split_faces(
    vertices: np.ndarray, faces: np.ndarray, kind: np.ndarray, colors: Sequence[tuple[str, tuple[float, float, float]]]
) -> list[MeshPart]:
    """Split a surface into parts by the kind of its faces, ``(F,)``: an index into names and colours."""
    parts = []
    for index, (name, color) in enumerate(colors):
        mine = faces[kind == index]
        if len(mine):
            used, where = np.unique(mine, return_inverse=True)
            parts.append(MeshPart(name, vertices[used], where.reshape(-1, 3), color))
    return parts


def reach_on_ground(parts: Sequence[MeshPart], above: float = -1.0e-4) -> float:
    """Largest distance from the z axis of vertices higher than ``above`` [m]."""
    points = np.concatenate([p.vertices for p in parts]).astype(np.float64)
    points = points[points[:, 2] >= above]
    return float(np.hypot(points[:, 0], points[:, 1]).max())


def capsule_between(a: Sequence[float], b: Sequence[float], radius: float) -> Collider:
    """Capsule whose straight part goes from ``a`` to ``b``; a sphere if they are the same point."""
    first, last = np.array(a, dtype=np.float64), np.array(b, dtype=np.float64)
    middle, axis = 0.5 * (first + last), last - first
    length = float(np.linalg.norm(axis))
    place = (float(middle[0]), float(middle[1]), float(middle[2]))
    if length < 1.0e-3 * radius:
        return Collider("sphere", (float(radius),), place)
    x, y, z = axis / length if axis[2] >= 0.0 else -axis / length
    quat = np.array([-y, x, 0.0, 1.0 + z])  # turns z to the axis the short way
    quat /= np.linalg.norm(quat)
    turn = (float(quat[0]), float(quat[1]), float(quat[2]), float(quat[3]))
    return Collider("capsule", (float(radius), 0.5 * length), place, turn)


def tube(
    line: np.ndarray,
    radii: np.ndarray,
    sides: int,
    closed: bool = True,
    shape: np.ndarray | None = None,
    along: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Tube around a line, faces outwards.

    Args:
        line: Its axis, ``(n, 3)`` [m].
        radii: Its radius at each point [m], ``(n,)``.
        sides: Corners of a cross-section, 3 or more.
        closed: Whether its ends are closed by fans of triangles.
        shape: Factors on the radius of each corner, ``(n, sides)``.
        along: Shift of each corner along the axis [m], ``(n, sides)``.

    Returns:
        Vertices ``(n * sides (+ 2), 3)``, ring by ring, then the middles of the ends; and faces: first the
        ``2 (n - 1) sides`` of the wall, then ``sides`` of the start and ``sides`` of the end.
    """
    line = np.asarray(line, dtype=np.float64)
    n, turn = len(line), 2.0 * math.pi * np.arange(sides) / sides
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    least = np.zeros(3)
    least[np.abs(tangent).sum(axis=0).argmin()] = 1.0
    u = np.cross(tangent, least)  # one reference for all rings, so that rows of corners do not twist
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(tangent, u)
    ring = np.cos(turn)[None, :, None] * u[:, None] + np.sin(turn)[None, :, None] * v[:, None]
    wide = np.asarray(radii)[:, None] * (np.ones((n, sides)) if shape is None else shape)
    shift = np.zeros((n, sides)) if along is None else along
    points = (line[:, None] + wide[..., None] * ring + shift[..., None] * tangent[:, None]).reshape(-1, 3)
    row, col = np.divmod(np.arange((n - 1) * sides), sides)
    a, b = row * sides + col, row * sides + (col + 1) % sides
    wall = np.concatenate([np.stack([a, b, b + sides], axis=1), np.stack([a, b + sides, a + sides], axis=1)])
    if not closed:
        return points, wall
    i, last = np.arange(sides), (n - 1) * sides
    start = np.stack([np.full(sides, n * sides), (i + 1) % sides, i], axis=1)
    end = np.stack([np.full(sides, n * sides + 1), last + i, last + (i + 1) % sides], axis=1)
    middles = points.reshape(n, sides, 3)[[0, -1]].mean(axis=1)
    return np.concatenate([points, middles]), np.concatenate([wall, start, end])


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Outward unit normals of triangles, ``(F, 3)``."""
    normal = _cross(vertices, faces)
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1.0e-12)


def rock(name: str, radius: float, rng: np.random.Generator, flatness: float = 0.6) -> DynamicMesh:
    """Make a boulder with broken faces, a quarter of its height below the ground.

    It is the body between some forty planes around an ellipsoid, its corners worn a little. Its colliders, one or two
    spheres or capsules, are fitted to its surface by least squares of the distance.

    Args:
        name: An identifier.
        radius: Largest distance from its middle, seen from above [m].
        rng: Generator of all random numbers.
        flatness: Ratio of its height to its width.

    Raises:
        ValueError: If a size is not positive.
    """
    check_positive("rock", radius=radius, flatness=flatness)
    vertices, faces = _boulder(np.array([1.0, rng.uniform(0.68, 0.95), flatness]), rng)
    vertices *= radius / np.hypot(vertices[:, 0], vertices[:, 1]).max()
    vertices[:, 2] -= vertices[:, 2].min() + _SUNK * np.ptp(vertices[:, 2])
    points, weights = _surface(vertices, faces, radius)
    colliders = _fit(points, weights, radius)
    normal = face_normals(vertices, faces)
    damp = rng.normal(0.0, 0.35, 3) + (0.0, 0.0, 1.0)
    mossy = (rng.random() < 0.45) & (normal @ damp > 0.86 * np.linalg.norm(damp))
    stone = tinted(_STONES[rng.integers(len(_STONES))], rng)
    parts = split_faces(vertices, faces, np.where(mossy, 1, 0), [("stone", stone), ("moss", tinted(_MOSS, rng))])
    return DynamicMesh(name, parts, colliders, "rock", float(radius))


def _boulder(axes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Irregular polyhedron around an ellipsoid of semi-axes ``axes``, of 80 to 200 triangles that face outwards."""
    # normals spread evenly over the sphere by the golden angle (a Fibonacci lattice), then disturbed
    i = np.arange(_FACES)
    lift = 1.0 - 2.0 * (i + 0.5) / _FACES
    turn = i * math.pi * (3.0 - math.sqrt(5.0)) + rng.uniform(0.0, 2.0 * math.pi)
    wide = np.sqrt(1.0 - lift**2)
    normal = np.stack([wide * np.cos(turn), wide * np.sin(turn), lift], axis=1) + rng.normal(0.0, 0.16, (_FACES, 3))
    normal /= axes  # normals of the ellipsoid
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    away = np.linalg.norm(normal * axes, axis=1) * (1.0 + rng.uniform(-0.05, 0.05, _FACES))
    # a few planes closer to the middle: broken faces
    broken = rng.choice(_FACES, 6, replace=False)
    away[broken] *= rng.uniform(0.78, 0.92, 6)
    cut = HalfspaceIntersection(np.column_stack([normal, -away]), np.zeros(3))
    corners = cut.intersections
    hull = ConvexHull(corners)
    faces = hull.simplices.astype(np.int64)
    inward = np.einsum("fk,fk->f", _cross(corners, faces), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    used, where = np.unique(faces, return_inverse=True)
    corners = corners[used]
    return corners * (1.0 + rng.normal(0.0, 0.012, (len(corners), 1))), where.reshape(-1, 3)


def _cross(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def _surface(vertices: np.ndarray, faces: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Points spread over the surface, and the square roots of their areas as weights; less for buried points."""
    # seven points in each triangle: its middle, near its corners, near the middles of its sides
    mids = [(6, 0, 0), (0, 6, 0), (0, 0, 6), (1, 1, 4), (1, 4, 1), (4, 1, 1)]
    corners = vertices[faces]
    bary = np.array([(2, 2, 2), *((np.array(m) + 1) for m in mids)], dtype=np.float64)
    bary /= bary.sum(axis=1, keepdims=True)
    points = np.einsum("sk,fkd->fsd", bary, corners)
    area = 0.5 * np.linalg.norm(_cross(vertices, faces), axis=1)
    weight = np.sqrt(np.repeat(area / area.sum() / len(bary), len(bary)))
    points = points.reshape(-1, 3)
    return points, weight * np.where(points[:, 2] >= 0.0, 1.0, math.sqrt(_BURIED))


def _residuals(values: np.ndarray, first: np.ndarray, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted signed distances of points to the nearest capsule; ``values`` are rows of two ends and a radius."""
    # the last terms pull weakly to the start: without them ends could move freely along a short capsule
    return np.append(weights * _nearest(values, points)[0], 1.0e-3 * (values - first))


def _jacobian(values: np.ndarray, first: np.ndarray, points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Jacobian of :func:`_residuals`: an end of an axis moves the nearest point by its share of the axis."""
    _, which, share, normal = _nearest(values, points)
    ends = np.column_stack([(share - 1.0)[:, None] * normal, -share[:, None] * normal, -np.ones(len(points))])
    slopes = np.zeros((len(points), len(values) // 7, 7))
    slopes[np.arange(len(points)), which] = weights[:, None] * ends
    return np.concatenate([slopes.reshape(len(points), -1), 1.0e-3 * np.eye(len(values))])


def _nearest(values: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """For each point: signed distance, nearest capsule, position along its axis (0 to 1), direction from there."""
    rows = values.reshape(-1, 1, 7)
    a, axis = rows[..., :3], rows[..., 3:6] - rows[..., :3]
    length = np.maximum((axis * axis).sum(axis=2), 1.0e-12)
    share = np.clip(((points - a) * axis).sum(axis=2) / length, 0.0, 1.0)
    away = points - a - share[..., None] * axis
    distance = np.sqrt(np.einsum("cpd,cpd->cp", away, away))
    which, every = np.argmin(distance - rows[..., 6], axis=0), np.arange(len(points))
    near = distance[which, every]
    normal = away[which, every] / np.maximum(near, 1.0e-12)[:, None]
    return near - values.reshape(-1, 7)[which, 6], which, share[which, every], normal


def _fit(points: np.ndarray, weights: np.ndarray, radius: float) -> list[Collider]:
    """One or two capsules whose surface fits points in the least-squares sense; two if they fit clearly better."""
    # Start: capsules along the longest horizontal extent, one in the middle or two side by side.
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    along = np.linalg.svd(flat, full_matrices=False)[2][0]
    x = np.array([along[0], along[1], 0.0])
    y = np.array([-along[1], along[0], 0.0])
    thick = half[2]
    reach = max(float(np.abs(flat @ along).max()) - thick, 0.3 * thick)
    one = [np.concatenate([middle - reach * x, middle + reach * x, [thick]])]
    pair = [
        np.concatenate(
            [middle + s * 0.4 * half[1] * y - reach * x, middle + s * 0.4 * half[1] * y + reach * x, [thick]]
        )
        for s in (-1.0, 1.0)
    ]
    best: tuple[float, np.ndarray] | None = None
    for start in (one, pair):
        first = np.concatenate(start) / radius
        solved = least_squares(_residuals, first, _jacobian, method="lm", args=(first, points / radius, weights))
        if best is None or solved.cost < 0.6 * best[0]:
            best = solved.cost, solved.x * radius
    assert best is not None
    rows = best[1].reshape(-1, 7)
    return [capsule_between(r[:3].tolist(), r[3:6].tolist(), abs(float(r[6]))) for r in rows]
