# SPDX-License-Identifier: Apache-2.0
"""Distributed training by the command line: dying ranks, an interrupted launcher, torchrun; with gloo on the CPU."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from stripe_newton.rl import RunFolder, find_checkpoint, load_checkpoint, read_metrics
from tests.helpers.checkout import HELPERS, PYTHONPATH

pytestmark = pytest.mark.slow

TASK = "Fake-Dying-v0"


def start(how: str, *words: str, gpus: int = 2) -> subprocess.Popen:
    command = [
        sys.executable,
        "-m",
        "stripe_newton.cli",
        "--import",
        str(HELPERS / "dying_env.py"),
        "train",
        TASK,
    ]
    command += ["--device", "cpu", "--gpus", str(gpus), "--final-video", "False", *words]
    env = os.environ | {"PYTHONPATH": PYTHONPATH, "OMP_NUM_THREADS": "1", "DYING_HOW": how}
    return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def train(how: str, *words: str, gpus: int = 2) -> subprocess.CompletedProcess:
    process = start(how, *words, gpus=gpus)
    try:
        out, err = process.communicate(timeout=300)
    finally:
        process.kill()
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def the_run() -> RunFolder:
    (path,) = Path("logs/fake_cart").iterdir()
    return RunFolder(path)


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("kill", "error: rank 1 was ended by SIGKILL"),
        ("exit", "error: rank 1 ended with code 7"),
        ("raise", "error: rank 1 failed, which ended the run: ZeroDivisionError: the wheel fell off"),
    ],
)
def test_a_rank_that_dies_ends_the_run_with_its_message(how, message):
    ended = train(how, "--num-envs", "8", "--max-iterations", "100000")
    assert ended.returncode == 1
    assert message in ended.stderr
    assert ('dying_env.py", line' in ended.stderr) == (how == "raise")  # its traceback, and of no other rank
    assert "Connection closed" not in ended.stderr
    run = the_run()
    assert f"--gpus 2 --resume {run.path}" in ended.stderr
    assert find_checkpoint(run.path).name == "model_0.pt"
    again = train("", "--resume", str(run.path), "--max-iterations", "4")
    assert again.returncode == 0, again.stderr
    assert read_metrics(run.metrics)["iteration"] == [0, 1, 2, 3]


def test_interrupted_launcher_saves_and_goes_on():
    ended = train("interrupt", "--num-envs", "8", "--max-iterations", "100000")
    assert ended.returncode == 0, ended.stderr
    assert "stopping after this iteration" in ended.stderr
    run = the_run()
    last = int(read_metrics(run.metrics)["iteration"][-1])
    assert 2 <= last <= 4
    assert find_checkpoint(run.path).name == f"model_{last}.pt"
    assert f"--gpus 2 --resume {run.path}" in ended.stdout
    assert ended.stdout.count("run folder:") == 2  # rank 0's alone
    assert yaml.safe_load((run.params / "env.yaml").read_text())["scene"]["num_envs"] == 8

    alone = train("", "--resume", str(run.path), "--max-iterations", str(last + 3), gpus=1)
    assert alone.returncode == 0, alone.stderr
    assert "is of 2 processes, now there are 1: episodes start anew" in alone.stderr
    columns = read_metrics(run.metrics)
    assert columns["iteration"] == list(range(last + 3))
    assert columns["total_steps"] == [8 * 16 * (n + 1) for n in range(last + 3)]


def test_errors_of_the_user_are_told_once():
    ended = train("", "--num-envs", "7")
    assert ended.returncode == 2
    assert ended.stderr.count("7 environments cannot be split evenly over 2 processes; 8 can") == 1
    assert "Traceback" not in ended.stderr
    assert not Path("logs").exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_ranks_save_and_end_when_the_launcher_is_ended(number):
    launcher = start("", "--num-envs", "8", "--max-iterations", "100000")
    try:
        deadline = time.monotonic() + 200.0
        while not list(Path("logs").glob("*/*/checkpoints/model_2.pt")) and time.monotonic() < deadline:
            time.sleep(0.1)
        launcher.send_signal(number)
        launcher.communicate(timeout=200)  # the ranks hold its output open until they end
    finally:
        launcher.kill()
    assert launcher.returncode == (-number if number == signal.SIGKILL else 0)
    last = int(read_metrics(the_run().metrics)["iteration"][-1])
    assert find_checkpoint(the_run().path).name == f"model_{last}.pt"
    assert load_checkpoint(find_checkpoint(the_run().path))["stripe_newton"]["ranks"]


def test_torchrun():
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["-m", "stripe_newton.cli", "--import", str(HELPERS / "dying_env.py"), "train", TASK]
    command += ["--device", "cpu", "--num-envs", "8", "--max-iterations", "2", "--final-video", "False"]
    env = os.environ | {"PYTHONPATH": PYTHONPATH, "OMP_NUM_THREADS": "1"}
    ended = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert find_checkpoint(the_run().path).name == "model_1.pt"
    assert read_metrics(the_run().metrics)["total_steps"] == [128.0, 256.0]
