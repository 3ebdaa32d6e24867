# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import csv
import os
import random
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.rl import (
    CheckpointError,
    OnPolicyRunner,
    RandomPolicy,
    RslRlMLPModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlRndCfg,
    RslRlRNNModelCfg,
    RslRlVecEnvWrapper,
    RunFolder,
    TrainingVideo,
    ZeroPolicy,
    evaluate,
    export_policy,
    find_checkpoint,
    load_checkpoint,
    plot_learning_curve,
    read_metrics,
    record_video,
    save_checkpoint,
)
from tests.helpers.checkout import ROOT
from tests.helpers.fake_env import FakeCartCfg, FakeCartEnv, FakeCartRunnerCfg

pytestmark = pytest.mark.usefixtures("one_thread")


def make_env(
    num_envs: int = 8, clip_actions: float | None = None, device: str = "cpu", **changes
) -> RslRlVecEnvWrapper:
    cfg = FakeCartCfg()
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = device, num_envs, 3
    return RslRlVecEnvWrapper(FakeCartEnv(cfg.replace(**changes), "rgb_array"), clip_actions)


def make_runner(
    folder: Path | None, agent: RslRlOnPolicyRunnerCfg | None = None, num_envs: int = 8, device: str = "cpu"
) -> OnPolicyRunner:
    random.seed(1)
    np.random.seed(1)  # noqa: NPY002
    torch.manual_seed(1)
    return OnPolicyRunner(make_env(num_envs, device=device), agent or FakeCartRunnerCfg(), folder)


def rnn_cfg() -> RslRlOnPolicyRunnerCfg:
    agent = FakeCartRunnerCfg()
    agent.actor = RslRlRNNModelCfg(
        hidden_dims=(8,), rnn_hidden_dim=6, distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg()
    )
    agent.critic = RslRlRNNModelCfg(hidden_dims=(8,), rnn_hidden_dim=6, rnn_type="gru")
    return agent


def rnd_cfg() -> RslRlOnPolicyRunnerCfg:
    agent = FakeCartRunnerCfg()
    agent.obs_groups["rnd_state"] = ["policy"]
    schedule = {"mode": "linear", "initial_step": 10, "final_step": 80, "final_value": 0.1}
    agent.algorithm.rnd_cfg = RslRlRndCfg(
        weight=5.0, state_normalization=True, reward_normalization=True, weight_schedule=schedule
    )
    return agent


def flat(state: dict, path: str = "") -> dict:
    """Leaves of a checkpoint by their path."""
    leaves = {}
    for key, value in state.items():
        if isinstance(value, dict):
            leaves |= flat(value, f"{path}{key}/")
        elif isinstance(value, (list, tuple)):
            leaves |= flat(dict(enumerate(value)), f"{path}{key}/")
        else:
            leaves[f"{path}{key}"] = value
    return leaves


def rows(folder: Path) -> list[dict[str, str]]:
    with open(folder / "metrics.csv", newline="") as file:
        return list(csv.DictReader(file))


def on_the_clock(name: str) -> bool:
    return name.startswith("Perf/") or name == "elapsed_s"


# -- the wrapper


def test_wrapper_hands_out_new_tensors_and_time_outs():
    env = make_env(num_envs=4)
    first = env.get_observations()
    kept = first["policy"].clone()
    env.episode_length_buf = torch.tensor([29, 29, 0, 0])
    buffer = env.unwrapped.episode_length_buf
    with torch.inference_mode():
        env.unwrapped.x[1, 0] = 5.0  # leaves the line in the step in which the clock runs out
    obs, rewards, dones, extras = env.step(torch.zeros(4, 1))
    torch.testing.assert_close(first["policy"], kept, rtol=0, atol=0)
    assert env.get_observations() is obs
    assert obs["policy"].data_ptr() != first["policy"].data_ptr()
    assert env.unwrapped.episode_length_buf is buffer
    assert dones.tolist() == [1, 1, 0, 0]
    assert extras["time_outs"].tolist() == [True, False, False, False]
    assert rewards.shape == (4,)
    assert "time_outs" not in make_env(is_finite_horizon=True).step(torch.zeros(8, 1))[3]


def test_wrapper_clips_actions():
    free, clipped = make_env(push=(-99.0, 99.0)), make_env(push=(-99.0, 99.0), clip_actions=2.0)
    free.get_observations(), clipped.get_observations()
    two, ten = torch.full((8, 1), 2.0), torch.full((8, 1), 10.0)
    expected = free.step(two)[0]["policy"]
    torch.testing.assert_close(clipped.step(ten)[0]["policy"], expected, rtol=0, atol=0)


# -- configs


def test_default_config_is_what_rsl_rl_takes():
    agent = RslRlOnPolicyRunnerCfg()
    agent.validate()
    runner = OnPolicyRunner(make_env(), agent)
    assert [layer.out_features for layer in runner.alg.actor.mlp if hasattr(layer, "out_features")] == [256, 128, 64, 1]
    assert runner.alg.learning_rate == agent.algorithm.learning_rate


def test_all_problems_of_a_config_at_once():
    agent = RslRlOnPolicyRunnerCfg(max_iterations=0)
    agent.algorithm.gamma = 1.5
    agent.algorithm.schedule = "cosine"
    agent.actor.activation = "relux"
    agent.actor.distribution_cfg.init_std = float("nan")
    agent.critic.hidden_dims = (8, 0)
    with pytest.raises(ConfigError) as caught:
        agent.validate()
    paths = {problem.split(":")[0] for problem in caught.value.problems}
    assert paths == {
        "max_iterations",
        "algorithm.gamma",
        "algorithm.schedule",
        "actor.activation",
        "actor.distribution_cfg.init_std",
        "critic.hidden_dims",
    }


def test_problems_beside_an_environment():
    agent = FakeCartRunnerCfg(num_steps_per_env=1)
    agent.obs_groups = {"actor": ["policy", "camera"], "critic": ["policy"]}
    agent.algorithm.num_mini_batches = 9
    with pytest.raises(ConfigError) as caught:
        OnPolicyRunner(make_env(), agent)
    assert "obs_groups.actor: 'camera' is no observation group, the environment has policy, critic" in str(caught.value)
    assert "algorithm.num_mini_batches: is 9, but there are 8 samples" in str(caught.value)


# -- learning, and going on


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


# -- checkpoints


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
        (text, "no file that torch.save wrote"),
        (foreign, "expected a dict with 'actor_state_dict'"),
        (tmp_path / "none.pt", "does not exist"),
    ):
        with pytest.raises(CheckpointError, match=message):
            runner.load(path)
    with pytest.raises(CheckpointError, match="holds no checkpoint"):
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
    with pytest.raises(CheckpointError, match="not the state of a training"):
        other.resume(tmp_path / "model_7.pt")


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


# -- evaluation


class ScriptedEnv(FakeCartEnv):
    """Episodes of fixed lengths: 2 in environment 0 and 10 in all others; a step is worth 1."""

    def step(self, action):
        self._length += 1
        lengths = torch.full((self.num_envs,), 10)
        lengths[0] = 2
        done = self._length >= lengths
        self.success = done & (lengths == 2)
        self._length[done] = 0
        log = {"Metrics/length": lengths[done].float().mean(), "Episode_Reward/x": torch.tensor(3.0)}
        early = done & (lengths == 2)
        return self._observe(), torch.ones(self.num_envs), early, done & ~early, {"log": log}


def scripted_env(num_envs: int) -> RslRlVecEnvWrapper:
    cfg = FakeCartCfg()
    cfg.sim.device, cfg.scene.num_envs = "cpu", num_envs
    return RslRlVecEnvWrapper(ScriptedEnv(cfg))


def test_evaluate_does_not_favour_short_episodes():
    env = scripted_env(4)
    result = evaluate(env, ZeroPolicy(env), 4, task="scripted")
    assert result.to_dict() == {
        "task": "scripted",
        "episodes": 4,
        "mean_return": 8.0,  # (2 + 3 * 10) / 4; the first four episodes to end would give (4 * 2) / 4
        "mean_length": 8.0,
        "max_length": 30,
        "terminated_rate": 0.25,
        "success_rate": 0.25,
        "metrics": {"length": 6.5},  # (2 + 3 * 8) / 4: what else ended in the same step is in its mean
    }
    assert evaluate(env, ZeroPolicy(env), 5).mean_length == (2 + 2 + 30) / 5
    assert evaluate(env, ZeroPolicy(env), 2).mean_length == 6.0


def test_evaluate_ends_when_episodes_do_not(monkeypatch):
    env = make_env(limit=1e9, episode_length_s=1.0)
    monkeypatch.setattr(env.unwrapped, "max_episode_length", 10**9)
    env.max_episode_length = 10
    with pytest.raises(RuntimeError, match="does it ever end"):
        evaluate(env, ZeroPolicy(env), 1)
    with pytest.raises(ValueError, match="at least 1"):
        evaluate(env, ZeroPolicy(env), 0)


def test_evaluate_tells_a_policy_with_a_memory_which_episodes_ended():
    env = scripted_env(3)
    told = []

    class Recorder(ZeroPolicy):
        def reset(self, dones=None):
            told.append(None if dones is None else dones.tolist())

    evaluate(env, Recorder(env), 3)
    assert told[:3] == [None, [0, 0, 0], [1, 0, 0]]
    assert told[-1] == [1, 1, 1]

    runner = make_runner(None, rnn_cfg())
    policy = runner.get_inference_policy()
    first = evaluate(runner.env, policy, 16, seed=5)
    assert evaluate(runner.env, policy, 16, seed=5) == first


def test_random_policy_stays_within_the_action_space():
    env = make_env(num_envs=200)
    env.unwrapped.single_action_space.low[:], env.unwrapped.single_action_space.high[:] = 2.0, 3.0
    actions = RandomPolicy(env)(env.get_observations())
    assert actions.shape == (200, 1)
    assert 2.0 <= actions.min() < 2.1 < 2.9 < actions.max() <= 3.0


# -- what a run leaves


def test_run_folder(tmp_path):
    one, two = RunFolder.create(tmp_path, "exp", "name"), RunFolder.create(tmp_path, "exp", "name")
    assert one.path != two.path
    assert one.path.parent == tmp_path / "exp"
    runner = make_runner(one.path)
    runner.learn(2)
    params = one.read_params()
    assert params == {"env": runner.env.cfg.to_dict(), "agent": runner.agent_cfg.to_dict()}
    assert RunFolder.of_checkpoint(find_checkpoint(one.path)).path == one.path.resolve()
    assert list(one.path.glob("events.out.tfevents.*"))
    (one.params / "env.yaml").write_text("a: [")
    with pytest.raises(CheckpointError, match="no valid YAML"):
        one.read_params()


def test_learning_curve(tmp_path):
    runner = make_runner(tmp_path)
    runner.learn()
    columns = read_metrics(tmp_path / "metrics.csv")
    assert columns["total_steps"] == [8 * 16 * n for n in range(1, 7)]
    assert all(0.0 < value < 3.0 for value in columns["Episode/distance"])
    path = plot_learning_curve(tmp_path / "metrics.csv", tmp_path / "curve.png", "fake")
    assert path.read_bytes()[:4] == b"\x89PNG"


def test_metrics_with_a_column_that_comes_late(tmp_path):
    from stripe_newton.rl.metrics import MetricsCsv

    metrics = MetricsCsv(tmp_path / "m.csv")
    metrics.write({"iteration": 0, "a": 1.0})
    metrics.write({"iteration": 1, "a": 2.0, "b": 3.0})
    columns = read_metrics(tmp_path / "m.csv")
    assert columns["a"] == [1.0, 2.0]
    assert np.isnan(columns["b"][0])
    assert columns["b"][1] == 3.0
    with open(tmp_path / "m.csv", "a") as file:
        file.write("2,4.0")  # a row that was cut short
    MetricsCsv(tmp_path / "m.csv", first_iteration=9)
    assert read_metrics(tmp_path / "m.csv")["iteration"] == [0.0, 1.0]


def test_export(tmp_path):
    runner = make_runner(None)
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


def test_videos(tmp_path):
    av = pytest.importorskip("av")
    env = make_env()
    path = record_video(env, ZeroPolicy(env), tmp_path / "videos" / "one.mp4", steps=7)
    with av.open(str(path)) as video:
        assert len(list(video.decode(video=0))) == 7
        assert float(video.streams.video[0].average_rate) == pytest.approx(10.0)


def test_filming_does_not_change_a_training(tmp_path):
    pytest.importorskip("av")
    plain = make_runner(tmp_path / "plain")
    plain.learn()
    filmed = make_runner(tmp_path / "filmed")
    film = TrainingVideo(filmed.env, tmp_path / "filmed" / "videos", interval=2, steps=20)
    filmed.logger.iteration_hooks.append(film.after_iteration)
    filmed.learn()
    film.close()
    names = {path.name for path in (tmp_path / "filmed" / "videos").iterdir()}
    assert names == {"iteration_2.mp4", "iteration_4.mp4"}
    one, other = (flat(run.alg.save()) for run in (plain, filmed))
    assert all(torch.equal(value, other[key]) for key, value in one.items() if isinstance(value, torch.Tensor))


def test_configs_import_no_torch():
    code = "import stripe_newton.rl, sys; assert not {'torch', 'rsl_rl', 'warp'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
