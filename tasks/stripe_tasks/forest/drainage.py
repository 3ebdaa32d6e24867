# SPDX-License-Identifier: Apache-2.0
"""Where water goes on a grid of heights: hollows filled up to where they spill, and the area that drains to a place."""

from __future__ import annotations

import heapq

import numpy as np

__all__ = ["fill_depressions", "flow_accumulation"]

FACETS = tuple(
    (cardinal, diagonal)
    for cardinal in ((0, 1), (-1, 0), (0, -1), (1, 0))
    for diagonal in ((a, b) for a in (-1, 1) for b in (-1, 1))
    if cardinal[0] in (0, diagonal[0]) and cardinal[1] in (0, diagonal[1])
)
"""The 8 triangles about a vertex: steps (rows, columns) to the neighbour along an axis and to the diagonal one."""


def fill_depressions(heights: np.ndarray, rise: float = 1.0e-5) -> np.ndarray:
    """Heights with every hollow filled so that water runs from each vertex to the edge, downhill all the way.

    Priority-flood with a rise per step: R. Barnes, C. Lehman and D. Mulla, "Priority-flood: An optimal
    depression-filling and watershed-labeling algorithm for digital elevation models", 2014. Visits vertices one by one.

    Args:
        heights: Heights [m], shape ``(nrow, ncol)``.
        rise: How much higher than the vertex it drains to a filled one is at least [m].

    Returns:
        Filled heights [m], float64 ``(nrow, ncol)``, nowhere lower than ``heights``.
    """
    nrow, ncol = heights.shape
    width = ncol + 2
    level = np.pad(np.asarray(heights, dtype=float), 1).ravel().tolist()
    seen = np.pad(np.zeros((nrow, ncol), dtype=bool), 1, constant_values=True)
    index = np.arange(seen.size).reshape(seen.shape)[1:-1, 1:-1]
    edge = np.unique(np.concatenate([index[0], index[-1], index[:, 0], index[:, -1]]))
    seen.ravel()[edge] = True
    closed = seen.ravel().tolist()
    heap = [(level[i], i) for i in edge.tolist()]
    heapq.heapify(heap)
    around = (-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1)
    while heap:
        height, i = heapq.heappop(heap)
        least = height + rise
        for step in around:
            n = i + step
            if not closed[n]:
                closed[n] = True
                if level[n] < least:
                    level[n] = least
                heapq.heappush(heap, (level[n], n))
    return np.array(level).reshape(nrow + 2, width)[1:-1, 1:-1]


def flow_accumulation(heights: np.ndarray, cell: tuple[float, float]) -> np.ndarray:
    """How many vertices drain through each one, itself included.

    D-infinity: water takes the steepest way down over the 8 triangles about a vertex and is shared between the two
    neighbours that it passes between, by angle (D. G. Tarboton, "A new method for the determination of flow directions
    and upslope areas in grid digital elevation models", 1997). Water that reaches the edge, or a vertex with no lower
    neighbour, has left: give filled heights.

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
        slope = np.where(angle <= 0.0, down, np.hypot(down, sideways))
        slope = np.where(angle >= widest, (middle - at(diagonal)) / np.hypot(along, across), slope)
        better = slope > steepest
        steepest = np.where(better, slope, steepest)
        facet = np.where(better, number, facet)
        share = np.where(better, np.clip(angle / widest, 0.0, 1.0), share)

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
