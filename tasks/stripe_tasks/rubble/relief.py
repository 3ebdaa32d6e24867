# SPDX-License-Identifier: Apache-2.0
"""Relief of the rubble: streets, blocks of buildings between them, and heaps where those stood."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from stripe_newton.specifications import TerrainInstance

__all__ = ["REPOSE", "Building", "RubbleTerrain", "blocks", "colors", "heap_up", "repose", "roughen", "street_map"]

REPOSE = math.radians(36.0)
"""Angle of repose of broken masonry: the steepest slope of a heap [rad]."""
# linear RGB
_DUST, _SOIL = np.array([0.33, 0.31, 0.275]), np.array([0.17, 0.13, 0.09])
_BRICK, _ASPHALT = np.array([0.30, 0.165, 0.11]), np.array([0.105, 0.105, 0.11])


@dataclass(frozen=True)
class Building:
    """Ground plan of a building that stood there.

    Attributes:
        middle: Middle of its floor [m].
        yaw: Direction of its longer axis [rad].
        half: Half extents along its axes [m].
    """

    middle: tuple[float, float]
    yaw: float
    half: tuple[float, float]

    def local(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of the world in the frame of the building [m]."""
        dx, dy = x - self.middle[0], y - self.middle[1]
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return cos * dx + sin * dy, cos * dy - sin * dx

    def world(self, u: float, v: float) -> tuple[float, float]:
        """Point of the building's frame in the world [m]."""
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        return self.middle[0] + cos * u - sin * v, self.middle[1] + sin * u + cos * v

    def depth(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Depth of points inside the walls, negative outside [m]."""
        u, v = self.local(x, y)
        return np.asarray(np.minimum(self.half[0] - np.abs(u), self.half[1] - np.abs(v)))


@dataclass(eq=False)
class RubbleTerrain(TerrainInstance):
    """Terrain that knows where buildings stood.

    Attributes:
        buildings: All buildings.
    """

    buildings: list[Building] = field(default_factory=list)


def blocks(
    size: tuple[float, float], rng: np.random.Generator, street: float = 4.5, block: float = 15.0
) -> list[Building]:
    """Buildings along straight streets that cross near the middle.

    Args:
        size: Extent of the field [m].
        rng: Generator of all random numbers.
        street: Width of a street [m].
        block: Approximate length of a building's shorter side [m].
    """
    yaw, reach = rng.uniform(-0.22, 0.22), 0.5 * math.hypot(*size) + block
    sides = []
    for _ in range(2):  # edges of the blocks along an axis of the town, outwards from the street in the middle
        shift, spans = rng.uniform(-0.12, 0.12) * min(size), []
        for sign in (-1.0, 1.0):
            at = 0.5 * street
            while at < reach:
                long = block * rng.uniform(0.85, 1.3)
                spans.append((shift + sign * (at + 0.5 * long), 0.5 * long))
                at += long + street * rng.uniform(0.8, 1.2)
        sides.append(spans)
    cos, sin = math.cos(yaw), math.sin(yaw)
    found = []
    for u, half_u in sides[0]:
        for v, half_v in sides[1]:
            middle = cos * u - sin * v, sin * u + cos * v
            # blocks that reach into the field; a little smaller than their block, so that pavements are left
            near = [abs(m) - half_u - half_v < 0.5 * s for m, s in zip(middle, size, strict=True)]
            inset = rng.uniform(0.3, 1.2, 2)
            if all(near):
                found.append(Building(middle, yaw, (half_u - inset[0], half_v - inset[1])))
    return found


def street_map(x: np.ndarray, y: np.ndarray, buildings: list[Building], margin: float = 1.2) -> np.ndarray:
    """Map of streets: 1 on a street, 0 where buildings stood, in between over a margin outside their walls [m]."""
    inside = np.full(np.shape(x), -np.inf)
    for building in buildings:
        inside = np.maximum(inside, building.depth(x, y))
    return np.asarray(np.clip(-inside / margin, 0.0, 1.0))


def heap_up(
    x: np.ndarray, y: np.ndarray, buildings: list[Building], height: float, rng: np.random.Generator
) -> np.ndarray:
    """Heights of heaps and craters [m], nowhere steeper than :data:`REPOSE`.

    A fallen building is a mound about as wide as it was, with piles on it. Craters with rims are everywhere, in the
    streets too.

    Args:
        x: World x of the columns [m], ``(ncol,)``.
        y: World y of the rows [m], ``(nrow,)``.
        buildings: Ground plans of the buildings.
        height: Approximate height of the heaps [m].
        rng: Generator of all random numbers.
    """
    heights = np.zeros((len(y), len(x)))
    steep, cell = math.tan(REPOSE), float(x[1] - x[0])
    ragged = 1.1 * _noise(heights.shape, 1.3 / cell, rng)
    for building in buildings:
        depth = building.depth(*np.meshgrid(x, y)) + ragged
        heights += height * rng.uniform(0.2, 0.36) * (1.0 - np.exp(-np.clip(depth + 0.3, 0.0, None) / 1.6))
        # piles in proportion to the area of the floor, about as steep as the angle of repose
        for _ in range(round(building.half[0] * building.half[1] / 3.6)):
            u, v = (rng.uniform(-0.9, 0.9) * h for h in building.half)
            peak = height * rng.uniform(0.15, 0.6)
            _add(heights, x, y, building.world(u, v), _pile, peak, 1.15 * peak / steep, rng)
    area = (x[-1] - x[0]) * (y[-1] - y[0])
    for _ in range(round(area / 700.0)):
        at = rng.uniform(0.9 * x[0], 0.9 * x[-1]), rng.uniform(0.9 * y[0], 0.9 * y[-1])
        _add(heights, x, y, at, _crater, rng.uniform(0.5, 0.9), rng.uniform(1.4, 2.2), rng)
    return repose(heights, (x[1] - x[0], y[1] - y[0]))


def _noise(shape: tuple[int, ...], width: float, rng: np.random.Generator) -> np.ndarray:
    """Smooth noise of variance 1, with features of a width in cells."""
    noise = ndimage.gaussian_filter(rng.standard_normal(shape), width, mode="wrap")
    return np.asarray(noise / max(float(noise.std()), 1.0e-9))


def _add(
    heights: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    at: tuple[float, float],
    shape: Callable[[np.ndarray], np.ndarray],
    size: float,
    radius: float,
    rng: np.random.Generator,
) -> None:
    """Add a shape of a size and radius [m] to the heights around a place, with a wavy outline."""
    phase, waves = rng.uniform(0.0, 2.0 * math.pi, 2), rng.uniform(0.05, 0.18, 2)
    cols = slice(*np.searchsorted(x, (at[0] - 2.2 * radius, at[0] + 2.2 * radius)))
    rows = slice(*np.searchsorted(y, (at[1] - 2.2 * radius, at[1] + 2.2 * radius)))
    dx, dy = np.meshgrid(x[cols] - at[0], y[rows] - at[1])
    turn = np.arctan2(dy, dx)
    wavy = 1.0 + waves[0] * np.sin(2.0 * turn + phase[0]) + waves[1] * np.sin(3.0 * turn + phase[1])
    heights[rows, cols] += size * shape(np.hypot(dx, dy) / (radius * wavy))


def _pile(share: np.ndarray) -> np.ndarray:
    """Cone with a rounded top."""
    return np.asarray(np.clip(1.08 - np.sqrt(share * share + 0.08**2), 0.0, None))


def _crater(share: np.ndarray) -> np.ndarray:
    """Bowl of depth 1 and radius 1 with a rim."""
    bowl = np.minimum(share * share - 1.0, 0.0)
    return np.asarray(bowl + 0.28 * np.exp(-(((share - 1.05) / 0.28) ** 2)))


def repose(heights: np.ndarray, cell: tuple[float, float], angle: float = REPOSE) -> np.ndarray:
    """Highest surface below ``heights`` with at most a given slope along rows, columns and diagonals.

    Args:
        heights: Shape ``(nrow, ncol)`` [m].
        cell: Spacing in x and y [m].
        angle: Steepest slope [rad].
    """
    steep = math.tan(angle)
    near = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    rise = np.array([math.hypot(i * cell[1], j * cell[0]) * steep for i, j in near])
    low = np.pad(np.asarray(heights, dtype=float), 1, mode="edge")
    # Each round carries the limit on by one cell; no path to a low place is longer than the field is wide and high.
    for _ in range(sum(low.shape)):
        inner = low[1:-1, 1:-1]
        before = inner.copy()
        for (i, j), up in zip(near, rise, strict=True):
            other = low[1 + i : low.shape[0] - 1 + i, 1 + j : low.shape[1] - 1 + j]
            np.minimum(inner, other + up, out=inner)
        low = np.pad(inner, 1, mode="edge")
        if np.abs(low[1:-1, 1:-1] - before).max() < 1.0e-6:
            break
    return low[1:-1, 1:-1].copy()


def roughen(heights: np.ndarray, street: np.ndarray, cell: float, rough: float, rng: np.random.Generator) -> np.ndarray:
    """Add lumps of a few sizes to the heights, on the heaps more than on the streets [m]."""
    lumps = np.zeros_like(heights)
    for width, high in ((1.1, 1.0), (0.35, 0.55)):
        lumps += high * _noise(heights.shape, width / cell, rng)
    return heights + rough * (1.0 - 0.8 * street) * lumps


def colors(heights: np.ndarray, street: np.ndarray, cell: float, height: float, rng: np.random.Generator) -> np.ndarray:
    """Linear RGB of the ground, float32 ``(nrow, ncol, 3)``: asphalt under dust, grey rubble, brick in places."""

    def patches(width: float) -> np.ndarray:
        return _noise(heights.shape, width / cell, rng)

    def blend(share: np.ndarray, color: np.ndarray) -> None:
        ground[:] += np.clip(share, 0.0, 1.0)[..., None] * (color - ground)

    ground = np.broadcast_to(_DUST, (*heights.shape, 3)).copy()
    blend(0.55 * np.clip(patches(1.6) - 0.2, 0.0, 1.0), _BRICK)
    blend(0.45 * np.clip(patches(0.5) - 0.5, 0.0, 1.0), 0.55 * _DUST)
    blend(street * np.clip(0.72 - 0.3 * patches(1.2) - 0.2 * patches(0.3), 0.15, 1.0), _ASPHALT)
    blend(np.clip(-heights / 0.35 - 0.2, 0.0, 0.9), _SOIL)
    ground *= (1.0 + 0.10 * patches(0.3) + 0.06 * rng.standard_normal(heights.shape))[..., None]
    ground *= np.clip(0.86 + 0.22 * heights / max(height, 0.1), 0.8, 1.1)[..., None]  # dust lies on top
    return np.clip(ground, 0.01, 1.0).astype(np.float32)
