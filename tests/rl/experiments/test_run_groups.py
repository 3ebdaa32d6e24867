# SPDX-License-Identifier: Apache-2.0
"""Groups of runs: which runs belong together, their curves, tables and statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.stats

from stripe_newton.rl.experiments.comparison_report import differences_of
from stripe_newton.rl.experiments.loaded_runs import CompareError, load_run
from stripe_newton.rl.experiments.run_groups import (
    Group,
    curve_of,
    differing_fields,
    final_value,
    group_runs,
    pick_metrics,
    summarize,
    t_interval,
)
from tests.helpers.loaded_runs import loaded, runs_of
from tests.helpers.run_files import REWARD, write_run

LENGTH = "Train/mean_episode_length"


@pytest.mark.parametrize("count", [2, 3, 5, 30])
def test_the_interval_is_students(count):
    values = np.random.default_rng(count).normal(3.0, 2.0, (count, 7))
    mean, half = t_interval(values)
    for column in range(7):
        expected = scipy.stats.ttest_1samp(values[:, column], 0.0).confidence_interval(0.95)
        assert mean[column] - half[column] == pytest.approx(expected.low)
        assert mean[column] + half[column] == pytest.approx(expected.high)


def test_the_interval_covers_the_mean_as_often_as_it_says():
    draws = np.random.default_rng(0).normal(1.0, 1.0, (4, 20_000))
    mean, half = t_interval(draws)
    assert np.mean(np.abs(mean - 1.0) <= half) == pytest.approx(0.95, abs=0.005)


def test_a_single_run_has_no_interval():
    mean, half = t_interval(np.array([[1.0, 2.0]]))
    assert mean.tolist() == [1.0, 2.0]
    assert np.isnan(half).all()


def test_a_curve_over_places_that_all_runs_share():
    values = np.random.default_rng(1).normal(size=(3, 20))
    curve = curve_of(Group("g", [loaded(row) for row in values]), REWARD, "steps")
    np.testing.assert_allclose(curve.x, np.arange(1, 21) * 100)
    np.testing.assert_allclose(curve.mean, values.sum(0) / 3)
    sem = np.sqrt(((values - values.sum(0) / 3) ** 2).sum(0) / 2 / 3)
    np.testing.assert_allclose(curve.half, 4.302653 * sem, rtol=1e-6)  # tabulated: t, 2 degrees of freedom, 0.975


def test_a_curve_over_other_places_is_interpolated_where_all_runs_are():
    one = loaded([0.0, 10.0, 20.0], seconds=[0.0, 10.0, 20.0])
    two = loaded([5.0, 15.0, 35.0], seconds=[4.0, 8.0, 16.0])
    curve = curve_of(Group("g", [one, two]), REWARD, "seconds")
    assert (curve.x[0], curve.x[-1]) == (4.0, 16.0)
    middle = len(curve.x) // 2
    assert curve.x[middle] == 10.0
    assert curve.mean[middle] == pytest.approx((10.0 + 20.0) / 2)  # 10 s: the second is at 15 + 2 / 8 * 20
    late = loaded([1.0, 2.0], seconds=[30.0, 40.0])
    assert curve_of(Group("g", [one, late]), REWARD, "seconds") is None


def test_a_curve_leaves_out_what_was_not_logged():
    curve = curve_of(Group("g", [loaded([np.nan, np.nan, 3.0, 4.0])]), REWARD, "iterations")
    assert curve.x.tolist() == [3.0, 4.0]
    assert curve.mean.tolist() == [3.0, 4.0]
    assert curve_of(Group("g", [loaded([np.nan])]), REWARD, "iterations") is None
    assert curve_of(Group("g", [loaded([1.0])]), "Other/one", "iterations") is None


def test_long_curves_are_averaged_over_neighbours():
    values = np.random.default_rng(2).normal(size=1001)
    curve = curve_of(Group("g", [loaded(values)]), REWARD, "iterations")
    assert len(curve.x) == 300
    assert curve_of(Group("g", [loaded(values)]), REWARD, "iterations", None).mean.tolist() == values.tolist()
    edges = [int(1001 * at / 300) for at in range(301)]
    for at in (0, 7, 299):
        part = slice(edges[at], edges[at + 1])
        assert curve.mean[at] == pytest.approx(sum(values[part]) / len(values[part]))
        assert curve.x[at] == pytest.approx(np.arange(1, 1002)[part].mean())


def test_the_final_value_is_of_the_last_twentieth():
    values = list(range(100))
    assert final_value(loaded(values), REWARD) == pytest.approx((95 + 96 + 97 + 98 + 99) / 5)
    values[97] = np.nan
    assert final_value(loaded(values), REWARD) == pytest.approx((95 + 96 + 98 + 99) / 4)
    assert final_value(loaded([1.0, 7.0]), REWARD) == 7.0
    assert math.isnan(final_value(loaded([np.nan]), REWARD))


def test_the_table():
    good = Group(
        "good",
        [loaded([0, 4, 8, 10, 10], seconds=[2, 4, 6, 8, 10]), loaded([0, 6, 10, 10, 10], seconds=[1, 2, 3, 4, 5])],
    )
    poor = Group("poor", [loaded([0, 1, 2, 9, 3], seconds=[2, 4, 6, 8, 10])])
    never = Group("never", [loaded([np.nan] * 5)])
    rows = summarize([poor, never, good], REWARD)
    assert [row.group for row in rows] == ["good", "poor", "never"]
    assert (rows[0].final, rows[0].final_half, rows[0].best, rows[0].runs) == (10.0, 0.0, 10.0, 2)
    assert (rows[0].steps_to_reach, rows[0].seconds_to_reach) == (
        300.0,
        4.5,
    )  # the mean of 8 and 10 is 9, after 6 and 3 s
    assert (rows[1].final, rows[1].best, rows[1].steps_to_reach) == (3.0, 9.0, 400.0)
    assert math.isnan(rows[1].final_half)
    assert rows[1].seconds_to_reach == 8.0
    assert (rows[0].steps_per_s, rows[1].steps_per_s) == (75.0, 50.0)
    timeless = Group("t", [loaded([0.0, 1.0, 2.0], steps=[np.nan] * 3, seconds=[5, 6, 7])])
    assert summarize([timeless], REWARD)[0].seconds_to_reach == 7.0  # known without samples
    assert math.isnan(rows[2].final)
    assert math.isnan(rows[2].steps_to_reach)


def test_the_interval_of_the_table_is_over_runs():
    finals = [3.0, 5.0, 10.0]
    row = summarize([Group("g", [loaded([value]) for value in finals])], REWARD)[0]
    low, high = scipy.stats.t.interval(0.95, 2, loc=6.0, scale=scipy.stats.sem(finals))
    assert (row.final - row.final_half, row.final + row.final_half) == pytest.approx((low, high))


def test_negative_values_and_costs():
    groups = [Group("a", [loaded([-30.0, -11.0, -10.0])]), Group("b", [loaded([-30.0, -20.0, -12.0])])]
    rows = summarize(groups, REWARD)
    assert (rows[0].group, rows[0].steps_to_reach) == ("a", 200.0)  # -11: a tenth of 10 below -10
    assert math.isnan(rows[1].steps_to_reach)
    costs = [Group("a", [loaded([9.0, 5.0, 5.0])]), Group("b", [loaded([9.0, 2.2, 2.0])])]
    rows = summarize(costs, REWARD, minimize=True)
    assert [row.group for row in rows] == ["b", "a"]
    assert (rows[0].best, rows[0].steps_to_reach) == (2.0, 200.0)


def test_runs_that_differ_by_seed_are_one_group():
    groups = group_runs(runs_of(low=(0.9, 0.9), high=(0.99, 0.99, 0.99)))
    assert [(group.name, len(group.runs)) for group in groups] == [("gamma 0.9", 2), ("gamma 0.99", 3)]


def test_names_devices_and_seeds_do_not_make_groups():
    here = {"sim": {"device": "cuda:0"}, "scene": {"num_envs": 10}}
    there = {"sim": {"device": "cuda:3"}, "scene": {"num_envs": 10}}
    paths = [write_run("a", [1.0], 1, env=here), write_run("b", [1.0], 2, env=there, agent={"run_name": "x"})]
    assert [group.name for group in group_runs([load_run(path) for path in paths])] == ["fake"]
    cpu = load_run(write_run("c", [1.0], 1, env={"sim": {"device": "cpu"}, "scene": {"num_envs": 10}}))
    assert len(group_runs([*map(load_run, paths), cpu])) == 2


def test_groups_by_fields():
    runs = [
        load_run(write_run(f"{gamma}_{lam}", [1.0], agent={"algorithm": {"gamma": gamma, "lam": lam}}))
        for gamma in (0.99, 0.9)
        for lam in (0.5, 0.7)
    ]
    assert [group.name for group in group_runs(runs)] == [
        "gamma 0.9, lam 0.5",
        "gamma 0.9, lam 0.7",
        "gamma 0.99, lam 0.5",
        "gamma 0.99, lam 0.7",
    ]
    for name in ("agent.algorithm.gamma", "--agent.algorithm.gamma", "gamma"):
        assert [(group.name, len(group.runs)) for group in group_runs(runs, [name])] == [
            ("gamma 0.9", 2),
            ("gamma 0.99", 2),
        ]
    with pytest.raises(CompareError, match=r"--group-by gama: no run has this field"):
        group_runs(runs, ["gama"])
    with pytest.raises(CompareError, match=r"--group-by seed: .* it may be env\.seed, agent\.seed"):
        group_runs(runs, ["seed"])


def test_metrics_that_all_runs_have():
    one = load_run(
        write_run("a", [1.0], **{"Episode_Reward/up": [1.0], "Loss/value": [1.0], LENGTH: [1.0], "Metrics/m": [2.0]})
    )
    two = load_run(write_run("b", [1.0], **{"Episode_Reward/up": [1.0], "Loss/value": [1.0], LENGTH: [1.0]}))
    groups = [Group("a", [one]), Group("b", [two])]
    assert pick_metrics(groups) == [REWARD, LENGTH, "Episode_Reward/up"]
    assert pick_metrics(groups, ["Loss/*", "Metrics/m"]) == ["Loss/value", "Metrics/m"]
    with pytest.raises(CompareError, match=r"--metric Loss/valu: no run has it; there are Train/mean_reward"):
        pick_metrics(groups, ["Loss/valu"])


def test_only_fields_that_differ_between_groups_are_told():
    runs = runs_of(low=(0.9, 0.9), high=(0.99,))
    for number, run in enumerate(runs):
        run.config["git.main.commit"] = f"c{number}"
        run.config["run.version"] = "0.1"
    groups = group_runs(runs)
    assert differences_of(groups) == [
        ("agent.algorithm.gamma", ["0.9", "0.99"]),
        ("git.main.commit", ["c0, c1", "c2"]),
    ]
    assert differing_fields(run.config for run in runs) == ["agent.algorithm.gamma"]
