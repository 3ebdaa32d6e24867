# SPDX-License-Identifier: Apache-2.0
"""Masonry pieces: walls, bricks, pipes and chips."""

from __future__ import annotations

import math

import numpy as np

from stripe_newton.specifications import Collider, MeshPart

from .making import BRICKS, CONCRETE, MORTAR, PIPES, PLASTER, piece, shades
from .rafts import raft, upright
from .resting import Piece
from .shapes import boxes, toned, tube

__all__ = ["brick", "debris", "pipe", "wall"]


def brick(name: str, courses: tuple[int, ...], rng: np.random.Generator) -> Piece:
    """Bricks along x that still hold together, ``courses`` in each layer; their middle is the origin."""
    size, gap = np.array([0.24, 0.115, 0.071]), 0.01
    spots = []
    for level, many in enumerate(courses):
        shift = 0.5 * (size[0] + gap) * (level % 2) + rng.integers(0, 2) * 0.0
        for k in range(many):
            spots.append(((k - 0.5 * (max(courses) - 1)) * (size[0] + gap) + shift, 0.0, level * (size[2] + gap)))
    middle = np.array(spots)
    middle -= 0.5 * (middle.min(axis=0) + middle.max(axis=0))
    surface = boxes(middle, np.broadcast_to(0.5 * size, middle.shape), rng, 0.006)
    tone = np.repeat(rng.integers(0, 4, len(middle)), 12)
    parts = toned("brick", surface, tone, BRICKS)
    if len(middle) > 1:
        parts.append(
            MeshPart(
                "mortar", *boxes(middle, np.broadcast_to(0.5 * size + 0.004, middle.shape) * (1, 0.9, 1), rng), MORTAR
            )
        )
    reach = np.abs(surface[0]).max(axis=0)
    radius = float(min(reach[1], reach[2]))
    lift = float(reach[2]) - radius
    touched = raft(float(reach[0]), radius, 2.0 * radius)
    if lift > 0.0:  # higher than wide: one above the other
        touched = tuple(Collider(c.kind, c.size, (*c.pos[:2], z), c.rot) for c in touched for z in (-lift, lift))
    return piece(name, "brick", parts, touched)


def pipe(name: str, length: float, radius: float, rng: np.random.Generator) -> Piece:
    """Pipe along x, open at its ends; its middle is the origin."""
    surface = tube(radius, 0.86 * radius, length)
    colors = shades(PIPES[int(rng.integers(3))], rng, (1.0, 0.6))
    inner = np.arange(len(surface[1])) // 28 >= 2
    parts = toned("pipe", surface, inner.astype(int), colors, 0.6)
    half = max(0.5 * length - radius, 1.0e-4)
    quarter = math.sqrt(0.5)
    return piece(name, "pipe", parts, (Collider("capsule", (radius, half), rot=(0.0, quarter, 0.0, quarter)),))


def wall(name: str, length: float, height: float, rng: np.random.Generator) -> Piece:
    """Standing rest of a brick wall along x, with a window in each storey.

    The origin is on the ground, 0.45 m above its foot.

    Args:
        name: An identifier.
        length: Length [m].
        height: Height of its highest point [m].
        rng: Generator of all random numbers.
    """
    thick, step_x, step_z, deep = 0.26, 0.29, 0.115, 0.45
    x = np.arange(-0.5 * length, 0.5 * length, 0.05)
    # outline of the top: falls to one end, with steps of a few bricks
    walk = np.interp(x, np.linspace(x[0], x[-1], 8), rng.uniform(-0.22, 0.22, 8))
    fall = rng.choice([-1.0, 1.0]) * 2.0 * x / length  # it is highest at one end
    top = np.clip(height * (1.0 - 0.75 * np.clip(fall - 0.1, 0.0, None) ** 1.5) + walk - 0.2, 0.35, height)
    window = -0.14 * length * np.sign(fall[-1])
    storeys = [(z, z + 1.15) for z in (0.85, 3.35) if z + 0.6 < height]
    spots = []
    for level in range(int((height + deep) / step_z)):
        z = -deep + (level + 0.5) * step_z
        for mid in np.arange(-0.5 * length + 0.5 * step_x * (level % 2), 0.5 * length, step_x) + 0.5 * step_x:
            opening = abs(mid - window) < 0.5 and any(low < z < high for low, high in storeys)
            if z < np.interp(mid, x, top) + 0.12 * rng.standard_normal() and not opening:
                spots.append((mid, 0.0, z))
    middle = np.array(spots)
    half = np.broadcast_to([0.5 * step_x - 0.006, 0.5 * thick, 0.5 * step_z - 0.006], middle.shape)
    middle = middle + rng.normal(0.0, 1.0, middle.shape) * (0.002, 0.006, 0.001)
    surface = boxes(middle, half, rng, 0.004)
    # plaster is left in patches
    wave = sum(np.sin(middle @ rng.normal(0.0, 1.6, 3) + rng.uniform(0, 6.3)) for _ in range(4))
    plastered = wave + 0.3 * rng.standard_normal(len(middle)) > 0.4
    parts = toned("brick", surface, np.repeat(rng.integers(0, 4, len(middle)), 12), BRICKS)
    parts.append(MeshPart("mortar", *boxes(middle, half + [0.007, -0.012, 0.007], rng), MORTAR))
    if plastered.any():
        at, size = middle[plastered] + (0.0, 0.012, 0.0), half[plastered] + (0.008, 0.004, 0.008)
        parts.append(MeshPart("plaster", *boxes(at, size, rng), PLASTER))
    sills = np.array([(window, 0.0, low - 0.02) for low, _ in storeys])
    parts.append(MeshPart("sill", *boxes(sills, np.array([[0.62, 0.19, 0.04]]), rng, 0.01), CONCRETE))
    return piece(name, "wall", parts, _wall_colliders(length, thick, -deep, (x, top), window, storeys))


def _wall_colliders(
    length: float,
    thick: float,
    foot: float,
    outline: tuple[np.ndarray, np.ndarray],
    window: float,
    storeys: list[tuple[float, float]],
) -> tuple[Collider, ...]:
    """Upright capsules side by side, from the foot to the outline; none in the windows, between sill and lintel."""
    radius = 0.5 * thick
    count = math.ceil((length - thick) / (1.7 * radius)) + 1
    found = []
    for x in np.linspace(-0.5 * length + radius, 0.5 * length - radius, count):
        high, floor = float(np.interp(x, *outline)), foot
        openings = storeys if abs(x - window) < 0.54 else []
        for sill, lintel in [*openings, (np.inf, np.inf)]:
            if min(high, sill) > floor + thick:
                found.append(upright(x, floor, min(high, sill), radius))
            floor = lintel
    return tuple(found)


def debris(name: str, reach: float, rng: np.random.Generator) -> Piece:
    """Chips on the ground within a distance of the origin, too small for colliders."""
    count = 60
    away, turn = reach * np.sqrt(rng.random(count)), rng.uniform(0.0, 2.0 * math.pi, count)
    size = 0.012 + 0.04 * rng.random(count) ** 2.5
    middle = np.column_stack([away * np.cos(turn), away * np.sin(turn), 0.1 * size])
    corners, faces = boxes(0.0 * middle, size[:, None] * rng.uniform(0.45, 1.0, (count, 3)), rng)
    # pairs of corners by the same factor: chips that are no longer boxes
    corners *= np.repeat(rng.uniform(0.6, 1.1, (count * 4, 1)), 2, axis=0)
    angle = np.repeat(rng.uniform(0.0, 6.3, (count, 3)), 8, axis=0)
    for k in range(3):  # turned about each axis
        a, b = np.cos(angle[:, k]), np.sin(angle[:, k])
        u, v = corners[:, (k + 1) % 3].copy(), corners[:, (k + 2) % 3].copy()
        corners[:, (k + 1) % 3], corners[:, (k + 2) % 3] = a * u - b * v, b * u + a * v
    corners += np.repeat(middle, 8, axis=0)
    tones = [*shades(CONCRETE, rng, (0.92,)), BRICKS[int(rng.integers(3))]]
    tone = np.repeat((rng.random(count) < rng.uniform(0.1, 0.5)).astype(int), 12)
    return piece(name, "debris", toned("chip", (corners, faces), tone, tones), ())
