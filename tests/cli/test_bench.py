# SPDX-License-Identifier: Apache-2.0
"""What ``stripe-newton bench`` measures and counts."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import warp as wp
from PIL import Image

from stripe_kernels import mdp
from stripe_newton.cli import main
from stripe_newton.cli.bench import table
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.configclass import configclass
from stripe_newton.envs import fusion_gain as fusion_gain_module
from stripe_newton.envs import measure, step_times
from stripe_newton.envs.call_counts import REGION, calls_in_trace, count_calls, warp_calls
from stripe_newton.envs.fusion_gain import fused_kernels, fusion_gain, launch_us, term_configs
from stripe_newton.envs.measure import benchmark, random_actions
from stripe_newton.envs.step_times import LEAD, Clock, measure_step
from stripe_newton.managers import RewardManager, RewardTermCfg, TerminationManager, TerminationTermCfg
from tests.helpers.cart_env import CartEnv, make
from tests.helpers.manager_world import manager_context
from tools.benchmarks import benchmark_table

TASK = "Stripe-Cartpole-Direct-v0"
KEYS = {
    *("task", "device", "num_envs", "decimation", "physics_ms", "env_ms", "overhead_ratio", "env_steps_per_s"),
    *("graph_launches_per_step", "kernel_launches_per_step", "host_syncs_per_step", "build_s", "first_step_s"),
    *("import_s", "ready_s"),
}


class CountingClock(Clock):
    """Its milliseconds are calls of a function, so that what is between two marks is known exactly."""

    count = 0

    def mark(self):
        return CountingClock.count

    def ms(self, start, end):
        return float(end - start)


@pytest.fixture
def count_of(monkeypatch):
    """Measure a step of an environment in calls of one of its functions."""

    def measured(env, owner, name):
        original = getattr(owner, name)

        def counted(*args, **kwargs):
            CountingClock.count += 1
            return original(*args, **kwargs)

        monkeypatch.setattr(owner, name, counted)
        monkeypatch.setattr(step_times, "Clock", CountingClock)
        return measure_step(env, random_actions(env, LEAD + 6), blocks=3)

    return measured


@pytest.fixture
def env():
    made = make()
    made.reset(seed=1)
    for action in random_actions(made, 4):
        made.step(action)
    yield made
    made.close()


def test_the_physics_alone_takes_as_many_solver_steps_as_the_whole_step(env, count_of):
    times = count_of(env, env.sim.solver, "step")
    assert times.env == times.env_wall == times.physics == times.physics_free == [2.0, 2.0, 2.0]
    assert times.physics_ms == 2.0
    assert times.to_dict()["overhead_ratio"] == 0.0


@pytest.mark.parametrize("hook", ["_get_rewards", "_apply_action", "_get_observations"])
def test_the_physics_alone_runs_nothing_of_the_task(env, count_of, hook):
    times = count_of(env, env, hook)
    assert min(times.env) >= 1.0
    assert max(times.physics) == max(times.physics_free) == 0.0


def test_resets_are_in_the_whole_step_and_not_in_the_physics(env, count_of):
    env.episode_length_buf = torch.tensor([9, 0, 2, 9])  # of 10 steps: two end in the block
    times = count_of(env, env, "_reset_idx")
    assert times.env == [2 / 6] * 3, "the state was not brought back: later blocks have other resets"
    assert max(times.physics) == 0.0


def test_the_physics_alone_does_what_the_whole_step_does(env):
    env.episode_length_buf = torch.tensor([9, 0, 2, 9])
    assert measure_step(env, random_actions(env, LEAD + 8), blocks=1).replay_difference == 0.0


def test_physics_under_other_targets_is_noticed():
    class Changing(CartEnv):
        """Its force changes within a step, which the targets that it leaves do not show."""

        def _apply_action(self):
            self.calls.append("apply")
            self.robot.set_joint_effort_target(30.0 * self.actions * (len(self.calls) % 7), joint_ids=[0])

    env = make(Changing, apply_action="substep")
    env.reset(seed=1)
    assert measure_step(env, random_actions(env, LEAD + 8), blocks=1).replay_difference > 1e-4
    env.close()


def test_the_environment_goes_on_where_it_was(env):
    before = env.get_state()
    rng = torch.get_rng_state()
    measure_step(env, random_actions(env, LEAD + 5), blocks=2)
    after = env.get_state()
    assert before["step"] == after["step"]
    for part in ("arrays", "buffers"):
        for name, value in before[part].items():
            assert torch.equal(value, after[part][name]), name
    assert torch.equal(rng, torch.get_rng_state())


def test_actions_are_seeded_and_real(env):
    actions = random_actions(env, 50, seed=3)
    assert actions.shape == (50, 4, 1)
    assert torch.equal(actions, random_actions(env, 50, seed=3))
    assert not torch.equal(actions, random_actions(env, 50, seed=4))
    assert actions.min() < -0.9
    assert actions.max() > 0.9
    assert actions.abs().max() <= 1.0


def test_discrete_actions_are_refused():
    env = make(action_space={3})
    with pytest.raises(ValueError, match="real actions"):
        random_actions(env, 2)
    env.close()


def test_episodes_are_spread_before_anything_is_timed(monkeypatch):
    seen = {}

    def instead(env, actions, blocks):
        seen["lengths"], seen["blocks"], seen["steps"] = env.episode_length_buf.clone(), blocks, len(actions) - LEAD
        raise KeyboardInterrupt

    monkeypatch.setattr(measure, "measure_step", instead)
    made = make(episode_length_s=1000.0)
    closed = []
    monkeypatch.setattr(made, "close", lambda: closed.append(True))
    with pytest.raises(KeyboardInterrupt):
        benchmark(lambda: made, steps=90, warmup=10)
    assert len(seen["lengths"].unique()) == 4
    assert seen["lengths"].min() > 10
    assert (seen["blocks"], seen["steps"]) == (3, 32)
    assert closed, "an environment that failed is closed too"


# -- counting


def call(category: str, name: str, start: float, dur: float = 1.0, tid: int = 1, **args) -> dict:
    return {"ph": "X", "cat": category, "name": name, "ts": start, "dur": dur, "tid": tid, "args": args}


def test_calls_are_counted_by_kind_within_the_steps():
    events = [
        {"ph": "M", "name": "process_name"},
        call("user_annotation", REGION, 0.0, 100.0),
        call("user_annotation", REGION, 200.0, 100.0),
        call("gpu_user_annotation", REGION, 100.0, 100.0),
        call("user_annotation", "something else", 100.0, 100.0),
        call("cuda_runtime", "cudaGraphLaunch", 1.0, 5.0, correlation=1),
        call("cuda_driver", "cuGraphLaunch", 2.0, 1.0),  # the same call, seen from within
        call("cuda_driver", "cuGraphLaunch_ptsz", 2.0, 1.0, tid=2),  # another thread's own
        call("cuda_runtime", "cudaLaunchKernel", 10.0, correlation=2),
        call("cuda_driver", "cuLaunchKernelEx", 20.0, correlation=3),
        call("cuda_runtime", "cudaLaunchKernel", 150.0, correlation=4),  # between the steps
        call("cuda_runtime", "cudaMemcpyAsync", 210.0, correlation=5),
        call("cuda_runtime", "cudaMemsetAsync_v3020", 211.0),
        call("cuda_runtime", "cudaStreamSynchronize", 212.0),
        call("cuda_driver", "cuMemcpyDtoH_v2", 220.0),
        call("cuda_runtime", "cudaStreamIsCapturing", 221.0),
        call("cpu_op", "cudaLaunchKernel", 222.0),
        *(call("kernel", f"k{i}", 400.0 + i, correlation=1) for i in range(7)),
        call("kernel", "k", 420.0, correlation=2),
        call("kernel", "k", 421.0, correlation=4),
        call("gpu_memcpy", "Memcpy DtoH (Device -> Pageable)", 430.0, correlation=5),
    ]
    counts = calls_in_trace({"traceEvents": events})
    assert dict(counts) == {
        "graph_launches": 2,
        "kernel_launches": 2,
        "copies": 2,
        "host_syncs": 2,
        "kernels": 8,
    }


def test_copies_to_the_host_are_waits_where_no_other_is_seen():
    events = [
        call("user_annotation", REGION, 0.0, 100.0),
        call("cuda_runtime", "cudaMemcpyAsync", 1.0, correlation=1),
        call("cuda_runtime", "cudaMemcpyAsync", 3.0, correlation=2),
        call("gpu_memcpy", "Memcpy DtoH (Device -> Pageable)", 2.0, correlation=1),
        call("gpu_memcpy", "Memcpy DtoH (Device -> Pinned)", 4.0, correlation=2),
    ]
    assert calls_in_trace({"traceEvents": events})["host_syncs"] == 1


def test_what_the_profiler_does_not_see_of_warp_is_added():
    events = [
        call("user_annotation", REGION, 0.0, 100.0),
        call("cuda_runtime", "cudaStreamSynchronize", 1.0),  # by torch
        call("cuda_runtime", "cudaGraphLaunch", 3.0),  # by Warp
    ]
    counts = calls_in_trace({"traceEvents": events}, {"host_syncs": 3, "graph_launches": 1, "kernel_launches": 2})
    assert (counts["host_syncs"], counts["graph_launches"], counts["kernel_launches"]) == (4, 1, 2)


def test_warps_functions_are_its_own_again():
    core = wp._src.context.runtime.core
    before = core.wp_cuda_stream_synchronize
    with warp_calls():
        assert core.wp_cuda_stream_synchronize is not before
    assert core.wp_cuda_stream_synchronize is before


@pytest.mark.gpu
def test_each_call_is_counted_once_on_a_gpu():
    source = torch.rand(1024, device="cuda:0")
    array, other = wp.from_torch(source), wp.zeros(1024, dtype=float, device="cuda:0")
    with wp.ScopedCapture("cuda:0") as capture:
        for _ in range(5):
            other.fill_(1.0)
            wp.copy(other, array)
            wp.launch(_double, dim=1024, inputs=[other], device="cuda:0")

    def step(index: int) -> None:
        wp.capture_launch(capture.graph)
        wp.launch(_double, dim=1024, inputs=[other], device="cuda:0")
        source.mul_(2.0)
        torch.add(source, 1.0, out=source)
        wp.synchronize_stream("cuda:0")
        source.sum().item()

    step(0)
    counts = count_calls(step, 10)
    assert counts["graph_launches"] == 1.0
    assert counts["kernel_launches"] == 4.0
    assert counts["host_syncs"] == 2.0
    assert counts["kernels"] >= 4.0 + 5.0


@pytest.mark.gpu
def test_marks_see_the_work_of_torch_and_of_warp():
    clock = Clock("cuda:0")
    clock.hold(1e-3)
    clock.wait()
    start = clock.mark()
    clock.hold(0.1)
    middle = clock.mark()
    wp.launch(_double, dim=1, inputs=[wp.zeros(1, dtype=float, device="cuda:0")], device="cuda:0")
    end = clock.mark()
    assert clock.ms(start, middle) > 10.0, "the mark did not wait for torch's stream"
    assert clock.ms(middle, end) < clock.ms(start, middle)


@wp.kernel(enable_backward=False)
def _double(values: wp.array[float]):
    i = wp.tid()
    values[i] = 2.0 * values[i]


# -- the command


def test_bench_writes_what_the_design_names(capsys):
    argv = ["bench", TASK, "--num-envs", "4", "--steps", "4", "--device", "cpu", "--json", "out/cartpole.json"]
    assert main(argv) == 0
    with open("out/cartpole.json") as file:
        result = json.load(file)
    assert result.keys() >= KEYS
    assert (result["task"], result["device"], result["num_envs"], result["decimation"]) == (TASK, "cpu", 4, 2)
    assert result["overhead_ratio"] == pytest.approx(result["env_ms"] / result["physics_ms"] - 1.0)
    assert result["env_steps_per_s"] == pytest.approx(4e3 / result["env_wall_ms"])
    assert [result[f"{kind}_per_step"] for kind in ("graph_launches", "kernel_launches", "host_syncs")] == [None] * 3
    assert result["replay_difference"] == 0.0
    out = capsys.readouterr().out
    assert f"{TASK}, 4 environments on cpu" in out
    assert f"{result['physics_ms']:.3f} ms" in out
    assert f"{result['env_ms']:.3f} ms" in out


def test_the_table_of_a_gpu_has_the_calls():
    result = {
        "task": "T-v0",
        "num_envs": 4096,
        "device": "cuda:0",
        "device_name": "NVIDIA X",
        "physics_ms": 2.0,
        "physics_range_ms": [1.9, 2.2],
        "env_ms": 2.1,
        "env_range_ms": [2.0, 2.3],
        "overhead_ratio": 0.05,
        "env_steps_per_s": 2e6,
        "graph_launches_per_step": 1.0,
        "kernel_launches_per_step": 0.0,
        "host_syncs_per_step": 0.015625,
        "build_s": 1.0,
        "first_step_s": 2.0,
        "import_s": 1.5,
        "ready_s": 4.5,
    }
    text = table(result)
    assert "4.50 s from the command" in text
    assert "T-v0, 4096 environments on NVIDIA X" in text
    assert "5.0 % of the physics" in text
    assert "1 graph launches, 0 kernel launches, 0.01562 host syncs" in text


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["bench"], "bench needs a task"),
        (["bench", TASK, "--steps", "0"], "--steps 0: must be at least 1"),
        (["bench", TASK, "--device", "cuda:99"], "there is no such device"),
        (["bench", TASK, "--num-envs", "-3", "--device", "cpu"], "env.scene.num_envs"),
    ],
)
def test_errors_are_one_message(capsys, argv, message):
    assert main(argv) == 2
    assert message in capsys.readouterr().err


# -- fusion


@pytest.fixture(scope="module")
def managers():
    context = manager_context(num_envs=3, num_terminations=2)
    height = {"minimum_height": 0.3}
    terminations = {
        "time_out": TerminationTermCfg(func=mdp.time_out, time_out=True),
        "low": TerminationTermCfg(func=mdp.root_height_below_minimum, params=height),
    }
    rewards = {
        "alive": RewardTermCfg(func=mdp.is_alive, weight=2.0),
        "off": None,
        "speed": RewardTermCfg(func=mdp.joint_vel_l2, weight=-0.5),
        "climb": RewardTermCfg(func=mdp.lin_vel_z_l2, weight=-1.0),
    }
    made = TerminationManager(terminations, context), RewardManager(rewards, context)
    wp.to_torch(context.entity("robot").data.struct.joint_vel)[:] = torch.rand(3, 8)
    yield made
    context.scene.close()


def test_terms_apart_compute_what_the_fused_ones_do(managers):
    _, rewards = managers
    reward = rewards.context.torch(rewards.context.reward)

    def result(cfg) -> tuple[int, torch.Tensor]:
        kernels = fused_kernels([rewards], [cfg])
        for kernel in kernels:
            kernel.launch()
        return len(kernels), reward.clone()

    count, fused = result(rewards.cfg)
    apart = [result(cfg) for cfg in term_configs(rewards.cfg)]
    assert count == 1
    assert [kernels for kernels, _ in apart] == [1, 1, 1]
    assert fused.abs().min() > 0.0
    torch.testing.assert_close(sum(value for _, value in apart), fused)


def test_the_sums_of_the_environment_are_left_alone(managers):
    _, rewards = managers
    for kernel in fused_kernels([rewards], [rewards.cfg]):
        kernel.launch()
    assert all(not values.any() for values in rewards.episode_sums.values())


def test_groups_are_taken_apart_too():
    terms = {name: RewardTermCfg(func=mdp.is_alive, weight=1.0) for name in "ab"}

    @configclass
    class Group:
        a: RewardTermCfg = terms["a"]
        b: RewardTermCfg = terms["b"]
        size = 3

    @configclass
    class Groups:
        policy: Group = Group()
        critic: Group = Group(a=None)
        none = None

    found = [
        (name, [t for t in "ab" if getattr(group, t)]) for cfg in term_configs(Groups()) for name, group in cfg.items()
    ]
    assert found == [("policy", ["a"]), ("policy", ["b"]), ("critic", ["b"])]


def test_fusion_gain_counts_terms(managers):
    terminations, rewards = managers
    env = SimpleNamespace(termination_manager=terminations, reward_manager=rewards, device="cpu")
    gain = fusion_gain(env, rounds=2)
    assert {name: entry["terms"] for name, entry in gain.items()} == {"terminations": 2, "rewards": 3, "all": 5}
    assert all(entry["fused_us"] > 0.0 and entry["apart_us"] > 0.0 for entry in gain.values())


def test_a_manager_based_task_is_measured_in_both_ways():
    cfg = load_cfg("Stripe-Cartpole-v0", "env")
    cfg.scene.num_envs, cfg.sim.device = 4, "cpu"
    env = make_env("Stripe-Cartpole-v0", cfg)
    env.reset(seed=1)
    assert measure_step(env, random_actions(env, LEAD + 8), blocks=1).replay_difference == 0.0
    gain = fusion_gain(env, rounds=1)
    observations, rewards, ends = (
        getattr(env, f"{kind}_manager").active_terms for kind in ("observation", "reward", "termination")
    )
    counts = {"observations": len(observations["policy"]), "rewards": len(rewards), "terminations": len(ends)}
    assert {name: entry["terms"] for name, entry in gain.items()} == {**counts, "all": sum(counts.values())}
    env.close()


def test_launches_are_timed_one_by_one(monkeypatch):
    calls = []
    monkeypatch.setattr(fusion_gain_module, "Clock", CountingClock)

    def launch() -> None:
        calls.append(1)
        CountingClock.count += 1

    assert launch_us("cpu", [launch, launch], rounds=3, repeats=5) == 2000.0
    assert len(calls) == 2 * (1 + 2 * 3 * 5)


# -- the tool

ENTRY = {
    "task": "T-v0",
    "num_envs": 4096,
    "device": "cuda:0",
    "device_name": "NVIDIA X",
    "physics_ms": 2.0,
    "env_ms": 2.1,
    "env_range_ms": [2.0, 2.3],
    "env_wall_ms": 2.2,
    "overhead_ratio": 0.05,
    "env_steps_per_s": 2e6,
    "graph_launches_per_step": 1.0,
    "kernel_launches_per_step": 0.0,
    "host_syncs_per_step": 0.015625,
}


def test_the_tool_goes_on_after_a_failure_and_keeps_what_was_measured(monkeypatch, capsys, tmp_path):
    def measured(task, num_envs, args):
        if task == "Bad-v0":
            raise MemoryError("too large")
        return {**ENTRY, "task": task, "num_envs": num_envs}

    monkeypatch.setattr(benchmark_table, "measure", measured)
    benchmark_table.main(["out", "--parts", "tasks", "--tasks", "Bad-v0", "Good-v0"])
    benchmark_table.main(["out", "--parts", "tasks", "--tasks", "Other-v0", "--num-envs", "16"])
    entries = json.loads((tmp_path / "out" / "tasks.json").read_text())
    assert [(e["task"], e["num_envs"]) for e in entries] == [("Bad-v0", 4096), ("Good-v0", 4096), ("Other-v0", 16)]
    assert entries[0]["error"] == "MemoryError: too large"
    text = (tmp_path / "out" / "benchmarks.md").read_text()
    assert "Measured on NVIDIA X." in text
    assert "| `Good-v0` | 4,096 | 2.000 | 2.100 | 2.000 to 2.300 | 5.0 % | 2.200 | 2,000,000 | 1 | 0 | 0.0156 |" in text
    assert "| `Bad-v0` | 4,096 | MemoryError: too large |" in text
    assert capsys.readouterr().out.endswith(text + "\n")


def test_the_tool_begins_nothing_after_its_time(monkeypatch, tmp_path):
    called = []
    monkeypatch.setattr(benchmark_table, "measure", lambda *args: called.append(args))
    benchmark_table.main(["out", "--parts", "tasks", "scaling", "--budget", "1e-9"])
    assert not called


def test_the_tool_draws_the_cost_over_the_number_of_environments(monkeypatch, tmp_path):
    monkeypatch.setattr(benchmark_table, "measure", lambda task, n, args: {**ENTRY, "task": task, "num_envs": n})
    benchmark_table.main(["out", "--parts", "scaling", "--sizes", "1", "4", "16"])
    assert len(json.loads((tmp_path / "out" / "scaling.json").read_text())) == 3 * len(benchmark_table.SCALING_TASKS)
    with Image.open(tmp_path / "out" / "scaling.png") as picture:
        assert picture.size == (1080, 432)


def test_a_start_counts_the_kernels_that_it_compiled(monkeypatch, tmp_path):
    def process(command, env, **kwargs):
        cache = Path(env["WARP_CACHE_PATH"]) / "1.19.0"
        if not cache.exists():
            (cache / "wp_a").mkdir(parents=True)
            (cache / "wp_a" / "a.cubin").write_text("a")
            (cache / "wp_a" / "a.cu").write_text("source")
            (cache / "b.cubin").write_text("b")
        else:
            os.utime(cache / "b.cubin", (1, 1))  # compiled anew
        times = {f"{part}_s": 1.0 for part in ("ready", "import", "build", "reset", "first_step")}
        Path(command[command.index("--json") + 1]).write_text(json.dumps({"device": "cpu", **times}))

    monkeypatch.setattr(benchmark_table.subprocess, "run", process)
    benchmark_table.main(["out", "--parts", "start"])
    (entry,) = json.loads((tmp_path / "out" / "start.json").read_text())
    assert entry["cold"]["kernel_files_made"] == entry["cold"]["kernel_files"] == 2
    assert entry["warm"]["kernel_files_made"] == 1
    assert "| `Stripe-Ant-v0` | 4,096 | cold |" in (tmp_path / "out" / "benchmarks.md").read_text()
