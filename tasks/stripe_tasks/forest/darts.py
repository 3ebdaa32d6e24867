# SPDX-License-Identifier: Apache-2.0
"""Dart throwing: random placement of discs that do not overlap, and maps that are read at positions.

Positions are (x, y) [m] in a field of ``size`` centred on the origin; maps are ``map[row, col]`` with rows along y,
their outer values on the field's edges.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

__all__ = [
    "Size",
    "check_discs",
    "check_map",
    "check_size",
    "clear_of",
    "mean_over_field",
    "sample_map",
    "sampler",
    "throw",
]

Size = tuple[float, float]
_MISSES = 60  # rounds with almost no success after which the field counts as full


def check_size(size: Size) -> Size:
    """Return ``size`` as two floats; raise a ValueError if they are not positive lengths [m]."""
    if len(size) != 2 or not all(math.isfinite(s) and s > 0.0 for s in size):
        raise ValueError(f"size is {size}, must be two positive lengths (x, y) [m]")
    return float(size[0]), float(size[1])


def check_map(name: str, values: np.ndarray) -> np.ndarray:
    """Return ``values`` as a float64 map; raise a ValueError if it is smaller than 2 x 2 or not finite."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2 or min(array.shape) < 2 or not np.isfinite(array).all():
        raise ValueError(f"{name} has the shape {array.shape}, must be (rows, cols) of 2 or more, all finite")
    return array


def sample_map(values: np.ndarray, size: Size, xy: np.ndarray) -> np.ndarray:
    """Bilinear values of a map at positions ``(..., 2)`` [m], shape ``(...)``; constant beyond its edges."""
    grid = check_map("map", values)
    xy = np.asarray(xy, dtype=np.float64)
    # outer values lie on the edges of the field, so there is one cell less than values
    scale = (np.array(grid.shape[::-1]) - 1) / np.array(size)
    col, row = np.moveaxis((xy + 0.5 * np.array(size)) * scale, -1, 0)
    flat = map_coordinates(grid, [row.ravel(), col.ravel()], order=1, mode="nearest", prefilter=False)
    return flat.reshape(row.shape)


def check_discs(name: str, discs: tuple[np.ndarray, np.ndarray] | None) -> tuple[np.ndarray, np.ndarray]:
    """Return ``discs`` as positions ``(M, 2)`` and radii ``(M,)`` [m], none for ``None``, or raise a ValueError."""
    if discs is None:
        return np.zeros((0, 2)), np.zeros(0)
    positions, radii = np.asarray(discs[0], dtype=np.float64), np.asarray(discs[1], dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] < 2 or radii.shape != positions.shape[:1]:
        raise ValueError(f"{name}: positions {positions.shape} and radii {radii.shape} must be (M, 2) and (M,)")
    if not np.isfinite(positions).all() or not np.isfinite(radii).all() or (radii < 0.0).any():
        raise ValueError(f"{name}: positions and radii must be finite, radii 0 or more")
    return positions[:, :2], radii


def _first_of_each_clash(xy: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Mask of the discs to keep: those that overlap no kept disc before them, ``reach`` being their radii."""
    keep = np.ones(len(xy), dtype=bool)
    if len(xy) < 2:
        return keep
    pairs = cKDTree(xy).query_pairs(2.0 * float(reach.max()), output_type="ndarray")
    gap = np.linalg.norm(xy[pairs[:, 0]] - xy[pairs[:, 1]], axis=1)
    pairs = np.sort(pairs[gap < reach[pairs].sum(axis=1)], axis=1)
    undecided = keep.copy()
    keep[:] = False
    # As a loop over discs in their order would decide, for many discs at once: a disc without an undecided neighbour
    # before it stays, and what overlaps it goes.
    while undecided.any():
        later = np.zeros_like(keep)
        later[pairs[:, 1]] = True
        new = undecided & ~later
        keep |= new
        gone = np.zeros_like(keep)
        gone[pairs[new[pairs[:, 0]], 1]] = True
        undecided &= ~new & ~gone
        pairs = pairs[undecided[pairs[:, 0]] & undecided[pairs[:, 1]]]
    return keep


def clear_of(xy: np.ndarray, reach: np.ndarray, others: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Mask of the discs of radius ``reach`` that overlap none of the discs ``others``."""
    clear = np.ones(len(xy), dtype=bool)
    if len(xy) == 0 or len(others) == 0:
        return clear
    tree, order = cKDTree(xy), np.argsort(radii, kind="stable")
    # In groups of similar radii: one search would have to reach as far as the largest disc for all of them.
    for part in np.array_split(order, min(8, len(order))):
        limit = float(radii[part].max() + reach.max())
        near = tree.sparse_distance_matrix(cKDTree(others[part]), limit, output_type="ndarray")
        clear[near["i"][near["v"] < reach[near["i"]] + radii[part][near["j"]]]] = False
    return clear


def throw(
    radii: np.ndarray,
    draw: Callable[[int], np.ndarray],
    reach: Callable[[np.ndarray, np.ndarray, float], np.ndarray],
    free: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Throw darts in batches, until all discs have a place or there is no more room.

    Args:
        radii: Of the discs ``(N,)`` [m].
        draw: Draws that many positions.
        reach: Radius that each disc wants for itself, by position, radius and ``ease``, which falls from 1 to 0 when
            darts keep missing.
        free: Mask of the positions at which discs of given radii may lie.

    Returns:
        Positions ``(N, 2)`` [m], and whether each disc found one.
    """
    order = np.argsort(-radii, kind="stable")  # large discs first: small ones still find room between them
    at, done, ease, misses = np.zeros((len(radii), 2)), np.zeros(len(radii), dtype=bool), 1.0, 0
    while not done.all() and misses < _MISSES:
        missing = order[~done[order]]
        disc = np.repeat(missing, max(2, 1024 // len(missing)))  # several darts for each disc
        xy = draw(len(disc))
        room = free(xy, radii[disc])
        xy, disc = xy[room], disc[room]
        wanted = reach(xy, radii[disc], ease)
        room = clear_of(xy, wanted, at[done], reach(at[done], radii[done], ease))
        xy, disc, wanted = xy[room], disc[room], wanted[room]
        keep = _first_of_each_clash(xy, wanted)
        found, first = np.unique(disc[keep], return_index=True)
        at[found], done[found] = xy[keep][first], True
        # A round that places few discs counts as a miss; well before that, wider spacings are given up.
        misses += len(found) < 0.02 * len(missing)
        if len(found) < 0.2 * len(missing):
            ease = 0.8 * ease if ease > 0.2 else 0.0
    return at, done


def sampler(size: Size, weight: np.ndarray | None, rng: np.random.Generator) -> Callable[[int], np.ndarray]:
    """Make a function that draws ``n`` positions ``(n, 2)`` [m] with a density in proportion to ``weight``."""
    extent = np.array(size)
    if weight is None:
        return lambda n: (rng.random((n, 2)) - 0.5) * extent
    rows, cols = weight.shape
    # each cell is drawn by its highest corner, an upper bound of the bilinear surface within it
    corner = weight / weight.max()
    cell = np.maximum.reduce([corner[:-1, :-1], corner[1:, :-1], corner[:-1, 1:], corner[1:, 1:]])
    total = np.cumsum(cell.ravel())

    def draw(n: int) -> np.ndarray:
        parts, have = [], 0
        while have < n:  # draws a cell by its highest corner, then rejects down to the bilinear value
            index = np.searchsorted(total, rng.random(n + 16) * total[-1], side="right")
            index = np.minimum(index, len(total) - 1)
            cells = np.stack([index % (cols - 1), index // (cols - 1)], axis=1)
            xy = ((cells + rng.random(cells.shape)) / np.array([cols - 1, rows - 1]) - 0.5) * extent
            xy = xy[rng.random(len(xy)) * cell.ravel()[index] < sample_map(corner, size, xy)]
            parts.append(xy)
            have += len(xy)
        return np.concatenate(parts)[:n]

    return draw


def mean_over_field(weight: np.ndarray) -> float:
    """Mean of the bilinear surface through a map."""
    return float(0.25 * (weight[:-1, :-1] + weight[1:, :-1] + weight[:-1, 1:] + weight[1:, 1:]).mean())
