# SPDX-License-Identifier: Apache-2.0
"""Training with PPO: it learns, a resumed run equals an uninterrupted one, an interrupt saves."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
import torch

from stripe_newton.rl import (
    RunFolder,
    evaluate,
    find_checkpoint,
    load_checkpoint,
)
from tests.helpers.fake_env import FakeCartEnv, FakeCartRunnerCfg
from tests.helpers.fake_runner import flat, make_runner, rnd_cfg, rnn_cfg, rows

pytestmark = pytest.mark.usefixtures("one_thread")


def on_the_clock(name: str) -> bool:
    return name.startswith("Perf/") or name == "elapsed_s"


def test_ppo_learns(tmp_path):
    agent = FakeCartRunnerCfg(max_iterations=25, save_interval=100)
    runner = make_runner(tmp_path, agent, num_envs=32)
    before = evaluate(runner.env, runner.get_inference_policy(), 32)
    assert runner.learn()
    after = evaluate(runner.env, runner.get_inference_policy(), 32)
    assert after.mean_return > before.mean_return + 5.0
    assert after.success_rate > 0.9


@pytest.mark.parametrize("agent", [FakeCartRunnerCfg, rnn_cfg, rnd_cfg], ids=["mlp", "rnn", "rnd"])
def test_resumed_run_equals_uninterrupted_one(tmp_path, agent):
    check_resume(tmp_path, agent, "cpu")


@pytest.mark.gpu
def test_resumed_run_equals_uninterrupted_one_on_a_gpu(tmp_path):
    check_resume(tmp_path, FakeCartRunnerCfg, "cuda:0")
    state = load_checkpoint(find_checkpoint(tmp_path / "whole"), "cuda:0")
    assert state["actor_state_dict"]["mlp.0.weight"].is_cuda
    assert not state["stripe_newton"]["rng"]["cuda"].is_cuda
    assert not load_checkpoint(find_checkpoint(tmp_path / "whole"))["actor_state_dict"]["mlp.0.weight"].is_cuda


def check_resume(folder: Path, agent, device: str) -> None:
    """Train six iterations at once, and three and three; compare everything but the clock, exactly."""
    whole, parts = folder / "whole", folder / "parts"
    make_runner(whole, agent(), device=device).learn()
    make_runner(parts, agent(), device=device).learn(3)
    assert [number for number, _ in RunFolder(parts).list_checkpoints()] == [0, 2]
    again = make_runner(parts, agent(), device=device)
    again.resume(find_checkpoint(parts))
    assert again.iterations_done == 3
    assert again.learn()

    expected, got = (flat(load_checkpoint(run / "checkpoints" / "model_5.pt")) for run in (whole, parts))
    assert expected.keys() == got.keys()
    assert len(expected) > 50
    for name, value in expected.items():
        if name == "stripe_newton/logger/tot_time":
            continue
        same = torch.equal(value, got[name]) if isinstance(value, torch.Tensor) else value == got[name]
        assert same, name

    first, second = rows(whole), rows(parts)
    assert [row["iteration"] for row in second] == [str(n) for n in range(6)]
    for one, other in zip(first, second, strict=True):
        assert {k: v for k, v in one.items() if not on_the_clock(k)} == {
            k: v for k, v in other.items() if not on_the_clock(k)
        }


def test_resume_from_an_earlier_checkpoint_leaves_no_double_rows(tmp_path, monkeypatch):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    from tensorboard.summary.writer import event_file_writer as events_of

    # files of one second are told apart by a count in their names, and read in the order of names: 10 before 9
    monkeypatch.setattr(events_of, "_global_uid", events_of.AtomicCounter(0))
    make_runner(tmp_path).learn()
    again = make_runner(tmp_path)
    again.resume(tmp_path / "checkpoints" / "model_2.pt")
    again.learn(1)
    assert [row["iteration"] for row in rows(tmp_path)] == ["0", "1", "2", "3"]
    assert find_checkpoint(tmp_path).name == "model_3.pt"
    assert {path.name for path in (tmp_path / "checkpoints" / "superseded").iterdir()} == {"model_4.pt", "model_5.pt"}
    events = EventAccumulator(str(tmp_path)).Reload()
    assert [event.step for event in events.Scalars("Loss/value")] == [0, 1, 2, 3]


def test_learn_again_goes_on_counting(tmp_path):
    runner = make_runner(tmp_path)
    runner.learn(2)
    runner.learn(2)
    assert [row["iteration"] for row in rows(tmp_path)] == ["0", "1", "2", "3"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupt_ends_after_the_iteration_with_a_checkpoint(tmp_path, capfd, number):
    runner = make_runner(tmp_path)
    previous = signal.getsignal(number)
    runner.logger.iteration_hooks.append(lambda it: os.kill(os.getpid(), number) if it == 3 else None)
    assert not runner.learn()
    assert signal.getsignal(number) is previous
    assert find_checkpoint(tmp_path).name == "model_3.pt"
    assert len(rows(tmp_path)) == 4
    again = make_runner(tmp_path)
    again.resume(find_checkpoint(tmp_path))
    assert again.learn()
    assert [row["iteration"] for row in rows(tmp_path)] == [str(n) for n in range(6)]
    assert "stopping after this iteration" in capfd.readouterr().err


def test_progress_is_one_short_line(tmp_path, capsys):
    make_runner(tmp_path).learn()
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 3
    assert lines[-1].startswith("iteration 6/6  reward")
    assert all(word in lines[-1] for word in ("length", "steps/s", "elapsed", "left"))


def test_checkpoint_of_an_environment_without_state(tmp_path, capsys, monkeypatch):
    monkeypatch.delattr(FakeCartEnv, "get_state")
    make_runner(tmp_path).learn(2)
    again = make_runner(tmp_path)
    again.resume(find_checkpoint(tmp_path))
    assert "episodes start anew" in capsys.readouterr().err
    assert again.logger.cur_episode_length.abs().sum() == 0
    assert again.learn(1)
