# SPDX-License-Identifier: Apache-2.0
"""Loaded runs: folders and events as they are read, and what cannot be."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from stripe_newton.rl.experiments.loaded_runs import CompareError, find_runs, load_run
from tests.helpers.run_files import REWARD, write_run


def test_reading_a_run():
    run = load_run(write_run("one", [1.0, None, 3.0], seed=4, **{"Metrics/x": [5.0, 6.0, 7.0]}))
    assert run.x["iterations"].tolist() == [1.0, 2.0, 3.0]
    assert run.x["steps"].tolist() == [100.0, 200.0, 300.0]
    assert run.x["seconds"].tolist() == [2.0, 4.0, 6.0]
    np.testing.assert_array_equal(run.columns[REWARD], [1.0, np.nan, 3.0])
    assert run.columns["Metrics/x"].tolist() == [5.0, 6.0, 7.0]
    assert (run.config["env.scene.num_envs"], run.config["agent.seed"], run.config["run.task"]) == (10, 4, "Fake-v0")
    assert run.label == "fake"


def test_runs_below_a_folder_are_found():
    for name in ("a/one", "a/b/two", "three"):
        write_run(Path("logs") / name, [1.0])
    assert find_runs("logs") == [Path("logs/a/b/two"), Path("logs/a/one"), Path("logs/three")]
    assert find_runs("logs/three") == [Path("logs/three")]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_events_of_isaac_lab_are_read():
    from torch.utils.tensorboard import SummaryWriter

    values = [1.0, 2.5, 4.0]
    with SummaryWriter("isaac/2026-01-01") as writer:
        for step, value in enumerate(values):
            writer.add_scalar(REWARD, value, step, walltime=1000.0 + 3.0 * step)
            writer.add_scalar(f"{REWARD}/time", value, 77 + step)
            if step:
                writer.add_scalar("Metrics/base_velocity/error", -value, step, walltime=1000.5 + 3.0 * step)
    with SummaryWriter("isaac/2026-01-01") as writer:  # resumed from iteration 2
        writer.add_scalar(REWARD, 8.0, 2, walltime=1020.0)
    params = Path("isaac/2026-01-01/params")
    params.mkdir()
    (params / "env.yaml").write_text(
        "seed: 42\nscene:\n  num_envs: 64\nfunc: !!python/name:isaaclab.envs.mdp.foo ''\n"
        "pos: !!python/tuple\n- 0.0\n- 1.0\nids: !!python/object/apply:builtins.slice\n- null\n- null\n"
    )
    (params / "agent.yaml").write_text("seed: 42\nnum_steps_per_env: 24\n")
    run = load_run(find_runs("isaac")[0])
    assert list(run.columns) == [REWARD, "Metrics/base_velocity/error"]
    assert run.columns[REWARD].tolist() == [1.0, 2.5, 8.0]
    np.testing.assert_array_equal(run.columns["Metrics/base_velocity/error"], [np.nan, -2.5, -4.0])
    assert run.x["iterations"].tolist() == [1.0, 2.0, 3.0]
    assert run.x["steps"].tolist() == [64 * 24.0, 2 * 64 * 24.0, 3 * 64 * 24.0]
    assert run.x["seconds"].tolist()[:2] == [0.0, 3.0]
    assert run.config["env.pos"] == [0.0, 1.0]
    assert run.config["env.func"] == "name:isaaclab.envs.mdp.foo"


def test_what_cannot_be_read():
    with pytest.raises(CompareError, match="none: is not a folder"):
        find_runs("none")
    Path("empty").mkdir()
    with pytest.raises(CompareError, match="empty: contains no run"):
        find_runs("empty")
    with pytest.raises(CompareError, match="no iteration was logged"):
        load_run(write_run("started", []))
    (write_run("broken", [1.0]) / "metrics.csv").write_text("iteration,total_steps\n0,x\n")
    with pytest.raises(CompareError, match="broken: cannot be read"):
        load_run(Path("broken"))
    (write_run("foreign", [1.0]) / "metrics.csv").write_text("a,b\n0,1\n")
    with pytest.raises(CompareError, match=r"metrics\.csv has no column iteration"):
        load_run(Path("foreign"))


def test_commits_are_read_from_what_rsl_rl_writes():
    path = write_run("a", [1.0])
    (path / "git").mkdir()
    text = "--- git commit ---\n0123456789abcdef\n\n\n--- git status ---\nclean\n\n\n--- git diff ---\n"
    (path / "git" / "main.diff").write_text(text)
    (path / "git" / "own.diff").write_text(text + "+a line\n")
    config = load_run(path).config
    assert (config["git.main.commit"], config["git.main.uncommitted_changes"]) == ("0123456789", "none")
    assert re.fullmatch("[0-9a-f]{8}", config["git.own.uncommitted_changes"])
