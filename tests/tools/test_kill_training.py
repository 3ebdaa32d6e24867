# SPDX-License-Identifier: Apache-2.0
"""Tool ``kill_training.py``: a training that is ended by signals and resumed, again and again."""

from __future__ import annotations

import itertools
import os
import signal

import pytest

from stripe_newton.rl import RunFolder, find_checkpoint, load_checkpoint, save_checkpoint
from tests.helpers.checkout import HELPERS, PYTHONPATH
from tools.checks import kill_training as tool


@pytest.fixture
def ranks_path(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", PYTHONPATH)
    monkeypatch.setenv("OMP_NUM_THREADS", "1")


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("after", [False, True])
def test_killed_inside_a_save(tmp_path, call, after):
    """In a process of its own, just before or after the file is flushed to the disk, or gets its name."""
    run = RunFolder(tmp_path)
    save_checkpoint({"actor_state_dict": {}, "iter": 1}, run.checkpoints / "model_1.pt")
    child = os.fork()
    if child == 0:
        do = getattr(os, call)

        def and_die(*args):
            if after:
                do(*args)
            os.kill(os.getpid(), signal.SIGKILL)

        setattr(os, call, and_die)
        save_checkpoint({"actor_state_dict": {}, "iter": 2}, run.checkpoints / "model_2.pt")
        os._exit(0)
    assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
    is_there = call == "replace" and after
    assert load_checkpoint(find_checkpoint(tmp_path))["iter"] == (2 if is_there else 1)
    assert len(list(run.checkpoints.glob("*.part"))) == (0 if is_there else 1)
    run.set_aside_after(2)
    assert not list(run.checkpoints.glob("*.part"))


@pytest.mark.slow
@pytest.mark.usefixtures("ranks_path")
def test_moments_of_all_kinds(tmp_path):
    options = ("--import", str(HELPERS / "fake_env.py"))
    training = tool.Training(tmp_path, "Fake-Cart-v0", options, seed=1)
    kinds = ["training", "saving", "training", "training", "anywhere"]
    endings = [signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGHUP]
    moments = tool.kill_and_resume(training, kinds, endings)
    assert [m.kind for m in moments] == kinds
    assert [m.signal for m in moments] == ["SIGKILL", "SIGKILL", "SIGTERM", "SIGHUP", "SIGKILL"]
    assert moments[0].done > 0
    assert moments[1].first == moments[0].saved
    assert (moments[2].lost, moments[3].lost) == (0, 0)
    assert tool.table(moments).count("\n") == 2 + 5


@pytest.mark.slow
@pytest.mark.usefixtures("ranks_path")
def test_twenty_moments(tmp_path):
    kinds = [tool.KINDS[number % len(tool.KINDS)] for number in range(20)]
    moments = tool.kill_and_resume(tool.Training(tmp_path, seed=2), kinds)
    assert any(m.half_written for m in moments)
    assert all(a.saved == b.first for a, b in itertools.pairwise(moments))
    assert moments[-1].saved > 20


def test_a_broken_promise_is_noticed(tmp_path):
    training = tool.Training(tmp_path)
    checkpoints = tmp_path / "logs" / "a" / "b" / "checkpoints"
    for number in (0, 5):
        save_checkpoint({"actor_state_dict": {}, "iter": number}, checkpoints / f"model_{number}.pt")
    assert training.look() == (0, 6)
    (checkpoints / "model_5.pt").write_bytes(b"PK")
    with pytest.raises(AssertionError, match="the newest checkpoint is damaged"):
        training.look()
    moment = tool.Moment("training", "SIGKILL", 1.0, first=0, done=9, saved=6, half_written=False, trained=True)
    assert moment.lost == 3
