# SPDX-License-Identifier: Apache-2.0
"""Terrains: tiles of every kind and the grid that they make, in plain NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from stripe_newton import terrains
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.terrains import (
    ROUGH_TERRAINS_CFG,
    FlatPatchSamplingCfg,
    SubTerrainBaseCfg,
    TerrainGenerator,
    TerrainGeneratorCfg,
    TerrainImporterCfg,
    sub_terrain_heights,
)
from tests.helpers.terrain_kinds import KINDS, SIZE, STEP


def made(kind: str, difficulty: float, seed: int = 0, **changes: Any) -> np.ndarray:
    cfg = KINDS[kind].replace(size=SIZE, horizontal_scale=STEP, **changes)
    cfg.validate()
    return sub_terrain_heights(cfg, difficulty, np.random.default_rng(seed))


def steepest(heights: np.ndarray) -> float:
    """The greatest step between neighbours [m]."""
    return max(float(abs(np.diff(heights, axis=i)).max()) for i in (0, 1))


def test_every_kind_that_the_package_exports_is_tested():
    exported = {n for n in terrains.__all__ if n.endswith("TerrainCfg")} - {"MeshRepeatedObjectsTerrainCfg"}  # a base
    assert exported == {type(cfg).__name__ for cfg in KINDS.values()}


@pytest.mark.parametrize("kind", KINDS)
def test_a_tile_is_finite_level_at_its_edges_and_the_same_for_the_same_seed(kind):
    heights = made(kind, 0.7)
    assert heights.shape == (61, 81)
    assert np.isfinite(heights).all()
    for edge in (heights[0], heights[-1], heights[:, 0], heights[:, -1]):
        assert not edge.any()
    np.testing.assert_array_equal(heights, made(kind, 0.7))
    drawn = {"random", "obstacles", "stones", "perlin", "grid", "grid_holes", "boxes", "cylinders", "pyramids"}
    assert (kind in drawn) == (not np.array_equal(heights, made(kind, 0.7, seed=1)))


@pytest.mark.parametrize("kind", [k for k in KINDS if k not in ("flat", "stones", "gap")])
def test_difficulty_1_is_steeper_than_0(kind):
    easy, middle, hard = (steepest(made(kind, d)) for d in (0.0, 0.5, 1.0))
    assert easy < middle < hard


@pytest.mark.parametrize("kind", ["stones", "gap", "star"])
def test_difficulty_1_leaves_less_ground_to_step_on_than_0(kind):
    easy, hard = (made(kind, d) for d in (0.0, 1.0))
    assert (hard > -0.06).sum() < 0.95 * (easy > -0.06).sum()


def test_stairs_are_steps_of_the_height_and_width_asked_for():
    heights = made("stairs", 1.0)[:, 40]  # from the edge at y = 0 through the middle
    assert not heights[:6].any()  # the border of 0.5 m
    # 6 m less two borders and the platform of 2 m leave 3 m: five steps of 0.3 m on each side
    expected = [0.23 * (1 + i // 3) for i in range(15)] + [0.23 * 6] * 10
    np.testing.assert_allclose(heights[6:31], expected, atol=1e-9)
    np.testing.assert_allclose(heights, heights[::-1], atol=1e-9)
    np.testing.assert_allclose(made("stairs", 0.0, inverted=True), -made("stairs", 0.0), atol=1e-9)


def test_a_slope_has_the_rise_asked_for_and_a_level_top():
    heights = made("slope", 1.0)[30]  # from the edge at x = 0 through the middle
    np.testing.assert_allclose(heights[3:20], 0.5 * STEP * np.arange(17), atol=2.6e-3)  # rounded to 5 mm
    assert np.ptp(heights[25:56]) < 1e-9
    assert not heights[:4].any()


def test_a_gap_is_as_wide_as_asked_for_and_the_platform_stands():
    heights = made("gap", 1.0)[30]
    np.testing.assert_allclose(heights[30:51], 0.0)  # the platform of 2 m about x = 4
    np.testing.assert_allclose(heights[51:60], -1.0)  # the opening of 1 m from x = 5 to x = 6
    np.testing.assert_allclose(heights[60:], 0.0)


def test_holes_of_stones_and_pits_have_their_depth():
    assert made("stones", 0.5).min() == pytest.approx(-1.0)
    assert made("pit", 1.0)[30, 40] == pytest.approx(-0.6)
    assert made("box", 1.0)[30, 40] == pytest.approx(0.6)
    assert sorted(set(made("pit", 1.0).round(6).ravel())) == [-0.6, -0.3, 0.0]
    assert sorted(set(made("rails", 1.0).round(6).ravel())) == [0.0, 0.25]


@pytest.mark.parametrize("kind", ["obstacles", "stones", "grid", "star", "gap", "rails"])
def test_the_platform_in_the_middle_is_level(kind):
    half = int(0.5 * KINDS[kind].platform_width / STEP + 1e-6)
    assert not made(kind, 1.0)[30 - half : 31 + half, 40 - half : 41 + half].any()


def test_heights_of_height_fields_are_multiples_of_the_vertical_scale():
    for kind in ("random", "wave", "perlin", "slope"):
        ratio = made(kind, 0.8, vertical_scale=0.02) / 0.02
        np.testing.assert_allclose(ratio, np.round(ratio), atol=1e-9)


def test_random_heights_stay_in_their_range():
    assert not made("random", 0.0).any()  # all have the least height
    heights = made("random", 1.0)
    assert heights.min() >= 0.0
    assert 0.08 < heights.max() <= 0.1


# -- the grid


def generator(**changes: Any) -> TerrainGenerator:
    kinds = {k: KINDS[k].copy() for k in ("slope", "stairs", "random", "stones")}
    kinds["stairs"].proportion = 2.0
    cfg = TerrainGeneratorCfg(size=SIZE, border_width=2.0, num_rows=4, num_cols=10, curriculum=True, sub_terrains=kinds)
    return TerrainGenerator(cfg.replace(**changes))


def test_tiles_stand_in_rows_along_x_and_columns_along_y():
    made_of = generator()
    ground, cells = made_of.ground, (80, 60)
    assert ground.heights.shape == (10 * 60 + 41, 4 * 80 + 41)
    assert ground.lower == pytest.approx((-4 * 4.0 - 2.0, -10 * 3.0 - 2.0))
    assert ground.tile == SIZE
    for row in range(4):
        for col in range(10):
            y, x = 20 + col * cells[1], 20 + row * cells[0]
            part = ground.heights[y : y + 61, x : x + 81]
            assert part.shape == (61, 81)
            np.testing.assert_allclose([part[0], part[-1]], 0.0, atol=1e-6)
            np.testing.assert_allclose([part[:, 0], part[:, -1]], 0.0, atol=1e-6)
            middle = [-16.0 + 8.0 * row + 4.0, -30.0 + 6.0 * col + 3.0, part[30, 40]]
            np.testing.assert_allclose(ground.origins[row, col], middle, atol=1e-5)
    border = ground.heights.copy()
    border[20:-20, 20:-20] = 0.0
    np.testing.assert_allclose(border, 0.0, atol=1e-6)


def test_a_curriculum_has_columns_of_one_kind_by_proportion_and_rows_of_rising_difficulty():
    made_of = generator(difficulty_range=(0.2, 0.8))
    kinds = made_of.kinds[0]
    assert (made_of.kinds == kinds).all()
    assert [list(kinds).count(k) for k in ("slope", "stairs", "random", "stones")] == [2, 4, 2, 2]
    bounds = 0.2 + 0.6 * np.arange(5) / 4
    assert (made_of.difficulties >= bounds[:-1, None]).all()
    assert (made_of.difficulties <= bounds[1:, None]).all()


def test_without_a_curriculum_kinds_and_difficulties_are_random():
    made_of = generator(curriculum=False, num_rows=20, border_width=0.0)
    share = (made_of.kinds == "stairs").mean()
    assert 0.3 < share < 0.5  # 0.4 expected of 200
    assert 0.4 < made_of.difficulties.mean() < 0.6
    assert len(set(made_of.kinds[:, 0])) > 1


def test_a_tile_depends_on_the_seed_and_on_its_place_alone():
    first, same, more = generator(), generator(), generator(num_cols=20, num_rows=4)
    np.testing.assert_array_equal(first.ground.heights, same.ground.heights)
    assert (generator(seed=3).ground.heights != first.ground.heights).any()
    wider = generator(border_width=4.0).ground.heights
    np.testing.assert_allclose(wider[20:-20, 20:-20], first.ground.heights, atol=1e-6)
    np.testing.assert_array_equal(more.difficulties[:, :10], first.difficulties)


def test_the_border_may_be_a_wall():
    heights = generator(border_height=-0.5).ground.heights
    np.testing.assert_allclose(heights[:20], 0.5, atol=1e-6)
    np.testing.assert_allclose(heights[20, 20:-20], 0.0, atol=1e-6)


def test_a_kind_of_ones_own():
    def ramp(difficulty: float, cfg: Any, rng: np.random.Generator) -> np.ndarray:
        return np.full((61, 81), 0.2 * difficulty)

    @configclass
    class RampCfg(SubTerrainBaseCfg):
        function: Any = ramp

    cfg = TerrainGeneratorCfg(size=SIZE, sub_terrains={"ramp": RampCfg()}, difficulty_range=(1.0, 1.0))
    ground = TerrainGenerator(cfg).ground
    np.testing.assert_allclose(ground.heights[1:-1, 1:-1], 0.2, atol=1e-6)
    wrong = TerrainGeneratorCfg(size=(4.0, 4.0), sub_terrains={"ramp": RampCfg()})
    with pytest.raises(ValueError, match=r"'ramp' returned heights of shape \(61, 81\), must be \(41, 41\)"):
        TerrainGenerator(wrong)


def test_the_ready_made_rough_ground():
    ground = TerrainGenerator(ROUGH_TERRAINS_CFG.replace(num_rows=2, num_cols=6, curriculum=True)).ground
    assert ground.origins.shape == (2, 6, 3)
    assert ROUGH_TERRAINS_CFG.num_rows * ROUGH_TERRAINS_CFG.num_cols == 200
    assert steepest(ground.heights) < 0.45


# -- wrong configs


@pytest.mark.parametrize(
    ("cfg", "message"),
    [
        (TerrainGeneratorCfg(size=(8.05, 8.0), sub_terrains={"flat": KINDS["flat"]}), r"size\[0\]: is 8.05 m"),
        (TerrainGeneratorCfg(size=SIZE, sub_terrains={}), "sub_terrains: has no kind"),
        (TerrainGeneratorCfg(size=SIZE, sub_terrains={"flat": KINDS["flat"]}, num_rows=0), "num_rows: is 0"),
        (
            TerrainGeneratorCfg(size=SIZE, sub_terrains={"flat": KINDS["flat"]}, difficulty_range=(0.0, 2.0)),
            "difficulty_range: is",
        ),
        (
            TerrainGeneratorCfg(
                size=SIZE, sub_terrains={"b": terrains.MeshBoxTerrainCfg(box_height_range=(0, 1), platform_width=9.0)}
            ),
            "sub_terrains.b.platform_width: with two borders is 9 m, the tile is 6 m",
        ),
        (TerrainGeneratorCfg(size=SIZE, sub_terrains={"b": 3}), "sub_terrains.b: is 3, must be a SubTerrainBaseCfg"),
        (terrains.MeshBoxTerrainCfg(box_height_range=(-0.1, 0.2)), "box_height_range: is .* must not be negative"),
        (terrains.HfRandomUniformTerrainCfg(noise_range=(0.1, 0.0), noise_step=0.01), "noise_range: is"),
        (terrains.HfRandomUniformTerrainCfg(noise_range=(0.0, 0.1), noise_step=0.0), "noise_step: is"),
        (FlatPatchSamplingCfg(num_patches=0, patch_radius=0.1, max_height_diff=0.1), "num_patches: is 0"),
        (TerrainImporterCfg(prim_path="/World/ground"), "terrain_generator: is None"),
        (TerrainImporterCfg(prim_path="/World/ground", terrain_type="hills"), "terrain_type: is 'hills'"),
        (TerrainImporterCfg(prim_path="/World/ground", terrain_type="usd", usd_path="/no"), "usd_path: '/no' does not"),
        (TerrainImporterCfg(prim_path="{ENV_REGEX_NS}/ground", terrain_type="plane"), "prim_path: is"),
    ],
)
def test_a_wrong_config_says_what_would_be_right(cfg, message):
    with pytest.raises(ConfigError, match=message):
        cfg.validate()
