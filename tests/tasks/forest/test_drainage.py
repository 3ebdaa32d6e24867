# SPDX-License-Identifier: Apache-2.0
"""Drainage of grids of heights, against slow references, and on natural ground."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stripe_tasks.forest.drainage import breach_depressions, fill_depressions, flow_accumulation
from stripe_tasks.forest.maps import moisture, slope
from stripe_tasks.forest.relief import ReliefCfg, make_relief

STEPS = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]


def rough(seed: int = 0, shape: tuple[int, int] = (20, 30)) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.0, 2.0, shape)


def lowest_beside(heights: np.ndarray) -> np.ndarray:
    nrow, ncol = heights.shape
    return np.min([heights[1 + a : nrow - 1 + a, 1 + b : ncol - 1 + b] for a, b in STEPS], axis=0)


def test_filled_ground_has_no_pit_and_is_nowhere_lower():
    heights = rough()
    filled = fill_depressions(heights)
    assert (filled >= heights).all()
    inner = filled[1:-1, 1:-1]
    steps = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    lowest = np.min(
        [filled[1 + a : filled.shape[0] - 1 + a, 1 + b : filled.shape[1] - 1 + b] for a, b in steps], axis=0
    )
    assert (lowest < inner).all()
    level = np.full(heights.shape, np.inf)  # the same by relaxation: the lowest way out, step by step
    level[0], level[-1], level[:, 0], level[:, -1] = heights[0], heights[-1], heights[:, 0], heights[:, -1]
    for _ in range(200):
        around = np.min(
            [level[1 + a : level.shape[0] - 1 + a, 1 + b : level.shape[1] - 1 + b] for a, b in steps], axis=0
        )
        level[1:-1, 1:-1] = np.minimum(level[1:-1, 1:-1], np.maximum(heights[1:-1, 1:-1], around))
    np.testing.assert_allclose(filled, level, atol=1e-3)


def test_all_water_leaves_over_the_edge():
    filled = fill_depressions(rough(1))
    flow = flow_accumulation(filled, (0.5, 0.5))
    edge = np.ones(flow.shape, dtype=bool)
    edge[1:-1, 1:-1] = False
    assert flow[edge].sum() == pytest.approx(flow.size, rel=1e-6)
    assert flow.min() >= 1.0


def reference_flow(heights: np.ndarray, cell: tuple[float, float]) -> np.ndarray:
    """D-infinity from the water's side: the downhill direction of each plane, and each share followed to its end."""
    nrow, ncol = heights.shape
    flow = np.zeros(heights.shape)

    def ways(row: int, col: int) -> list[tuple[int, int, float]]:
        best, result = 0.0, []
        for a, b in ((0, 1), (-1, 0), (0, -1), (1, 0)):
            for c, d in ((a or s, b or s) for s in (-1, 1)):
                near, far = heights[row + a, col + b], heights[row + c, col + d]
                # gradient of the plane along the axis of the near neighbour, and from there to the far one
                along, across = (cell[0], cell[1]) if a == 0 else (cell[1], cell[0])
                p, q = (near - heights[row, col]) / along, (far - near) / across
                edges = [(-p, 1.0), ((heights[row, col] - far) / math.hypot(along, across), 0.0)]
                if p < 0.0 and q < 0.0 and -q / -p < across / along:
                    angle = math.atan(q / p)
                    edges = [(math.sqrt(p * p + q * q), 1.0 - angle / math.atan(across / along))]
                steepest, part = max(edges)
                if steepest > best + 1e-15:
                    best, result = steepest, [(row + a, col + b, part), (row + c, col + d, 1.0 - part)]
        return result

    def pour(row: int, col: int, amount: float) -> None:
        flow[row, col] += amount
        if 0 < row < nrow - 1 and 0 < col < ncol - 1:
            for r, c, part in ways(row, col):
                if part > 0.0:
                    pour(r, c, amount * part)

    for row in range(nrow):
        for col in range(ncol):
            pour(row, col, 1.0)
    return flow


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("cell", [(1.0, 1.0), (0.5, 0.8)])
def test_flow_is_that_of_water_followed_drop_by_drop(seed, cell):
    heights = rough(seed, (7, 9))
    np.testing.assert_allclose(flow_accumulation(heights, cell), reference_flow(heights, cell), rtol=1e-9)


def test_flow_with_ties_and_on_level_ground():
    np.testing.assert_array_equal(flow_accumulation(np.ones((5, 6)), (1.0, 1.0)), 1.0)
    terraces = np.random.default_rng(0).integers(0, 4, (8, 9)).astype(float)  # ties are settled in the same order
    np.testing.assert_allclose(flow_accumulation(terraces, (1.0, 1.0)), reference_flow(terraces, (1.0, 1.0)), rtol=1e-9)


@pytest.mark.parametrize("bank", [np.inf, 0.5])
@pytest.mark.parametrize("steps", [None, 3])
def test_breached_ground_has_no_pit_and_is_nowhere_higher(bank, steps):
    heights = rough(2, (30, 40))
    if steps:
        heights = np.round(heights * steps) / steps  # terraces, full of ties
    drained = breach_depressions(heights, (1.0, 0.7), 0.01, bank=bank, width=2.0)
    assert (drained <= heights).all()
    assert (lowest_beside(drained) < drained[1:-1, 1:-1]).all()
    flow = flow_accumulation(drained, (1.0, 0.7))
    assert flow[1:-1, 1:-1].max() < flow.size
    assert flow.sum() - flow[1:-1, 1:-1].sum() == pytest.approx(flow.size)


def test_an_outlet_is_cut_through_the_lowest_threshold():
    x, y = np.meshgrid(np.arange(-15.0, 16.0), np.arange(-15.0, 16.0))
    bowl = np.minimum(0.05 * (x**2 + y**2), 5.0)  # 5 m deep in a plateau
    bowl[15, 15:] = np.minimum(bowl[15, 15:], 3.0)  # with a notch to the east
    drained = breach_depressions(bowl, (1.0, 1.0), 0.01)
    np.testing.assert_allclose(drained[15, 15:], -0.01 * np.arange(16.0), atol=1e-12)
    ring = (np.hypot(x, y) < 9.5) & (y != 0.0) & (np.hypot(x, y) > 0.0)
    np.testing.assert_array_equal(drained[ring], bowl[ring])
    shallow = breach_depressions(bowl, (1.0, 1.0), 0.01, deepest=1.5)
    depth = 3.0 - bowl[15, 12]
    assert shallow[15, 12] == pytest.approx(3.0 - depth / (1.0 + depth / 1.5))
    assert shallow[15, 15] == pytest.approx(3.0 - 3.0 / (1.0 + 3.0 / 1.5))


@pytest.mark.parametrize("seed", range(5))
def test_natural_ground_drains_and_is_hardly_ever_level(seed):
    # the heights of the coarse grid themselves: no waves or bumps are added to them
    cfg = ReliefCfg(seed=seed, resolution=1.0, octaves=5, micro_amplitude=0.0)
    relief = make_relief(cfg)
    heights = relief.heights.astype(float)
    assert (lowest_beside(heights) < heights[1:-1, 1:-1]).all()
    flow = flow_accumulation(heights, relief.cell)
    assert flow.sum() - flow[1:-1, 1:-1].sum() == pytest.approx(flow.size)  # all of it at the edge
    assert np.mean(slope(heights, relief.cell) < np.radians(0.3)) < 0.02
    natural = make_relief(ReliefCfg(**{**cfg.__dict__, "drainage": 0.0})).heights
    changed = heights - natural
    assert np.abs(changed - np.median(changed)).max() < 0.6 * cfg.relief  # and is still that of the noise
    assert np.corrcoef(heights.ravel(), natural.ravel())[0, 1] > 0.9


def test_level_ground_drains_too():
    heights = make_relief(ReliefCfg(size=(32.0, 32.0), resolution=1.0, relief=0.0, micro_amplitude=0.0)).heights
    assert np.isfinite(heights).all()
    assert (lowest_beside(heights) < heights[1:-1, 1:-1]).all()


def test_the_bottom_of_a_hollow_is_its_wettest_part():
    x, y = np.meshgrid(np.arange(-20.0, 21.0), np.arange(-20.0, 21.0))
    wet = moisture(-4.0 * np.exp(-(x**2 + y**2) / 60.0) + 0.02 * x, 1.0)
    away = np.hypot(x, y)
    assert wet[away < 2.0].mean() > wet[(away > 5.0) & (away < 8.0)].mean() + 0.2
