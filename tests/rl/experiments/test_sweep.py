# SPDX-License-Identifier: Apache-2.0
"""Sweeps: search spaces, trials in processes, and their reports."""

from __future__ import annotations

import csv
import itertools
import statistics
from pathlib import Path

import pytest

pytest.importorskip("optuna")

from stripe_newton.rl.experiments.sweep_cfg import MedianPruning, Space
from stripe_newton.rl.experiments.sweep_folder import SweepError
from stripe_newton.rl.experiments.sweep_process import Slot
from stripe_newton.rl.experiments.sweep_report import report
from tests.helpers.fake_env import TASK
from tests.helpers.sweeps import DELAY, GAMMA, LAM, calls, cfg_of, run, sweep


def test_each_trial_runs_with_each_seed_and_the_mean_counts():
    made, lines = run(cfg_of(num_envs=5, options=("--env.limit", "3.0"), last=2))
    trials = made.study.get_trials()
    assert [trial.params[GAMMA] for trial in trials] == [0.9, 0.5]
    for trial, gamma in zip(trials, (0.9, 0.5)):
        each = {str(seed): (1 - gamma) * (2 + 3) / 2 + 0.1 * seed for seed in (1, 2)}
        assert trial.user_attrs["values"] == pytest.approx(each)
        assert trial.value == pytest.approx(statistics.fmean(each.values()))
    assert made.study.best_trial.params == {GAMMA: 0.5}
    started = calls()
    assert len(started) == 4
    assert {call["gpu"] for call in started} == {""}
    first = started[0]["options"]
    assert started[0]["task"] == TASK
    assert first == {
        "--max-iterations": "4",
        "--env.limit": "3.0",
        "--num-envs": "5",
        f"--{GAMMA}": "0.9",
        "--seed": "1",
        "--device": "cpu",
        "--log-dir": "sweep/trials/0000/seed_1",
        "--final-video": "False",
    }
    assert "trial 1 done: Train/mean_reward 1.4" in lines[-1]
    assert Path("sweep/trials/0000/seed_1/output.txt").read_text() == "done\n"


def test_results_as_table_csv_and_picture():
    cfg = cfg_of(spaces={GAMMA: Space(choices=(0.9, 0.5)), LAM: Space(choices=(0.0, 0.95))}, trials=4)
    made, _ = run(cfg)
    table, best = report(made.study, cfg, Path("sweep"))
    assert best == {GAMMA: 0.5, LAM: 0.95}
    assert table.splitlines()[0].split() == ["trial", "Train/mean_reward", "±", "std", "gamma", "lam"]
    assert [line.split()[0] for line in table.splitlines()[2:]] == ["3", "1", "0", "2"]
    assert "seed 1 ended with code 1" in table
    with open("sweep/results.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["state"] for row in rows] == ["COMPLETE", "COMPLETE", "FAIL", "FAIL"]
    assert float(rows[0]["seed_2"]) == pytest.approx(0.5 * 1.5 + 0.2)
    assert float(rows[0]["objective"]) == pytest.approx(0.5 * 1.5 + 0.15)
    assert "RuntimeError: nothing to learn" in rows[2]["error"]
    assert Path("sweep/sweep.png").read_bytes().startswith(b"\x89PNG")


def test_a_failed_run_fails_its_trial_and_the_sweep_goes_on():
    made, lines = run(cfg_of(spaces={LAM: Space(choices=(0.0, 0.9))}))
    failed, done = made.study.get_trials()
    assert (failed.state.name, done.state.name) == ("FAIL", "COMPLETE")
    assert "seed 1 ended with code 1" in failed.user_attrs["error"]
    assert failed.user_attrs["error"].endswith("RuntimeError: nothing to learn")
    assert any("trial 0 failed: seed 1 ended with code 1" in line for line in lines)
    assert not Path("sweep/trials/0000/seed_2").exists()


def test_a_column_that_no_run_has_ends_the_sweep_with_those_there_are():
    made, _ = sweep(cfg_of(objective="Metrics/success"))
    with pytest.raises(
        SweepError, match=r"'Metrics/success' is not a column of sweep.*metrics.csv; there are iteration, .*mean_reward"
    ):
        made.run()
    made.close()
    assert len(calls()) == 1


def test_a_column_without_values_fails_the_trial():
    made, _ = run(cfg_of(objective="late", last=1, trials=1))
    error = made.study.get_trials()[0].user_attrs["error"]
    assert "seed 1: 'late' has no value in its last rows" in error


def test_one_process_a_slot():
    slots = [Slot(f"GPU {name}", "cuda:0", {"CUDA_VISIBLE_DEVICES": name}) for name in ("3", "5")]
    run(cfg_of(spaces={GAMMA: Space(choices=(0.9, 0.5)), DELAY: Space(choices=(50.0,))}), slots)
    started = calls()
    assert {call["gpu"] for call in started} == {"3", "5"}
    assert {call["options"]["--device"] for call in started} == {"cuda:0"}
    for name in ("3", "5"):  # four iterations of 50 ms: the next on that GPU begins after that
        times = [call["t"] for call in started if call["gpu"] == name]
        assert all(later - earlier > 0.19 for earlier, later in itertools.pairwise(times))


def test_a_trial_below_the_median_is_pruned():
    spaces = {GAMMA: Space(choices=(0.5, 0.6, 0.95)), DELAY: Space(choices=(20.0,))}
    pruner = MedianPruning(startup_trials=2, warmup_iterations=3)
    cfg = cfg_of(spaces=spaces, trials=3, max_iterations=25, pruner=pruner, last=1)
    made, lines = run(cfg)
    trials = made.study.get_trials()
    assert [trial.state.name for trial in trials] == ["COMPLETE", "COMPLETE", "PRUNED"]
    assert 3 <= trials[2].last_step < 25
    assert any("trial 2 pruned after" in line for line in lines)
    assert not Path("sweep/trials/0002/seed_2").exists()
    assert trials[0].intermediate_values[3] == pytest.approx(0.5 * 2 + 0.1)
    report(made.study, cfg, Path("sweep"))
    with open("sweep/results.csv", newline="") as file:
        assert int(list(csv.DictReader(file))[-1]["pruned_at"]) == trials[2].last_step


@pytest.mark.parametrize("sampler", ["random", "tpe"])
def test_samplers_stay_within_the_spaces(sampler):
    spaces = {
        GAMMA: Space(low=0.9, high=0.99),
        LAM: Space(low=1e-3, high=1.0, log=True),
        "agent.algorithm.num-learning-epochs": Space(low=2, high=8, step=2, integer=True),
    }
    made, _ = run(cfg_of(spaces=spaces, sampler=sampler, trials=4, seeds=(1,), max_iterations=1))
    tried = [trial.params for trial in made.study.get_trials()]
    assert len({params[GAMMA] for params in tried}) == 4
    for params in tried:
        assert 0.9 <= params[GAMMA] <= 0.99
        assert 1e-3 <= params[LAM] <= 1.0
        assert params["agent.algorithm.num-learning-epochs"] in (2, 4, 6, 8)
