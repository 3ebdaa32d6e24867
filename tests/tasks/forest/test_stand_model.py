# SPDX-License-Identifier: Apache-2.0
"""Stand model: its rules, one by one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stripe_tasks.forest.growth import SPECIES, competition_index
from stripe_tasks.forest.stand_model import StandModel
from stripe_tasks.forest.traits import site_suitability


def test_competition_is_that_of_a_double_loop():
    rng = np.random.default_rng(0)
    size = (30.0, 20.0)
    xy, diameter = rng.random((60, 2)) * size, rng.uniform(0.02, 0.6, 60)
    expected = np.zeros(60)
    for i in range(60):
        for j in range(60):
            dx, dy = (min(abs(a - b), s - abs(a - b)) for a, b, s in zip(xy[i], xy[j], size))
            if i != j and math.hypot(dx, dy) <= 6.0:
                expected[i] += diameter[j] / diameter[i] / (math.hypot(dx, dy) + 1.0)
    np.testing.assert_allclose(competition_index(xy, diameter, size, 6.0), expected, rtol=1e-12)
    order = rng.permutation(60)
    np.testing.assert_allclose(
        competition_index(xy[order], diameter[order], size, 6.0), expected[order], rtol=1e-12
    )  # in whatever order the trees come


def test_an_index_does_not_see_what_is_out_of_reach():
    xy, diameter = np.array([[1.0, 1.0], [3.0, 1.0], [19.5, 1.0]]), np.array([0.2, 0.4, 0.1])
    index = competition_index(xy, diameter, (20.0, 20.0), 1.9)
    np.testing.assert_allclose(index, [0.5 / 2.5, 0.0, 2.0 / 2.5])  # 0 and 2 are 1.5 m apart around the edge


def model_of(*trees: tuple[float, float, float], name: str = "beech", size=(100.0, 100.0)) -> StandModel:
    """A model with trees at (x, y) of a diameter [m], all of them bearing seed."""
    model = StandModel(size, {name: SPECIES[name]}, np.ones(1), 100, {}, 0)
    x, y, diameter = np.array(trees).T
    model.plant(np.column_stack([x, y]), np.zeros(len(x), dtype=np.int32), np.ones(len(x)))
    model.trees.diameter, model.trees.stage = diameter, np.full(len(x), 100.0)
    return model


def test_half_of_the_seeds_fall_within_the_distance_of_the_species():
    for name in ("beech", "birch"):
        size = (4000.0, 4000.0)
        position, species = model_of((2000.0, 2000.0, 0.5), name=name, size=size).seeds(20_000)
        assert (species == 0).all()
        away = np.linalg.norm(position - 2000.0, axis=1)
        near = np.mean(away < SPECIES[name].dispersal)
        assert near == pytest.approx(0.5 * 0.95, abs=0.015)  # one in twenty comes from far away
        r = 3.0 * SPECIES[name].dispersal
        assert np.mean(away < r) == pytest.approx(0.9 * 0.95, abs=0.015)  # r^2 / (u + r^2) of the 2Dt kernel


def test_it_is_dark_below_crowns_and_there_is_no_room_in_trunks():
    model = model_of((50.0, 50.0, 0.5), (53.0, 50.0, 0.3), (99.9, 10.0, 0.5))
    places = np.array([[50.0, 50.3], [51.0, 50.0], [52.0, 51.0], [60.0, 60.0], [0.7, 10.0]])
    light, clear = model.light(places)
    assert clear.tolist() == [False, True, True, True, True]
    for place, share in zip(places, light):
        leaves = 0.0
        for at, crown in zip(model.trees.position, model.crown_radius()):
            dx, dy = (min(abs(a - b), 100.0 - abs(a - b)) for a, b in zip(place, at))
            leaves += 5.0 * max(1.0 - math.hypot(dx, dy) / (1.2 * crown), 0.0)
        assert share == pytest.approx(math.exp(-0.5 * leaves))
    assert light[3] == 1.0
    assert light[1] < 0.3
    assert light[4] < 0.3  # below a crown that reaches around the edge


def test_saplings_come_up_in_the_light():
    # a wood in the west, open ground in the east, and no young trees yet
    trees = [(x, y, 0.35) for x in np.arange(2.0, 60.0, 4.0) for y in np.arange(2.0, 100.0, 4.0)]
    light = {}
    for name in ("birch", "beech"):
        model = model_of(*trees, name=name)
        model.establish(200)
        assert len(model.trees.age) == len(trees) + 200
        saplings = model.trees.position[len(trees) :].copy()
        seeds, _ = model.seeds(4000)
        model.trees.keep(np.arange(len(trees) + 200) < len(trees))
        (here, _), (there, _) = model.light(saplings), model.light(seeds)
        assert here.mean() > there.mean() + 0.1  # lighter than where seeds fall
        light[name] = np.median(here)
    assert light["birch"] > light["beech"]  # which is the more shade-tolerant one


def test_the_weak_die_first():
    model = model_of(*((x, y, d) for x in (10.0, 40.0, 70.0) for y in (20.0, 70.0) for d in (0.4,)), *(
        (x + 1.0, y, 0.03) for x in (10.0, 40.0, 70.0) for y in (20.0, 70.0)
    ))  # fmt: skip
    model.compete()
    assert (model.trees.vigour[:6] > 2.0 * model.trees.vigour[6:]).all()
    model.advance(0.01, 6, 0)
    assert len(model.trees.age) == 6
    assert (model.trees.diameter > 0.3).sum() >= 5


def test_suitability_is_one_within_the_ranges_and_falls_outside():
    traits = SPECIES["oak"]
    moisture = np.array([0.0, 0.1, 0.25, 0.5, 0.7, 0.82])
    good = site_suitability(traits, moisture=moisture)
    np.testing.assert_allclose(good[2:5], 1.0)
    assert good[5] == pytest.approx(math.exp(-0.5))
    assert 0.02 <= good[0] < good[1] < 1.0
    np.testing.assert_allclose(
        site_suitability(traits, slope=np.radians([0.0, 20.0, 26.0, 60.0])), [1.0, 1.0, math.exp(-0.5), 0.0]
    )


def test_new_trees_bring_the_shares_to_those_asked_for():
    names = ("beech", "birch")
    model = StandModel((60.0, 60.0), {n: SPECIES[n] for n in names}, np.array([0.6, 0.4]), 100, {}, 0)
    model.plant(np.random.default_rng(0).random((50, 2)) * 60.0, np.zeros(50, dtype=np.int32), np.ones(50))
    assert model.wanted(50, np.ones(2, dtype=bool)).tolist() == [10, 40]
    assert model.wanted(20, np.ones(2, dtype=bool)).tolist() == [0, 20]
    assert model.wanted(20, np.array([True, False])).tolist() == [20, 0]  # birch finds no room
    model.establish(50)
    assert model.present().tolist() == [60, 40]
