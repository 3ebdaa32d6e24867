# SPDX-License-Identifier: Apache-2.0
"""Training with PPO: it learns, a resumed run equals an uninterrupted one, an interrupt saves."""

from __future__ import annotations

import itertools
import os
import re
import shutil
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from stripe_newton.rl import (
    CheckpointError,
    RunFolder,
    evaluate,
    find_checkpoint,
    load_checkpoint,
    read_metrics,
)
from stripe_newton.rl.runs import run_folder
from stripe_newton.rl.runs.run_folder import find_run
from tests.helpers.fake_env import FakeCartEnv, FakeCartRunnerCfg
from tests.helpers.fake_runner import flat, make_runner, rnd_cfg, rnn_cfg, rows


def on_the_clock(name: str) -> bool:
    return name.startswith("Perf/") or name == "elapsed_s"


def test_a_clock_that_jumps_does_not_reach_the_log(tmp_path, monkeypatch):
    import rsl_rl.runners.on_policy_runner as module

    jumps = itertools.cycle((0.0, 86400.0, -1.7e9, 3.0e9, -86400.0))
    monkeypatch.setattr(module, "time", SimpleNamespace(time=lambda: time.monotonic() + next(jumps)))
    agent = FakeCartRunnerCfg(max_iterations=6, save_interval=100)
    agent.runner = "rsl_rl"
    began = time.monotonic()
    assert make_runner(tmp_path, agent, num_envs=4).learn()
    lasted, columns = time.monotonic() - began, read_metrics(tmp_path / "metrics.csv")
    elapsed = columns["elapsed_s"]
    assert elapsed == sorted(elapsed)
    assert elapsed[0] >= 0.0
    assert elapsed[-1] <= 3.0 * lasted + 6.0
    assert all(value > 0.0 for value in columns["Perf/total_fps"])


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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupt_ends_after_the_iteration_with_a_checkpoint(tmp_path, capfd, number):
    runner = make_runner(tmp_path)
    previous = signal.getsignal(number)
    # A terminal that closes may send its signal twice, by the shell and by the system.
    times = 2 if number == signal.SIGHUP else 1
    runner.logger.iteration_hooks.append(lambda it: [os.kill(os.getpid(), number) for _ in range(times * (it == 3))])
    assert not runner.learn()
    assert signal.getsignal(number) is previous
    assert find_checkpoint(tmp_path).name == "model_3.pt"
    assert len(rows(tmp_path)) == 4
    again = make_runner(tmp_path)
    again.resume(find_checkpoint(tmp_path))
    assert again.learn()
    assert [row["iteration"] for row in rows(tmp_path)] == [str(n) for n in range(6)]
    assert "stopping after this iteration" in capfd.readouterr().err


def test_under_nohup_a_closed_terminal_changes_nothing(tmp_path):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        runner = make_runner(tmp_path)
        runner.logger.iteration_hooks.append(lambda it: os.kill(os.getpid(), signal.SIGHUP))
        assert runner.learn()
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


GONE = "was moved or deleted while the training runs; it is made again, without what was in it"


def test_a_run_folder_that_is_deleted_is_said_and_made_again(tmp_path, capsys):
    folder = RunFolder(tmp_path / "run")
    folder.write_task("Some-Task-v0")
    runner = make_runner(folder.path)

    def delete(iteration: int) -> None:
        while iteration == 2 and folder.path.exists():  # another thread may be writing the report
            shutil.rmtree(folder.path, ignore_errors=True)

    runner.logger.iteration_hooks.append(delete)
    assert runner.learn()
    err = capsys.readouterr().err
    assert f"warning: {folder.path}: {GONE}" in err
    assert folder.read_task() == "Some-Task-v0"
    assert folder.read_params()["agent"] == runner.agent_cfg.to_dict()
    assert [number for number, _ in folder.list_checkpoints()] == [2, 4, 5]
    # The row of an iteration after the deletion waits for the folder.
    assert [row["iteration"] for row in rows(folder.path)] == ["3", "4", "5"]


@pytest.mark.parametrize("moment", ["before the training", "before the first checkpoint"])
def test_a_run_folder_that_is_moved_at_once_is_said_and_made_again(tmp_path, capsys, monkeypatch, moment):
    folder, moved = RunFolder(tmp_path / "run"), tmp_path / "moved"
    folder.write_task("Some-Task-v0")
    runner = make_runner(folder.path)
    runner.task = "Some-Task-v0"
    with runner.run_folder.hold():
        if moment == "before the training":
            folder.path.rename(moved)
        else:
            runner.logger.iteration_hooks.append(lambda it: it == 0 and folder.path.rename(moved))
        assert runner.learn(2)
        assert capsys.readouterr().err.count(f"warning: {folder.path}: {GONE}") == 1
        assert folder.read_task() == "Some-Task-v0"
        assert [number for number, _ in folder.list_checkpoints()] == [0, 1]
        monkeypatch.setattr(run_folder, "_held", {})  # as in another process
        with pytest.raises(CheckpointError, match="another training runs in this folder"), folder.hold():
            pass
        monkeypatch.undo()
        with RunFolder(moved).hold():  # nothing holds the old one
            pass
    assert not (folder.path / "lock").exists()


def test_a_second_training_in_one_folder_is_refused(tmp_path, monkeypatch):
    first, second = make_runner(tmp_path), make_runner(tmp_path)
    with first.run_folder.hold():
        assert first.learn(1)  # it may hold it twice
        monkeypatch.setattr(run_folder, "_held", {})  # as in another process
        with pytest.raises(CheckpointError, match=rf"another training runs in this folder: process {os.getpid()} on "):
            second.learn()
    assert second.learn(1)
    assert not (tmp_path / "lock").exists()
    outside = tmp_path.parent / "outside"
    outside.mkdir()
    (tmp_path / "videos").symlink_to(outside)
    with pytest.raises(CheckpointError, match=r"videos: is a link to .*outside, outside of the run folder; remove it"):
        second.learn()


def test_links_of_files_do_not_lead_out_of_a_run(tmp_path):
    run = make_runner(tmp_path / "run").run_folder
    make_runner(tmp_path / "run").learn()
    (run.path / "newest.pt").symlink_to(find_checkpoint(run.path).resolve())
    run.check_links()
    for name in ("report.html", "params/system.yaml", "exported/policy.onnx"):
        (link := run.path / name).parent.mkdir(exist_ok=True)
        link.unlink(missing_ok=True)
        link.symlink_to(tmp_path / "precious")
        with pytest.raises(CheckpointError, match=rf"{name}: is a link to .*precious, outside of the run folder"):
            find_run(run.path)
        with pytest.raises(CheckpointError, match=rf"{name}: is a link"):
            run.check_links(link.parent if "/" in name else link)
        run.check_links(run.videos)
        link.unlink()


def test_a_run_whose_checkpoints_are_a_link_is_read_and_not_written(tmp_path):
    folder = make_runner(tmp_path / "run").run_folder
    make_runner(tmp_path / "run").learn()
    os.rename(folder.checkpoints, tmp_path / "elsewhere")
    folder.checkpoints.symlink_to(tmp_path / "elsewhere")
    newest = find_checkpoint(folder.path)
    assert RunFolder.of_checkpoint(newest).path == folder.path
    with pytest.raises(CheckpointError, match=r"checkpoints: is a link to .*elsewhere, outside of the run folder"):
        find_run(folder.path)


def test_a_run_says_what_its_checkpoints_will_take(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("stripe_newton.rl.runs.checkpoint._MUCH", 0.0)
    make_runner(tmp_path).learn()
    found = re.findall(
        r"checkpoints: 0\.\d MB each, 0\.\d of them the state of the environments; 2 more take", capsys.readouterr().err
    )
    assert len(found) == 1
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1000))
    make_runner(tmp_path / "full").learn(1)
    assert "warning: checkpoints: " in (err := capsys.readouterr().err)
    assert "but 0.0 GB are free in" in err


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
