# SPDX-License-Identifier: Apache-2.0
"""Sweeps: search spaces, trials in processes, and their reports."""

from __future__ import annotations

import ast
import csv
import itertools
import json
import os
import signal
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import yaml

from tests.helpers.checkout import HELPERS

optuna = pytest.importorskip("optuna")

from stripe_newton.cli import main  # noqa: E402
from stripe_newton.cli import tasks as cli_tasks  # noqa: E402
from stripe_newton.cli import train_sweep as cli_sweep  # noqa: E402
from stripe_newton.cli.run_configs import Configs  # noqa: E402
from stripe_newton.cli.sweep_file import read_sweep_file  # noqa: E402
from stripe_newton.cli.user_error import UserError  # noqa: E402
from stripe_newton.rl.experiments.sweep import Sweep  # noqa: E402
from stripe_newton.rl.experiments.sweep_cfg import MedianPruning, Space, SweepCfg, words_of  # noqa: E402
from stripe_newton.rl.experiments.sweep_folder import SweepError  # noqa: E402
from stripe_newton.rl.experiments.sweep_process import Slot, end_with_sweep  # noqa: E402
from stripe_newton.rl.experiments.sweep_report import report  # noqa: E402
from stripe_newton.threads import PROCESSES  # noqa: E402
from tests.helpers.fake_env import TASK, FakeCartCfg, FakeCartRunnerCfg  # noqa: E402

FAKE = [sys.executable, str(HELPERS / "fake_training.py")]
CPU = Slot("the CPU", "cpu", {"CUDA_VISIBLE_DEVICES": ""})
GAMMA, LAM, DELAY = "agent.algorithm.gamma", "agent.algorithm.lam", "agent.algorithm.max-grad-norm"


def configs() -> Configs:
    env = FakeCartCfg()
    env.sim.device = "cpu"
    return Configs(env, FakeCartRunnerCfg())


def read(text: str) -> SweepCfg:
    path = Path("my.yaml")
    path.write_text(text, encoding="utf-8")
    return read_sweep_file(path, TASK, configs())[0]


def wrong(text: str) -> str:
    with pytest.raises(UserError) as caught:
        read(text)
    assert str(caught.value).startswith(("my.yaml: ", "--sweep my.yaml"))
    return str(caught.value)


def sweep(cfg: SweepCfg, slots: list[Slot] | None = None, folder: str = "sweep") -> tuple[Sweep, list[str]]:
    lines: list[str] = []
    return Sweep(cfg, Path(folder), slots or [CPU], FAKE, show=lines.append, poll_s=0.02), lines


def run(cfg: SweepCfg, slots: list[Slot] | None = None) -> tuple[Sweep, list[str]]:
    made, lines = sweep(cfg, slots)
    assert made.run()
    made.close()
    return made, lines


def cfg_of(**changes) -> SweepCfg:
    spaces = {GAMMA: Space(choices=(0.9, 0.5))}
    return SweepCfg(**{"task": TASK, "spaces": spaces, "seeds": (1, 2), "trials": 2, "max_iterations": 4} | changes)


def calls(folder: str = "sweep") -> list[dict]:
    """Every start of the fake training, in order."""
    lines = [line for file in Path(folder).rglob("calls.jsonl") for line in file.read_text().splitlines()]
    return sorted(map(json.loads, lines), key=lambda call: call["t"])


# -- the file


def test_a_file_says_what_is_tried():
    cfg = read(
        """
        agent.algorithm.learning-rate: [1e-4, 1e-3, 0.01]
        --agent.algorithm.gamma: {low: 0.9, high: 0.999}
        agent.algorithm.entropy_coef: {low: 1e-4, high: 1e-2, log: true}
        agent.algorithm.num-learning-epochs: {low: 2, high: 8, step: 2}
        agent.actor.hidden-dims: [[32, 32], [64]]
        agent.algorithm.schedule: {choices: [fixed, adaptive]}
        env.push: -2 2
        seeds: [1, 2, 3]
        trials: 20
        max-iterations: 30
        num_envs: 8
        objective: Train/mean_episode_length
        last: 5
        maximize: false
        pruner: {startup-trials: 3, warmup_iterations: 7}
        """
    )
    assert cfg.spaces == {
        "agent.algorithm.learning-rate": Space(choices=(1e-4, 1e-3, 0.01)),
        "agent.algorithm.gamma": Space(low=0.9, high=0.999),
        "agent.algorithm.entropy-coef": Space(low=1e-4, high=1e-2, log=True),
        "agent.algorithm.num-learning-epochs": Space(low=2, high=8, step=2, integer=True),
        "agent.actor.hidden-dims": Space(choices=("32 32", "64")),
        "agent.algorithm.schedule": Space(choices=("fixed", "adaptive")),
        "env.push": Space(choices=("-2 2",)),
    }
    assert (cfg.seeds, cfg.trials, cfg.sampler, cfg.max_iterations, cfg.num_envs) == ((1, 2, 3), 20, "tpe", 30, 8)
    assert (cfg.objective, cfg.last, cfg.maximize) == ("Train/mean_episode_length", 5, False)
    assert cfg.pruner == MedianPruning(3, 7, 1)


def test_what_a_file_leaves_out():
    cfg = read(f"{GAMMA}: [0.9, 0.99]\n{LAM}: [0.9, 0.95, 1.0]")
    assert (cfg.sampler, cfg.trials, cfg.seeds) == ("grid", 6, (FakeCartRunnerCfg().seed,))
    assert (cfg.objective, cfg.maximize, cfg.pruner) == ("Train/mean_reward", True, None)
    assert cfg.max_iterations == FakeCartRunnerCfg().max_iterations
    assert read("seeds: [1, 2, 3, 4]").trials == 1


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("agent.algorithm.lerning-rate: [1e-3]", ["agent.algorithm.lerning-rate", "no such field", "learning-rate"]),
        ("agent.algorithm: [1]", ["agent.algorithm: is a group of fields", "agent.algorithm.gamma"]),
        ("agent.algorithm.gamma: [high]", ["agent.algorithm.gamma: 'high' does not fit", "0.99", "float"]),
        ("agent.algorithm.num-learning-epochs: [1.5]", ["num-learning-epochs: 1.5 does not fit", "int"]),
        (
            "agent.algorithm.gamma: [0.9, 1.5]",
            ["agent.algorithm.gamma: 1.5 is rejected", "must be a number from 0 to 1"],
        ),
        ("env.limit: [-1.0]", ["env.limit: -1.0 is rejected", "must be above 0"]),
        ("agent.algorithm.gamma: []", ["agent.algorithm.gamma: has no values", "give a list"]),
        ("agent.algorithm.gamma: [0.9, 0.9]", ["agent.algorithm.gamma: has values twice"]),
        ("agent.algorithm.gamma: {low: 0.9, high: 0.9}\ntrials: 2", ["gamma: the range from 0.9 to 0.9 is empty"]),
        ("agent.algorithm.gamma: {low: 0.0, high: 0.9, log: true}\ntrials: 2", ["low is 0.0, must be above 0"]),
        ("agent.algorithm.gamma: {low: 0.5}", ["low or high is missing"]),
        ("agent.algorithm.gamma: {low: 0.5, hihg: 0.9}", ["'hihg' is not known"]),
        ("agent.algorithm.gamma: {low: 0.5, high: 0.9, step: 2}\ntrials: 2", ["step is 2", "within the range"]),
        ("agent.algorithm.schedule: {low: fixed, high: adaptive}", ["schedule: a range needs numbers", "list"]),
        ("agent.algorithm.gamma: {low: 0.5, high: 0.9}", ["trials: is missing"]),
        ("agent.algorithm.gamma: {low: 0.5, high: 0.9}\nsampler: grid", ["gamma: is a range", "sampler: tpe"]),
        ("agent.algorithm.gamma: [0.9, 0.8]\ntrials: 3", ["trials: is 3, but the grid has 2"]),
        ("agent.seed: [1, 2]", ["agent.seed: use 'seeds'"]),
        ("env.sim.device: [cpu]", ["env.sim.device: use the option --device"]),
        ("seeds: 3", ["seeds: is 3, must be a list"]),
        ("seeds: [1, 1]", ["seeds: is [1, 1]", "different"]),
        ("trials: 0", ["trials: is 0", "at least 1"]),
        ("sampler: bayes", ["sampler: is 'bayes'", "grid, random, tpe"]),
        ("objective: Train/reward", ["objective: there is no column 'Train/reward'", "Train/mean_reward"]),
        ("objective: reward", ["objective: is 'reward', must be a column of metrics.csv"]),
        ("maximize: up", ["maximize: is 'up', must be true or false"]),
        ("pruner: hyperband", ["pruner: is 'hyperband'", "median"]),
        ("pruner: {startup_trials: -1}", ["pruner: startup_trials is -1"]),
        ("trails: 3", ["trails: is not known", "did you mean 'trials'"]),
        ("name: a/b", ["name: is 'a/b'"]),
        ("- 1", ["contains list"]),
        ("a: [", ["is not valid YAML"]),
        ("sampler: bayes\nseeds: []", ["sampler: ", "\nmy.yaml: seeds: "]),
    ],
)
def test_a_bad_file_gets_one_message_that_says_what_is_right(text, parts):
    message = wrong(text)
    assert not [part for part in parts if part not in message], message


def test_a_file_that_is_not_there():
    with pytest.raises(UserError, match=r"--sweep none\.yaml: does not exist; give a YAML file"):
        read_sweep_file(Path("none.yaml"), TASK, configs())


def test_reading_leaves_the_configs_as_they_are():
    given = configs()
    Path("my.yaml").write_text(f"{GAMMA}: [0.5]\nenv.limit: [7.0]", encoding="utf-8")
    read_sweep_file(Path("my.yaml"), TASK, given)
    assert given.agent.to_dict() == configs().agent.to_dict()
    assert given.env.to_dict() == configs().env.to_dict()


def test_rewards_of_a_task_with_managers_are_known():
    from stripe_newton.cli.tasks import load_cfg

    task = "Stripe-Cartpole-v0"
    Path("my.yaml").write_text("objective: Episode_Reward/alive", encoding="utf-8")
    both = Configs(load_cfg(task, "env"), load_cfg(task, "agent"))
    assert read_sweep_file(Path("my.yaml"), task, both)[0].objective == "Episode_Reward/alive"
    Path("my.yaml").write_text("objective: Episode_Reward/alife", encoding="utf-8")
    with pytest.raises(UserError, match=r"there are Episode_Reward/"):
        read_sweep_file(Path("my.yaml"), task, both)


def test_words_of_values():
    assert [words_of(value) for value in (1e-4, 3, True, "32 64", "'a b' c")] == [
        ["0.0001"],
        ["3"],
        ["True"],
        ["32", "64"],
        ["a b", "c"],
    ]


# -- running


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


def test_a_sweep_that_goes_on_does_not_draw_the_same_again():
    cfg = cfg_of(spaces={GAMMA: Space(low=0.9, high=0.99)}, sampler="random", trials=2, seeds=(1,))
    run(cfg)
    made, _ = run(cfg_of(spaces=cfg.spaces, sampler="random", trials=4, seeds=(1,)))
    assert len({trial.params[GAMMA] for trial in made.study.get_trials()}) == 4


# -- stopping and going on

DRIVEN = {
    "task": TASK,
    "spaces": {GAMMA: Space(choices=(0.9, 0.5)), DELAY: Space(choices=(50.0,))},
    "seeds": (1, 2),
    "trials": 2,
    "max_iterations": 30,
}
DRIVER = f"""
import sys
from pathlib import Path
from stripe_newton.rl.experiments.sweep import Sweep
from stripe_newton.rl.experiments.sweep_cfg import Space, SweepCfg
from stripe_newton.rl.experiments.sweep_process import Slot
from math import nan
cfg = SweepCfg(**{DRIVEN!r})
sweep = Sweep(cfg, Path("sweep"), [Slot("A", "cpu"), Slot("B", "cpu")], sys.argv[1:], poll_s=0.02)
print("done" if sweep.run() else "stopped", flush=True)
sweep.close()
"""


def wait_for_iterations(process: subprocess.Popen, count: int) -> None:
    end = time.monotonic() + 60.0
    while time.monotonic() < end and process.poll() is None:
        files = list(Path("sweep").rglob("metrics.csv"))
        if len(files) == 2 and all(len(file.read_text().splitlines()) > count for file in files):
            return
        time.sleep(0.02)
    process.kill()
    pytest.fail("the runs did not begin")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_a_sweep_that_was_ended_goes_on(number):
    process = subprocess.Popen([sys.executable, "-c", DRIVER, *FAKE], stdout=subprocess.PIPE, text=True)
    wait_for_iterations(process, 3)
    process.send_signal(number)
    told = process.communicate(timeout=60)[0]
    assert ("stopped\n" in told) == (number != signal.SIGKILL)
    if number == signal.SIGKILL:
        with open("sweep/study.journal", "a") as journal:
            journal.write('{"op_code": 5, "half a li')  # as a kill within a write leaves it
    began = calls()
    assert len(began) == 2

    cfg = SweepCfg(**DRIVEN)
    made, told = sweep(cfg, [Slot("A", "cpu"), Slot("B", "cpu")])
    assert made.run()
    made.close()
    assert any(line.startswith("trial 0, seed 1 goes on") for line in told)
    later = calls()
    assert len(later) == 6  # both runs went on, the other two were begun
    resumed = [call for call in later if call["first"] > 0]
    assert len(resumed) == 2
    assert all("--resume" in call["options"] for call in resumed)
    runs = list(Path("sweep").rglob("metrics.csv"))
    assert len(runs) == 4
    for file in runs:
        with open(file, newline="") as lines:
            assert [int(row["iteration"]) for row in csv.DictReader(lines)] == list(range(30))
    made, told = sweep(cfg)
    assert made.run()
    made.close()
    assert not told
    assert len(calls()) == 6


@pytest.mark.parametrize("value", ["x", "", "99", "-1", "9" * 30])
def test_a_pipe_that_is_none_is_said_and_does_not_matter(monkeypatch, capsys, value):
    monkeypatch.setenv("STRIPE_NEWTON_SWEEP_PIPE", value)
    end_with_sweep()
    assert capsys.readouterr().err.startswith(f"warning: STRIPE_NEWTON_SWEEP_PIPE={value}: is no open pipe")
    assert "end_with_sweep" not in [thread.name for thread in threading.enumerate()]


def test_a_run_gets_one_interrupt_when_its_sweep_dies(monkeypatch):
    got: list[int] = []
    previous = signal.signal(signal.SIGINT, lambda number, frame: got.append(number))
    try:
        theirs, mine = os.pipe()
        monkeypatch.setenv("STRIPE_NEWTON_SWEEP_PIPE", str(theirs))
        end_with_sweep()
        assert "STRIPE_NEWTON_SWEEP_PIPE" not in os.environ  # what a run starts does not wait for it, too
        time.sleep(0.1)
        assert not got
        os.close(mine)
        end = time.monotonic() + 10.0
        while not got and time.monotonic() < end:
            time.sleep(0.01)
        time.sleep(0.1)
        assert got == [signal.SIGINT]
    finally:
        signal.signal(signal.SIGINT, previous)


def test_a_run_that_was_cut_before_its_first_checkpoint_begins_anew():
    left = Path("sweep/trials/0000/seed_1/fake/0")
    left.mkdir(parents=True)
    (left / "metrics.csv").write_text("iteration,total_steps,elapsed_s,Train/mean_reward\n0,1,1,5.0\n")
    run(cfg_of())
    assert not left.exists()
    assert all(call["first"] == 0 for call in calls())


def test_a_folder_is_for_one_sweep_at_a_time():
    made, _ = sweep(cfg_of())
    with pytest.raises(SweepError, match=rf"sweep: a sweep is running here \(process {os.getpid()} on "):
        sweep(cfg_of())
    made.close()
    sweep(cfg_of())[0].close()


def test_another_sweep_cannot_go_on_but_more_trials_can():
    run(cfg_of(trials=1))
    made, _ = run(cfg_of(trials=2))
    assert len([trial for trial in made.study.get_trials() if trial.state.name == "COMPLETE"]) == 2
    with pytest.raises(SweepError, match=r"sweep: contains another sweep.*seeds: was \[1, 2\], is \[1\].*'name'"):
        sweep(cfg_of(seeds=(1,)))
    sweep(cfg_of())[0].close()  # the folder was let go


# -- the command


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
