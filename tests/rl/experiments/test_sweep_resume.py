# SPDX-License-Identifier: Apache-2.0
"""Sweeps that are stopped, and go on."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("optuna")

from stripe_newton.rl.experiments.sweep_cfg import Space, SweepCfg
from stripe_newton.rl.experiments.sweep_folder import SweepError
from stripe_newton.rl.experiments.sweep_process import Slot, end_with_sweep
from tests.helpers.fake_env import TASK
from tests.helpers.sweeps import DELAY, FAKE, GAMMA, calls, cfg_of, run, sweep


def test_a_sweep_that_goes_on_does_not_draw_the_same_again():
    cfg = cfg_of(spaces={GAMMA: Space(low=0.9, high=0.99)}, sampler="random", trials=2, seeds=(1,))
    run(cfg)
    made, _ = run(cfg_of(spaces=cfg.spaces, sampler="random", trials=4, seeds=(1,)))
    assert len({trial.params[GAMMA] for trial in made.study.get_trials()}) == 4


DRIVEN = {
    "task": TASK,
    "spaces": {GAMMA: Space(choices=(0.9, 0.5)), DELAY: Space(choices=(50.0,))},
    "seeds": (1, 2),
    "trials": 2,
    "max_iterations": 30,
}
DRIVER = f"""
import sys
import threading
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
