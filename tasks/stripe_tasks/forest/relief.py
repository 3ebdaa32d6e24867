# SPDX-License-Identifier: Apache-2.0
"""Relief of natural ground: hills, channels cut by water, small bumps; and clearings, paths and ravines in it.

Hills and channels are computed on a grid of about 1 m, whatever the resolution is, so that a finer field has the same
form. Short waves and small bumps are added at the resolution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from .drainage import breach_depressions, flow_accumulation
from .fractal import fractal_noise, gradient_noise, smoothstep, warp
from .maps import height_at

__all__ = ["Relief", "ReliefCfg", "carve_path", "carve_ravine", "flatten_disc", "make_relief"]

HILLS, BENDS, MICRO, PATCHES = range(4)  # numbers of the random streams
COARSE = 1.0
"""Spacing of the grid of hills and channels [m]; twice that beyond ``WIDE``."""
WIDE = 600.0
"""Extent above which the coarse grid has twice the spacing [m]."""
SPRING = 300.0
"""Drained area above which water cuts a channel [m^2]."""
BANK = 0.5
"""Slope of the banks of channels."""
ROUND = 2.0
"""Width over which banks are rounded [m]."""
BED = 0.01
"""Slope of the beds of outlets that are cut through thresholds."""
OUTLET = 0.25
"""Depth of the outlets of the deepest hollows, as a share of the height of the hills."""


@dataclass(frozen=True)
class ReliefCfg:
    """Natural ground to make: its extent, hills, channels and bumps.

    Attributes:
        size: Extent in x and y [m].
        resolution: Spacing of the heights [m], adjusted so that it divides the size.
        relief: Height of the hills [m]: 4 standard deviations of the longest waves.
        roughness: 0 for rounded hills, 1 for rugged ground: short waves fade as ``wavelength^(1.5 - roughness)``.
        wavelength: Length of the longest waves [m].
        octaves: Number of wavelengths, each half of the one before; those below 2 ``resolution`` are left out.
        micro_amplitude: Height of roots, tussocks and hummocks [m]: 4 standard deviations where there are most.
        micro_wavelength: Spacing of the largest of them [m]; others have half and a quarter of it.
        drainage: Depth of the largest channel [m], outlets of hollows aside; 0: no channels, hollows of any depth.
        seed: Seed of the random numbers.
    """

    size: tuple[float, float] = (128.0, 128.0)
    resolution: float = 0.25
    relief: float = 8.0
    roughness: float = 0.4
    wavelength: float = 90.0
    octaves: int = 7
    micro_amplitude: float = 0.12
    micro_wavelength: float = 1.6
    drainage: float = 0.8
    seed: int = 0

    def __post_init__(self) -> None:
        if len(self.size) != 2 or not all(np.isfinite(s) and s >= 4.0 for s in self.size):
            raise ValueError(f"ReliefCfg.size is {self.size}: must be the extent in x and y, each at least 4 m")
        if not 0.02 <= self.resolution <= 0.25 * min(self.size):
            most = 0.25 * min(self.size)
            raise ValueError(f"ReliefCfg.resolution is {self.resolution}: must be from 0.02 m to {most} m, 1/4 of size")
        for name in ("relief", "micro_amplitude", "drainage"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise ValueError(f"ReliefCfg.{name} is {getattr(self, name)}: must be at least 0 [m] and finite")
        for name in ("wavelength", "micro_wavelength"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ValueError(f"ReliefCfg.{name} is {getattr(self, name)}: must be above 0 [m] and finite")
        if not 0.0 <= self.roughness <= 1.0:
            raise ValueError(f"ReliefCfg.roughness is {self.roughness}: must be from 0 to 1")
        if self.octaves != int(self.octaves) or not 1 <= self.octaves <= 16:
            raise ValueError(f"ReliefCfg.octaves is {self.octaves}: must be a whole number from 1 to 16")
        if self.seed != int(self.seed) or self.seed < 0:
            raise ValueError(f"ReliefCfg.seed is {self.seed}: must be a whole number, 0 or more")


@dataclass(frozen=True, eq=False)
class Relief:
    """Ground made by :func:`make_relief`, centred on the origin.

    Attributes:
        heights: Heights [m], float32 ``(nrow, ncol)``, rows along y, columns along x.
        size: Extent in x and y [m].
        drained: Area that drains through each vertex of the coarse grid that channels were made on [m^2], float32, over
            the same extent; 2 x 2 zeros where the ground was not drained.
    """

    heights: np.ndarray
    size: tuple[float, float]
    drained: np.ndarray

    @property
    def cell(self) -> tuple[float, float]:
        """Spacing of the heights in x and y [m]."""
        nrow, ncol = self.heights.shape
        return self.size[0] / (ncol - 1), self.size[1] / (nrow - 1)

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates x of the columns and y of the rows [m], shapes ``(1, ncol)`` and ``(nrow, 1)``."""
        return _axes(self.size, self.heights.shape)


def _axes(size: tuple[float, float], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the columns ``(1, ncol)`` and rows ``(nrow, 1)`` of a field centred on the origin [m]."""
    x, y = (np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(size, shape[::-1]))
    return x[None, :], y[:, None]


def _finer(coarse: np.ndarray, size: tuple[float, float], shape: tuple[int, int], order: int) -> np.ndarray:
    """Sample a field on a finer grid of the same extent, by splines."""
    (x, y), (fine_x, fine_y) = _axes(size, coarse.shape), _axes(size, shape)
    spline = RectBivariateSpline(y[:, 0], x[0], coarse, kx=order, ky=order)
    return np.asarray(spline(fine_y[:, 0], fine_x[0]), dtype=np.float32)


def _drained(hills: np.ndarray, cell: tuple[float, float], cfg: ReliefCfg) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drained ground, the depth of its channels [m], and the area drained [m^2].

    Outlets are cut from hollows, then channels. Rounding the banks leaves small hollows, which get outlets in turn, the
    last ones unrounded. The depth of channels grows with area^0.4, as that of streams with their discharge (L. B.
    Leopold and T. Maddock, "The Hydraulic Geometry of Stream Channels", 1953).
    """
    # 1. outlets of hollows; 2. channels by the area drained; 3. outlets of what rounding has left
    outlets = breach_depressions(hills, cell, BED, max(OUTLET * cfg.relief, 0.01), BANK, 2.0 * ROUND)
    area = flow_accumulation(outlets, cell) * cell[0] * cell[1]
    hills = hills + _rounded(outlets - hills, cell)
    depth = cfg.drainage
    spring = min(SPRING, 0.05 * area.size * cell[0] * cell[1])
    cut = depth * (np.clip(area - spring, 0.0, None) / max(area.max() - spring, 1.0e-9)) ** 0.4
    # banks: the cut spreads sideways as a cone, so the ground beside a channel slopes down to it
    reach = [max(1, int(np.ceil(depth / BANK / c))) for c in cell]
    across, along = (np.arange(-n, n + 1) * c for n, c in zip(reach, cell))
    banks = -BANK * np.hypot(along[:, None], across[None, :])
    cut = ndimage.grey_dilation(cut, structure=banks, mode="nearest")
    cut = _rounded(np.clip(cut, 0.0, None), cell)
    hills = hills - cut
    for _ in range(2):
        outlets = breach_depressions(hills, cell, BED, bank=BANK, width=2.0 * ROUND)
        hills = hills + _rounded(outlets - hills, cell)
    return breach_depressions(hills, cell, 0.7 * BED, bank=BANK, width=2.0 * ROUND), cut, area


def _rounded(cut: np.ndarray, cell: tuple[float, float]) -> np.ndarray:
    """Round the banks of what is cut out of the ground."""
    return ndimage.gaussian_filter(cut, [0.5 * ROUND / c for c in cell[::-1]], mode="nearest")


def _micro(x: np.ndarray, y: np.ndarray, cfg: ReliefCfg, least: float) -> np.ndarray:
    """Small bumps: rounded mounds, and at shorter wavelengths narrow ridges like roots; more in some patches."""
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape), dtype=np.float32)
    for octave, (share, ridged) in enumerate(((0.85, False), (0.45, True), (0.25, False))):
        wavelength = cfg.micro_wavelength / 2.0**octave
        if wavelength < least:
            continue
        noise = gradient_noise(x, y, wavelength, (cfg.seed, MICRO, octave))
        # |n| of normally distributed noise has mean 0.798 and deviation 0.603: ridges get mean 0 and variance 1 as well
        total += np.float32(share) * ((0.798 - np.abs(noise)) / 0.603 if ridged else noise)
    patches = gradient_noise(x, y, 8.0 * cfg.micro_wavelength, (cfg.seed, PATCHES))
    return np.asarray(0.25 * cfg.micro_amplitude * (0.3 + 0.7 * smoothstep(0.5 + 0.4 * patches)) * total)


def make_relief(cfg: ReliefCfg) -> Relief:
    """Make ground from noise, drain it, and add small bumps, which fade in channels.

    Hollows are made shallower and get outlets, and channels are cut where much water gathers. So on the coarse grid,
    before small bumps are added, water runs downhill from everywhere to the edge.
    """
    coarse = COARSE if max(cfg.size) <= WIDE else 2.0 * COARSE
    shape, coarse_shape = (
        (round(cfg.size[1] / spacing) + 1, round(cfg.size[0] / spacing) + 1) for spacing in (cfg.resolution, coarse)
    )
    x, y = _axes(cfg.size, coarse_shape)
    cell = float(x[0, 1] - x[0, 0]), float(y[1, 0] - y[0, 0])
    hurst, deviation = 1.5 - cfg.roughness, 0.25 * cfg.relief
    lengths = cfg.wavelength / 2.0 ** np.arange(cfg.octaves)
    # long waves on the coarse grid, which is drained; short ones are added at the resolution, as far as it shows them
    long, fit = int((lengths >= 4.0 * coarse).sum()), int((lengths >= 2.0 * cfg.resolution).sum())
    moved = warp(x, y, cfg.wavelength, 0.05 * cfg.wavelength, (cfg.seed, BENDS))
    hills = deviation * fractal_noise(*moved, cfg.wavelength, range(long), hurst, (cfg.seed, HILLS)).astype(float)
    cut, area = np.zeros((2, 2)), np.zeros((2, 2))
    if cfg.drainage > 0.0:
        hills, cut, area = _drained(hills, cell, cfg)
    heights = _finer(hills - hills.mean(), cfg.size, shape, 3)

    x, y = _axes(cfg.size, shape)
    small = deviation * fractal_noise(x, y, cfg.wavelength, range(long, fit), hurst, (cfg.seed, HILLS))
    if cfg.micro_amplitude > 0.0:
        small = small + _micro(x, y, cfg, 2.0 * cfg.resolution)
    if cfg.drainage > 0.0:
        small = small * (1.0 - 0.8 * _finer(smoothstep(cut / (0.5 * cfg.drainage)), cfg.size, shape, 1))
    heights += small.astype(np.float32)
    return Relief(heights, (float(cfg.size[0]), float(cfg.size[1])), area.astype(np.float32))


def flatten_disc(relief: Relief, centre: tuple[float, float], radius: float, blend: float) -> Relief:
    """Level a clearing within ``radius`` at its mean height; beyond ``radius + blend`` nothing changes [m]."""
    _positive("flatten_disc", radius=radius, blend=blend)
    x, y = relief.axes
    away = np.hypot(x - centre[0], y - centre[1])
    inside = away <= radius
    if not inside.any():
        raise ValueError(f"flatten_disc: no height of the field {relief.size} lies within {radius} m of {centre}")
    weight = smoothstep((radius + blend - away) / blend)
    level = relief.heights[inside].mean(dtype=float)
    return replace(relief, heights=(relief.heights + weight * (level - relief.heights)).astype(np.float32))


def carve_path(relief: Relief, points: np.ndarray, width: float, blend: float) -> Relief:
    """Carve a trodden path: level across its width, smooth along it, with corners rounded over a width.

    Args:
        relief: Ground.
        points: Polyline in x and y [m], shape ``(K, 2)``, at least 2.
        width: Width of the level part [m].
        blend: Width of the transition to the ground around it, on either side [m].
    """
    _positive("carve_path", width=width, blend=blend)
    # points along the path; its height is that of the ground, smoothed over two widths
    step = max(0.25 * width, min(relief.cell))
    line = _stations(points, step, width, "carve_path")
    ground = height_at(relief.heights, relief.size, line)
    ground = ndimage.gaussian_filter1d(ground, max(2.0 * width, 1.0) / step, mode="nearest")
    away, level = _along(relief, line, 0.5 * width + blend, ground)
    weight = smoothstep((0.5 * width + blend - away) / blend)
    return replace(relief, heights=(relief.heights + weight * (level - relief.heights)).astype(np.float32))


def carve_ravine(relief: Relief, points: np.ndarray, depth: float, width: float) -> Relief:
    """Carve a ravine: ``depth`` deeper over the middle third of ``width``, steep at both sides [m].

    ``points`` is a polyline in x and y [m], shape ``(K, 2)``; the ends are as steep as the sides.
    """
    _positive("carve_ravine", width=width, depth=depth)
    line = _stations(points, max(0.25 * width, min(relief.cell)), 0.5 * width, "carve_ravine")
    away, _ = _along(relief, line, 0.5 * width, np.zeros(len(line)))
    cut = depth * smoothstep((0.5 * width - away) / (width / 3.0))
    return replace(relief, heights=(relief.heights - cut).astype(np.float32))


def _positive(function: str, **values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < np.inf:
            raise ValueError(f"{function}: {name} is {value}, must be above 0 [m] and finite")


def _stations(points: np.ndarray, step: float, rounding: float, function: str) -> np.ndarray:
    """Points every ``step`` along a polyline with rounded corners; its ends stay."""
    points = np.asarray(points, dtype=float)
    if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2 or not np.isfinite(points).all():
        raise ValueError(f"{function}: points are {points.shape}, must be a polyline (K, 2) of at least 2, finite")
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    if way[-1] <= 0.0:
        raise ValueError(f"{function}: points all lie at {tuple(points[0].tolist())}, the line has no length")
    at = np.linspace(0.0, way[-1], max(2, int(np.ceil(way[-1] / step)) + 1))
    line = np.stack([np.interp(at, way, column) for column in points.T], axis=1)
    spread = min(int(4.0 * rounding / step) + 1, len(line) - 1)
    # point reflections beyond both ends, so that smoothing leaves the ends where they are
    ahead, behind = 2.0 * line[0] - line[spread:0:-1], 2.0 * line[-1] - line[-2 : -2 - spread : -1]
    line = ndimage.gaussian_filter1d(np.concatenate([ahead, line, behind]), rounding / step, axis=0)
    return np.asarray(line[spread : len(line) - spread])


def _along(relief: Relief, line: np.ndarray, reach: float, value: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from a line [m], ``inf`` beyond ``reach``, and the value at its nearest point, for each vertex."""
    (x, y), (dx, dy) = relief.axes, relief.cell
    away, found = np.full(relief.heights.shape, np.inf), np.zeros(relief.heights.shape)
    for a, b, first, last in zip(line[:-1], line[1:], value[:-1], value[1:]):
        low, high = np.minimum(a, b) - reach, np.maximum(a, b) + reach
        cols = slice(*(int(np.clip((e - x[0, 0]) / dx + n, 0, x.size)) for e, n in ((low[0], 0), (high[0], 1))))
        rows = slice(*(int(np.clip((e - y[0, 0]) / dy + n, 0, y.size)) for e, n in ((low[1], 0), (high[1], 1))))
        px, py = x[:, cols] - a[0], y[rows] - a[1]
        ex, ey = b - a
        t = np.clip((px * ex + py * ey) / max(ex * ex + ey * ey, 1.0e-12), 0.0, 1.0)
        distance = np.hypot(px - t * ex, py - t * ey)
        nearer = (distance < away[rows, cols]) & (distance <= reach)
        away[rows, cols] = np.where(nearer, distance, away[rows, cols])
        found[rows, cols] = np.where(nearer, first + t * (last - first), found[rows, cols])
    return away, found
