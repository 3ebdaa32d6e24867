# SPDX-License-Identifier: Apache-2.0
"""Scaling over GPUs: train a task on 1, 2, 4 ... GPUs and compare the speed.

    python tools/benchmarks/scaling.py OUT --gpus 1 2 4 [--weak | --strong]
        [--task TASK] [--num-envs N] [--iterations N]

Weak scaling (the default) gives each GPU ``--num-envs`` environments, strong scaling splits them over the GPUs. Each
training runs through the command line. Its speed is the number of steps of all environments in an iteration divided by
the median time of an iteration, without the first few. Efficiency is the speed per GPU relative to that of the first
training. OUT gets the runs, ``results.json`` and ``results.md``. ``--device cpu`` tries it out with processes on the
CPU; other options go to ``stripe-newton train``.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import statistics
import subprocess
import sys
import time
from pathlib import Path

from stripe_newton.rl import read_metrics

TASK = "Stripe-Velocity-Flat-Quadruped-v0"
WARMUP = 5


@dataclasses.dataclass
class Result:
    """Result of one training."""

    task: str
    scaling: str
    gpus: int
    num_envs: int
    """Number on all GPUs together."""
    iterations: int
    steps_per_s: float
    """Median over iterations, on all GPUs together."""
    iteration_s: float
    """Median time of an iteration."""
    collection_s: float
    """Median part of it that rank 0 spent collecting."""
    learning_s: float
    """Median part of it that rank 0 spent learning."""
    wall_s: float
    """Time of the whole command."""
    mean_reward: float
    """Mean reward at the end."""
    efficiency: float = 1.0


def measure(columns: dict[str, list[float]]) -> tuple[float, float, float, float]:
    """Median steps/s, and seconds of an iteration, of its collection and of its learning, without the warm-up."""
    steps, collect, learn = (columns[name] for name in ("total_steps", "Perf/collection_time", "Perf/learning_time"))
    if len(steps) <= WARMUP:
        raise SystemExit(f"there are {len(steps)} iterations, of which {WARMUP} are warm-up: give more --iterations")
    seconds = statistics.median(c + t for c, t in zip(collect[WARMUP:], learn[WARMUP:]))
    size = steps[1] - steps[0]
    return size / seconds, seconds, statistics.median(collect[WARMUP:]), statistics.median(learn[WARMUP:])


def train(args: argparse.Namespace, gpus: int, rest: list[str]) -> Result:
    """Train on some GPUs through the command line."""
    total = args.num_envs * (1 if args.strong else gpus)
    logs = args.out / f"{gpus}_gpus"
    command = [sys.executable, "-m", "stripe_newton.cli", "train", args.task, "--log-dir", str(logs)]
    command += ["--gpus", str(gpus), "--num-envs", str(total), "--max-iterations", str(args.iterations)]
    command += ["--seed", str(args.seed), "--final-video", "False"]
    command += ["--agent.save-interval", str(10 * args.iterations)]
    command += ["--device", args.device] if args.device else []
    start = time.perf_counter()
    subprocess.run([*command, *rest], check=True)
    wall = time.perf_counter() - start
    folder = max(logs.glob("*/*/metrics.csv"), key=lambda path: path.stat().st_mtime)
    columns = read_metrics(folder)
    rewards = [value for value in columns.get("Train/mean_reward", []) if not math.isnan(value)]
    kind = "strong" if args.strong else "weak"
    reward = rewards[-1] if rewards else float("nan")
    return Result(args.task, kind, gpus, total, args.iterations, *measure(columns), wall, reward)


def table(results: list[Result]) -> str:
    """The results in Markdown."""
    lines = [
        f"{results[0].task}, {results[0].scaling} scaling",
        "",
        "| GPUs | environments | steps/s | efficiency | iteration | collecting | learning |",
        "|---|---|---|---|---|---|---|",
    ]
    for r in results:
        times = " | ".join(f"{1e3 * value:.1f} ms" for value in (r.iteration_s, r.collection_s, r.learning_s))
        lines.append(f"| {r.gpus} | {r.num_envs:,} | {r.steps_per_s:,.0f} | {r.efficiency:.0%} | {times} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Train on each number of GPUs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--gpus", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--task", default=TASK)
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--iterations", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device", choices=["cpu", "cuda"])
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--weak", action="store_true")
    kind.add_argument("--strong", action="store_true")
    args, rest = parser.parse_known_args()
    args.out.mkdir(parents=True, exist_ok=True)
    results: list[Result] = []
    for gpus in args.gpus:
        result = train(args, gpus, rest)
        base = results[0] if results else result
        result.efficiency = result.steps_per_s / base.steps_per_s / (result.gpus / base.gpus)
        results.append(result)
        (args.out / "results.json").write_text(json.dumps([dataclasses.asdict(r) for r in results], indent=1))
        (args.out / "results.md").write_text(table(results))
    print(table(results))


if __name__ == "__main__":
    main()
