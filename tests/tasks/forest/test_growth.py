# SPDX-License-Identifier: Apache-2.0
"""Growth of stands: numbers, shares, spacing and sizes of trees."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from stripe_newton.configclass import ConfigError
from stripe_tasks.forest.growth import SPECIES, GrowthCfg, Stand, grow
from stripe_tasks.forest.traits import SpeciesTraits

SIZE = (200.0, 160.0)
EDGES = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 14.0])
ARRAYS = ("position", "species", "age", "height", "trunk_radius", "crown_radius", "vigour")


@functools.cache
def stand(density: float = 700.0, years: float = 120.0, seed: int = 3) -> Stand:
    return grow(GrowthCfg(size=SIZE, density=density, years=years, seed=seed))


def distances(a: np.ndarray, b: np.ndarray, size) -> np.ndarray:
    """All distances on the wrapped field, by brute force."""
    offset = np.abs(a[:, None] - b[None])
    return np.linalg.norm(np.minimum(offset, np.array(size) - offset), axis=-1)


def pair_correlation(xy: np.ndarray, size) -> np.ndarray:
    """Pairs per ring of EDGES over those of a Poisson process."""
    apart = distances(xy, xy, size)[~np.eye(len(xy), dtype=bool)]
    expected = len(xy) * (len(xy) - 1) / (size[0] * size[1]) * math.pi * np.diff(EDGES**2)
    return np.histogram(apart, EDGES)[0] / expected


@pytest.mark.parametrize(("density", "years"), [(150.0, 120.0), (700.0, 120.0), (700.0, 40.0), (2500.0, 80.0)])
def test_the_density_asked_for_is_what_stands(density, years):
    result = stand(density, years)
    assert result.density == pytest.approx(density, rel=0.01)
    assert len(grow(GrowthCfg(size=(60.0, 60.0), count=137))) == 137
    half = 0.5 * np.array(SIZE)
    assert (np.abs(result.position) <= half).all()
    assert np.abs(result.position).max(axis=0) == pytest.approx(half, abs=3.0)  # and fills the field


def test_trunks_keep_apart():
    result = stand()
    apart = distances(result.position, result.position, SIZE)
    np.fill_diagonal(apart, np.inf)
    gap = apart - result.trunk_radius[:, None] - result.trunk_radius[None]
    assert gap.min() > 0.29
    # and the nearest neighbours are those that a tree of positions finds
    near, _ = cKDTree(result.position + 0.5 * np.array(SIZE), boxsize=SIZE).query(
        result.position + 0.5 * np.array(SIZE), k=2
    )
    np.testing.assert_allclose(near[:, 1], apart.min(axis=1), atol=1e-9)


def test_big_trees_keep_their_distance_and_young_ones_flock():
    big, young = [], []
    for seed in (1, 2, 3):
        result = stand(seed=seed)
        order = np.argsort(-result.trunk_radius)
        big.append(pair_correlation(result.position[order[: round(0.2 * len(order))]], SIZE))
        young.append(pair_correlation(result.position[result.trunk_radius < 0.04], SIZE))
    big, young = np.mean(big, axis=0), np.mean(young, axis=0)
    assert (big[:4] < 0.95).all()  # up to 5 m
    assert big[0] < 0.3
    assert big[-1] == pytest.approx(1.0, abs=0.1)
    assert (young[1:4] > 1.1).all()
    assert young[-1] == pytest.approx(1.0, abs=0.15)


def test_chance_alone_would_neither_keep_apart_nor_flock():
    xy = np.random.default_rng(0).random((1500, 2)) * SIZE
    np.testing.assert_allclose(pair_correlation(xy, SIZE)[1:], 1.0, atol=0.12)


def test_there_are_fewer_trees_the_thicker_they_are():
    counts = np.histogram(2.0 * stand().trunk_radius, [0.0, 0.1, 0.2, 0.4, 0.8])[0]
    per_width = counts / np.array([0.1, 0.1, 0.2, 0.4])
    assert (np.diff(per_width) < 0.0).all()  # reverse J
    assert counts[-1] > 0


@pytest.mark.parametrize("density", [400.0, 600.0, 800.0])
def test_basal_area_is_that_of_grown_forests(density):
    result = stand(density)
    by_hand = sum(math.pi * r * r for r in result.trunk_radius) / (SIZE[0] * SIZE[1] / 1.0e4)
    assert result.basal_area == pytest.approx(by_hand)
    assert 20.0 < by_hand < 50.0


def test_a_young_forest_is_thin():
    young, old = stand(700.0, 20.0), stand(700.0, 120.0)
    assert young.basal_area < 0.3 * old.basal_area
    assert np.quantile(young.height, 0.9) < 0.6 * np.quantile(old.height, 0.9)
    assert young.age.max() < 40.0


def test_trees_have_sizes_of_their_species():
    result = stand()
    for kind, name in enumerate(result.species_names):
        traits, own = SPECIES[name], result.species == kind
        assert own.any()
        height, age = result.height[own], result.age[own]
        assert (height >= 1.3).all()
        assert (height <= traits.max_height).all()
        # none outgrows a tree without neighbours of its age
        free = traits.max_height * (1.0 - np.exp(-traits.growth_rate * (age + 1e-6))) ** traits.growth_shape
        assert (height <= free + 0.5).all()
        wide = traits.crown_scale * (2.0 * result.trunk_radius[own]) ** traits.crown_exponent
        assert (result.crown_radius[own] <= wide + 1e-9).all()
        assert (result.crown_radius[own] >= 0.5 * wide).all()
    assert ((result.vigour > 0.0) & (result.vigour <= 1.0)).all()
    slender = result.height / (2.0 * result.trunk_radius)
    assert np.median(slender[result.height > 15.0]) == pytest.approx(85.0, abs=25.0)


def test_height_and_diameter_follow_the_named_curves():
    for traits in SPECIES.values():
        age = traits.age_at(12.0)
        assert float(traits.height_at(np.array(age))) == pytest.approx(12.0)
        d = 100.0 * float(traits.diameter_at(np.array(12.0)))
        assert 1.3 + d**2 / (traits.hd_a + traits.hd_b * d) ** 2 == pytest.approx(12.0)


def test_species_follow_moisture():
    ramp = np.tile(np.linspace(0.0, 1.0, 65), (33, 1))  # dry in the west, wet in the east
    mix = {"pine": 1.0, "spruce": 1.0, "beech": 1.0}
    result = grow(GrowthCfg(size=SIZE, density=700.0, mix=mix, seed=1), moisture=ramp)
    wet = result.position[:, 0] / SIZE[0] + 0.5
    names = np.array(result.species_names)[result.species]
    shares = [(np.mean(names == n)) for n in mix]
    assert min(shares) > 0.1
    assert np.median(wet[names == "pine"]) < 0.35
    assert 0.4 < np.median(wet[names == "beech"]) < 0.6
    assert np.median(wet[names == "spruce"]) > 0.6
    assert np.mean(names[wet < 0.2] == "pine") > 0.6
    mirrored = grow(GrowthCfg(size=SIZE, density=700.0, mix=mix, seed=1), moisture=ramp[:, ::-1])
    pine = mirrored.position[np.array(mirrored.species_names)[mirrored.species] == "pine", 0]
    assert np.median(pine) > 0.15 * SIZE[0]


def test_rows_of_a_map_run_along_y():
    ramp = np.tile(np.linspace(0.0, 1.0, 33)[:, None], (1, 65))
    result = grow(GrowthCfg(size=SIZE, density=300.0, mix={"pine": 1.0}, years=40.0), moisture=ramp)
    assert np.median(result.position[:, 1]) < -0.2 * SIZE[1]
    assert abs(np.median(result.position[:, 0])) < 0.1 * SIZE[0]


def test_nothing_grows_on_a_cliff():
    steep = np.full((33, 65), 0.1)
    steep[:, 40:] = math.radians(75.0)  # its edge is at x = 200 (39 / 64 - 1 / 2)
    result = grow(GrowthCfg(size=SIZE, density=300.0, years=40.0), slope=steep)
    assert len(result) == 960
    assert result.position[:, 0].max() < SIZE[0] * (40.0 / 64.0 - 0.5)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("moisture", [None, 0.45])
def test_a_mix_is_kept_where_the_site_suits_all(seed, moisture):
    cfg = GrowthCfg(size=(120.0, 120.0), density=700.0, seed=seed)
    result = grow(cfg, moisture=None if moisture is None else np.full((5, 5), moisture))
    for kind, name in enumerate(result.species_names):
        assert np.mean(result.species == kind) == pytest.approx(cfg.mix[name], rel=0.35)
        assert result.height[result.species == kind].max() > 8.0  # not seedlings alone


def test_a_seed_says_all():
    cfg = GrowthCfg(size=(80.0, 90.0), density=700.0, seed=5)
    np.random.seed(1)  # noqa: NPY002
    first = grow(cfg)
    np.random.seed(2)  # noqa: NPY002
    again, other = grow(cfg), grow(cfg.replace(seed=6))
    for name in ARRAYS:
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
    assert first.position.tobytes() != other.position.tobytes()
    assert {len(getattr(first, name)) for name in ARRAYS} == {len(first)}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"size": (0.0, 10.0)}, "size: is"),
        ({"density": None}, "density: is None"),
        ({"density": -5.0}, "density: is -5.0"),
        ({"size": (10.0, 10.0), "count": 101}, "count: asks for 101 stems"),
        ({"years": 1.0}, r"years: is 1.0, must be in \[5, 2000\]"),
        ({"step": 0.0}, "step: is 0.0"),
        ({"mix": {}}, "mix: is {}"),
        ({"mix": {"oak": -1.0}}, "mix: is"),
    ],
)
def test_a_bad_config_is_refused(changes, says):
    with pytest.raises(ConfigError, match=says):
        grow(GrowthCfg(**changes))


def test_bad_maps_and_species_are_refused():
    cfg = GrowthCfg(size=(30.0, 30.0), count=5)
    with pytest.raises(ValueError, match=r"no species 'elm'; known are spruce, pine"):
        grow(cfg.replace(mix={"elm": 1.0}))
    with pytest.raises(ValueError, match=r"moisture is in \[0, 2\], must be in \[0, 1\]"):
        grow(cfg, moisture=np.array([[0.0, 1.0], [2.0, 1.0]]))
    with pytest.raises(ValueError, match=r"slope has the shape \(3,\)"):
        grow(cfg, slope=np.zeros(3))
    with pytest.raises(ValueError, match="no place of the field suits 'oak'"):
        grow(cfg.replace(mix={"oak": 1.0}), slope=np.full((4, 4), 1.3))
    with pytest.raises(ValueError, match="max_height is 40"):
        SpeciesTraits(40.0, 0.02, 1.3, 1.6, 0.2, 5.0, 0.6, 0.5, (0.0, 1.0), (0.0, 1.0), 10.0, 200.0, 30.0)


def test_a_forest_may_be_empty():
    assert len(grow(GrowthCfg(size=(30.0, 30.0), density=0.0))) == 0
