# SPDX-License-Identifier: Apache-2.0
"""Determinism: trains with ``--deterministic`` twice, and in two parts, and compares all bits; and what it costs.

    python tools/checks/determinism.py OUT [--device cuda:0] [--num-envs 256] [--iterations 20] [TASK ...]

Prints a row for each task, which is also in ``OUT/table.md``: whether these are the same bits: checkpoints of a run
that is done again in another process, and of one that was resumed half-way; results of ``eval``; pictures; and what
environments do beside four times as many others. The last columns are the time of an iteration with and without the
option. The command fails if a checkpoint differs in anything but the clock, if results or pictures differ, or if
environments do although none of their numbers come from torch's generator, which all of them share.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnv

__all__ = ["Beside", "beside_others", "differences", "main"]

TASKS = ("Stripe-Cartpole-Direct-v0", "Stripe-Cartpole-v0", "Stripe-Velocity-Flat-Quadruped-v0")
COLUMNS = ("task", "device", "run again", "resumed", "`eval`", "picture", "beside others", "iteration",
           "`--deterministic`")  # fmt: skip
FEW, STEPS = 16, 150
"""Environments that are watched beside others, and steps."""
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


def evaluate(run: Path, task: str, device: str) -> dict[str, object]:
    """Results of an evaluation of a run."""
    words = ["--checkpoint", str(run), "--num-envs", "16", "--episodes", "16", "--device", device, "--seed", "5"]
    command = [sys.executable, "-m", "stripe_newton.cli", "eval", task, *words, "--deterministic"]
    subprocess.run([*command, "--json", str(run / "eval.json")], check=True, stdout=subprocess.DEVNULL)
    return json.loads((run / "eval.json").read_text())


def make(task: str, device: str, num_envs: int, render_mode: str | None = None) -> RLEnv:
    """An environment with a fixed seed, reset."""
    from stripe_newton.cli.tasks import load_cfg, make_env

    cfg = load_cfg(task, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = num_envs, device, 3
    env = make_env(task, cfg, render_mode)
    env.reset(seed=3)
    return env.unwrapped


def picture(task: str, device: str) -> np.ndarray:
    """The picture after some steps with the same actions."""
    env = make(task, device, 4, "rgb_array")
    try:
        for _ in range(10):
            env.step(torch.zeros(env.action_space.shape, device=device))
        found = env.render()
        assert found is not None
        return found
    finally:
        env.close()


@dataclass
class Beside:
    """What the first environments do beside others."""

    step: int | None
    """First step in which anything of them differs; None if nothing does."""
    shared_numbers: bool
    """Whether the environment draws from torch's generator, so that numbers depend on how many others draw."""

    def __str__(self) -> str:
        why = ": it draws from torch's generator" if self.shared_numbers else ""
        return "yes" if self.step is None else f"from step {self.step} on not{why}"


def beside_others(task: str, device: str, few: int = FEW, steps: int = STEPS) -> Beside:
    """Compare the first environments of some, and of four times as many, for the same actions."""
    one, first = _watch(task, device, few, few, steps)
    two, second = _watch(task, device, 4 * few, few, steps)
    step = next((n for n, (a, b) in enumerate(zip(one, two, strict=True)) if list(differences(a, b))), None)
    return Beside(step, first or second)


def _watch(task: str, device: str, num_envs: int, few: int, steps: int) -> tuple[list[list[torch.Tensor]], bool]:
    """What the first environments return in each step, and whether steps draw from torch's generator."""
    env = make(task, device, num_envs)
    actions = torch.zeros(env.action_space.shape, device=device)
    generator = torch.Generator().manual_seed(0)
    shape, before = actions[:few].shape, _torch_numbers(device)
    found = []
    for _ in range(steps):
        # The others do something else.
        actions.fill_(0.3)
        actions[:few] = (2.0 * torch.rand(shape, generator=generator) - 1.0).to(device)
        observations, *rest, _ = env.step(actions)
        found.append([value[:few].clone() for value in (*observations.values(), *rest)])
    drawn = _bytes(before) != _bytes(_torch_numbers(device))
    env.close()
    return found, drawn


def _torch_numbers(device: str) -> torch.Tensor:
    return torch.get_rng_state() if device == "cpu" else torch.cuda.get_rng_state(device)


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("tasks", nargs="*", default=TASKS)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--num-envs", type=int, default=256)
    parser.add_argument("--iterations", type=int, default=20)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    all_same = True
    lines = [f"| {' | '.join(COLUMNS)} |", "|---|---|" + "---|" * 5 + "---:|---:|"]
    print("\n".join(lines), flush=True)
    for task in args.tasks:
        cells, same = check(task, args)
        all_same &= same
        lines.append(f"| {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    (args.out / "table.md").write_text("\n".join(lines) + "\n")
    return 0 if all_same else 1


def check(task: str, args: argparse.Namespace) -> tuple[list[str], bool]:
    """The row of a task, and whether all that must be the same is."""
    words = ["--device", args.device, "--num-envs", str(args.num_envs)]
    whole = ["--max-iterations", str(args.iterations)]
    usual = train(args.out / "usual" / task, task, *words, *whole)
    first, second = (train(args.out / x / task, task, *words, *whole, "--deterministic") for x in ("first", "second"))
    half = ["--max-iterations", str(args.iterations // 2)]
    parts = train(args.out / "parts" / task, task, *words, *half, "--deterministic")
    train(args.out / "parts" / task, task, "--resume", str(parts), *whole, "--deterministic")
    again = list(differences(newest(first), newest(second)))
    resumed = list(differences(newest(first), newest(parts)))
    same_results = evaluate(first, task, args.device) == evaluate(second, task, args.device)
    same_picture = np.array_equal(picture(task, args.device), picture(task, args.device))
    beside = beside_others(task, args.device)
    words = [_said(again), _said(resumed), *("yes" if same else "no" for same in (same_results, same_picture))]
    times = [f"{1000.0 * _seconds_per_iteration(run):.0f} ms" for run in (usual, first)]
    good = not again and not resumed and same_results and same_picture
    return [task, args.device, *words, str(beside), *times], good and (beside.step is None or beside.shared_numbers)


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
