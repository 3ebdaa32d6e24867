# SPDX-License-Identifier: Apache-2.0
"""Places for robots in a scene: on ground that is not too steep, clear of colliders, and all connected."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

from .asset_instance import AssetInstance
from .asset_mesh import Collider
from .terrain_instance import TerrainInstance

__all__ = ["Places", "add_places", "footprints", "walkable"]

SPACING = 0.25
"""Spacing of the grid on which places are searched [m]."""
LARGEST = 4096
"""Most grid cells along a side; a larger scene gets a coarser grid."""


@dataclass(frozen=True)
class Places:
    """Places to find on each tile of a scene after all assets are placed.

    Attributes:
        count: Number of places. Some may be close together, as robots of different environments never meet.
        radius: Radius of the space around a place that is free of colliders [m].
        max_slope: Steepest slope of the ground in that space [rad].
        margin: Distance from the edge of the tile [m].
    """

    count: int = 256
    radius: float = 0.6
    max_slope: float = math.radians(25.0)
    margin: float = 2.0

    def __post_init__(self) -> None:
        if self.count != int(self.count) or self.count < 1:
            raise ValueError(f"Places.count is {self.count}: must be a whole number, 1 or more")
        if not 0.0 < self.radius < math.inf:
            raise ValueError(f"Places.radius is {self.radius}: must be above 0 [m]")
        if not 0.0 < self.max_slope < 0.5 * math.pi:
            raise ValueError(f"Places.max_slope is {self.max_slope}: must be in (0, pi / 2) [rad]")
        if not 0.0 <= self.margin < math.inf:
            raise ValueError(f"Places.margin is {self.margin}: must be 0 or more [m]")


def footprints(terrain: TerrainInstance) -> np.ndarray:
    """Circles on the ground that cover all colliders, ``(N, 3)``: x, y, radius [m]. Long ones are rows of circles."""
    by_mesh: dict[int, list[AssetInstance]] = {}
    for placed in terrain.placed.values():
        for instance in placed:
            by_mesh.setdefault(id(instance.mesh), []).append(instance)
    found = [np.zeros((0, 3))]
    for instances in by_mesh.values():
        pos = np.array([i.position for i in instances])
        scale = np.array([i.scale for i in instances])[:, None]
        # The first two rows of a rotation: its projection onto the ground.
        onto = Rotation.from_quat([i.rotation for i in instances]).as_matrix()[:, :2]
        for collider in instances[0].mesh.colliders():
            points, radius, apart = _balls(collider)
            turn = Rotation.from_quat(collider.rot)
            at = pos[:, None, :2] + scale[:, None] * ((collider.pos + turn.apply(points)) @ onto.transpose(0, 2, 1))
            across = np.linalg.norm(onto @ turn.apply(apart), axis=1)
            # Wide enough to cover what lies between the circles of a row, too.
            wide = scale * np.hypot(radius, 0.5 * across)[:, None]
            found.append(np.dstack([at, np.broadcast_to(wide[:, None], (*at.shape[:2], 1))]).reshape(-1, 3))
    return np.concatenate(found)


def _balls(collider: Collider) -> tuple[np.ndarray, float, np.ndarray]:
    """Balls that fill a collider, in its frame: centres ``(K, 3)``, radius, and offset between neighbours [m]."""
    size = collider.size
    if collider.kind == "box":
        # A grid of balls with one layer along the shortest side; each covers the corners of its cell.
        order = np.argsort(size)
        reach = max(size[order[0]], 0.5 * SPACING)
        counts = np.ceil(np.array(size) / reach).astype(int)
        counts[order[0]] = 1
        cell = np.array(size) / counts
        rows = [(2 * np.arange(n) - n + 1) * half for n, half in zip(counts, cell, strict=True)]
        return np.stack(np.meshgrid(*rows), axis=-1).reshape(-1, 3), float(np.linalg.norm(cell)), np.zeros(3)
    half, radius = (0.0, size[0]) if len(size) == 1 else (size[1], size[0])
    steps = np.linspace(-half, half, 1 + 2 * math.ceil(half / max(radius, SPACING)))
    axis = np.array([0.0, 0.0, 1.0])
    return steps[:, None] * axis, radius, axis * (2.0 * half / max(len(steps) - 1, 1))


def walkable(terrain: TerrainInstance, radius: float, max_slope: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find out where a robot of some radius can stand.

    Args:
        terrain: Ground with the assets on it.
        radius: Radius of the space that the robot needs [m].
        max_slope: Steepest slope of the plane that fits the ground best in that space, approximately [rad].

    Returns:
        Whether it can stand at a point of the grid, bool ``(nrow, ncol)``, and x ``(ncol,)`` and y ``(nrow,)`` of the
        grid [m].
    """
    ground = terrain.ground
    shape = [max(3, min(round(s / SPACING), LARGEST) + 1) for s in ground.size]
    x, y = (np.linspace(low, low + s, n) for low, s, n in zip(ground.lower, ground.size, shape))
    cell = np.array([x[1] - x[0], y[1] - y[0]])
    heights = ground.height_at(*np.meshgrid(x, y))
    # The gradient of heights smoothed with this width is about the slope of the plane that fits a disc of that radius.
    smooth = ndimage.gaussian_filter(heights, radius / math.sqrt(6.0) / cell[::-1], mode="nearest")
    along_y, along_x = np.gradient(smooth, cell[1], cell[0])
    level = np.hypot(along_x, along_y) <= math.tan(max_slope)
    taken = np.zeros(heights.shape, dtype=bool)
    circles = footprints(terrain)
    circles[:, 2] += radius
    reach = np.ceil(circles[:, 2] / cell.min() + 0.5).astype(int)
    # A loop over the offsets that a circle can reach, each for all circles of that size at once.
    for span in np.unique(reach):
        few = circles[reach == span]
        col, row = np.rint((few[:, 0] - x[0]) / cell[0]), np.rint((few[:, 1] - y[0]) / cell[1])
        for i in range(-span, span + 1):
            for j in range(-span, span + 1):
                c, r = (col + j).astype(int), (row + i).astype(int)
                inside = (c >= 0) & (c < len(x)) & (r >= 0) & (r < len(y))
                away = np.hypot(x[0] + c * cell[0] - few[:, 0], y[0] + r * cell[1] - few[:, 1])
                hit = inside & (away <= few[:, 2])
                taken[r[hit], c[hit]] = True
    return level & ~taken, x, y


def add_places(terrain: TerrainInstance, wanted: Mapping[str, Places], rng: np.random.Generator) -> None:
    """Find places on every tile and store them as flat patches of the ground, for terms that start robots there.

    All places of a tile are connected: they lie in its largest walkable part. A ground without tiles becomes one tile.
    The origins of tiles and terrain move to the nearest place of ``init_pos``.

    Raises:
        ValueError: if a tile has no such place.
    """
    ground = terrain.ground
    if ground.origins is None:
        ground.origins, ground.tile = np.array(terrain.origin).reshape(1, 1, 3), ground.size
    origins = np.array(ground.origins, dtype=float)
    levels, types = origins.shape[:2]
    seed = int(rng.integers(1 << 63))
    for name, places in wanted.items():
        free, x, y = walkable(terrain, places.radius, places.max_slope)
        found = np.zeros((levels, types, places.count, 3))
        for level, kind in np.ndindex(levels, types):
            low, high = tile_bounds(terrain, level, kind)
            inner = [
                (low[k] + places.margin <= axis) & (axis <= high[k] - places.margin) for k, axis in enumerate((x, y))
            ]
            labels, count = ndimage.label(free & inner[1][:, None] & inner[0][None, :])
            if not count:
                raise ValueError(
                    f"scene: tile {level}, {kind} has no place '{name}' with {places.radius:g} m of room on slopes "
                    f"of up to {math.degrees(places.max_slope):.0f} degrees; allow less room, or fewer assets"
                )
            largest = 1 + np.argmax(np.bincount(labels.ravel())[1:])  # label 0 is where nobody can stand
            rows, cols = np.nonzero(labels == largest)
            # A generator for each name and tile: other tiles or names change nothing here.
            own = np.random.default_rng([seed, zlib.crc32(name.encode()), level, kind])
            pick = own.integers(0, len(rows), places.count)
            at = np.column_stack([x[cols[pick]], y[rows[pick]]])
            found[level, kind] = np.column_stack([at, _highest(terrain, at, min(places.radius, 0.5))])
        ground.patches[name] = found  # terms look for robots' starts and targets there
    if "init_pos" in wanted:
        first = ground.patches["init_pos"]
        for level, kind in np.ndindex(levels, types):
            origins[level, kind] = _nearest(first[level, kind], origins[level, kind])
        ground.origins = origins
        x, y, z = _nearest(first.reshape(-1, 3), np.array(terrain.origin))
        terrain.origin = float(x), float(y), float(z)


def _nearest(places: np.ndarray, point: np.ndarray) -> np.ndarray:
    return np.asarray(places[np.argmin(np.hypot(*(places - point)[:, :2].T))])


def tile_bounds(terrain: TerrainInstance, level: int, kind: int) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper corner of a tile in the plane [m]. The tiles are centred, levels along x, types along y."""
    ground = terrain.ground
    assert ground.origins is not None
    tile, shape = np.array(ground.tile), np.array(ground.origins.shape[:2])
    low = np.array(ground.middle) + (np.array([level, kind]) - 0.5 * shape) * tile
    return low, low + tile


def _highest(terrain: TerrainInstance, at: np.ndarray, radius: float) -> np.ndarray:
    """Height of the highest ground around points, so that no foot starts inside it [m]."""
    turn = np.arange(12) * math.pi / 6.0
    circle = radius * np.column_stack([np.cos(turn), np.sin(turn)])
    ring = np.concatenate([np.zeros((1, 2)), circle / 3.0, circle / 1.5, circle])
    points = at[:, None] + ring
    return np.asarray(terrain.ground.height_at(points[..., 0], points[..., 1]).max(axis=1))
