# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: errors of those that are refused; a failed write leaves the old one."""

from __future__ import annotations

import os

import pytest
import torch

from stripe_newton.rl import (
    CheckpointError,
    find_checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from stripe_newton.rl.runs.training_state import set_learning_rate
from tests.helpers.fake_env import FakeCartRunnerCfg
from tests.helpers.fake_runner import make_runner


def test_checkpoint_errors(tmp_path):
    runner = make_runner(tmp_path / "run")
    runner.learn(1)
    good = find_checkpoint(tmp_path / "run")
    cut = tmp_path / "cut.pt"
    cut.write_bytes(good.read_bytes()[:2000])
    text = tmp_path / "text.pt"
    text.write_text("hello")
    foreign = tmp_path / "foreign.pt"
    torch.save({"model": torch.zeros(3)}, foreign)
    (tmp_path / "empty").mkdir()
    for path, message in (
        (cut, "damaged or cut short"),
        (text, "was not written by torch.save"),
        (foreign, "expected a dict with 'actor_state_dict'"),
        (tmp_path / "none.pt", "does not exist"),
    ):
        with pytest.raises(CheckpointError, match=message):
            runner.load(path)
    with pytest.raises(CheckpointError, match="contains no checkpoint"):
        find_checkpoint(tmp_path / "empty")
    with pytest.raises(CheckpointError, match="does not exist"):
        find_checkpoint(tmp_path / "nowhere")


def test_checkpoint_runs_no_code(tmp_path):
    marker = tmp_path / "ran"

    class Evil:
        def __reduce__(self):
            return os.system, (f"touch {marker}",)

    torch.save({"actor_state_dict": Evil()}, tmp_path / "evil.pt")
    with pytest.raises(CheckpointError, match="more than tensors and plain values"):
        load_checkpoint(tmp_path / "evil.pt")
    assert not marker.exists()


def test_checkpoint_of_other_networks_or_sizes(tmp_path):
    make_runner(tmp_path).learn(1)
    wide = FakeCartRunnerCfg()
    wide.actor.hidden_dims = (32, 16)
    with pytest.raises(CheckpointError, match="other networks"):
        make_runner(None, wide).load(find_checkpoint(tmp_path))
    with pytest.raises(CheckpointError, match="8 environments, there are 4"):
        make_runner(None, num_envs=4).resume(find_checkpoint(tmp_path))


def test_checkpoint_of_plain_rsl_rl_can_be_loaded_but_not_resumed(tmp_path):
    runner = make_runner(None)
    torch.save(runner.alg.save() | {"iter": 7, "infos": {"a": 1}}, tmp_path / "model_7.pt")
    other = make_runner(None)
    assert other.load(tmp_path / "model_7.pt") == {"a": 1}
    assert other.iterations_done == 8
    with pytest.raises(CheckpointError, match="no training state"):
        other.resume(tmp_path / "model_7.pt")


def test_training_goes_on_with_the_networks_of_a_checkpoint_without_state(tmp_path):
    runner = make_runner(None)
    set_learning_rate(runner.alg, 2.5e-4)
    torch.save(runner.alg.save() | {"iter": 7, "infos": None}, tmp_path / "model_7.pt")
    other = make_runner(None)
    other.resume(tmp_path / "model_7.pt", networks_alone=True)
    assert (other.iterations_done, other.alg.learning_rate) == (8, 2.5e-4)
    for one, two in zip(runner.alg.actor.parameters(), other.alg.actor.parameters(), strict=True):
        torch.testing.assert_close(one, two, rtol=0.0, atol=0.0)
    other.learn(1)
    assert other.iterations_done == 9


def test_a_failed_write_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "model_1.pt"
    save_checkpoint({"actor_state_dict": {}}, path)
    before = path.read_bytes()

    def fail(data, file):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(OSError, match="disk full"):
        save_checkpoint({}, path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["model_1.pt"]


def test_newest_checkpoint_is_by_number(tmp_path):
    for number in (9, 100, 20):
        save_checkpoint({}, tmp_path / "checkpoints" / f"model_{number}.pt")
    assert find_checkpoint(tmp_path).name == "model_100.pt"
    assert find_checkpoint(tmp_path / "checkpoints").name == "model_100.pt"
