# SPDX-License-Identifier: Apache-2.0
"""``--deterministic``: the same bits again and after a resume, and a refusal of what cannot give them."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from stripe_newton.cli import determinism
from stripe_newton.cli.user_error import UserError
from stripe_newton.rl import find_checkpoint, load_checkpoint
from stripe_newton.solvers import SolverFused
from tests.helpers.checkout import PYTHONPATH
from tools.checks.determinism import differences

TASK = "Stripe-Cartpole-Direct-v0"


@pytest.fixture
def settings_of_torch():
    threads, benchmark = torch.get_num_threads(), torch.backends.cudnn.benchmark
    yield
    torch.use_deterministic_algorithms(False)
    torch.backends.cudnn.benchmark = benchmark
    torch.set_num_threads(threads)


def env_with(device: str, solver: object) -> SimpleNamespace:
    sim = SimpleNamespace(device=device, solver=solver, is_static=False, describe_solver=lambda: "MuJoCo Warp")
    return SimpleNamespace(unwrapped=SimpleNamespace(sim=sim), num_envs=8)


def test_what_is_promised_and_what_is_refused(monkeypatch, settings_of_torch):
    monkeypatch.setattr(determinism, "is_simulated", lambda env: True)
    monkeypatch.setenv("CUBLAS_WORKSPACE_CONFIG", "")
    monkeypatch.delenv("CUBLAS_WORKSPACE_CONFIG")
    determinism.make_deterministic("cpu")
    assert torch.are_deterministic_algorithms_enabled()
    assert torch.get_num_threads() == 1
    assert os.environ["CUBLAS_WORKSPACE_CONFIG"] == ":4096:8"
    assert "this device, these versions, seed and 8 environments" in determinism.promise(env_with("cpu", object()))
    with pytest.raises(UserError, match="--deterministic: the physics is MuJoCo Warp; on a GPU its threads add forces"):
        determinism.promise(env_with("cuda:0", object()))
    monkeypatch.setattr(determinism, "world", lambda: SimpleNamespace(size=2))
    with pytest.raises(UserError, match="--deterministic: not with --gpus or torchrun"):
        determinism.make_deterministic("cpu")


@pytest.mark.parametrize(("unsupported", "refused"), [("", ""), ("a tendon", "MuJoCo Warp's threads add forces")])
def test_the_fused_solver_promises_what_it_steps_itself(monkeypatch, unsupported, refused):
    monkeypatch.setattr(determinism, "is_simulated", lambda env: True)
    solver = object.__new__(SolverFused)
    solver.unsupported = unsupported
    assert determinism.promise(env_with("cpu", solver))
    if not refused:
        assert determinism.promise(env_with("cuda:0", solver))
        return
    with pytest.raises(UserError, match=refused):
        determinism.promise(env_with("cuda:0", solver))


def test_differences():
    one = {"a": torch.tensor([1.0, float("nan")]), "logger": {"tot_time": 1.0}, "b": [1, (2.0,)]}
    same = {"a": torch.tensor([1.0, float("nan")]), "logger": {"tot_time": 2.0}, "b": [1, (2.0,)]}
    assert not list(differences(one, same))
    other = same | {"a": torch.tensor([-0.0, 1.0]), "b": [1, (3.0,)]}
    assert list(differences(one, other)) == ["a", "b.1.0"]


@pytest.mark.slow
def test_two_trainings_and_a_resumed_one_have_the_same_bits(tmp_path):
    def train(folder: Path, *words: str) -> Path:
        command = [sys.executable, "-m", "stripe_newton.cli", "train", TASK, "--deterministic", "--device", "cpu"]
        command += ["--num-envs", "4", "--final-video", "False", "--log-dir", str(folder), *words]
        # Threads of torch have no say in it.
        environment = os.environ | {"PYTHONPATH": PYTHONPATH, "OMP_NUM_THREADS": "2"}
        done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
        assert "deterministic: physics, sensors, rewards and networks give the same bits" in done.stdout
        return next(folder.glob("*/*"))

    one, two = (train(tmp_path / name, "--max-iterations", "4") for name in ("one", "two"))
    part = train(tmp_path / "part", "--max-iterations", "2")
    train(tmp_path / "part", "--resume", str(part), "--max-iterations", "4")
    contents = [load_checkpoint(find_checkpoint(run)) for run in (one, two, part)]
    assert not list(differences(contents[0], contents[1]))
    assert not list(differences(contents[0], contents[2]))
