# SPDX-License-Identifier: Apache-2.0
"""Natural ground and its maps, against analytic surfaces and slow references."""

from __future__ import annotations

import numpy as np
import pytest

from stripe_tasks.forest.drainage import flow_accumulation
from stripe_tasks.forest.maps import aspect, height_at, moisture, reachable, slope, step_height, traversability
from stripe_tasks.forest.relief import ReliefCfg, carve_path, carve_ravine, flatten_disc, make_relief

SMALL = ReliefCfg(size=(48.0, 32.0), resolution=0.5, relief=4.0, wavelength=24.0, micro_amplitude=0.1, seed=3)


@pytest.fixture(scope="module")
def relief():
    return make_relief(SMALL)


def test_the_same_seed_gives_the_same_ground(relief):
    again = make_relief(SMALL)
    assert again.heights.tobytes() == relief.heights.tobytes()
    other = make_relief(ReliefCfg(**{**SMALL.__dict__, "seed": 4}))
    assert np.abs(other.heights - relief.heights).mean() > 0.2
    assert relief.heights.shape == (65, 97)
    assert relief.heights.dtype == np.float32
    assert relief.cell == pytest.approx((0.5, 0.5))


def test_hills_are_as_high_as_asked():
    spreads = [make_relief(ReliefCfg(**{**SMALL.__dict__, "relief": r})).heights.std() for r in (4.0, 8.0)]
    assert spreads[1] / spreads[0] == pytest.approx(2.0, rel=0.25)


def test_water_gathers_along_a_valley():
    x, y = np.meshgrid(np.linspace(-5.0, 5.0, 41), np.linspace(0.0, 10.0, 41))
    flow = flow_accumulation(np.abs(x) + 0.2 * y, (0.25, 0.25))
    middle = flow[1:-1, 20]
    assert (middle > 5.0 * np.median(flow)).mean() > 0.8
    assert np.argmax(flow[1]) == 20


def test_slope_and_aspect_of_a_plane_and_of_a_bowl():
    x, y = np.meshgrid(np.linspace(-4.0, 4.0, 33), np.linspace(-3.0, 3.0, 25))
    np.testing.assert_allclose(slope(0.3 * x - 0.4 * y, (0.25, 0.25)), np.arctan(0.5), atol=1e-5)
    np.testing.assert_allclose(aspect(0.3 * x - 0.4 * y, (0.25, 0.25)), np.arctan2(0.4, -0.3), atol=1e-5)
    inner = (slice(2, -2), slice(2, -2))
    bowl = 0.1 * (x**2 + y**2)
    expected = np.arctan(0.2 * np.hypot(x, y))
    np.testing.assert_allclose(slope(bowl, (0.25, 0.25))[inner], expected[inner], atol=1e-3)
    away = np.hypot(x, y)[inner] > 0.5
    toward = np.arctan2(-y, -x)[inner]
    turn = np.angle(np.exp(1j * (aspect(bowl, (0.25, 0.25))[inner] - toward)))
    assert np.abs(turn[away]).max() < 0.02


def test_channels_are_wetter_than_ridges(relief):
    wet = moisture(relief.heights, relief.cell)
    assert wet.min() >= 0.0
    assert wet.max() <= 1.0
    x, y = np.meshgrid(np.linspace(-8.0, 8.0, 65), np.linspace(-8.0, 8.0, 65))
    valley = moisture(0.5 * np.abs(x) + 0.1 * y, (0.25, 0.25))
    assert valley[8:-8, 30:35].mean() > valley[8:-8, 8:20].mean() + 0.2


def test_a_clearing_is_level_and_leaves_the_rest(relief):
    cleared = flatten_disc(relief, (4.0, -2.0), 6.0, 3.0)
    x, y = relief.axes
    away = np.hypot(x - 4.0, y + 2.0)
    assert np.ptp(cleared.heights[away <= 6.0]) < 1e-5
    np.testing.assert_array_equal(cleared.heights[away >= 9.0], relief.heights[away >= 9.0])


def test_a_path_is_level_across(relief):
    path = carve_path(relief, np.array([[-20.0, 0.0], [20.0, 0.0]]), 2.0, 1.0)
    across = [
        height_at(path.heights, path.size, np.column_stack([np.linspace(-15, 15, 40), np.full(40, y)]))
        for y in (-0.5, 0, 0.5)
    ]
    assert np.abs(across[0] - across[2]).max() < 0.02
    before = height_at(relief.heights, relief.size, np.column_stack([np.linspace(-15, 15, 40), np.zeros(40)]))
    assert np.abs(across[1] - before).mean() < 0.5
    _, y = relief.axes
    far = np.broadcast_to(np.abs(y) > 2.6, relief.heights.shape)
    np.testing.assert_array_equal(path.heights[far], relief.heights[far])


def test_a_ravine_is_as_deep_as_asked(relief):
    ravine = carve_ravine(relief, np.array([[-24.0, 0.0], [24.0, 0.0]]), 3.0, 9.0)
    cut = relief.heights - ravine.heights
    _, y = relief.axes
    middle = np.broadcast_to(np.abs(y) < 1.2, cut.shape)[:, 10:-10]
    np.testing.assert_allclose(cut[:, 10:-10][middle], 3.0, atol=1e-3)
    assert np.abs(cut[np.broadcast_to(np.abs(y) > 4.6, cut.shape)]).max() == 0.0


def test_obstacles_and_steps_are_in_the_way():
    heights = np.zeros((81, 81))
    heights[:, 60:] = 0.5
    free = traversability(heights, (0.1, 0.1), np.array([[-2.0, 0.0, 0.3]]), 0.3, 0.6, 0.3)
    assert free[40, 20] == 0.0  # in the trunk
    assert free[40, 60] == 0.0  # at the step
    assert free[10, 35] == pytest.approx(1.0)
    there = reachable(free, (10, 35))
    assert there[70, 35]
    assert not there[40, 75]  # beyond the step
    assert not reachable(free, (40, 20)).any()


@pytest.mark.parametrize("cell", [0.1, 0.25, 0.5])
@pytest.mark.parametrize("turn", [0.0, 0.4, 0.25 * np.pi])
@pytest.mark.parametrize("tilt", [-0.3, 0.0, 0.3])
def test_a_sharp_step_counts_in_full_and_a_plane_not_at_all(cell, turn, tilt):
    axis = np.arange(-6.0, 6.0 + 0.5 * cell, cell)
    across = np.cos(turn) * axis[None, :] + np.sin(turn) * axis[:, None] + 0.013
    plane = tilt * across
    steps = step_height(plane + 0.3 * (across > 0.0), cell, 0.3)
    np.testing.assert_allclose(steps[np.abs(across) < 0.5 * cell], 0.3, rtol=0.05)
    assert steps[np.abs(across) > 4.0 * max(cell, 0.3)].max() < 1e-4
    assert step_height(plane, cell, 0.3).max() < 1e-4
    free = traversability(plane, cell, np.zeros((0, 3)), 0.3, 0.8, 0.2)
    np.testing.assert_allclose(free, 1.0 - np.arctan(abs(tilt)) / 0.8, atol=1e-3)


def test_a_step_is_the_range_over_the_square_on_level_ground():
    heights = np.zeros((30, 40))
    heights[12, 20] = 0.4
    expected = np.zeros_like(heights)
    expected[9:16, 17:24] = 0.4
    np.testing.assert_allclose(step_height(heights, 0.1, 0.3), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: ReliefCfg(size=(1.0, 9.0)), "each at least 4 m"),
        (lambda: ReliefCfg(resolution=0.0), "must be from 0.02 m"),
        (lambda: ReliefCfg(relief=-1.0), "ReliefCfg.relief is -1.0"),
        (lambda: ReliefCfg(roughness=2.0), "must be from 0 to 1"),
        (lambda: ReliefCfg(octaves=0), "must be a whole number from 1 to 16"),
        (lambda: ReliefCfg(seed=-1), "must be a whole number, 0 or more"),
        (lambda: flatten_disc(make_relief(SMALL), (500.0, 0.0), 1.0, 1.0), "no height of the field"),
        (
            lambda: traversability(np.zeros((9, 9)), (1.0, 1.0), np.zeros((2, 2)), 0.3, 0.5, 0.2),
            "must be finite (N, 3)",
        ),
        (lambda: reachable(np.ones((3, 3)), (5, 0)), "outside of the map"),
    ],
)
def test_what_is_wrong_is_said(make, text):
    with pytest.raises(ValueError) as error:
        make()
    assert text in str(error.value)
