# SPDX-License-Identifier: Apache-2.0
"""Full disk: by a limit on the size of files in this process, and by a small file system."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from stripe_newton.rl import (
    CheckpointError,
    OnPolicyRunner,
    RslRlVecEnvWrapper,
    find_checkpoint,
    load_checkpoint,
    read_metrics,
    save_checkpoint,
)
from stripe_newton.rl.errors import CheckpointWriteError
from stripe_newton.rl.runs.metrics_csv import MetricsCsv
from tests.helpers.checkout import PYTHONPATH, ROOT
from tests.helpers.fake_env import FakeCartCfg, FakeCartEnv, FakeCartRunnerCfg


@contextlib.contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """A write beyond so many bytes fails, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)


def make_runner(folder: Path) -> OnPolicyRunner:
    torch.manual_seed(1)
    cfg = FakeCartCfg()
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = "cpu", 4, 3
    return OnPolicyRunner(RslRlVecEnvWrapper(FakeCartEnv(cfg)), FakeCartRunnerCfg(), folder)


def test_a_checkpoint_that_does_not_fit(tmp_path):
    path = tmp_path / "model_1.pt"
    save_checkpoint({"iter": 0, "actor_state_dict": {"old": torch.ones(1)}}, path)
    with files_of_at_most(50_000), pytest.raises(CheckpointWriteError) as caught:
        save_checkpoint({"actor_state_dict": {"new": torch.ones(100_000)}}, path)
    text = str(caught.value)
    assert text.startswith(f"{path}: could not be written: File too large (it needs 0.40 MB, ")
    assert text.endswith(f" MB are free in {tmp_path})")
    assert list(load_checkpoint(path)["actor_state_dict"]) == ["old"]
    assert list(tmp_path.iterdir()) == [path]


def test_rows_wait_for_room(tmp_path):
    path = tmp_path / "metrics.csv"
    metrics = MetricsCsv(path)
    for number in range(100):
        metrics.write({"iteration": number, "a": 1.0 / 3.0})
    before = path.read_bytes()
    with files_of_at_most(len(before) + 10):
        for number in (100, 101):
            with pytest.raises(OSError, match=r"No space left|File too large"):
                metrics.write({"iteration": number, "a": 2.0 / 3.0})
        with pytest.raises(OSError, match=r"No space left|File too large"):
            metrics.write({"iteration": 102, "a": 2.0 / 3.0, "b": 1.0})
        assert path.read_bytes() == before
        assert list(tmp_path.iterdir()) == [path]
    metrics.write({"iteration": 103, "a": 0.5})
    columns = read_metrics(path)
    assert columns["iteration"] == list(range(104))
    assert columns["a"][-4:] == [2.0 / 3.0] * 3 + [0.5]
    assert columns["b"][-2] == 1.0


def test_training_goes_on_and_ends_with_an_error_if_the_last_checkpoint_fails_too(tmp_path, capsys):
    runner = make_runner(tmp_path)
    limit = contextlib.ExitStack()
    room = {1: 8_000, 4: 10**9}

    def change(iteration: int) -> None:
        if iteration in room:
            limit.close()
            limit.enter_context(files_of_at_most(room[iteration]))

    runner.logger.iteration_hooks.append(change)
    with limit:
        assert runner.learn()
    error = capsys.readouterr().err
    assert "model_2.pt: could not be written: File too large" in error
    assert "the training goes on and tries again at the next checkpoint" in error
    assert "Traceback" not in error
    assert {file.name for file in (tmp_path / "checkpoints").iterdir()} == {"model_0.pt", "model_4.pt", "model_5.pt"}
    assert read_metrics(tmp_path / "metrics.csv")["iteration"] == list(range(6))

    again = make_runner(tmp_path)
    again.resume(find_checkpoint(tmp_path))
    again.logger.iteration_hooks.append(change)
    room.clear()
    room[6] = 8_000
    limit = contextlib.ExitStack()
    with (
        limit,
        pytest.raises(CheckpointError, match=r"model_8.pt: could not .*; the newest checkpoint is .*model_5.pt"),
    ):
        again.learn(3)
    assert find_checkpoint(tmp_path).name == "model_5.pt"


DRIVER = """
import json, os, sys
from pathlib import Path
from stripe_newton.cli import main
from stripe_newton.rl import find_checkpoint, load_checkpoint, read_metrics
sys.path.insert(0, sys.argv[2])
import tests.helpers.fake_env as fake
disk = Path(sys.argv[1])
fill, steps = disk / "fill", [0]
step = fake.FakeCartEnv.step
def filling_step(self, action):
    steps[0] += 1
    if steps[0] == 16 * 3 + 5:  # in the fourth iteration
        with open(fill, "wb", buffering=0) as file:
            try:
                while file.write(bytes(1024)) == 1024:
                    pass
            except OSError:
                pass
    return step(self, action)
fake.FakeCartEnv.step = filling_step
words = ["train", fake.TASK, "--device", "cpu", "--num-envs", "4", "--log-dir", str(disk / "logs")]
code = main([*words, "--max-iterations", "9", "--final-video", "False"])
(run,) = (disk / "logs" / "fake_cart").iterdir()
newest = find_checkpoint(run)
parts = [str(path) for path in run.rglob("*.part")]
rows = read_metrics(run / "metrics.csv")["iteration"]
fill.unlink()
again = main(["train", fake.TASK, "--device", "cpu", "--resume", str(run), "--final-video", "False"])
after = read_metrics(run / "metrics.csv")["iteration"]
print(json.dumps([code, load_checkpoint(newest)["iter"], parts, rows, again, after]))
"""


def can_mount() -> bool:
    command = ["unshare", "-rm", "true"]
    with contextlib.suppress(OSError):
        return subprocess.run(command, capture_output=True).returncode == 0
    return False


@pytest.mark.slow
def test_a_full_disk(tmp_path):
    """A file system of 1 MB that is filled up while a training writes to it."""
    if not can_mount():
        pytest.skip("needs 'unshare -rm', for a small file system that nobody else sees")
    (tmp_path / "driver.py").write_text(DRIVER)
    disk = tmp_path / "disk"
    disk.mkdir()
    program = f"mount -t tmpfs -o size=1m none {disk} && exec {sys.executable} {tmp_path}/driver.py {disk} {ROOT}"
    ended = subprocess.run(
        ["unshare", "-rm", "sh", "-c", program],
        env=os.environ | {"PYTHONPATH": PYTHONPATH, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert ended.returncode == 0, ended.stderr
    code, newest, parts, rows, again, after = json.loads(ended.stdout.splitlines()[-1])
    assert (code, newest, parts) == (2, 2, [])
    assert rows == list(range(len(rows)))
    assert (again, after) == (0, list(range(9)))
    assert "No space left on device" in ended.stderr
    assert "error: " in ended.stderr
    assert "model_8.pt: could not be written: No space left on device (it needs " in ended.stderr
    assert "model_2.pt" in ended.stderr
    assert "Traceback" not in ended.stderr
