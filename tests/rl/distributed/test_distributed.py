# SPDX-License-Identifier: Apache-2.0
"""Several processes that train one policy, with gloo on the CPU."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from stripe_newton.cli import main
from stripe_newton.rl import RunFolder, find_checkpoint, load_checkpoint, read_metrics
from stripe_newton.rl.distributed import as_rank, exchange, rank_device, world
from stripe_newton.rl.launcher import launch
from stripe_newton.rl.metrics import merge_rows
from tests.helpers.checkout import HELPERS, PYTHONPATH

TASK = "Fake-Dying-v0"


@pytest.fixture
def rank_environment(monkeypatch):
    """Sets what torchrun sets."""

    def put(rank: int, local_rank: int, size: int) -> None:
        values = {"RANK": rank, "LOCAL_RANK": local_rank, "WORLD_SIZE": size, "MASTER_ADDR": "x", "MASTER_PORT": 1}
        for name, value in values.items():
            monkeypatch.setenv(name, str(value))

    return put


def test_two_ranks(tmp_path, capfd, monkeypatch):
    """Equal parameters, averaged gradients, the update of one process, one set of files, exact resume."""
    monkeypatch.setenv("PYTHONPATH", PYTHONPATH)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    code, folder = launch([str(HELPERS / "rank_checks.py"), str(tmp_path)], 2)
    out, err = capfd.readouterr()
    assert code == 0, err
    assert folder is None
    assert out.count("all checks passed") == 1  # only rank 0 prints
    assert not {"STRIPE_NEWTON_LAUNCHER", "RANK"} & set(os.environ)


def test_which_rank_this_is(rank_environment, monkeypatch):
    assert world().size == 1
    assert as_rank(lambda: 3) == 3
    assert exchange("alone") == ["alone"]
    rank_environment(5, 1, 8)
    assert (world().rank, world().local_rank, world().size) == (5, 1, 8)
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 4)
    chosen = []
    monkeypatch.setattr("torch.cuda.set_device", chosen.append)
    monkeypatch.setattr("warp.set_device", chosen.append)
    assert rank_device(None, "cuda:0") == rank_device("cuda", None) == "cuda:1"
    assert chosen == [1, "cuda:1"] * 2
    assert rank_device("cpu", "cuda:0") == rank_device(None, "cpu") == "cpu"
    with pytest.raises(ValueError, match="CUDA_VISIBLE_DEVICES"):
        rank_device("cuda:2", None)
    rank_environment(5, 5, 8)
    with pytest.raises(ValueError, match=r"this is number 6, and the host has 4 GPUs"):
        rank_device(None, None)
    rank_environment(9, 1, 8)
    with pytest.raises(ValueError, match="below WORLD_SIZE"):
        world()
    monkeypatch.delenv("MASTER_PORT")
    with pytest.raises(ValueError, match="MASTER_PORT not set: start the processes with torchrun"):
        world()


def test_means_over_ranks():
    rows = [{"a": 1.0, "Perf/s": 5.0, "b": 7.0}, {"a": 2.0, "Perf/s": 9.0, "c": 3.0}]
    assert merge_rows(rows) == {"a": 1.5, "Perf/s": 5.0, "b": 7.0, "c": 3.0}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--gpus", "two"), "--gpus two: must be a whole number"),
        (("--gpus", "0"), "--gpus 0: must be at least 1"),
    ],
)
def test_wrong_numbers_of_gpus(capsys, words, message):
    assert main(["train", "Stripe-Cartpole-Direct-v0", *words]) == 2
    assert message in capsys.readouterr().err


def test_gpus_beside_torchrun(capsys, rank_environment):
    rank_environment(0, 0, 2)
    assert main(["train", "Stripe-Cartpole-Direct-v0", "--gpus", "3"]) == 2
    assert "torchrun has started 2 processes; leave --gpus out" in capsys.readouterr().err


# -- the command; each of these starts processes


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_errors_of_the_user_are_told_once():
    ended = train("", "--num-envs", "7")
    assert ended.returncode == 2
    assert ended.stderr.count("7 environments cannot be split evenly over 2 processes; 8 can") == 1
    assert "Traceback" not in ended.stderr
    assert not Path("logs").exists()


@pytest.mark.slow
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


@pytest.mark.slow
def test_torchrun():
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    command += ["-m", "stripe_newton.cli", "--import", str(HELPERS / "dying_env.py"), "train", TASK]
    command += ["--device", "cpu", "--num-envs", "8", "--max-iterations", "2", "--final-video", "False"]
    env = os.environ | {"PYTHONPATH": PYTHONPATH, "OMP_NUM_THREADS": "1"}
    ended = subprocess.run(command, env=env, capture_output=True, text=True, timeout=300)
    assert ended.returncode == 0, ended.stderr
    assert find_checkpoint(the_run().path).name == "model_1.pt"
    assert read_metrics(the_run().metrics)["total_steps"] == [128.0, 256.0]
