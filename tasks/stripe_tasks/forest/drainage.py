# SPDX-License-Identifier: Apache-2.0
"""Drainage of a grid of heights: depressions are filled or breached, and flow is accumulated."""

from __future__ import annotations

import heapq

import numpy as np
from scipy import ndimage

__all__ = ["breach_depressions", "fill_depressions", "flow_accumulation"]

FACETS = tuple(
    (cardinal, diagonal)
    for cardinal in ((0, 1), (-1, 0), (0, -1), (1, 0))
    for diagonal in ((a, b) for a in (-1, 1) for b in (-1, 1))
    if cardinal[0] in (0, diagonal[0]) and cardinal[1] in (0, diagonal[1])
)
"""The 8 triangles about a vertex: steps (rows, columns) to the neighbour along an axis and to the diagonal one."""
AROUND = np.array([[True, True, True], [True, False, True], [True, True, True]])
"""The 8 neighbours of a vertex."""


def _flood(heights: np.ndarray) -> tuple[list[int], list[int]]:
    """Flood the field from its edge: the order of the vertices, and the vertex from which each was reached.

    The flood always goes on to the lowest vertex beside wet ones, which grows a minimum spanning tree (R. C. Prim,
    "Shortest connection networks and some generalizations", 1957): the path back to the edge has the lowest threshold.

    Returns:
        Flat indices of all vertices in the order of the flood; for each flat index the vertex before it, or -1 at the
        edge.
    """
    nrow, ncol = heights.shape
    width = ncol + 2  # with a rim around the field, every vertex has 8 neighbours
    level = np.pad(np.asarray(heights, dtype=float), 1).ravel().tolist()
    index = np.arange((nrow + 2) * width).reshape(nrow + 2, width)
    before = np.full(index.size, -1)
    before[index[2:-2, 2:-2]] = -2  # still dry
    came = before.tolist()
    edge = np.setdiff1d(index[1:-1, 1:-1], index[2:-2, 2:-2])
    heap = [(level[i], i) for i in edge.tolist()]
    heapq.heapify(heap)
    around = (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1)
    order = []
    while heap:
        _, i = heapq.heappop(heap)
        order.append(i)
        for step in around:
            n = i + step
            if came[n] == -2:
                came[n] = i
                heapq.heappush(heap, (level[n], n))
    inner = np.full(index.size + 1, -1)
    inner[index[1:-1, 1:-1].ravel()] = np.arange(nrow * ncol)
    return inner[order].tolist(), inner[np.array(came)[index[1:-1, 1:-1].ravel()]].tolist()


def _fill(heights: np.ndarray, order: list[int], before: list[int], rise: float) -> np.ndarray:
    """Raise each vertex above the one from which the flood reached it."""
    level = np.asarray(heights, dtype=float).ravel().tolist()
    for i in order:
        if before[i] >= 0 and level[i] < level[before[i]] + rise:
            level[i] = level[before[i]] + rise
    return np.array(level).reshape(heights.shape)


def fill_depressions(heights: np.ndarray, rise: float = 1.0e-5) -> np.ndarray:
    """Fill every depression, so that water runs from each vertex to the edge, downhill all the way.

    Priority-flood with a rise per step: R. Barnes, C. Lehman and D. Mulla, "Priority-flood: An optimal
    depression-filling and watershed-labeling algorithm for digital elevation models", 2014. It visits each vertex once.

    Args:
        heights: Heights [m], shape ``(nrow, ncol)``.
        rise: How much higher than the vertex it drains to a filled one is at least [m].

    Returns:
        Filled heights [m], float64 ``(nrow, ncol)``, nowhere lower than ``heights``.
    """
    return _fill(heights, *_flood(heights), rise)


def breach_depressions(
    heights: np.ndarray,
    cell: tuple[float, float],
    fall: float = 1.0e-5,
    deepest: float = np.inf,
    bank: float = np.inf,
    width: float = 0.0,
) -> np.ndarray:
    """Cut an outlet from every depression, so that water runs from each vertex to the edge, downhill all the way.

    Breaching along the paths of a priority-flood: J. B. Lindsay, "Efficient hybrid breaching-filling sink removal
    methods for flow path enforcement in digital elevation models", 2016. There, outlets that would be too deep are not
    cut and their depressions are filled. Here such depressions are made shallower first and keep their form: a depth
    ``d`` below the threshold becomes ``d / (1 + d / deepest)``.

    Args:
        heights: Heights [m], shape ``(nrow, ncol)``.
        cell: Spacing in x and y [m].
        fall: Slope of the outlets' beds.
        deepest: Depressions are made shallower than this [m]; outlets are deeper by the fall of their bed.
        bank: Slope of the outlets' banks; ``inf``: they are one vertex wide.
        width: Of their rounded beds [m]: a bank is ``bank (hypot(l, width / 2) - width / 2)`` high at a distance ``l``.

    Returns:
        Heights [m], float64 ``(nrow, ncol)``; each vertex inside the edge has a lower neighbour.
    """
    heights = np.asarray(heights, dtype=float)
    nrow, ncol = heights.shape
    order, before = _flood(heights)
    if deepest < np.inf:
        depth = _fill(heights, order, before, 0.0) - heights
        heights = heights + depth - depth / (1.0 + depth / deepest)
    # pits: no neighbour is lower; the edge is where water leaves
    lowest = ndimage.minimum_filter(heights, footprint=AROUND, mode="nearest")
    pit = lowest >= heights
    pit[[0, -1]] = pit[:, [0, -1]] = False
    # fall of the bed by the step between flat indices: along x, along y, diagonally
    across = {1: fall * cell[0], ncol: fall * cell[1]}
    across |= {ncol + side: fall * float(np.hypot(*cell)) for side in (-1, 1)}
    # lists: single reads and writes of NumPy arrays are many times slower
    level = heights.ravel().tolist()
    for place in np.flatnonzero(pit).tolist():
        i, bed = place, level[place]
        while before[i] >= 0:
            bed -= across[abs(before[i] - i)]
            i = before[i]
            if level[i] <= bed:
                break
            level[i] = bed
    drained = np.array(level).reshape(nrow, ncol)
    if bank == np.inf or not (drained < heights).any():
        return drained
    # the cone reaches as far as the deepest cut needs for its banks
    highest = float((heights - drained).max()) / bank
    x, y = (c * np.arange(-n, n + 1) for c in cell for n in [int(np.sqrt(highest * (highest + width)) / c) + 1])
    # banks: each bed is the tip of a cone, and the ground is cut down to the lowest of all cones
    cone = -bank * (np.hypot(np.hypot(y[:, None], x[None, :]), 0.5 * width) - 0.5 * width)
    banks = ndimage.grey_erosion(np.where(drained < heights, drained, 1.0e9), structure=cone, mode="nearest")
    return np.minimum(drained, banks)


def flow_accumulation(heights: np.ndarray, cell: tuple[float, float]) -> np.ndarray:
    """Number of vertices that drain through each one, itself included.

    D-infinity: water takes the steepest way down over the 8 triangles about a vertex and is shared between the two
    neighbours that it passes between, by angle (D. G. Tarboton, "A new method for the determination of flow directions
    and upslope areas in grid digital elevation models", 1997). Water that reaches the edge, or a vertex with no lower
    neighbour, has left: give heights that are filled or breached.

    Args:
        heights: Heights [m], shape ``(nrow, ncol)``.
        cell: Spacing in x and y [m].

    Returns:
        Numbers of vertices, float64 ``(nrow, ncol)``; they sum to ``nrow ncol`` over the edge and the pits.
    """
    heights = np.asarray(heights, dtype=float)
    nrow, ncol = heights.shape

    def at(step: tuple[int, int]) -> np.ndarray:
        return heights[1 + step[0] : nrow - 1 + step[0], 1 + step[1] : ncol - 1 + step[1]]

    middle = at((0, 0))
    steepest, share = np.zeros(middle.shape), np.zeros(middle.shape)
    facet = np.full(middle.shape, -1)
    for number, (cardinal, diagonal) in enumerate(FACETS):
        along, across = cell if cardinal[0] == 0 else cell[::-1]
        down, sideways = (middle - at(cardinal)) / along, (at(cardinal) - at(diagonal)) / across
        widest = np.arctan2(across, along)
        angle = np.arctan2(sideways, down)
        # The steepest descent lies within the facet, or along one of its two edges.
        slope = np.where(angle <= 0.0, down, np.hypot(down, sideways))
        slope = np.where(angle >= widest, (middle - at(diagonal)) / np.hypot(along, across), slope)
        better = slope > steepest
        steepest = np.where(better, slope, steepest)
        facet = np.where(better, number, facet)
        share = np.where(better, np.clip(angle / widest, 0.0, 1.0), share)

    # from the highest vertex down: all that flows into a vertex is known before it is shared on
    order = np.argsort(-middle, axis=None, kind="stable")
    order = order[facet.ravel()[order] >= 0]
    steps = np.array([[row * ncol + col for row, col in pair] for pair in FACETS])[facet.ravel()[order]]
    places = np.arange(nrow * ncol).reshape(nrow, ncol)[1:-1, 1:-1].ravel()[order]
    water = [1.0] * (nrow * ncol)
    to = (places[:, None] + steps).T.tolist()
    for i, first, second, part in zip(places.tolist(), *to, share.ravel()[order].tolist()):
        amount = water[i]
        water[first] += amount * (1.0 - part)
        water[second] += amount * part
    return np.array(water).reshape(nrow, ncol)
