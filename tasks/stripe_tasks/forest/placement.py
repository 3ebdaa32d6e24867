# SPDX-License-Identifier: Apache-2.0
"""Placement in the forest: blue-noise scatter, and poses on the ground.

Positions are (x, y) [m] in a field of ``size`` centred on the origin; maps are ``map[row, col]`` with rows along y,
their outer values on the field's edges. A generator in the same state gives the same result.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter

from .darts import Size, check_discs, check_map, check_size, clear_of, mean_over_field, sample_map, sampler, throw
from .maps import height_at

__all__ = ["ground_slope", "lie_on_slope", "patch_map", "sample_map", "scatter", "stand_on_ground"]

_SPACING = 0.30
"""Share of the ground that blue-noise discs cover; random darts can reach 0.547 (random sequential packing)."""
_PROFILE = 32
"""Points along a log; an even number, so that none is at its middle."""
_TIE = 1.0e-4
"""Pairs of supports whose heights differ by less count as equal [m]: the widest pair is taken."""


def _how_many(size: Size, density: float | None, count: int | None) -> int:
    """Number of discs, from a density or a count."""
    if (density is None) == (count is None):
        raise ValueError("scatter needs either density [1/m^2] or count, one of the two")
    number = float(count) if count is not None else float(density or 0.0) * size[0] * size[1]
    if not 0.0 <= number < math.inf or (count is not None and count != int(count)):
        raise ValueError(f"scatter: {'count' if count is not None else 'density'} must be 0 or more")
    return round(number)


def _radius_range(radius: float | tuple[float, float] | np.ndarray, number: int) -> tuple[float, float]:
    """Smallest and largest radius [m] of ``number`` discs; raise a ValueError if ``radius`` does not give them."""
    if isinstance(radius, np.ndarray):
        if radius.shape != (number,):
            raise ValueError(
                f"scatter: radius has the shape {radius.shape}, must be ({number},), that of each disc [m]"
            )
        low, high = (float(radius.min()), float(radius.max())) if number else (0.0, 0.0)
    else:
        low, high = (radius, radius) if isinstance(radius, (int, float)) else radius
    if not 0.0 <= low <= high < math.inf:
        raise ValueError(f"scatter: radius is {radius}, must be 0 or more, or (smallest, largest) [m]")
    return low, high


def scatter(
    size: Size,
    rng: np.random.Generator,
    *,
    density: float | None = None,
    count: int | None = None,
    weight: np.ndarray | None = None,
    radius: float | tuple[float, float] | np.ndarray = 0.0,
    avoid: tuple[np.ndarray, np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Blue-noise placement of discs that do not overlap: Poisson-disc darts (Cook 1986, ACM Trans. Graph. 5).

    Neighbours keep a distance that fits the local density, as long as there is room. Discs never overlap.

    Args:
        size: Extent of the field [m].
        rng: Where the randomness comes from.
        density: Discs per square metre, the mean over the field.
        count: Number of discs. Give either it or ``density``.
        weight: Map of relative density, 0 or more; uniform by default.
        radius: Radius of all, or (smallest, largest) of radii drawn uniformly, or an array of that of each [m].
        avoid: Positions ``(M, 2)`` and radii ``(M,)`` of discs to stay clear of.

    Returns:
        Positions ``(N, 2)`` and radii ``(N,)`` [m].

    Raises:
        ValueError: For bad input, or when not all fit; it says how many do.
    """
    size = check_size(size)
    number = _how_many(size, density, count)
    low, high = _radius_range(radius, number)
    others, widths = check_discs("scatter: avoid", avoid)
    if weight is not None:
        weight = check_map("scatter: weight", weight)
        if weight.min() < 0.0 or weight.max() <= 0.0:
            raise ValueError("scatter: weight must be 0 or more everywhere and positive somewhere")
    radii = radius.astype(np.float64) if isinstance(radius, np.ndarray) else rng.uniform(low, high, number)
    if number == 0:
        return np.zeros((0, 2)), radii
    spacing = math.sqrt(_SPACING * size[0] * size[1] / (math.pi * number))
    mean = 1.0 if weight is None else mean_over_field(weight)

    def reach(xy: np.ndarray, own: np.ndarray, ease: float) -> np.ndarray:
        if weight is None:
            return np.maximum(own, ease * spacing)
        share = np.maximum(sample_map(weight, size, xy) / mean, 0.1)  # caps the spacing where the density is low
        return np.maximum(own, ease * spacing / np.sqrt(share))

    draw = sampler(size, weight, rng)
    at, done = throw(radii, draw, reach, lambda xy, own: clear_of(xy, own, others, widths))
    if not done.all():
        raise ValueError(
            f"scatter: only {done.sum()} of {number} discs of radius {low:g} to {high:g} m fit into "
            f"{size[0]:g} x {size[1]:g} m beside what they avoid; ask for fewer or for smaller ones"
        )
    return at, radii


def patch_map(shape: tuple[int, int], size: Size, rng: np.random.Generator, patch: float, cover: float) -> np.ndarray:
    """Map of soft-edged patches in [0, 1], for plants that grow in clumps; a ``weight`` of :func:`scatter`.

    Smoothed white noise above its own quantile (a thresholded Gaussian field, Chiu et al. 2013, Stochastic Geometry and
    its Applications). ``patch`` is about the width of a patch [m], ``cover`` the share of the ground with any growth.
    """
    if not (patch > 0.0 and 0.0 < cover <= 1.0) or len(shape) != 2 or min(shape) < 2:
        raise ValueError(f"patch_map: patch is {patch}, cover {cover}, shape {shape}; must be > 0, in (0, 1], >= 2 x 2")
    cell = np.array(check_size(size))[::-1] / (np.array(shape) - 1)
    field = gaussian_filter(rng.standard_normal(shape), 0.35 * patch / cell, mode="reflect")
    # the quantile makes the share of ground with growth exact, whatever the size of patches
    over = field - np.quantile(field, 1.0 - cover)
    return np.clip(2.0 * over / max(float(over.max()), 1.0e-12), 0.0, 1.0)


def stand_on_ground(heights: np.ndarray, size: Size, xy: np.ndarray, sink: float | np.ndarray = 0.0) -> np.ndarray:
    """Positions ``(..., 3)`` at ``xy`` ``(..., 2)``, ``sink`` [m] below the surface of the ground."""
    xy = np.asarray(xy, dtype=np.float64)
    ground = height_at(check_map("heights", heights), check_size(size), xy)
    return np.concatenate([xy, (ground - sink)[..., None]], axis=-1)


def ground_slope(heights: np.ndarray, size: Size, xy: np.ndarray) -> np.ndarray:
    """Angle between the ground's normal and up [rad] at ``xy`` ``(..., 2)``, over two cells; shape ``(...)``."""
    rows, cols = check_map("heights", heights).shape
    half = 0.5 * np.array(check_size(size))
    xy = np.clip(np.asarray(xy, dtype=np.float64), -half, half)
    rises = []
    for step in np.diag(2.0 * half / (np.array([cols, rows]) - 1)):
        low, high = np.maximum(xy - step, -half), np.minimum(xy + step, half)  # one-sided at the edges
        rises.append(
            (height_at(heights, size, high) - height_at(heights, size, low)) / np.linalg.norm(high - low, axis=-1)
        )
    return np.arctan(np.hypot(*rises))


def lie_on_slope(
    heights: np.ndarray,
    size: Size,
    xy: np.ndarray,
    yaw: np.ndarray | float,
    length: np.ndarray | float,
    radius: np.ndarray | float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Pose of a log at rest on two points of the ground, on either side of its middle; its axis is its x axis.

    The ground below the log is a profile. At rest the log is that edge of the profile's upper convex hull which lies
    above its middle: between its two ends in a hollow or on a plane, between two points beside the crest on a hump.

    Args:
        heights: The ground [m], ``(rows, cols)``.
        size: Extent of the field [m].
        xy: Middle of the log ``(..., 2)`` [m].
        yaw: Heading of its axis [rad].
        length: From end to end [m].
        radius: Its radius [m]: distance of the axis from the ground, at right angles to the axis.

    Returns:
        Positions ``(..., 3)`` [m] of its middle and quaternions ``(..., 4)``, xyzw.
    """
    ground, size = check_map("heights", heights), check_size(size)
    xy = np.asarray(xy, dtype=np.float64)
    yaw, length, radius = (np.broadcast_to(np.asarray(v, np.float64), xy.shape[:-1]) for v in (yaw, length, radius))
    if xy.shape[-1:] != (2,) or not np.isfinite(xy).all() or not np.isfinite(yaw).all():
        raise ValueError(f"lie_on_slope: xy has the shape {xy.shape}, must be (..., 2), and it and yaw finite")
    if not (length > 0.0).all() or not (radius >= 0.0).all():
        raise ValueError("lie_on_slope: length must be positive and radius 0 or more [m]")
    heading = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    unit = np.linspace(-1.0, 1.0, _PROFILE)
    left, right = unit[: _PROFILE // 2, None], unit[None, _PROFILE // 2 :]
    pitch = np.zeros(xy.shape[:-1])
    # A steeper log spans less ground, so the pitch is found by fixed-point iteration, with the mean of two rounds.
    for _ in range(12):
        half = 0.5 * length * np.cos(pitch)
        along = half[..., None] * unit
        profile = height_at(ground, size, xy[..., None, :] + along[..., None] * heading[..., None, :])
        a, b = profile[..., : _PROFILE // 2, None], profile[..., None, _PROFILE // 2 :]
        middle = (a * right - b * left) / (right - left)  # height above the middle of the line through two points
        best = middle.max(axis=(-2, -1), keepdims=True)
        width = np.where(middle >= best - _TIE, right - left, 0.0).reshape(pitch.shape + (-1,))
        pair = width.argmax(axis=-1)[..., None]
        slope = np.take_along_axis(((b - a) / (right - left)).reshape(width.shape), pair, axis=-1)[..., 0] / half
        pitch = 0.5 * (pitch + np.arctan(slope))
    height = best[..., 0, 0]
    lift = np.stack([-np.sin(pitch) * heading[..., 0], -np.sin(pitch) * heading[..., 1], np.cos(pitch)], axis=-1)
    position = np.concatenate([xy, height[..., None]], axis=-1) + radius[..., None] * lift
    # Rz(yaw) Ry(-pitch): the log's x axis goes along the heading and up by the pitch
    sp, cp, sy, cy = np.sin(-0.5 * pitch), np.cos(-0.5 * pitch), np.sin(0.5 * yaw), np.cos(0.5 * yaw)
    return position, np.stack([-sy * sp, cy * sp, sy * cp, cy * cp], axis=-1)
