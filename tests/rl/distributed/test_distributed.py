# SPDX-License-Identifier: Apache-2.0
"""Distributed training: several processes train one policy, with gloo on the CPU."""

from __future__ import annotations

import os

import pytest

from stripe_newton.cli import main
from stripe_newton.rl.distributed import as_rank, exchange, rank_device, world
from stripe_newton.rl.distributed.launcher import launch
from stripe_newton.rl.runs.metrics_csv import merge_rows
from tests.helpers.checkout import HELPERS, PYTHONPATH


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
        (("--gpus", "two"), "Error parsing --gpus"),
        (("--gpus", "0"), "--gpus 0: must be at least 1"),
        (("--gpus", "1000000000"), "--gpus 1000000000: must be at most "),
    ],
)
def test_wrong_numbers_of_gpus(capsys, words, message):
    assert main(["train", "Stripe-Cartpole-Direct-v0", *words]) == 2
    assert message in capsys.readouterr().err


def test_gpus_beside_torchrun(capsys, rank_environment):
    rank_environment(0, 0, 2)
    assert main(["train", "Stripe-Cartpole-Direct-v0", "--gpus", "3"]) == 2
    assert "torchrun has started 2 processes; leave --gpus out" in capsys.readouterr().err
