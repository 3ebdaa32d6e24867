# SPDX-License-Identifier: Apache-2.0
"""The command of sweeps: its options, devices and report."""

from __future__ import annotations

import ast
import csv
import statistics
import sys
from pathlib import Path

import pytest
import yaml

pytest.importorskip("optuna")

from stripe_newton.cli import main
from stripe_newton.cli import tasks as cli_tasks
from stripe_newton.cli import train_sweep as cli_sweep
from stripe_newton.cli.user_error import UserError
from stripe_newton.threads import PROCESSES
from tests.helpers.fake_env import TASK
from tests.helpers.sweeps import FAKE, GAMMA, LAM


def command(*words: str) -> int:
    return main(["train", TASK, "--device", "cpu", "--sweep", "my.yaml", *words])


@pytest.fixture
def fake_children(monkeypatch):
    monkeypatch.setattr(cli_sweep, "child_command", lambda: FAKE)
    monkeypatch.setattr(cli_tasks, "_imported", [])


def test_the_command(fake_children, capsys):
    Path("my.yaml").write_text(f"{GAMMA}: [0.9, 0.5]\nseeds: [1, 2]\nmax_iterations: 3", encoding="utf-8")
    assert command("--num-envs", "6", "--env.limit", "3.0", "--log-dir", "here", "--jobs", "2") == 0
    out = capsys.readouterr().out
    assert f"train {TASK} --max-iterations 3 --env.limit 3.0 --num-envs 6 --{GAMMA} 0.5\n" in out
    folder = Path("here/fake_cart/sweep_my")
    assert {"results.csv", "sweep.png", "sweep.yaml", "study.journal", "trials"} <= {p.name for p in folder.iterdir()}
    assert yaml.safe_load((folder / "sweep.yaml").read_text())["options"] == ["--env.limit", "3.0"]
    assert [slot.environ[PROCESSES] for slot in cli_sweep.list_slots("cpu", 2)] == ["2", "2"]


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["--seed", "3"], "--seed: cannot be given beside --sweep; the seeds are in the file"),
        (["--agent.seed=3"], "--agent.seed: cannot be given beside --sweep"),
        (["--jobs", "0"], "--jobs 0: must be at least 1"),
        (["--log-dir", "taken"], "contains another sweep"),
    ],
)
def test_command_lines_that_do_not_fit(fake_children, capsys, words, part):
    Path("my.yaml").write_text(f"{GAMMA}: [0.9, 0.5]", encoding="utf-8")
    taken = Path("taken/fake_cart/sweep_my")
    taken.mkdir(parents=True)
    (taken / "sweep.yaml").write_text("task: Other-v0")
    assert command(*words) == 2
    assert part in capsys.readouterr().err
    assert not list(Path().rglob("trials"))


def test_jobs_need_a_sweep(capsys):
    assert main(["train", TASK, "--device", "cpu", "--jobs", "2"]) == 2
    assert "--jobs 2: is for sweeps; give --sweep FILE too" in capsys.readouterr().err


def test_no_trial_was_completed(fake_children, capsys):
    Path("my.yaml").write_text(f"{LAM}: [0.0]\nmax_iterations: 3", encoding="utf-8")
    assert command() == 2
    assert "no trial was completed; results.csv says why" in capsys.readouterr().err


def test_runs_import_what_the_command_imported():
    Path("some_own_tasks.py").write_text("")
    assert main(["--import", "some_own_tasks.py", "list"]) == 0
    words = cli_sweep.child_command()
    assert words[:3] == [sys.executable, "-m", "stripe_newton.cli"]
    assert words[-3:] == ["--import", "some_own_tasks.py", "train"]


def test_slots_of_gpus(monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 3)
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)

    def names(*args) -> list[str]:
        return [slot.environ["CUDA_VISIBLE_DEVICES"] for slot in cli_sweep.list_slots(*args)]

    assert names(None, None) == ["0", "1", "2"]
    assert names(None, 2) == ["0", "1"]
    assert names("cuda:1", None) == ["1"]
    assert names("cpu", 2) == ["", ""]
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,6,7")
    assert names("cuda", None) == ["4", "6", "7"]
    with pytest.raises(UserError, match=r"--jobs 4: a run has a GPU of its own, there are 3"):
        cli_sweep.list_slots(None, 4)


def test_nothing_else_imports_optuna():
    """Only two modules do, and none but they import those before a sweep is asked for."""
    package = Path(cli_sweep.__file__).parents[1]
    found: dict[str, set[str]] = {"optuna": set(), "sweep": set(), "sweep_folder": set()}
    for path in package.rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                last = name.split(".")[0] if name.startswith("optuna") else name.rpartition(".")[2]
                if last in found:
                    found[last].add(str(path.relative_to(package)))
    assert found == {
        "optuna": {"rl/experiments/sweep.py", "rl/experiments/sweep_folder.py"},
        "sweep": set(),
        "sweep_folder": {"rl/experiments/sweep.py"},
    }


@pytest.mark.slow
def test_a_sweep_of_cartpole(capsys):
    Path("cart.yaml").write_text(
        "agent.algorithm.learning-rate: [1e-3, 1e-2]\nseeds: [1, 2]\nmax_iterations: 3\nnum_envs: 4\n"
        "objective: Loss/value\nmaximize: false\nlast: 2\n"
    )
    words = ["train", "Stripe-Cartpole-Direct-v0", "--sweep", "cart.yaml", "--device", "cpu"]
    assert main(words) == 0
    folder = Path("logs/cartpole_direct/sweep_cart")
    with open(folder / "results.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2
    assert {row["state"] for row in rows} == {"COMPLETE"}
    for row in rows:
        each = []
        for seed in (1, 2):
            run_folder = next((folder / "trials" / f"{int(row['trial']):04d}" / f"seed_{seed}").rglob("metrics.csv"))
            with open(run_folder, newline="") as file:
                losses = [float(line["Loss/value"]) for line in csv.DictReader(file)]
            params = yaml.safe_load((run_folder.parent / "params" / "agent.yaml").read_text())
            assert len(losses) == 3
            assert (params["seed"], params["algorithm"]["learning_rate"]) == (
                seed,
                float(row["agent.algorithm.learning-rate"]),
            )
            each.append(statistics.fmean(losses[-2:]))
        assert float(row["objective"]) == pytest.approx(statistics.fmean(each))
    assert float(rows[0]["objective"]) <= float(rows[1]["objective"])
