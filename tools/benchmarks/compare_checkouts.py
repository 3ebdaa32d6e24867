# SPDX-License-Identifier: Apache-2.0
"""Compare checkouts: the step of some tasks in two checkouts of this project, measured in turn on one device.

python tools/benchmarks/compare_checkouts.py BEFORE AFTER --tasks Stripe-Ant-v0 Stripe-Cartpole-v0 --out figures.json

Each round runs ``stripe-newton bench`` of a task in each checkout, in processes of their own. The first round, which
compiles kernels, is not counted. The range over the others is the noise that a difference must exceed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

FIGURES = {
    "physics_ms": "physics [ms]",
    "env_ms": "step [ms]",
    "env_wall_ms": "by the wall [ms]",
    "start_s": "start [s]",
}


def measure(checkout: Path, task: str, options: list[str]) -> dict[str, float]:
    """Result of ``stripe-newton bench`` of a task.

    Raises:
        RuntimeError: with the output, if it fails.
    """
    path = os.pathsep.join([*(str(checkout / part) for part in (".", "kernels", "tasks")), os.getenv("PYTHONPATH", "")])
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "bench.json"
        # Named, as a checkout that is not installed has no entry points.
        command = [sys.executable, "-m", "stripe_newton.cli", "--import", "stripe_tasks", "bench", task]
        command += ["--json", str(result), *options]
        ended = subprocess.run(
            command, env=os.environ | {"PYTHONPATH": path}, cwd=folder, capture_output=True, text=True
        )
        if ended.returncode:
            raise RuntimeError(f"bench of {task} in {checkout} failed:\n{ended.stdout}{ended.stderr}")
        return json.loads(result.read_text())


def row(task: str, title: str, before: list[float], after: list[float]) -> str:
    """A row of the table: medians, ranges over the rounds, and the change."""
    cells = [f"{median(v):.3f} ({min(v):.3f} to {max(v):.3f})" for v in (before, after)]
    return f"| `{task}` | {title} | {cells[0]} | {cells[1]} | {100 * (median(after) / median(before) - 1):+.1f} % |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--tasks", nargs="+", required=True)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, help="file for all results, as JSON")
    args, options = parser.parse_known_args()
    results: dict[str, dict[str, list[dict[str, float]]]] = {}
    print("| task | | before | after | change |\n| --- | --- | ---: | ---: | ---: |")
    for task in args.tasks:
        found = results[task] = {"before": [], "after": []}
        for counts in [False, *[True] * args.rounds]:
            for side in found:
                result = measure(getattr(args, side).resolve(), task, options)
                if counts:
                    found[side].append(result)
        for name, title in FIGURES.items():
            sides = [[r[name] for r in found[side] if name in r] for side in found]
            if all(sides):
                print(row(task, title, *sides), flush=True)
        if args.out:
            args.out.write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
