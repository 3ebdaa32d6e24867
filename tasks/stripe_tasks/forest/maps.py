# SPDX-License-Identifier: Apache-2.0
"""Maps of a field of heights: slope, aspect, moisture, and traversability for a legged robot.

Heights are ``(nrow, ncol)`` [m], rows along y, columns along x. ``cell`` is their spacing [m], one number or (x, y).
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.interpolate import RectBivariateSpline

from stripe_newton.terrains import surface_height

from .drainage import breach_depressions, flow_accumulation

__all__ = ["aspect", "height_at", "moisture", "reachable", "slope", "step_height", "traversability", "vertex_at"]

Cell = float | tuple[float, float]

COARSE = 1.0
"""Least spacing at which moisture is computed [m]."""


def _spacing(heights: np.ndarray, cell: Cell) -> tuple[float, float]:
    """Spacing in x and y [m]; raise a ValueError if it or the heights are not as they must be."""
    dx, dy = cell if isinstance(cell, tuple) else (cell, cell)
    if not (0.0 < dx < np.inf and 0.0 < dy < np.inf):
        raise ValueError(f"cell is {cell}: must be above 0 [m], one number or (x, y)")
    if heights.ndim != 2 or min(heights.shape) < 3:
        raise ValueError(f"heights are {heights.shape}: must be (nrow, ncol), at least 3 x 3")
    return float(dx), float(dy)


def _gradient(heights: np.ndarray, cell: Cell) -> tuple[np.ndarray, np.ndarray]:
    """Rise along x and y, over 3 x 3 heights with weights 1 2 1; beyond the edge the ground is continued linearly."""
    dx, dy = _spacing(heights, cell)
    h = np.pad(heights.astype(float), 1, mode="reflect", reflect_type="odd")
    rows, cols = h[:-2] + 2.0 * h[1:-1] + h[2:], h[:, :-2] + 2.0 * h[:, 1:-1] + h[:, 2:]
    return (rows[:, 2:] - rows[:, :-2]) / (8.0 * dx), (cols[2:] - cols[:-2]) / (8.0 * dy)


def slope(heights: np.ndarray, cell: Cell) -> np.ndarray:
    """Steepness [rad], float32: B. K. P. Horn, "Hill shading and the reflectance map", 1981."""
    along_x, along_y = _gradient(heights, cell)
    return np.arctan(np.hypot(along_x, along_y)).astype(np.float32)


def aspect(heights: np.ndarray, cell: Cell) -> np.ndarray:
    """Direction in which the ground falls [rad], counterclockwise from x, in (-pi, pi], float32; 0 on level ground."""
    along_x, along_y = _gradient(heights, cell)
    return np.arctan2(0.0 - along_y, 0.0 - along_x).astype(np.float32)


def _resampled(heights: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Sample a field on another grid of the same extent, linearly between its points."""
    axes, to = ([np.linspace(0.0, 1.0, n) for n in s] for s in (heights.shape, shape))
    return np.asarray(RectBivariateSpline(*axes, heights, kx=1, ky=1)(*to))


def moisture(heights: np.ndarray, cell: Cell) -> np.ndarray:
    """Moisture of the ground as its form suggests, 0 to 1, float32.

    Topographic wetness index ``ln(a / tan b)``: ``a`` the area drained per width [m], ``b`` the slope (K. J. Beven and
    M. J. Kirkby, "A physically based, variable contributing area model of basin hydrology", 1979). 0 and 1 are its 2nd
    and 98th percentiles. It is computed at 1 m or the spacing, whichever is more. Depressions get outlets, so that
    water can leave; the slope is that of the ground without outlets, at least 0.01. The index is smoothed over the
    spacing.
    """
    dx, dy = _spacing(heights, cell)
    nrow, ncol = heights.shape
    shape = max(3, round((nrow - 1) * min(1.0, dy / COARSE)) + 1), max(3, round((ncol - 1) * min(1.0, dx / COARSE)) + 1)
    coarse = (ncol - 1) * dx / (shape[1] - 1), (nrow - 1) * dy / (shape[0] - 1)
    # smoothed before it is made coarser, or bumps between two points would count by chance
    spread = [0.5 * (n - 1) / (m - 1) if n > m else 0.0 for n, m in zip(heights.shape, shape)]
    ground = _resampled(ndimage.gaussian_filter(heights.astype(float), spread, mode="nearest"), shape)
    width = np.sqrt(coarse[0] * coarse[1])
    drained = flow_accumulation(breach_depressions(ground, coarse), coarse) * width
    index = np.log(drained / np.maximum(np.tan(slope(ground, coarse)), 0.01))
    index = ndimage.gaussian_filter(index, 1.0, mode="nearest")
    # percentiles, as the index of single vertices can be very large
    low, high = np.percentile(index, [2.0, 98.0])
    wet = np.clip((index - low) / max(high - low, 1.0e-9), 0.0, 1.0)
    return np.clip(_resampled(wet, heights.shape), 0.0, 1.0).astype(np.float32)


def _occupied(shape: tuple[int, ...], cell: tuple[float, float], obstacles: np.ndarray) -> np.ndarray:
    """Mask of the vertices in an obstacle; the vertex nearest to an obstacle always counts."""
    taken = np.zeros(shape, dtype=bool)
    col, row = ((obstacles[:, i] / cell[i] + 0.5 * (shape[1 - i] - 1)) for i in (0, 1))
    spans = np.ceil(obstacles[:, 2] / min(cell)).astype(int)
    # obstacles of one size at a time: a window about each is tested at once
    for span in np.unique(spans):
        few = spans == span
        offsets = np.arange(-span, span + 1)
        cols, rows = np.rint(col[few])[:, None] + offsets, np.rint(row[few])[:, None] + offsets
        away = np.hypot(
            ((rows - row[few, None]) * cell[1])[:, :, None], ((cols - col[few, None]) * cell[0])[:, None, :]
        )
        inside = away <= obstacles[few, 2][:, None, None]
        inside[:, span, span] = True
        inside &= ((rows >= 0) & (rows < shape[0]))[:, :, None] & ((cols >= 0) & (cols < shape[1]))[:, None, :]
        which, i, j = np.nonzero(inside)
        taken[rows[which, i].astype(int), cols[which, j].astype(int)] = True
    return taken


def step_height(heights: np.ndarray, cell: Cell, radius: float) -> np.ndarray:
    """Highest step [m] of the ground in the square of half-width ``radius`` [m] around each vertex, float32.

    It is the range of heights along each row and column of the square, after the slope of the ground is taken out. That
    slope is the median of the rises between vertices over 4 ``radius``, at least 5 of them. So a plane has no step, and
    a sharp step, which is only one of those rises, counts in full, whichever way the ground falls.
    """
    dx, dy = _spacing(heights, cell)
    if not 0.0 < radius < np.inf:
        raise ValueError(f"step_height: radius is {radius}, must be above 0 [m] and finite")
    ground = heights.astype(np.float32)
    along = _steps(ground, max(1, round(radius / dx)), max(1, round(radius / dy)))
    return np.maximum(along, _steps(ground.T, max(1, round(radius / dy)), max(1, round(radius / dx))).T)


def _steps(ground: np.ndarray, reach: int, beside: int) -> np.ndarray:
    """Largest range of heights without their slope, over ``reach`` vertices along rows and ``beside`` across them."""
    ncol = ground.shape[1]
    rises = ndimage.median_filter(np.diff(ground, axis=1), size=(1, max(5, 4 * reach + 1)), mode="reflect")
    rises = np.pad(rises, [(0, 0), (1, 1)], mode="edge")
    trend = 0.5 * (rises[:, :-1] + rises[:, 1:])
    # shifted copies of the ground, each less the trend over the shift: what is left are steps
    level = np.pad(ground, [(0, 0), (reach, reach)], constant_values=np.nan)  # beyond the edge there is no step
    high, low = ground.copy(), ground.copy()
    for step in range(-reach, reach + 1):
        beyond = level[:, reach + step : reach + step + ncol] - step * trend
        np.fmax(high, beyond, out=high)
        np.fmin(low, beyond, out=low)
    return np.asarray(ndimage.maximum_filter1d(high - low, 2 * beside + 1, axis=0, mode="nearest"))


def _checked_obstacles(obstacles: np.ndarray) -> np.ndarray:
    """Return obstacles as ``(N, 3)``; raise a ValueError if they are not x, y and radius [m]."""
    if np.size(obstacles) == 0:
        return np.zeros((0, 3))
    array = np.asarray(obstacles)
    if array.ndim != 2 or array.shape[1] != 3 or not np.isfinite(array).all() or (array[:, 2] < 0).any():
        raise ValueError(f"traversability: obstacles are {array.shape}, must be finite (N, 3): x, y, radius >= 0")
    return array


def traversability(
    heights: np.ndarray,
    cell: Cell,
    obstacles: np.ndarray,
    robot_radius: float,
    max_slope: float,
    max_step: float,
) -> np.ndarray:
    """Traversability for a legged robot, from 0 (impassable) to 1 (level, even and free).

    It is the product of three shares, each of which falls linearly from 1 to 0: with the slope of the ground, smoothed
    over the robot; with the highest step under it (:func:`step_height`); and with the distance to the next obstacle,
    from 1 at 2 ``robot_radius`` to 0 at ``robot_radius``. That distance is exact to half a cell.

    Args:
        heights: Heights [m].
        cell: Spacing [m].
        obstacles: x, y and radius of each [m], shape ``(N, 3)``, the field being centred on the origin.
        robot_radius: Radius of the circle around the robot [m].
        max_slope: Least slope that it cannot climb [rad].
        max_step: Least step that it cannot climb [m].

    Returns:
        Shares, float32 ``(nrow, ncol)``.
    """
    dx, dy = _spacing(heights, cell)
    for name, value in (("robot_radius", robot_radius), ("max_slope", max_slope), ("max_step", max_step)):
        if not 0.0 < value < np.inf:
            raise ValueError(f"traversability: {name} is {value}, must be above 0 and finite")
    obstacles = _checked_obstacles(obstacles)
    # continue the ground beyond the edge, or smoothing would see a level rim there
    margin = [min(int(np.ceil(4.0 * robot_radius / c)), n - 1) for c, n in zip((dy, dx), heights.shape)]
    ground = np.pad(heights.astype(np.float32), [(n, n) for n in margin], mode="reflect", reflect_type="odd")
    smooth = ndimage.gaussian_filter(ground, [robot_radius / dy, robot_radius / dx], truncate=3.0)
    steep = slope(smooth[tuple(slice(n, -n) for n in margin)], (dx, dy))
    step = step_height(heights, (dx, dy), robot_radius)
    share = np.clip(1.0 - steep / max_slope, 0.0, 1.0) * np.clip(1.0 - step / max_step, 0.0, 1.0)
    taken = _occupied(heights.shape, (dx, dy), obstacles)
    if taken.any():
        room = ndimage.distance_transform_edt(~taken, sampling=(dy, dx))
        share = share * np.clip(room / robot_radius - 1.0, 0.0, 1.0)
    return share.astype(np.float32)


def reachable(passable: np.ndarray, start: tuple[int, int], least: float = 0.0) -> np.ndarray:
    """Mask of the vertices that can be reached from ``start`` (row, column) over vertices of more than ``least``.

    Steps go along the axes.

    Returns:
        bool, of the shape of ``passable``; nowhere true if the start itself is not passable.
    """
    nrow, ncol = passable.shape
    if not (0 <= start[0] < nrow and 0 <= start[1] < ncol):
        raise ValueError(f"reachable: start (row, column) {tuple(start)} is outside of the map {passable.shape}")
    labels, _ = ndimage.label(passable > least)
    return np.asarray((labels == labels[start[0], start[1]]) & (labels > 0))


def vertex_at(shape: tuple[int, ...], size: tuple[float, float], xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and column of the vertex nearest to points ``(..., 2)`` [m] of a field of ``size`` centred on the origin."""
    xy = np.asarray(xy, dtype=float)
    col, row = (np.rint((xy[..., i] / size[i] + 0.5) * (shape[1 - i] - 1)).astype(int) for i in (0, 1))
    return row.clip(0, shape[0] - 1), col.clip(0, shape[1] - 1)


def height_at(heights: np.ndarray, size: tuple[float, float], xy: np.ndarray) -> np.ndarray:
    """Height of the surface of a field centred on the origin, at points ``(..., 2)`` [m]; float64 ``(...)``.

    As :func:`stripe_newton.terrains.surface_height`; ``size`` is the extent of the field [m].
    """
    xy, (nrow, ncol) = np.asarray(xy, dtype=float), heights.shape
    cell = size[0] / (ncol - 1), size[1] / (nrow - 1)
    return surface_height(heights, (-0.5 * size[0], -0.5 * size[1]), cell, xy[..., 0], xy[..., 1])
