# SPDX-License-Identifier: Apache-2.0
"""Export: files that act as the network does, their content, and how they are played."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from stripe_newton.cli import main
from stripe_newton.rl import (
    CheckpointError,
    ExportError,
    OnnxPolicy,
    OnPolicyRunner,
    RslRlCNNModelCfg,
    RslRlMLPModelCfg,
    RslRlRNNModelCfg,
    RslRlVecEnvWrapper,
    evaluate,
    export_policy,
    read_policy_metadata,
)
from stripe_newton.rl.export import exporter
from tests.helpers import fake_runner
from tests.helpers.checkout import ROOT
from tests.helpers.fake_env import TASK, FakeCartCfg, FakeCartEnv, FakeCartRunnerCfg
from tests.helpers.fake_runner import make_env

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")


@pytest.fixture(autouse=True)
def _one_thread_full_precision():
    threads, convolutions = torch.get_num_threads(), torch.backends.cudnn.allow_tf32
    torch.set_num_threads(1)
    torch.backends.cudnn.allow_tf32 = False  # or a recurrent network on a GPU would round
    yield
    torch.set_num_threads(threads)
    torch.backends.cudnn.allow_tf32 = convolutions
    torch.set_float32_matmul_precision("highest")


class PictureEnv(FakeCartEnv):
    """Also sees two channels of 12 by 16 pixels."""

    def _observe(self):
        shape = (self.num_envs, 2, 12, 16)
        picture = torch.rand(shape, generator=self.generator, device=self.device) + self.x[:, :1, None, None]
        return super()._observe() | {"camera": picture}


def agent_cfg(kind: str) -> FakeCartRunnerCfg:
    agent = FakeCartRunnerCfg(clip_actions=0.4, matmul_precision="highest")
    common = {
        "hidden_dims": (8,),
        "obs_normalization": kind != "camera",
        "distribution_cfg": RslRlMLPModelCfg.GaussianDistributionCfg(),
    }
    if kind in ("lstm", "gru"):
        layers = 2 if kind == "gru" else 1
        agent.actor = RslRlRNNModelCfg(rnn_type=kind, rnn_hidden_dim=6, rnn_num_layers=layers, **common)
    elif kind in ("camera", "camera and state"):
        convolution = RslRlCNNModelCfg.CNNCfg(output_channels=(4, 4), norm="batch")
        agent.actor = RslRlCNNModelCfg(cnn_cfg=convolution, **common)
        agent.obs_groups["actor"] = ["camera"] if kind == "camera" else ["policy", "camera"]
    elif kind == "two groups":
        agent.obs_groups["actor"] = ["policy", "critic"]
    return agent


def make_runner(kind: str = "mlp", device: str = "cpu") -> OnPolicyRunner:
    """A policy whose normalizer has seen something and whose output layer is not near zero."""
    torch.manual_seed(1)
    cfg = FakeCartCfg(seed=3)
    cfg.sim.device, cfg.scene.num_envs = device, 5
    agent = agent_cfg(kind)
    env = RslRlVecEnvWrapper((PictureEnv if "camera" in kind else FakeCartEnv)(cfg), agent.clip_actions)
    agent.algorithm.num_mini_batches = 1
    runner = OnPolicyRunner(env, agent)
    policy = runner.alg.get_policy()
    with torch.no_grad():
        for parameter in policy.mlp.parameters():
            parameter.mul_(2.0)
    policy.update_normalization(runner.env.get_observations()) if kind != "camera" else None
    return runner


KINDS = ("mlp", "two groups", "lstm", "gru", "camera", "camera and state")


@pytest.mark.parametrize("kind", KINDS)
def test_an_exported_policy_plays_as_the_network(kind, device, tmp_path):
    """Over episodes that end at different times, in all environments at once, with hidden states reset."""
    runner = make_runner(kind, device)
    found = export_policy(runner, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["policy.json", "policy.onnx", "policy.pt"]
    content = found.onnx.read_bytes()
    assert b"site-packages" not in content  # torch's notes of where code was
    assert str(ROOT).encode() not in content
    for result in found.metadata["check"]["results"].values():
        assert 0.0 <= result["largest_difference"] <= 1e-5
    assert found.metadata["check"]["largest_action"] > 0.05
    policy, mine = runner.get_inference_policy(), OnnxPolicy(found.onnx, runner.env)
    torch.set_float32_matmul_precision("highest")  # the runner's own products round to TF32 on a GPU
    obs, ended = runner.env.reset(seed=5), 0
    policy.reset()
    with torch.inference_mode():
        for _ in range(40):
            actions = mine(obs)
            torch.testing.assert_close(actions, policy(obs).clamp(-0.4, 0.4), rtol=1e-4, atol=1e-5)
            assert actions.device == obs.device or obs.device is None
            obs, _, dones, _ = runner.env.step(8.0 * actions)
            policy.reset(dones)
            mine.reset(dones)
            ended += int(dones.sum())
    assert 5 <= ended < 40
    one, other = (evaluate(runner.env, p, 8, seed=2) for p in (mine, policy))
    assert (one.mean_length, one.terminated_rate) == (other.mean_length, other.terminated_rate)
    assert one.mean_return == pytest.approx(other.mean_return, rel=1e-4)


@pytest.mark.parametrize("kind", ["mlp", "lstm"])
def test_torchscript_alone(kind, tmp_path):
    runner = make_runner(kind)
    module = torch.jit.load(export_policy(runner, tmp_path).torchscript)
    policy = runner.get_inference_policy()
    obs = runner.env.get_observations()[:1]
    with torch.inference_mode():
        first, second = policy(obs), policy(obs)
        for expected in (first, second):
            torch.testing.assert_close(module(obs["policy"]), expected, rtol=1e-4, atol=1e-5)
        module.reset()
        torch.testing.assert_close(module(obs["policy"]), first, rtol=1e-4, atol=1e-5)
    assert torch.equal(first, second) == (kind == "mlp")


def test_export_leaves_the_policy_as_it_was(tmp_path):
    """A training may go on: mode and hidden state are kept."""
    runner = make_runner("lstm")
    policy, obs = runner.alg.get_policy().train(), runner.env.get_observations()
    with torch.no_grad():
        policy(obs)
        hidden = [x.clone() for x in policy.get_hidden_state()]
        export_policy(runner, tmp_path)
    assert policy.training
    assert all(torch.equal(x, y) for x, y in zip(hidden, policy.get_hidden_state(), strict=True))


def test_a_policy_that_rounds_is_checked_without(device, tmp_path):
    """TF32 is switched off for the check, and on again."""
    runner = make_runner("lstm", device)
    torch.set_float32_matmul_precision("high")
    torch.backends.cudnn.allow_tf32 = True
    found = export_policy(runner, tmp_path)
    assert (torch.get_float32_matmul_precision(), torch.backends.cudnn.allow_tf32) == ("high", True)
    assert found.metadata["check"]["results"]["onnx"]["largest_difference"] < 1e-5


def test_metadata_is_the_same_in_all_files(tmp_path):
    runner = make_runner("two groups")
    found = export_policy(runner, tmp_path / "exported", task="Some-Task-v0", run="some_run")
    metadata = found.metadata
    for path in (found.onnx, found.torchscript, found.json, tmp_path / "exported", tmp_path):
        assert read_policy_metadata(path) == metadata
    assert (metadata["task"], metadata["run"], metadata["iteration"]) == ("Some-Task-v0", "some_run", 0)
    assert metadata["rates"] == {"physics_dt": 0.05, "decimation": 1, "step_dt": 0.1}
    assert metadata["actions"] == {"size": 1, "clip": 0.4, "terms": None}
    assert metadata["observations"] == [
        {"name": "policy", "shape": [2], "terms": None},
        {"name": "critic", "shape": [1], "terms": None},
    ]
    inputs = [{"name": "obs", "groups": ["policy", "critic"], "shape": ["batch", 3]}]
    assert (metadata["network"]["inputs"], metadata["network"]["states"]) == (inputs, [])
    assert metadata["versions"]["torch"] == torch.__version__
    assert json.loads(found.json.read_text()) == metadata


def test_the_normalizer_is_inside(tmp_path):
    """The network takes raw observations; what it does to them stands in the metadata."""
    runner = make_runner()
    metadata = export_policy(runner, tmp_path).metadata
    norm, seen = metadata["network"]["normalizer"], runner.env.get_observations()["policy"]
    np.testing.assert_allclose(norm["mean"], seen.mean(dim=0), rtol=1e-5)
    np.testing.assert_allclose(norm["std"], seen.std(dim=0, unbiased=False), rtol=1e-5)
    mean = torch.tensor([norm["mean"]])
    with torch.no_grad():
        at_mean = runner.alg.get_policy().mlp(torch.zeros(1, 2))
    torch.testing.assert_close(torch.jit.load(tmp_path / "policy.pt")(mean), at_mean, rtol=1e-4, atol=1e-5)


# -- what goes wrong


@pytest.mark.parametrize("changed", ["onnx", "torchscript"])
def test_a_network_that_acts_differently_is_refused(changed, tmp_path, monkeypatch):
    runner = make_runner()
    before = {
        path: path.read_bytes() for path in vars(export_policy(runner, tmp_path)).values() if isinstance(path, Path)
    }
    make = {"onnx": "as_onnx", "torchscript": "as_jit"}[changed]
    policy = runner.alg.get_policy()
    honest = getattr(policy, make)

    def wrong(**kwargs):
        network = honest(**kwargs)
        with torch.no_grad():
            network.mlp[-1].bias += 5e-4
        return network

    monkeypatch.setattr(type(policy), make, lambda self, **kwargs: wrong(**kwargs))
    with pytest.raises(ExportError, match=f"{changed}: the exported policy's actions differ .* by 0.0005"):
        export_policy(runner, tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_network_that_cannot_be_exported(tmp_path, monkeypatch):
    runner = make_runner()
    monkeypatch.delattr(type(runner.alg.get_policy()), "as_onnx")
    with pytest.raises(ExportError, match="MLPModel cannot be exported: AttributeError"):
        export_policy(runner, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("kind", ["mlp", "gru"])
def test_without_onnxruntime(kind, tmp_path, monkeypatch):
    """The slow evaluator of the package onnx checks; nothing can play."""
    runner = make_runner(kind)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    found = export_policy(runner, tmp_path)
    result = found.metadata["check"]["results"]["onnx"]
    assert "reference evaluator" in result["by"]
    assert result["largest_difference"] <= 1e-5
    with pytest.raises(CheckpointError, match=r"needs onnxruntime: pip install stripe-newton\[export\]"):
        OnnxPolicy(found.onnx, runner.env)
    monkeypatch.setattr(onnx.reference, "ReferenceEvaluator", None)
    found = export_policy(runner, tmp_path)
    assert found.metadata["check"]["results"]["onnx"]["largest_difference"] is None
    assert "onnx: not checked, install onnxruntime" in str(found)


def test_files_that_are_no_policies(tmp_path):
    found = export_policy(make_runner(), tmp_path / "out")
    env = make_env(num_envs=2)
    (tmp_path / "text.onnx").write_text("no network")
    model = onnx.load(str(found.onnx))
    later = next(p for p in model.metadata_props if p.key == "format_version")
    later.value = "99"
    onnx.save_model(model, str(tmp_path / "later.onnx"))
    later.value = "1"
    next(p for p in model.metadata_props if p.key == "observations").value = "[]"
    onnx.save_model(model, str(tmp_path / "blind.onnx"))
    next(p for p in model.metadata_props if p.key == "observations").value = "[{}]"
    onnx.save_model(model, str(tmp_path / "empty.onnx"))
    del model.metadata_props[:]
    onnx.save_model(model, str(tmp_path / "bare.onnx"))
    torch.save({"a": 1}, tmp_path / "other.pt")
    (tmp_path / "bad.json").write_text("{")
    for name, text in (
        ("missing.onnx", "does not exist"),
        ("text.onnx", "it is not an ONNX file"),
        ("bare.onnx", "has no metadata of a policy; was it written by 'stripe-newton export RUN'"),
        ("later.onnx", "has metadata of version 99, this package reads up to 1"),
        ("blind.onnx", "has wrong metadata: observations: lack the group 'policy' of the network"),
        ("empty.onnx", "has wrong metadata: observations.0.name: is missing, must be text"),
        ("other.pt", "it contains no metadata.json"),
        ("bad.json", "has no metadata of a policy"),
    ):
        with pytest.raises(CheckpointError) as caught:
            read_policy_metadata(tmp_path / name)
        assert text in str(caught.value)
        assert name in str(caught.value)
    with pytest.raises(CheckpointError, match="it is not an ONNX file"):
        OnnxPolicy(tmp_path / "text.onnx", env)


def test_observations_and_actions_that_do_not_fit(tmp_path):
    runner = make_runner("camera and state")
    found = export_policy(runner, tmp_path, task="Pictures-v0")
    env = make_env(num_envs=2)
    inner = env.unwrapped
    inner._observe = lambda: {"policy": inner.x.repeat(1, 2)}
    inner.single_action_space.shape  # noqa: B018 (one number)
    env.num_actions = 3
    with pytest.raises(CheckpointError) as caught:
        OnnxPolicy(found.onnx, env)
    assert str(caught.value).splitlines() == [
        f"{found.onnx} (of Pictures-v0) does not fit this environment:",
        "  observations 'policy': the policy reads (2,); the environment has (4,)",
        "  observations 'camera': the environment has no such group, but policy",
        "  actions: the policy returns 1, the environment takes 3",
    ]


# -- the commands


def trained(*args: str) -> Path:
    assert main(["train", TASK, "--device", "cpu", "--num-envs", "8", "--max-iterations", "2", *args]) == 0
    return max(Path("logs/fake_cart").iterdir(), key=lambda path: path.stat().st_mtime_ns)


@pytest.fixture
def no_video(monkeypatch):
    from stripe_newton.cli import train

    monkeypatch.setattr(train, "record_video", lambda *args, **kwargs: None)


@pytest.mark.usefixtures("no_video")
def test_train_export_eval_play(capsys):
    run = trained("--agent.clip-actions", "0.2")
    out = capsys.readouterr().out
    assert "onnx: at most " in out
    assert "torchscript: at most " in out
    exported = run / "exported" / "policy.onnx"
    metadata = read_policy_metadata(run)
    assert (metadata["task"], metadata["run"], metadata["iteration"]) == (TASK, run.name, 2)

    assert main(["export", str(run), "--out", "robot", "--device", "cpu"]) == 0
    out = capsys.readouterr().out
    assert f"{Path('robot/policy.onnx')}  {Path('robot/policy.onnx').stat().st_size:,} bytes" in out
    again = read_policy_metadata("robot")
    assert {k: v for k, v in again.items() if k != "check"} == {k: v for k, v in metadata.items() if k != "check"}

    results = []
    for policy in (run, exported, "robot/policy.onnx"):
        command = ["eval", TASK, "--checkpoint", str(policy), "--episodes", "6", "--num-envs", "3", "--seed", "4"]
        assert main([*command, "--device", "cpu", "--json", "r.json"]) == 0
        results.append(json.loads(Path("r.json").read_text()))
        assert results[-1].pop("metrics") == {}
        assert results[-1].pop("task") == TASK
    assert results[1] == pytest.approx(results[0], rel=1e-4)
    assert results[2] == pytest.approx(results[0], rel=1e-4)
    command = ["play", TASK, "--checkpoint", str(exported), "--viewer", "none", "--num-envs", "2", "--device", "cpu"]
    assert main(command) == 0
    assert "30 steps of 2 environments" in capsys.readouterr().out


@pytest.mark.usefixtures("no_video")
def test_export_of_a_checkpoint_alone(capsys):
    checkpoint = trained() / "checkpoints" / "model_1.pt"
    alone = Path("alone.pt")
    alone.write_bytes(checkpoint.read_bytes())
    capsys.readouterr()
    assert main(["export", str(alone)]) == 2
    assert "is in no run folder that names its task; give --task TASK" in capsys.readouterr().err
    assert main(["export", str(alone), "--task", TASK, "--device", "cpu"]) == 0
    assert Path("policy.onnx").is_file()
    assert read_policy_metadata("policy.onnx")["run"] is None
    assert main(["export", "nowhere"]) == 2
    assert "nowhere: does not exist" in capsys.readouterr().err
    assert main(["export", str(checkpoint), "--mjcf", "--device", "cpu"]) == 2
    assert "--mjcf: this task" in capsys.readouterr().err


@pytest.mark.usefixtures("no_video")
def test_a_training_whose_export_fails_says_so_at_its_end(capsys, monkeypatch):
    monkeypatch.setattr(exporter, "TOLERANCE", -1.0)
    assert main(["train", TASK, "--device", "cpu", "--num-envs", "8", "--max-iterations", "1"]) == 2
    assert "differ from the policy's" in capsys.readouterr().err
    (run,) = Path("logs/fake_cart").iterdir()
    assert (run / "checkpoints" / "model_0.pt").is_file()
    assert yaml.safe_load((run / "params" / "run.yaml").read_text()) == {"task": TASK}
    assert not (run / "exported").exists()


def test_exported_files_act_as_the_policy(tmp_path):
    runner = fake_runner.make_runner(None)
    runner.learn(2)
    found = export_policy(runner, tmp_path)
    script, onnx_file = found.torchscript, found.onnx
    assert sorted(file.name for file in tmp_path.iterdir()) == ["policy.json", "policy.onnx", "policy.pt"]
    obs = runner.env.get_observations()[:1]
    with torch.no_grad():
        expected = runner.get_inference_policy()(obs)
    torch.testing.assert_close(torch.jit.load(script)(obs["policy"]), expected)
    onnxruntime = pytest.importorskip("onnxruntime")
    session = onnxruntime.InferenceSession(str(onnx_file))
    (actions,) = session.run(None, {"obs": obs["policy"].numpy()})
    np.testing.assert_allclose(actions, expected.numpy(), rtol=1e-4, atol=1e-5)
