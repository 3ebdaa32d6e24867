# SPDX-License-Identifier: Apache-2.0
"""Ray patterns, in the frame of the sensor: x forward, y left, z up. Names as in Isaac Lab."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import PositiveInt

from .pinhole import PinholeIntrinsics

__all__ = ["BpearlPatternCfg", "GridPatternCfg", "LidarPatternCfg", "PatternBaseCfg", "PinholeCameraPatternCfg"]

MOST_RAYS = 10_000_000
"""Limit on the rays of one sensor: more is a mistake in a resolution."""


@configclass
class PatternBaseCfg:
    """Base of the patterns; a subclass says by :meth:`rays` which rays a sensor has."""

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """Starts [m] and unit directions of the rays in the sensor's frame, float64, each of shape ``(n, 3)``."""
        raise NotImplementedError(f"{type(self).__name__} does not say which rays it has")


@configclass
class GridPatternCfg(PatternBaseCfg):
    """Parallel rays from the points of a grid."""

    size: Sequence[float] = MISSING
    """Extent in x and y [m]; ``(1.6, 1.0)`` at a resolution of 0.1 are 17 times 11 rays."""
    resolution: float = MISSING
    """Distance between rays [m]."""
    direction: Sequence[float] = (0.0, 0.0, -1.0)
    """Direction of all rays."""
    ordering: str = "xy"
    """``"xy"``: rays in rows along x, one row after the other along y; ``"yx"``: rows along y."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            yield "resolution", f"is {self.resolution}, must be a distance above 0 [m]"
        if len(self.size) != 2 or not all(math.isfinite(s) and s >= 0.0 for s in self.size):
            yield "size", f"is {self.size}, must be two lengths, 0 or more [m]"
        elif self.resolution > 0.0 and math.prod(s / self.resolution + 1.0 for s in self.size) > MOST_RAYS:
            yield "resolution", f"is {self.resolution}, more than {MOST_RAYS} rays: make it larger"
        if len(self.direction) != 3 or not 0.0 < math.hypot(*self.direction) < math.inf:
            yield "direction", f"is {self.direction}, must be a vector that is not zero"
        if self.ordering not in ("xy", "yx"):
            yield "ordering", f"is {self.ordering!r}, must be 'xy' or 'yx'"

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        # The tolerance keeps a size that is a multiple of the resolution, but for rounding, from losing its last row.
        x, y = (np.arange(math.floor(s / self.resolution + 1.0e-6) + 1) * self.resolution - 0.5 * s for s in self.size)
        grid = np.meshgrid(x, y, indexing="xy" if self.ordering == "xy" else "ij")
        starts = np.stack([grid[0].ravel(), grid[1].ravel(), np.zeros(grid[0].size)], axis=1)
        return starts, np.tile(_unit(np.array(self.direction, dtype=float)), (len(starts), 1))


@configclass
class LidarPatternCfg(PatternBaseCfg):
    """Rays from one point in rings of equal elevation, ring by ring from the lowest bound on."""

    channels: int = MISSING
    """Number of rings."""
    vertical_fov_range: tuple[float, float] = MISSING
    """Elevations of the first and the last ring [degrees]."""
    horizontal_fov_range: tuple[float, float] = MISSING
    """Azimuths of the first and the last ray of a ring [degrees]; over a full turn the last is left out."""
    horizontal_res: float = MISSING
    """Largest angle between neighbours in a ring [degrees]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not isinstance(self.channels, int) or self.channels < 1:
            yield "channels", f"is {self.channels!r}, must be a whole number above 0"
        if not (math.isfinite(self.horizontal_res) and self.horizontal_res > 0.0):
            yield "horizontal_res", f"is {self.horizontal_res}, must be an angle above 0 [degrees]"
        for name, most in (("vertical_fov_range", 180.0), ("horizontal_fov_range", 360.0)):
            bounds = getattr(self, name)
            if len(bounds) != 2 or not 0.0 <= bounds[1] - bounds[0] <= most:
                yield name, f"is {bounds}, must be two angles, the second larger, at most {most:g} apart [degrees]"

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = self.horizontal_fov_range
        count = math.ceil((high - low) / self.horizontal_res - 1.0e-6) + 1
        # The last ray of a full turn would be the first one again.
        full = abs(high - low - 360.0) < 1.0e-6
        around = np.radians(np.linspace(low, high, count)[: -1 if full else None])
        up = np.radians(np.linspace(*self.vertical_fov_range, self.channels))
        return _from_angles(*np.meshgrid(up, around, indexing="ij"))


@configclass
class BpearlPatternCfg(PatternBaseCfg):
    """The dome of rays of a RoboSense Bpearl: the half space above the sensor."""

    horizontal_fov: float = 360.0
    """Azimuths that are covered, about x [degrees]."""
    horizontal_res: float = 10.0
    """Angle between neighbours in a ring [degrees]."""
    vertical_ray_angles: Sequence[float] = tuple(89.5 - 90.0 / 32 * i for i in range(32))
    """Elevations of the rings [degrees]; those of the sensor's data sheet."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not (math.isfinite(self.horizontal_res) and self.horizontal_res > 0.0):
            yield "horizontal_res", f"is {self.horizontal_res}, must be an angle above 0 [degrees]"
        if not 0.0 < self.horizontal_fov <= 360.0:
            yield "horizontal_fov", f"is {self.horizontal_fov}, must be in (0, 360] [degrees]"
        if not self.vertical_ray_angles:
            yield "vertical_ray_angles", "is empty, name at least one elevation [degrees]"

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        count = math.ceil(self.horizontal_fov / self.horizontal_res - 1.0e-6)
        around = np.radians(-0.5 * self.horizontal_fov + self.horizontal_res * np.arange(count))
        return _from_angles(*np.meshgrid(np.radians(self.vertical_ray_angles), around, indexing="ij"))


@configclass
class PinholeCameraPatternCfg(PinholeIntrinsics, PatternBaseCfg):
    """Rays through the middles of a camera's pixels, row by row from the upper left; the camera looks along x."""

    width: PositiveInt = MISSING
    """Pixels in a row."""
    height: PositiveInt = MISSING
    """Pixels in a column."""

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        pixels = self.pixel_directions(self.width, self.height).reshape(-1, 3)
        # From the camera's frame (x right, y down, z ahead) to the sensor's (x ahead, y left, z up).
        directions = np.stack([pixels[:, 2], -pixels[:, 0], -pixels[:, 1]], axis=1)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.zeros_like(directions), directions


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector / np.linalg.norm(vector))


def _from_angles(elevation: np.ndarray, azimuth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    flat = np.cos(elevation)
    directions = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)
    return np.zeros_like(directions), directions
