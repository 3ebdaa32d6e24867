# SPDX-License-Identifier: Apache-2.0
"""Torch hooks, eager, recorded in the step's CUDA graph and fused, beside hooks in Warp: times, equality, training.

    python tools/benchmarks/hook_graphs.py OUT                                  # Ant, Humanoid and Cartpole, 4096 each
    python tools/benchmarks/hook_graphs.py OUT --tasks Ant --parts speed equal

``OUT/hook_graphs.json`` has the numbers, ``OUT/hook_graphs.md`` the tables: steps, with their ratio to those with Warp
hooks, what they launch and wait for, and resets; equality; training. Both are written after each measurement. Steps
are timed by the clock on the wall, after some thousand, with episodes that end in every step. Equality compares the
bits of all results of 1000 steps from one seed.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import torch

import stripe_tasks  # noqa: F401  (registers the tasks)
from stripe_newton.cli.run_configs import load_configs
from stripe_newton.envs.call_counts import count_calls
from stripe_newton.envs.measure import random_actions

TASKS = ("Ant", "Humanoid", "Cartpole")
CASES = {
    "eager": ("Direct", False, False),
    "recorded": ("Direct", "auto", False),
    "fused": ("Direct", "auto", True),
    "warp": ("Direct-Warp", "auto", True),
}
"""Name of the form of the task, ``hooks_graph`` and ``hooks_fusion``."""
WARM, COUNTED = 2200, 64
"""Steps before those that are timed, and steps whose calls are counted. After 2144 steps hooks are compared with
themselves in step 4288 only."""

Entry = dict[str, Any]


def make(task: str, case: str, args: argparse.Namespace) -> Any:
    """An environment, reset, with episodes spread over their length."""
    form, hooks, fusion = CASES[case]
    name = f"Stripe-{task}-{form}-v0"
    configs = load_configs(name, None)
    configs.env.sim.device, configs.env.scene.num_envs, configs.env.seed = args.device, args.num_envs, 1
    configs.env.hooks_graph, configs.env.hooks_fusion = hooks, fusion
    env = gymnasium.make_vec(name, cfg=configs.env).unwrapped
    env.reset(seed=1)
    generator = torch.Generator(device=env.device).manual_seed(2)
    shape = env.episode_length_buf.shape
    env.episode_length_buf = torch.randint(env.max_episode_length, shape, generator=generator, device=env.device)
    return env


def wait(device: str) -> None:
    if device != "cpu":
        torch.cuda.synchronize(device)


def timed(function: Callable[[int], object], steps: int, device: str) -> float:
    """Milliseconds of a call, the mean of some in a row."""
    wait(device)
    start = time.perf_counter()
    for index in range(steps):
        function(index)
    wait(device)
    return 1e3 * (time.perf_counter() - start) / steps


def speed(task: str, case: str, args: argparse.Namespace) -> Entry:
    """Milliseconds of a step and of its physics, and CUDA calls."""
    env = make(task, case, args)
    actions = random_actions(env, 64)

    def step(index: int) -> object:
        return env.step(actions[index % 64])

    started = time.perf_counter()
    for index in range(160 if case == "eager" else WARM):
        step(index)
    wait(args.device)
    found: Entry = {"warm_s": time.perf_counter() - started}
    blocks = [timed(step, args.steps, args.device) for _ in range(3)]
    found |= {"step_ms": sorted(blocks)[1], "blocks_ms": blocks}
    if args.device != "cpu":
        found |= count_calls(step, COUNTED)
        torch.cuda.set_sync_debug_mode("default")
    found["resets"] = sum(float((r[2] | r[3]).sum()) for r in map(env.step, actions)) / len(actions)
    # Last, as it moves the robots without hooks.
    found["physics_ms"] = timed(lambda index: env.sim.step(env.cfg.decimation), args.steps, args.device)
    recorder = getattr(env, "_recorder", None)
    if recorder is not None:
        found["reasons"] = {h.name: h.reason for h in recorder.hooks if h.reason}
        found["fusion"] = {h.name: h.fusion.status for h in recorder.hooks}
        found["variants"] = max((h.variants for h in recorder.hooks), default=0)
        found["attempts"] = recorder._attempts
    print(env.describe(), flush=True)
    if args.device != "cpu":
        found["memory_mb"] = torch.cuda.memory_reserved() / 2**20
    env.close()
    return found


def bits(values: dict[str, torch.Tensor]) -> torch.Tensor:
    """A checksum of the bits of each tensor, int64, shape ``(count,)``."""
    sums = []
    for value in values.values():
        flat = value.reshape(-1)
        flat = (flat.to(torch.int32) if flat.dtype == torch.bool else flat.view(torch.int32)).long()
        weights = torch.arange(1, len(flat) + 1, device=flat.device) * 2654435761 % 4294967291
        sums.append((flat * weights).sum())
    return torch.stack(sums)


def run(task: str, case: str, args: argparse.Namespace) -> tuple[list[str], torch.Tensor, float]:
    """Checksums of all results of some steps from one seed: names, values ``(steps, count)``, and number of ends."""
    env = make(task, case, args)
    actions = random_actions(env, 64)
    torch.manual_seed(5)
    found, ends = [], torch.zeros((), device=env.device)
    names: list[str] = []
    for index in range(args.equal_steps):
        obs, reward, terminated, truncated, extras = env.step(actions[index % 64])
        log = {f"log/{k}": torch.as_tensor(v, device=env.device).float() for k, v in extras["log"].items()}
        values = {**obs, "reward": reward, "terminated": terminated, "truncated": truncated, **log}
        names = list(values)
        found.append(bits(values))
        ends += (terminated | truncated).sum()
    env.close()
    return names, torch.stack(found).cpu(), float(ends)


def equal(task: str, args: argparse.Namespace) -> Entry:
    """Whether eager and recorded hooks give the same bits, step by step; and eager hooks twice."""
    names, eager, ends = run(task, "eager", args)
    _, again, _ = run(task, "eager", args)
    _, recorded, _ = run(task, "recorded", args)
    _, fused, _ = run(task, "fused", args)
    found: Entry = {"steps": args.equal_steps, "ends": ends}
    for label, other in (("eager_again", again), ("recorded", recorded), ("fused", fused)):
        differs = (eager != other).nonzero()
        found[label] = "equal" if not len(differs) else f"step {int(differs[0, 0])}: {names[int(differs[0, 1])]}"
    return found


def train(task: str, case: str, args: argparse.Namespace) -> Entry:
    """Samples a second of training with PPO, from the sixth iteration on."""
    from stripe_newton.cli.device import set_seeds
    from stripe_newton.cli.env_and_policy import build
    from stripe_newton.rl import read_metrics

    form, hooks, fusion = CASES[case]
    name = f"Stripe-{task}-{form}-v0"
    configs = load_configs(name, None)
    configs.env.sim.device, configs.env.scene.num_envs, configs.env.seed = args.device, args.num_envs, 1
    configs.env.hooks_graph, configs.env.hooks_fusion = hooks, fusion
    configs.agent.max_iterations, configs.agent.save_interval, configs.agent.seed = args.iterations, 10**6, 1
    set_seeds(1)
    folder = args.out / f"{task}_{case}"
    runner = build(name, configs, folder)
    runner.learn()
    wait(args.device)
    metrics = {k: v[5:] for k, v in read_metrics(folder / "metrics.csv").items()}
    collect, learn = (sum(metrics[f"Perf/{n}_time"]) / len(metrics["elapsed_s"]) for n in ("collection", "learning"))
    samples = configs.agent.num_steps_per_env * args.num_envs
    result = {"samples_per_s": samples / (collect + learn), "collect_ms": 1e3 * collect, "learn_ms": 1e3 * learn}
    lengths = metrics["Train/mean_episode_length"]
    result["resets"] = args.num_envs * len(lengths) / sum(lengths)
    runner.env.close()
    return {**result, "reward": metrics["Train/mean_reward"][-1], "no_graphs": runner.no_graphs}


def guarded(found: Entry, key: str, function: Callable[[], Entry], args: argparse.Namespace) -> None:
    """Measure, and keep what is found or the error; one failure does not hide the others."""
    print(f"== {key}", flush=True)
    try:
        found[key] = function()
    except Exception as error:
        lines = traceback.format_exc().strip().splitlines()
        found[key] = {"error": f"{type(error).__name__}: {error}"}
        print("\n".join(lines[-24:]), flush=True)
    print(json.dumps(found[key], default=str), flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "hook_graphs.json").write_text(json.dumps(found, indent=1, default=str) + "\n", encoding="utf-8")
    (args.out / "hook_graphs.md").write_text(tables(found, args.tasks) + "\n", encoding="utf-8")


def _cells(entry: Entry, formats: dict[str, str]) -> list[str]:
    return [form.format(entry[name]) if name in entry else "-" for name, form in formats.items()]


def _ratio(entry: Entry, other: Entry, name: str) -> str:
    return f"{entry[name] / other[name]:.2f}" if name in entry and name in other else "-"


def tables(found: Entry, tasks: list[str]) -> str:
    """The numbers in Markdown."""
    steps = {"step_ms": "{:.3f} ms", "physics_ms": "{:.3f} ms", "graph_launches": "{:.1f}", "kernel_launches": "{:.1f}",
             "host_syncs": "{:.2f}", "resets": "{:.1f}"}  # fmt: skip
    training = {"samples_per_s": "{:,.0f}", "collect_ms": "{:.1f} ms", "learn_ms": "{:.1f} ms", "resets": "{:.1f}"}
    lines = ["| hooks | step | physics | graphs | launches | waits | resets a step | step over that with Warp hooks |"]
    lines.append("|---|" + "---:|" * 7)
    for task, case in itertools.product(tasks, CASES):
        entry, warp = (found.get(f"speed {task} {name}", {}) for name in (case, "warp"))
        lines.append(f"| {task}, {case} | {' | '.join([*_cells(entry, steps), _ratio(entry, warp, 'step_ms')])} |")
    lines += ["", "| training | samples/s | steps | learning | resets a step | samples/s over those of eager hooks |"]
    lines.append("|---|" + "---:|" * 5)
    for task, case in itertools.product(tasks, CASES):
        entry, eager = (found.get(f"train {task} {name}", {}) for name in (case, "eager"))
        cells = [*_cells(entry, training), _ratio(entry, eager, "samples_per_s")]
        lines.append(f"| {task}, {case} | {' | '.join(cells)} |")
    lines += [
        "",
        "| the same bits | steps | ends | recorded | fused | eager, once more |",
        "|---|---:|---:|---|---|---|",
    ]
    for task in tasks:
        entry = found.get(f"equal {task}", {})
        cells = _cells(entry, {"steps": "{}", "ends": "{:.0f}", "recorded": "{}", "fused": "{}", "eager_again": "{}"})
        lines.append(f"| {task} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    """Measure the cases one after the other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--tasks", nargs="*", default=list(TASKS))
    parser.add_argument("--parts", nargs="*", default=["speed", "equal", "train"])
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--equal-steps", type=int, default=1000)
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--device", default="cuda:0")
    args = parser.parse_args()
    found: Entry = {}
    for part in args.parts:
        for task in args.tasks:
            if part == "equal":
                guarded(found, f"equal {task}", lambda task=task: equal(task, args), args)
                continue
            for case in args.cases:
                function = speed if part == "speed" else train
                key = f"{part} {task} {case}"
                guarded(found, key, lambda f=function, t=task, c=case: f(t, c, args), args)
    print(tables(found, args.tasks))


if __name__ == "__main__":
    main()
