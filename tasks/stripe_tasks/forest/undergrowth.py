# SPDX-License-Identifier: Apache-2.0
"""Undergrowth: meshes of bushes, ferns, grass and blueberries, without colliders.

A generator in the same state gives the same mesh. Stems reach a little below the ground, for slopes.
"""

from __future__ import annotations

import math

import numpy as np

from stripe_newton.specifications import DynamicMesh, MeshPart

from .stones import check_positive, tinted, tube

__all__ = ["blueberry", "bush", "fern", "grass"]

_SUNK = 0.03  # depth of stems below the ground [m]
_LEAVES = (0.062, 0.115, 0.028)
_FERN = (0.085, 0.150, 0.028)
_GRASS = (0.115, 0.150, 0.045)
_STRAW = (0.250, 0.205, 0.090)
_BERRY_LEAVES = (0.055, 0.100, 0.036)
_BERRIES = (0.022, 0.026, 0.070)
_TWIGS = (0.085, 0.062, 0.042)


def bush(name: str, height: float, radius: float, rng: np.random.Generator) -> DynamicMesh:
    """A bush of several stems and a few lumps of leaves, dark inside and below, light on top.

    Args:
        name: An identifier.
        height: Of its highest leaf [m].
        radius: Largest distance of a leaf from its middle, seen from above [m].
        rng: Generator of all random numbers.

    Raises:
        ValueError: If a size is not positive.
    """
    check_positive("bush", height=height, radius=radius)
    stems, count = int(rng.integers(5, 8)), 76
    turn = 2.0 * math.pi * (np.arange(stems) + rng.uniform(-0.3, 0.3, stems)) / stems
    away = rng.uniform(0.25, 0.62, stems)
    # lumps of leaves about the ends of the stems; the first one is the top
    lumps = np.stack([away * np.cos(turn), away * np.sin(turn), rng.uniform(0.24, 0.66, stems)], axis=1)
    lumps[0] = (0.12 * np.cos(turn[0]), 0.12 * np.sin(turn[0]), 0.74)
    wide = rng.uniform(0.30, 0.44, stems)
    of = np.arange(count) % stems
    out = _sphere(count, rng)
    out[:, 2] = np.where(out[:, 2] < -0.45, -out[:, 2], out[:, 2])
    at = lumps[of] + out * (wide[of] * rng.uniform(0.55, 1.0, count))[:, None]
    at[:, 2] = np.clip(at[:, 2], 0.10, None)
    heading = out * (1.0, 1.0, 0.5) + 0.35 * _sphere(count, rng) + (0.0, 0.0, -0.15)
    upward = 0.7 * out + 0.4 * _sphere(count, rng) + (0.0, 0.0, 0.75)
    at *= (radius, radius, height)
    size = rng.uniform(0.24, 0.36, count) * math.sqrt(radius * height)
    vertices, faces = _leaves(at - 0.4 * size[:, None] * _unit(heading), heading, upward, size, 0.62 * size)
    # three tones, dark inside and below, light on top: shading that single leaves do not cast
    light = 0.9 * out[:, 2] + 0.8 * (at[:, 2] / height - 0.5) + rng.normal(0.0, 0.25, count)
    tone = np.digitize(light, np.quantile(light, (0.36, 0.76)))
    green = np.array(tinted(_LEAVES, rng))
    parts = [
        _part(f"leaves_{i}", vertices, faces[np.repeat(tone == i, 2)], tuple(green * factor))
        for i, factor in enumerate((0.52, 1.0, 1.55))
    ]
    lines = []
    for tip, start in zip(lumps * (radius, radius, height), turn, strict=True):
        foot = np.array([0.10 * radius * math.cos(start), 0.10 * radius * math.sin(start), 0.0])
        knee = foot + (tip - foot) * (0.35, 0.35, 0.55)
        lines.append(np.stack([foot, 0.6 * knee + 0.4 * tip]))
    thick = 0.022 * math.sqrt(radius * height)
    parts.append(_stems(lines, thick, tinted(_TWIGS, rng)))
    return DynamicMesh(name, _fitted(parts, radius, height), (), "bush", float(radius))


def blueberry(name: str, height: float, radius: float, rng: np.random.Generator) -> DynamicMesh:
    """A low cushion of thin upright twigs with many small leaves and a few dark berries; arguments as of a bush."""
    check_positive("blueberry", height=height, radius=radius)
    twigs, each = 13, 6
    away = np.sqrt((np.arange(twigs) + 0.5) / twigs) * 0.72
    turn = np.arange(twigs) * math.pi * (3.0 - math.sqrt(5.0)) + rng.uniform(-0.4, 0.4, twigs)
    foot = np.stack([away * np.cos(turn), away * np.sin(turn), 0.0 * away], axis=1) * radius
    tall = height * (1.0 - 0.45 * away**2) * rng.uniform(0.75, 1.0, twigs)
    tip = foot * rng.uniform(1.05, 1.3, (twigs, 1)) + rng.normal(0.0, 0.05 * radius, (twigs, 3)) * (1.0, 1.0, 0.0)
    tip[:, 2] = 0.86 * tall
    # leaves along the upper three quarters of each twig
    share = np.linspace(0.24, 1.0, each)[None, :, None] + rng.uniform(-0.05, 0.0, (twigs, each, 1))
    at = (foot[:, None] + share * (tip - foot)[:, None]).reshape(-1, 3)
    side = 2.0 * math.pi * rng.random(len(at))
    heading = np.stack([np.cos(side), np.sin(side), rng.uniform(-0.1, 0.9, len(at))], axis=1)
    size = rng.uniform(0.75, 1.2, len(at)) * 0.30 * math.sqrt(height * radius)
    upward = 0.5 * _sphere(len(at), rng) + (0.0, 0.0, 1.0)
    vertices, faces = _leaves(at, heading, upward, size, 0.6 * size)
    tone = (rng.random(len(at)) + at[:, 2] / height > 1.05).astype(int)
    green = np.array(tinted(_BERRY_LEAVES, rng))
    parts = [
        _part(f"leaves_{i}", vertices, faces[np.repeat(tone == i, 2)], tuple(green * factor))
        for i, factor in enumerate((0.75, 1.4))
    ]
    parts.append(
        _stems([np.stack([a, b]) for a, b in zip(foot, tip, strict=True)], 0.013 * radius, tinted(_TWIGS, rng))
    )
    ripe = at[rng.choice(len(at), 5, replace=False)] + (0.0, 0.0, 0.03 * height)
    cube = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]) * 0.045 * height
    eight = np.array([(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)])
    balls = (ripe[:, None] + cube[None]).reshape(-1, 3)
    parts.append(MeshPart("berries", balls, (eight[None] + 6 * np.arange(5)[:, None, None]).reshape(-1, 3), _BERRIES))
    return DynamicMesh(name, _fitted(parts, radius, height), (), "bush", float(radius))


def fern(name: str, radius: float, rng: np.random.Generator) -> DynamicMesh:
    """A fern: fronds that rise from one place and arch outwards, each with two rows of leaflets.

    Args:
        name: An identifier.
        radius: Largest distance of a tip from its middle, seen from above [m].
        rng: Generator of all random numbers.

    Raises:
        ValueError: If the radius is not positive.
    """
    check_positive("fern", radius=radius)
    fronds = int(rng.choice([6, 7, 8, 9], p=[0.4, 0.3, 0.2, 0.1]))
    pairs = 74 // fronds
    turn = 2.0 * math.pi * (np.arange(fronds) + rng.uniform(-0.3, 0.3, fronds)) / fronds
    all_vertices: list[np.ndarray] = []
    all_faces: list[np.ndarray] = []
    tones: list[np.ndarray] = []
    for k in range(fronds):
        long = rng.uniform(0.82, 1.0)
        rise = rng.uniform(0.9, 1.35)
        share = np.linspace(0.0, 1.0, pairs + 1)
        # outwards and up: steep at the foot, highest at two thirds, hanging at the tip
        line = np.stack([long * share**1.35, 0.10 * np.sin(3.0 * share) * rng.uniform(-1.0, 1.0), 0.0 * share], axis=1)
        line[:, 2] = rise * (1.75 * share - 1.35 * share**2) * 0.9
        ahead = _unit(np.gradient(line, axis=0))
        side = _unit(np.cross(ahead, (0.0, 0.0, 1.0)))
        over = np.cross(side, ahead)
        middle = 0.5 * (share[1:] + share[:-1])
        # leaflets are longest at two fifths of the frond and taper to its tip
        reach = (
            0.30 * long * np.clip((middle - 0.10) / 0.30, 0.02, 1.0) * np.clip((1.08 - middle) / 0.68, 0.0, 1.0) ** 0.9
        )
        points, leaflets = [line], []
        for s, sign in enumerate((1.0, -1.0)):
            lean = sign * side[:-1] + 0.42 * ahead[:-1] - 0.14 * over[:-1] + 0.05 * _sphere(pairs, rng)
            base = 0.5 * (line[1:] + line[:-1])
            points.append(base + _unit(lean) * (reach * rng.uniform(0.9, 1.1, pairs))[:, None])
            i = np.arange(pairs)
            tip = pairs + 1 + s * pairs + i
            leaflets.append(np.stack([i, tip, i + 1] if sign > 0 else [i, i + 1, tip], axis=1))
        cos, sin = math.cos(turn[k]), math.sin(turn[k])
        spun = np.concatenate(points) @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        all_faces.append(np.concatenate(leaflets) + sum(len(v) for v in all_vertices))
        all_vertices.append(spun + (0.0, 0.0, -_SUNK / radius))
        tones.append(np.full(2 * pairs, k % 2))
    vertices, faces, tone = np.concatenate(all_vertices) * radius, np.concatenate(all_faces), np.concatenate(tones)
    green = np.array(tinted(_FERN, rng, 0.25))
    parts = [_part(f"fronds_{i}", vertices, faces[tone == i], tuple(green * f)) for i, f in enumerate((1.15, 0.8))]
    return DynamicMesh(name, _fitted(parts, radius), (), "fern", float(radius))


def grass(name: str, radius: float, height: float, rng: np.random.Generator) -> DynamicMesh:
    """A tuft of grass: narrow blades that bend outwards, some of them dry.

    Args:
        name: An identifier.
        radius: Largest distance of a tip from its middle, seen from above [m].
        height: Of its highest blade [m].
        rng: Generator of all random numbers.

    Raises:
        ValueError: If a size is not positive.
    """
    check_positive("grass", radius=radius, height=height)
    blades = int(rng.integers(16, 31))
    turn = np.arange(blades) * math.pi * (3.0 - math.sqrt(5.0)) + rng.uniform(-0.5, 0.5, blades)
    away = rng.uniform(0.2, 1.0, blades) ** 0.8
    tall = rng.uniform(0.55, 1.0, blades) * (1.15 - 0.45 * away)
    out = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    twist = turn + rng.uniform(-0.5, 0.5, blades)
    side = np.stack([-np.sin(twist), np.cos(twist), 0.0 * turn], axis=1)
    foot = out * (0.22 * radius * rng.random(blades))[:, None]
    half = 0.5 * np.clip(0.022 * height + 0.012 * radius, 0.0, 0.012) * rng.uniform(0.7, 1.3, blades)
    share = np.array([0.0, 0.45, 0.78, 1.0])
    # a blade rises steeply and bends outwards with the power of its length
    bend = rng.uniform(1.6, 2.4, blades)
    droop = 0.32 * away**2
    rows = []
    for s, wide in zip(share, (0.8, 1.0, 0.75, 0.0), strict=True):
        middle = foot + out * (radius * away * s**bend)[:, None]
        middle[:, 2] = height * tall * (s - droop * s**4) if s > 0.0 else -_SUNK
        rows += [middle - side * (half * wide)[:, None], middle + side * (half * wide)[:, None]][: 2 if wide else 1]
    vertices = np.stack(rows, axis=1)  # (blades, 7, 3)
    blade = np.array([(0, 1, 3), (0, 3, 2), (2, 3, 5), (2, 5, 4), (4, 5, 6)])
    faces = (blade[None] + 7 * np.arange(blades)[:, None, None]).reshape(-1, 3)
    dry = rng.random(blades) < rng.uniform(0.1, 0.4)
    dry[:2] = True, False
    tone = np.repeat(dry.astype(int), len(blade))
    colors = tinted(_GRASS, rng, 0.25), tinted(_STRAW, rng)
    parts = [
        _part(name_, vertices.reshape(-1, 3), faces[tone == i], colors[i])
        for i, name_ in enumerate(("blades", "straw"))
    ]
    return DynamicMesh(name, _fitted(parts, radius, height), (), "grass", float(radius))


def _leaves(
    at: np.ndarray, heading: np.ndarray, upward: np.ndarray, length: np.ndarray, width: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Leaves of two triangles, folded along the middle; they start ``at`` and face ``upward``, all ``(N, 3)``."""
    ahead = _unit(heading)
    side = _unit(np.cross(ahead, upward))
    over = np.cross(side, ahead)
    belly = at + ahead * (0.45 * length)[:, None] + over * (0.16 * width)[:, None]
    edge = side * (0.5 * width)[:, None]
    tip = at + ahead * length[:, None] - over * (0.10 * length)[:, None]
    vertices = np.stack([at, belly + edge, tip, belly - edge], axis=1).reshape(-1, 3)
    faces = np.array([(0, 1, 2), (0, 2, 3)])[None] + 4 * np.arange(len(at))[:, None, None]
    return vertices, faces.reshape(-1, 3)


def _stems(lines: list[np.ndarray], thick: float, color: tuple[float, float, float]) -> MeshPart:
    """Three-sided stems along lines ``(2, 3)`` that start on the ground."""
    vertices, faces = [], []
    for index, line in enumerate(lines):
        line = line - [[0.0, 0.0, _SUNK], [0.0, 0.0, 0.0]]
        points, walls = tube(line, np.array([thick, 0.45 * thick]), 3, closed=False)
        vertices.append(points)
        faces.append(walls + 6 * index)
    return MeshPart("stems", np.concatenate(vertices), np.concatenate(faces), color)


def _part(name: str, vertices: np.ndarray, faces: np.ndarray, color: tuple[float, ...]) -> MeshPart:
    """Part of some faces with the vertices that they use; visible from both sides, as leaves are."""
    used, where = np.unique(faces, return_inverse=True)
    red, green, blue = (float(min(c, 1.0)) for c in color)
    return MeshPart(name, vertices[used], where.reshape(-1, 3), (red, green, blue), double_sided=True)


def _fitted(parts: list[MeshPart], radius: float, height: float | None = None) -> list[MeshPart]:
    """Parts scaled to a radius around the z axis and to a height; what is below the ground keeps its depth."""
    points = np.concatenate([p.vertices for p in parts]).astype(np.float64)
    wide = radius / np.hypot(points[:, 0], points[:, 1]).max()
    tall = wide if height is None else height / points[:, 2].max()
    fitted = []
    for p in parts:
        scaled = p.vertices * np.where(p.vertices[:, 2:] > 0.0, (wide, wide, tall), (wide, wide, 1.0))
        fitted.append(MeshPart(p.name, scaled, p.faces, p.color, p.roughness, p.double_sided))
    return fitted


def _sphere(count: int, rng: np.random.Generator) -> np.ndarray:
    """Directions, uniform on the sphere, ``(count, 3)``."""
    return _unit(rng.standard_normal((count, 3)))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
