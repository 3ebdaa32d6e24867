# SPDX-License-Identifier: Apache-2.0
"""Training of tasks: train, evaluate and film one after the other, and print a table.

    python tools/benchmarks/train_tasks.py OUT TASK[:ITERATIONS][@NUM_ENVS] ...

Each task is trained, evaluated over 256 episodes and filmed through the command line, as a user would. OUT gets the
learning curve, metrics, video and evaluation of each, and ``results.md`` with the table: seconds of the whole training
command, of its iterations, and until 90 % of the best return in training; return, episode length and its limit, share
of episodes that ended early, and the task's own metrics.
"""

from __future__ import annotations

import json
import math
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

from stripe_newton.rl import read_metrics


def run(*words: str) -> str:
    """Run a command of the project, echo its output, and return it."""
    process = subprocess.run(
        [sys.executable, "-m", "stripe_newton.cli", *words, "--import", "stripe_tasks"],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        check=False,
    )
    print(process.stdout[-3000:], flush=True)
    process.check_returncode()
    return process.stdout


def train(out: Path, name: str, iterations: str | None, num_envs: str | None) -> str:
    """Train one task; return its row of the table."""
    options = [
        *(["--max-iterations", iterations] if iterations else []),
        *(["--num-envs", num_envs] if num_envs else []),
    ]
    start = time.perf_counter()
    text = run("train", name, "--seed", "1", "--log-dir", str(out / "logs"), *options)
    seconds = time.perf_counter() - start
    folder = Path(re.findall(r"run folder: (.*)", text)[-1].strip())
    report = out / f"{name}.json"
    run("eval", name, "--checkpoint", str(folder), "--episodes", "256", "--num-envs", "256", "--json", str(report))
    for item in [*folder.glob("videos/*.mp4"), folder / "learning_curve.png", folder / "metrics.csv"]:
        shutil.copy(item, out / f"{name}-{item.name}")
    result = json.loads(report.read_text())
    curve = read_metrics(folder / "metrics.csv")
    elapsed, returns = curve["elapsed_s"], curve["Train/mean_reward"]
    best = max(x for x in returns if not math.isnan(x))
    reached = next(t for t, r in zip(elapsed, returns, strict=True) if r >= 0.9 * best)
    row = [
        name,
        f"{seconds:.0f} s",
        f"{elapsed[-1]:.0f} s",
        f"{reached:.0f} s",
        f"{result['mean_return']:.1f}",
        f"{result['mean_length']:.0f} / {result['max_length']}",
        f"{100 * result['terminated_rate']:.1f} %",
        ", ".join(f"{metric} {value:.3g}" for metric, value in result["metrics"].items()),
    ]
    return "| " + " | ".join(row) + " |"


def main() -> None:
    """Train each named task."""
    out = Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    rows = ["| task | command | iterations | to 90 % | return | length | ended early | metrics |", "|---" * 8 + "|"]
    for word in sys.argv[2:]:
        name, iterations, num_envs = re.fullmatch(r"([\w-]+)(?::(\d+))?(?:@(\d+))?", word).groups()
        rows.append(train(out, name, iterations, num_envs))
    (out / "results.md").write_text("\n".join(rows) + "\n")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
