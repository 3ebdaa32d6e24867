# SPDX-License-Identifier: Apache-2.0
"""Run commands: train, resume, eval and play, signals, and places that cannot be written."""

from __future__ import annotations

import errno
import json
import os
import signal
import subprocess
import sys
import time
import types
from pathlib import Path

import pytest
import torch
import yaml

from stripe_newton.cli import main, tasks
from stripe_newton.cli.field_options import apply_saved
from stripe_newton.cli.shell_command import command, program
from stripe_newton.configclass import configclass
from stripe_newton.rl import CheckpointError, DivergedError, RslRlVecEnvWrapper, find_checkpoint, read_metrics
from tests.helpers.checkout import HELPERS, PYTHONPATH
from tests.helpers.command_line import error_of, train
from tests.helpers.fake_env import TASK


def test_train_eval_play(capsys):
    pytest.importorskip("av")
    run = train("--num-envs", "8", "--seed", "5", "--agent.actor.hidden-dims", "8", "4", "--video-interval", "3")
    out = capsys.readouterr().out
    assert f"run folder: {run}" in out
    assert f"  {program()} play {TASK} --checkpoint {run}" in out
    names = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    assert names >= {
        *("params/env.yaml", "params/agent.yaml", "checkpoints/model_5.pt", "metrics.csv", "learning_curve.png"),
        *("params/system.yaml", "params/changes.yaml", "report.html"),
        *("videos/iteration_3.mp4", "videos/final_6.mp4", "exported/policy.pt", "exported/policy.onnx"),
    }
    agent = yaml.safe_load((run / "params/agent.yaml").read_text())
    env = yaml.safe_load((run / "params/env.yaml").read_text())
    assert (agent["seed"], env["seed"], env["scene"]["num_envs"]) == (5, 5, 8)
    assert agent["actor"]["hidden_dims"] == [8, 4]
    page = (run / "report.html").read_text()
    changes = yaml.safe_load((run / "params/changes.yaml").read_text())
    assert changes["agent.actor.hidden_dims"][1] == "[8, 4]"
    assert {"env.scene.num_envs", "agent.seed"} <= changes.keys()
    assert "final_6.mp4" in page
    assert "6 of 6 iterations" in page

    assert main(["eval", TASK, "--checkpoint", str(run), "--episodes", "5", "--json", "out/r.json"]) == 0
    result = json.loads(Path("out/r.json").read_text())
    assert list(result) == [
        "task",
        "episodes",
        "mean_return",
        "mean_length",
        "max_length",
        "terminated_rate",
        "success_rate",
        "metrics",
    ]
    assert (result["task"], result["episodes"], result["max_length"]) == (TASK, 5, 30)
    checkpoint = str(run / "checkpoints/model_5.pt")
    assert main(["eval", TASK, "--checkpoint", checkpoint, "--episodes", "5", "--json", "out/again.json"]) == 0
    assert json.loads(Path("out/again.json").read_text()) == result

    capsys.readouterr()
    assert main(["play", TASK, "--checkpoint", checkpoint, "--viewer", "video", "--steps", "3"]) == 0
    assert capsys.readouterr().out.strip().endswith("videos/play_model_5.mp4")
    assert main(["play", TASK, "--agent", "random", "--viewer", "none"]) == 0
    assert "30 steps of 16 environments" in capsys.readouterr().out


@pytest.mark.usefixtures("no_video")
def test_resume_takes_the_configuration_over(capsys):
    run = train("--num-envs", "8", "--max-iterations", "3", "--agent.algorithm.learning-rate", "0.002")
    assert "3 iterations are done, of 3" in error_of(capsys, "train", TASK, "--resume", str(run))
    assert main(["train", TASK, "--resume", str(run), "--max-iterations", "6"]) == 0
    assert read_metrics(run / "metrics.csv")["iteration"] == [0, 1, 2, 3, 4, 5]
    agent = yaml.safe_load((run / "params/agent.yaml").read_text())
    assert (agent["max_iterations"], agent["algorithm"]["learning_rate"]) == (6, 0.002)
    assert "env.scene.num_envs: was 8, is 4" in error_of(
        capsys, "train", TASK, "--resume", str(run), "--max-iterations", "9", "--num-envs", "4"
    )

    whole = train("--num-envs", "8", "--max-iterations", "6", "--agent.algorithm.learning-rate", "0.002")
    one, other = (torch.load(find_checkpoint(path))["actor_state_dict"] for path in (run, whole))
    assert all(torch.equal(value, other[name]) for name, value in one.items())


@pytest.mark.usefixtures("no_video")
def test_same_seed_same_policy():
    policies = []
    for seed in ("7", "7", "8"):
        run = train("--num-envs", "8", "--max-iterations", "2", "--seed", seed)
        policies.append(torch.load(find_checkpoint(run))["actor_state_dict"]["mlp.0.weight"])
    assert torch.equal(policies[0], policies[1])
    assert not torch.equal(policies[0], policies[2])


def test_live_view(monkeypatch, capsys):
    import stripe_newton.viewers

    seen = []

    class View:
        url = "http://localhost:1"

        def __init__(self, subject, **options):
            seen.append((subject.num_envs, options["title"], options["host"], options["port"]))
            options["reset"]()

        def steps(self, limit):
            yield from range(3)
            raise KeyboardInterrupt

        def close(self):
            seen.append("closed")

    monkeypatch.setattr(stripe_newton.viewers, "LiveViewer", View, raising=False)
    monkeypatch.setattr("stripe_newton.cli.live_view.check_installed", lambda: None)
    monkeypatch.setattr("stripe_newton.cli.play.check_installed", lambda: None)
    monkeypatch.setattr("tests.helpers.fake_env.FakeCartEnv.sim", types.SimpleNamespace(cfg=None), raising=False)
    steps = []
    monkeypatch.setattr(
        "stripe_newton.rl.RslRlVecEnvWrapper.step",
        lambda self, actions, step=RslRlVecEnvWrapper.step: (steps.append(1), step(self, actions))[1],
    )
    words = ["play", TASK, "--agent", "zero", "--viewer", "viser", "--num-envs", "2", "--host", "::1", "--port", "99"]
    assert main(words) == 0
    assert seen == [(2, TASK, "::1", 99), "closed"]
    assert len(steps) == 3
    assert "http://localhost:1" in capsys.readouterr().out


@pytest.mark.usefixtures("no_video")
def test_the_checkpoints_of_a_run_act_in_turn(monkeypatch):
    """`play --viewer viser` hands them to the viewer; the policy is the same object with other weights."""
    import stripe_newton.viewers

    run = train("--num-envs", "4", "--max-iterations", "4")
    files = dict(sorted((file.stem, file) for file in (run / "checkpoints").glob("model_*.pt")))
    *_, older, newest = files
    seen = []

    class View:
        url = "http://localhost:1"

        def __init__(self, subject, checkpoints, **options):
            self.checkpoints = checkpoints

        def steps(self, limit):
            for name in [None, older, newest]:
                if name is not None:
                    self.checkpoints.load(name)
                weights = self.checkpoints._runner.networks["actor"].state_dict()["mlp.0.weight"]
                seen.append((self.checkpoints.current, weights.clone(), self.checkpoints.names()))
                yield 0
            with pytest.raises(CheckpointError):
                self.checkpoints.load("model_99")
            assert self.checkpoints.current == newest

        def close(self):
            pass

    monkeypatch.setattr(stripe_newton.viewers, "LiveViewer", View, raising=False)
    monkeypatch.setattr("stripe_newton.cli.play.check_installed", lambda: None)
    monkeypatch.setattr("tests.helpers.fake_env.FakeCartEnv.sim", types.SimpleNamespace(cfg=None), raising=False)
    assert main(["play", TASK, "--checkpoint", str(run), "--viewer", "viser", "--num-envs", "2"]) == 0
    assert [name for name, _, _ in seen] == [newest, older, newest]
    for name, weights, names in seen:
        assert torch.equal(weights, torch.load(files[name])["actor_state_dict"]["mlp.0.weight"])
        assert names == list(files)
    assert not torch.equal(seen[0][1], seen[1][1])


def test_a_training_is_shown_only_while_somebody_looks(monkeypatch):
    import stripe_newton.viewers

    seen = []

    class View:
        url = "http://localhost:1"

        def __init__(self, subject, **options):
            assert options["reset"] is False
            assert not options["is_paced"]

        def has_clients(self):
            return 2 <= sum("iteration" in x for x in seen) < 4  # a browser comes after one iteration, and goes

        def set_status(self, lines):
            seen.append(lines)

        def after_step(self):
            seen.append("step")

        def serve(self):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            seen.append("closed")

    monkeypatch.setattr(stripe_newton.viewers, "LiveViewer", View, raising=False)
    monkeypatch.setattr("stripe_newton.cli.train.check_installed", lambda: None)
    monkeypatch.setattr("tests.helpers.fake_env.FakeCartEnv.sim", None, raising=False)
    train("--num-envs", "4", "--max-iterations", "5", "--viewer", "viser", "--final-video", "False")
    lines = [x["iteration"] for x in seen if isinstance(x, dict)]
    assert lines == [f"{i} of 5" for i in range(6)]
    begin, end = (
        next(i for i, x in enumerate(seen) if x != "step" and x.get("iteration") == f"{k} of 5") for k in (1, 3)
    )
    assert "step" in seen[begin:end]
    assert "step" not in seen[:begin] + seen[end:]
    assert seen[-1] == "closed"


def test_interrupted_command_leaves_a_run_that_goes_on():
    words = [sys.executable, "-m", "stripe_newton.cli", "--import", str(HELPERS / "fake_env.py"), "train", TASK]
    process = subprocess.Popen(
        [*words, "--device", "cpu", "--max-iterations", "100000"],
        env=os.environ | {"PYTHONPATH": PYTHONPATH, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 60.0
        while not list(Path("logs").glob("*/*/checkpoints/model_2.pt")) and time.monotonic() < deadline:
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == 0, err
    assert "stopping after this iteration" in err
    (run,) = Path("logs/fake_cart").iterdir()
    assert f"run folder: {run}" in out
    assert f"--resume {run}" in out
    last = read_metrics(run / "metrics.csv")["iteration"][-1]
    assert find_checkpoint(run).name == f"model_{last:.0f}.pt"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_while_the_environment_is_built_leaves_no_run(monkeypatch, number):
    from stripe_newton.cli import end_signals, env_and_policy

    before = signal.getsignal(number)
    monkeypatch.setattr(env_and_policy, "make_env", lambda *_: os.kill(os.getpid(), number))
    # Its thread, and the alarm below, end a process that goes on after the signal, as this one does.
    monkeypatch.setattr(end_signals, "_watch", lambda: None)
    signal.signal(number, signal.SIG_DFL)  # which the tests may be run without, under nohup
    try:
        end_signals.end_on_signals()
        assert main(["train", TASK, "--device", "cpu"]) == 128 + number
    finally:
        signal.alarm(0)
        end_signals.leave_signals()
        signal.signal(number, before)
    assert not list(Path("logs").glob("*/*"))


def test_errors_of_the_system_are_one_line(capsys, monkeypatch):
    from stripe_newton.cli import train as module

    def failing(error: Exception):
        def fail(*_, **__):
            raise error

        return fail

    for error, message in (
        (OSError(errno.ENOSPC, "No space left on device", "/full/x"), "'/full/x': No space left on device"),
        (MemoryError(), "out of memory: Python got none; use fewer environments"),
        (RuntimeError("Failed to allocate 9 bytes on device 'cpu'"), "out of memory: Failed to allocate 9 bytes"),
        (DivergedError("iteration 3: the loss value is nan"), "iteration 3: the loss value is nan"),
    ):
        monkeypatch.setattr(module, "load_configs", failing(error))
        found = error_of(capsys, "train", TASK)
        assert f"error: {message}" in found
        assert len(found.splitlines()) == 1
        if not isinstance(error, DivergedError):
            with monkeypatch.context() as patch:
                patch.setenv("STRIPE_NEWTON_TRACEBACK", "1")
                with pytest.raises(type(error)):
                    main(["train", TASK])


def test_places_are_tried_before_the_work(capsys, monkeypatch):
    from stripe_newton.cli import bench, env_and_policy

    def never(*_):
        raise AssertionError("the work had begun")

    monkeypatch.setattr(env_and_policy, "make_env", never)
    monkeypatch.setattr(bench, "measure", never)
    Path("file").touch()
    for words in (
        ("bench", TASK, "--json", "file/x.json"),
        ("inspect", TASK, "--out", "file/x"),
        ("compare", "file", "--out", "file/x"),
        ("train", TASK, "--log-dir", "file/x"),
    ):
        found = error_of(capsys, *words)
        assert "file/x" in found
        assert "Not a directory" in found
        assert len(found.splitlines()) == 1
    assert sorted(path.name for path in Path().iterdir()) == ["file"]


def test_a_run_of_another_machine_finds_the_files_of_this_one(tmp_path):

    here = tmp_path / "robot.usda"
    here.write_text("#usda 1.0")

    @configclass
    class Cfg:
        usd_path: str = str(here)
        other: str = str(here)

    cfg = Cfg()
    assert apply_saved(cfg, {"usd_path": "/elsewhere/robot.usda", "other": "/elsewhere/cart.usda"}, "env") == []
    assert cfg.usd_path == str(here)
    assert cfg.other == "/elsewhere/cart.usda"  # another file: the run's own, to be missed when it is opened


def test_the_commands_to_run_next_start_in_the_callers_shell(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "argv", [str(tmp_path / ".venv/bin/stripe-newton"), "train"])
    assert program() == ".venv/bin/stripe-newton"  # not on the PATH: where it lies, from here
    monkeypatch.setattr(sys, "argv", ["/somewhere/stripe_newton/cli/__main__.py"])
    assert program() == f"{sys.executable} -m stripe_newton.cli"
    script = tmp_path / "stripe-newton"
    script.write_text("#!/bin/sh\n")
    script.chmod(0o755)
    assert program() == "stripe-newton"
    monkeypatch.setattr(tasks, "_imported", ["my task.py"])
    assert command("play", "My-v0") == "stripe-newton play My-v0 --import 'my task.py'"
