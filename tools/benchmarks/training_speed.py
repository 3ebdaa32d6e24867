# SPDX-License-Identifier: Apache-2.0
"""Training speed: rollout and update as CUDA graphs against rsl_rl's own loop, and the parts of an iteration.

    python tools/benchmarks/training_speed.py OUT                                # the flat quadruped, 4096 environments
    python tools/benchmarks/training_speed.py OUT --cases graph "graph tf32" rsl_rl --iterations 60

Networks are 512-256-128; an iteration has 24 steps and 5 epochs of 4 minibatches. ``OUT/training_speed.json`` has the
numbers, ``OUT/training_speed.md`` the table. Iterations are timed by the clock on the wall from the sixth to the last,
medians. Their parts are timed after the training, each alone and many times in a row; "the rest" is the time of an
iteration beyond those parts. ``--kernels`` adds ``OUT/kernels_CASE.md``, the kernels of an iteration by their time, and
``OUT/kernel_groups.md``, their sums by what they do, with what bounds each.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

import torch
from kernel_groups import Kernel, groups_table

from stripe_newton.rl import OnPolicyRunner

CASES = {
    "rsl_rl": {"runner": "rsl_rl", "matmul_precision": "highest"},
    "graph": {"runner": "graph", "matmul_precision": "highest"},
    "graph tf32": {"runner": "graph", "matmul_precision": "high"},
    "graph tf32 triton": {"runner": "graph", "matmul_precision": "high", "triton": True},
    "graph bf16 triton": {"runner": "graph", "matmul_precision": "high", "bf16": True, "triton": True},
    "graph tf32 streams": {"runner": "graph", "matmul_precision": "high", "streams": True},
    "graph tf32 both": {"runner": "graph", "matmul_precision": "high", "triton": True, "streams": True},
    "graph bf16 both": {"runner": "graph", "matmul_precision": "high", "bf16": True, "triton": True, "streams": True},
    "graph bf16": {"runner": "graph", "matmul_precision": "high", "bf16": True},
}
WARM = 5
"""Iterations left out at the beginning."""

Entry = dict[str, Any]
"""Measurement of one case, as it is written to JSON."""


def measure(case: str, args: argparse.Namespace) -> Entry:
    """Train for some iterations and measure them and their parts."""
    import stripe_tasks  # noqa: F401  (registers the tasks)
    from stripe_newton.cli.device import set_device, set_seeds
    from stripe_newton.cli.env_and_policy import build
    from stripe_newton.cli.run_configs import load_configs
    from stripe_newton.rl import read_metrics

    configs, options = load_configs(args.task, None), dict(CASES[case])
    configs.env.scene.num_envs, configs.env.seed = args.num_envs, 1
    set_device(configs.env, args.device)  # and torch's threads, as a training has them
    agent = configs.agent
    os.environ["STRIPE_NEWTON_TRITON"] = str(int(options.pop("triton", False)))
    os.environ["STRIPE_NEWTON_STREAMS"] = str(int(options.pop("streams", False)))
    agent.algorithm.use_mixed_precision = options.pop("bf16", False)
    agent.actor.hidden_dims = agent.critic.hidden_dims = (512, 256, 128)
    agent.max_iterations, agent.save_interval, agent.seed = args.iterations, 10 * args.iterations, 1
    for name, value in options.items():
        setattr(agent, name, value)
    set_seeds(1)
    folder = args.out / case.replace(" ", "_")
    started = time.perf_counter()
    runner = build(args.task, configs, folder)
    runner.learn()
    wait(args.device)
    result: Entry = {"case": case, "all_s": time.perf_counter() - started, "no_graphs": runner.no_graphs}
    metrics = {k: v[WARM:] for k, v in read_metrics(folder / "metrics.csv").items()}
    times = [[1e3 * t for t in metrics[f"Perf/{n}_time"]] for n in ("collection", "learning")]
    collect, learn = (median(t) for t in times)
    whole = [sum(pair) for pair in zip(*times, strict=True)]
    result |= {"collect_ms": collect, "learn_ms": learn, "mean_ms": sum(whole) / len(whole), "max_ms": max(whole)}
    result["slowest"] = sorted(range(len(whole)), key=lambda i: -whole[i])[:5]
    result["steps_per_s"] = 1e3 * agent.num_steps_per_env * args.num_envs / median(whole)
    result["reward"] = metrics["Train/mean_reward"][-1]
    if not runner.no_graphs:
        result |= parts(runner, args.device)
        if args.kernels:
            result["kernels"] = kernels(runner, args.device)
            text = kernel_table(result["kernels"])
            (args.out / f"kernels_{folder.name}.md").write_text(text + "\n", encoding="utf-8")
            print(text)
    runner.env.close()
    return result


def parts(runner: OnPolicyRunner, device: str) -> dict[str, float]:
    """Milliseconds of the parts of an iteration, each alone; step and physics with actions of the policy."""
    from stripe_newton.envs.step_times import measure_step

    rollout, algorithm = runner._rollout, runner.alg
    program = type(rollout._program)

    steps, env, found = algorithm.storage.num_transitions_per_env, runner.env.unwrapped, dict[str, float]()
    obs = rollout.collect()
    with torch.no_grad():
        rollout._index.zero_()
        found["policy_ms"] = steps * timed(program(rollout._act, device).run, device)
        found["values_ms"] = timed(program(rollout._finish, device).run, device)
        found["rollout_ms"] = timed(rollout.collect, device, 10)
    actions = algorithm.storage.actions.clone()
    for action in actions[:4]:
        env.step(action)
    times = measure_step(env, actions, 8)
    found |= {"env_ms": steps * median(times.env), "physics_ms": steps * times.physics_ms}

    def update() -> None:
        algorithm.compute_returns(obs)
        algorithm.update()

    found["update_ms"] = timed(update, device, 10)
    return found


def kernels(runner: OnPolicyRunner, device: str) -> dict[str, list[Kernel]]:
    """Kernels of the parts of an iteration (on the CPU: torch's operations), the longest first."""
    from torch.profiler import ProfilerActivity, profile

    on_gpu, result = device != "cpu", dict[str, list[Kernel]]()
    algorithm, obs = runner.alg, runner._rollout.collect()

    def update() -> None:
        algorithm.compute_returns(obs)
        algorithm.update()

    for part, function in (("rollout", runner._rollout.collect), ("update", update)):
        function()
        wait(device)
        with profile(activities=[ProfilerActivity.CUDA if on_gpu else ProfilerActivity.CPU]) as found:
            function()
            wait(device)
        events = found.key_averages()
        rows = [(e.self_device_time_total if on_gpu else e.self_cpu_time_total, e.count, e.key) for e in events]
        result[part] = sorted((r for r in rows if r[0] > 0.0), reverse=True)
    return result


def kernel_table(found: Mapping[str, Sequence[Kernel]]) -> str:
    """Table of the longest kernels of an iteration in Markdown."""
    lines = ["| | us | launches | |", "|---|---:|---:|---|"]
    for part, rows in found.items():
        lines.append(f"| {part} | {sum(r[0] for r in rows):.0f} | {sum(r[1] for r in rows)} | all |")
        lines += [f"| {part} | {us:.0f} | {count} | `{name[:110]}` |" for us, count, name in rows[:45]]
    return "\n".join(lines)


def timed(function: Callable[[], object], device: str, count: int = 100) -> float:
    """Milliseconds of a call, the mean of some in a row."""
    for _ in range(4):
        function()
    wait(device)
    start = time.perf_counter()
    for _ in range(count):
        function()
    wait(device)
    return 1e3 * (time.perf_counter() - start) / count


def wait(device: str) -> None:
    """Wait until the device has done all its work."""
    if device != "cpu":
        torch.cuda.synchronize(device)


def table(found: list[Entry]) -> str:
    """The numbers in Markdown."""
    lines = ["| | iteration | rollout | update | steps/s | reward then |", "|---|---:|---:|---:|---:|---:|"]
    for f in found:
        whole = f["collect_ms"] + f["learn_ms"]
        cells = f"{whole:.1f} ms | {f['collect_ms']:.1f} ms | {f['learn_ms']:.1f} ms | {f['steps_per_s']:,.0f}"
        lines.append(f"| {f['case']} | {cells} | {f['reward']:.2f} |")
    split = [f for f in found if "env_ms" in f]
    if split:
        names = " | ".join(f["case"] for f in split)
        lines += ["", f"| of an iteration | {names} |", "|---|" + "---:|" * len(split)]
        rows = {
            "physics": lambda f: f["physics_ms"],
            "task part of the step": lambda f: f["env_ms"] - f["physics_ms"],
            "policy, sampling": lambda f: f["policy_ms"],
            "values, sums of episodes, checks": lambda f: f["values_ms"],
            "storage, bookkeeping": lambda f: f["rollout_ms"] - f["env_ms"] - f["policy_ms"] - f["values_ms"],
            "update": lambda f: f["update_ms"],
            "the rest": lambda f: f["collect_ms"] + f["learn_ms"] - f["rollout_ms"] - f["update_ms"],
        }
        for name, value in rows.items():
            lines.append(f"| {name} | " + " | ".join(f"{value(f):.2f} ms" for f in split) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure the cases one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--task", default="Stripe-Velocity-Flat-Quadruped-v0")
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--kernels", action="store_true", help="table the kernels of an iteration")
    args = parser.parse_args()
    found, launched = [], dict[str, Mapping[str, Sequence[Kernel]]]()
    for case in args.cases:
        found.append(measure(case, args))
        if "kernels" in found[-1]:
            launched[case] = found[-1].pop("kernels")
        print(json.dumps(found[-1]), flush=True)
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "training_speed.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (args.out / "training_speed.md").write_text(table(found) + "\n", encoding="utf-8")
    print(table(found))
    if launched:
        groups = groups_table(launched)
        (args.out / "kernel_groups.md").write_text(groups + "\n", encoding="utf-8")
        print(groups)


if __name__ == "__main__":
    main()
