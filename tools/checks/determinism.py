# SPDX-License-Identifier: Apache-2.0
"""Determinism: trains with ``--deterministic`` twice, and in two parts, and compares all bits; and what it costs.

    python tools/checks/determinism.py OUT [--device cuda:0] [--num-envs 256] [--iterations 20] [TASK ...]

The command fails if two checkpoints differ in anything but the clock. It prints a table for each task: whether the
same run, a resumed run and pictures are the same bits, and the time of an iteration with and without the option.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch

__all__ = ["differences", "main"]

TASKS = ("Stripe-Cartpole-Direct-v0", "Stripe-Velocity-Flat-Quadruped-v0")
CLOCK = ("tot_time",)
"""What differs between runs by its nature."""


def train(out: Path, task: str, *words: str) -> Path:
    """Train and return the run folder."""
    command = [sys.executable, "-m", "stripe_newton.cli", "train", task, "--log-dir", str(out), *words]
    subprocess.run([*command, "--final-video", "False"], check=True, stdout=subprocess.DEVNULL)
    return max(out.glob("*/*"), key=lambda path: path.stat().st_mtime)


def differences(one: object, other: object, path: str = "") -> Iterator[str]:
    """Paths at which two contents of checkpoints differ."""
    if path.rpartition(".")[2] in CLOCK:
        return
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        for name in one:
            yield from differences(one[name], other[name], f"{path}.{name}" if path else str(name))
    elif isinstance(one, (list, tuple)) and isinstance(other, (list, tuple)) and len(one) == len(other):
        for number, (a, b) in enumerate(zip(one, other, strict=True)):
            yield from differences(a, b, f"{path}.{number}")
    elif isinstance(one, torch.Tensor) and isinstance(other, torch.Tensor):
        # By bytes: NaN equals NaN, and 0.0 is not -0.0.
        if one.shape != other.shape or one.dtype != other.dtype or _bytes(one) != _bytes(other):
            yield path
    elif type(one) is not type(other) or one != other:
        yield path


def _bytes(tensor: torch.Tensor) -> bytes:
    return tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes()


def newest(run: Path) -> dict:
    from stripe_newton.rl import find_checkpoint, load_checkpoint

    return load_checkpoint(find_checkpoint(run))


def picture(task: str, device: str) -> np.ndarray:
    """The picture after some steps with the same actions."""
    from stripe_newton.cli.tasks import load_cfg, make_env

    cfg = load_cfg(task, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = 4, device, 3
    env = make_env(task, cfg, "rgb_array")
    try:
        env.reset(seed=3)
        for _ in range(10):
            env.step(torch.zeros(env.action_space.shape, device=device))
        found = env.render()
        assert found is not None
        return found
    finally:
        env.close()


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("tasks", nargs="*", default=TASKS)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--num-envs", type=int, default=256)
    parser.add_argument("--iterations", type=int, default=20)
    args = parser.parse_args()
    all_same = True
    print("| task | device | same run | resumed | picture | iteration, as usual | `--deterministic` |")
    print("|---|---|---|---|---|---:|---:|", flush=True)
    for task in args.tasks:
        words = ["--device", args.device, "--num-envs", str(args.num_envs)]
        half, whole = str(args.iterations // 2), ["--max-iterations", str(args.iterations)]
        seconds = []
        runs = []
        for name, more in (("usual", []), ("first", ["--deterministic"]), ("second", ["--deterministic"])):
            runs.append(train(args.out / name / task, task, *words, *whole, *more))
            seconds.append(_seconds_per_iteration(runs[-1]))
        part = train(args.out / "parts" / task, task, *words, "--max-iterations", half, "--deterministic")
        train(args.out / "parts" / task, task, "--resume", str(part), *whole, "--deterministic")
        again = list(differences(newest(runs[1]), newest(runs[2])))
        resumed = list(differences(newest(runs[1]), newest(part)))
        same_picture = np.array_equal(picture(task, args.device), picture(task, args.device))
        found = [_said(again), _said(resumed), "yes" if same_picture else "no"]
        cells = [task, args.device, *found, *(f"{1000.0 * s:.0f} ms" for s in seconds[:2])]
        print(f"| {' | '.join(cells)} |", flush=True)
        all_same &= not again and not resumed and same_picture
    return 0 if all_same else 1


def _said(paths: list[str]) -> str:
    return "yes" if not paths else f"no: {', '.join(paths[:3])}"


def _seconds_per_iteration(run: Path) -> float:
    """Median, without the first iterations, in which graphs are recorded."""
    from stripe_newton.rl import read_metrics

    elapsed = read_metrics(run / "metrics.csv")["elapsed_s"]
    return float(np.median(np.diff(elapsed[len(elapsed) // 2 :])))


if __name__ == "__main__":
    began = time.monotonic()
    code = main()
    print(f"{time.monotonic() - began:.0f} s", file=sys.stderr)
    sys.exit(code)
