# SPDX-License-Identifier: Apache-2.0
"""Resumed runs: exactly, with changes, from damaged and foreign files, before the first checkpoint."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp
import yaml

from stripe_newton.cli import main
from stripe_newton.cli.env_and_policy import build
from stripe_newton.cli.run_configs import load_configs
from stripe_newton.cli.train_resume import check_changes, differences
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.managers import RunningNormCfg
from stripe_newton.rl import (
    CheckpointError,
    OnPolicyRunner,
    RslRlOnPolicyRunnerCfg,
    RslRlVecEnvWrapper,
    RunFolder,
    find_checkpoint,
    load_checkpoint,
    read_metrics,
    save_checkpoint,
)
from stripe_tasks.cartpole import CartpoleEnv, CartpoleEnvCfg, CartpolePPORunnerCfg
from stripe_tasks.cartpole.manager_based import CartpoleManagerPPORunnerCfg
from tests.helpers.cartpole_manager_env import rich
from tests.helpers.fake_env import TASK

STEPS = 16


def direct() -> CartpoleEnv:
    cfg = CartpoleEnvCfg(seed=3)
    cfg.sim.device, cfg.scene.num_envs = "cpu", 4
    return CartpoleEnv(cfg)


def managed() -> ManagerBasedRLEnv:
    """With noise, bias, history, delays, commands, interval events, and a curriculum that acts after the resume."""
    cfg = rich()
    cfg.curriculum["alive"].params["num_steps"] = 2 * STEPS + 5
    return ManagerBasedRLEnv(cfg)


def make_runner(make_env: Callable[[], Any], folder: Path | None, seed: int = 1) -> OnPolicyRunner:
    cfg: RslRlOnPolicyRunnerCfg = (CartpolePPORunnerCfg if make_env is direct else CartpoleManagerPPORunnerCfg)()
    cfg.num_steps_per_env, cfg.max_iterations, cfg.save_interval = STEPS, 4, 10
    env = make_env()
    torch.manual_seed(seed)
    np.random.seed(seed)  # noqa: NPY002
    return OnPolicyRunner(RslRlVecEnvWrapper(env), cfg, folder)


def leaves(value: Any, path: str = "") -> dict[str, Any]:
    if isinstance(value, (list, tuple)):
        value = dict(enumerate(value))
    if not isinstance(value, dict):
        return {path: value}
    return {k: v for name, item in value.items() for k, v in leaves(item, f"{path}/{name}").items()}


@pytest.mark.parametrize("make_env", [direct, managed])
def test_the_next_iterations_equal_those_of_an_uninterrupted_run(make_env, tmp_path):
    make_runner(make_env, tmp_path / "whole").learn()
    make_runner(make_env, tmp_path / "parts").learn(2)
    again = make_runner(make_env, tmp_path / "parts", seed=99)
    again.resume(find_checkpoint(tmp_path / "parts"))
    again.learn()
    one, other = (leaves(load_checkpoint(tmp_path / run / "checkpoints/model_3.pt")) for run in ("whole", "parts"))
    assert one.keys() == other.keys()
    for name, value in one.items():
        if name != "/stripe_newton/logger/tot_time":
            assert torch.equal(value, other[name]) if isinstance(value, torch.Tensor) else value == other[name], name
    arrays = "/stripe_newton/env/env/arrays/"
    assert len([name for name in one if name.startswith(arrays)]) > 15
    if make_env is managed:
        # The last observations are what the environment's buffer holds, and are written once.
        assert one["/stripe_newton/env/obs/policy"].data_ptr() == one[f"{arrays}context.obs.policy"].data_ptr()
        assert {f"{arrays}context.{name}" for name in ("rng", "parameters", "commands.place.command")} <= one.keys()
        early = leaves(load_checkpoint(tmp_path / "parts/checkpoints/model_1.pt"))
        name = f"{arrays}context.parameters"
        assert not torch.equal(one[name], early[name])  # the curriculum acted after the resume
    rows = [read_metrics(tmp_path / run / "metrics.csv") for run in ("whole", "parts")]
    for name in rows[0]:
        if not name.startswith("Perf/") and name != "elapsed_s":
            np.testing.assert_array_equal(rows[0][name], rows[1][name], name)


def test_new_episodes_keep_the_clock_and_what_curricula_changed(tmp_path):
    first = make_runner(managed, tmp_path)
    first.learn(3)
    again = make_runner(managed, None, seed=99)
    weights = wp.to_torch(again.env.unwrapped.context.arrays["parameters"])
    assert not torch.equal(weights, wp.to_torch(first.env.unwrapped.context.arrays["parameters"]))
    data = load_checkpoint(find_checkpoint(tmp_path))
    data["stripe_newton"]["ranks"] = [torch.zeros(3, dtype=torch.uint8)]  # as if it were of two ranks
    save_checkpoint(data, tmp_path / "two.pt")
    again.resume(tmp_path / "two.pt")
    assert torch.equal(weights, wp.to_torch(first.env.unwrapped.context.arrays["parameters"]))
    assert again.env.unwrapped.common_step_counter == 3 * STEPS
    assert again.env.episode_length_buf.unique().numel() > 1  # as at the beginning of a run
    assert again.iterations_done == 3
    assert again.alg.learning_rate == first.alg.learning_rate
    assert again.logger.tot_timesteps == first.logger.tot_timesteps
    again.resume(find_checkpoint(tmp_path), episodes=False)  # the user has changed the environment: its weights count
    assert again.env.unwrapped.common_step_counter == 3 * STEPS


# -- the command


@pytest.fixture
def no_files(monkeypatch):
    from stripe_newton.cli import train

    monkeypatch.setattr(train, "record_video", lambda *args, **kwargs: None)
    monkeypatch.setattr(train, "export_policy", lambda *args: "")


def train(*words: str) -> int:
    return main(["train", TASK, "--device", "cpu", "--final-video", "False", *words])


def new_run(iterations: int = 5) -> RunFolder:
    assert train("--num-envs", "8", "--max-iterations", str(iterations)) == 0
    (path,) = Path("logs/fake_cart").iterdir()
    return RunFolder(path)


@pytest.mark.usefixtures("no_files")
def test_changes_are_told_or_refused(capsys):
    run = new_run(2)
    resume = ["--resume", str(run.path)]
    before = {file: file.read_bytes() for file in run.path.rglob("*.pt")} | {
        file: file.read_bytes() for file in run.path.rglob("*.yaml")
    }
    capsys.readouterr()
    assert train(*resume, "--max-iterations", "3", "--env.limit", "3", "--agent.actor.hidden-dims", "8", "4") == 2
    error = capsys.readouterr().err
    assert "  env.limit: was 2.0, is 3.0\n" in error
    assert "  agent.actor.hidden_dims: was [16, 16], is [8, 4]\n" in error
    assert "add --allow-changes True" in error
    assert (
        train(*resume, "--max-iterations", "3", "--agent.actor.hidden-dims", "8", "4", "--allow-changes", "True") == 2
    )
    assert "has other networks or observations" in capsys.readouterr().err
    assert {file: file.read_bytes() for file in before} == before

    learning = ["--agent.algorithm.entropy-coef", "0.02", "--agent.algorithm.learning-rate", "0.0007"]
    learning += ["--agent.algorithm.schedule", "fixed", "--agent.save-interval", "7"]
    assert train(*resume, "--max-iterations", "3", *learning) == 0
    out = capsys.readouterr().out
    assert "  agent.algorithm.entropy_coef: was 0.01, is 0.02\n" in out
    assert "save_interval" not in out
    assert read_metrics(run.metrics)["Loss/learning_rate"][-1] == pytest.approx(0.0007)
    saved = run.read_params()["agent"]
    assert (saved["algorithm"]["entropy_coef"], saved["save_interval"]) == (0.02, 7)

    assert (
        train(*resume, "--max-iterations", "4", "--env.limit", "3", "--num-envs", "4", "--allow-changes", "True") == 0
    )
    assert read_metrics(run.metrics)["total_steps"] == [128.0, 256.0, 384.0, 448.0]
    assert run.read_params()["env"]["scene"]["num_envs"] == 4


def test_differences():
    one = {"env": {"a": 1, "b": {"c": [1]}, "sim": {"device": "cpu"}}, "agent": {"seed": 1}}
    other = {"env": {"a": 1, "b": {"c": [2], "d": 0}, "sim": {"device": "cuda:0"}}, "agent": {"seed": 1}}
    found = differences(one, other)
    assert found == {"env.b.c": ([1], [2]), "env.b.d": (None, 0), "env.sim.device": ("cpu", "cuda:0")}
    assert check_changes("run", {"env.sim.device": ("cpu", "cuda:0")}, allowed=False)
    assert not check_changes("run", found, allowed=True)
    assert check_changes("run", {"agent.clip_actions": (None, 1.0)}, allowed=True)


@pytest.mark.usefixtures("no_files")
def test_a_damaged_checkpoint_is_passed_over(capsys):
    run = new_run()
    newest, whole = (run.checkpoints / f"model_{k}.pt" for k in (4, 2))
    content = bytearray(newest.read_bytes())
    content[len(content) // 2] ^= 0xFF
    newest.write_bytes(content)
    assert find_checkpoint(run.path) == whole
    error = capsys.readouterr().err
    assert f"{newest}: is damaged: the checksum of" in error
    assert f"taking {whole.name} instead" in error
    newest.write_bytes(newest.read_bytes()[:3000])
    with pytest.raises(CheckpointError, match=r"model_4.pt: is damaged or cut short; .* whole is .*model_2.pt"):
        find_checkpoint(newest)
    assert train("--resume", str(run.path), "--max-iterations", "5") == 0
    assert f"continuing after iteration 3 of {whole}" in capsys.readouterr().out
    assert read_metrics(run.metrics)["iteration"] == [0, 1, 2, 3, 4]
    assert load_checkpoint(newest)["iter"] == 4
    for _, file in run.list_checkpoints():
        file.write_bytes(b"")
    assert train("--resume", str(run.path), "--max-iterations", "9") == 2
    assert "no checkpoint is whole" in capsys.readouterr().err


def test_foreign_files(tmp_path):
    archive = tmp_path / "sb3.zip"
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("policy.pth", "x")
    script = tmp_path / "script.pt"
    torch.jit.script(torch.nn.Linear(2, 2)).save(str(script))
    old = tmp_path / "old.pt"
    torch.save({"model_state_dict": {}, "iter": 3}, old)
    folder = tmp_path / "folder.pt"
    folder.mkdir()
    for path, message in (
        (archive, "sb3.zip: was not written by torch.save"),
        (script, "script.pt: is a packed archive, which torch.save does not write"),
        (old, "old.pt: is not a checkpoint of rsl_rl 5.*found keys"),
        (folder, "folder.pt: is a folder"),
    ):
        with pytest.raises(CheckpointError, match=message):
            load_checkpoint(path)


@pytest.mark.usefixtures("no_files")
def test_a_run_without_a_checkpoint_begins_anew(capsys):
    run = new_run(2)
    for _, file in run.list_checkpoints():
        file.unlink()
    (run.checkpoints / "model_0.pt.part").write_bytes(b"half")
    (run.params / "env.yaml.part").write_text("half")
    assert train("--resume", str(run.path)) == 0
    assert f"{run.path} contains no checkpoint yet: it starts anew" in capsys.readouterr().out
    assert read_metrics(run.metrics)["iteration"] == [0, 1]
    assert not list(run.path.rglob("*.part"))
    assert yaml.safe_load((run.params / "env.yaml").read_text())["scene"]["num_envs"] == 8
    (run.params / "env.yaml").unlink()
    for _, file in run.list_checkpoints():
        file.unlink()
    assert train("--resume", str(run.path)) == 2
    assert "env.yaml: is missing" in capsys.readouterr().err


def test_what_is_played_is_normalized_as_in_training(tmp_path):
    configs = load_configs("Stripe-Cartpole-v0", None)
    configs.env.sim.device, configs.env.scene.num_envs, configs.env.seed = "cpu", 8, 1
    configs.env.observations.policy.normalization = RunningNormCfg()
    runner = build("Stripe-Cartpole-v0", configs, tmp_path)
    runner.learn(2)
    path = "observations.policy.normalization.mean"
    mean = runner.env.unwrapped.context.arrays[path].numpy()
    assert (mean != 0.0).any()
    configs.env.scene.num_envs = 3
    played = build("Stripe-Cartpole-v0", configs, checkpoint=tmp_path / "checkpoints" / "model_1.pt")
    assert (played.env.unwrapped.context.arrays[path].numpy() == mean).all()
