# SPDX-License-Identifier: Apache-2.0
"""Soak: many steps of a task under random actions, with memory, speed and state over time, as a table and curves.

    python tools/benchmarks/soak.py OUT [--task T] [--device cuda:0] [--num-envs 4096] [--steps 1e8] [--seconds 3600]

``--steps`` counts the steps of all environments. OUT gets ``soak.csv``, a row for each interval, and ``soak.png``. The
command fails if memory of the host or the device grows by more than 2 % after the first tenth, if a world was not
finite, or if an observation or reward was not. With ``--episode-s`` episodes are longer, for simulated time without an
end: the clock of an environment is an integer of 64 bits, and joints that only turn are a trial of float32.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path

import torch

__all__ = ["main", "problems"]

GROWTH = 0.02
"""Share by which memory may grow after the first tenth."""
COLUMNS = ("seconds", "steps", "simulated_s", "steps_per_s", "host_mb", "device_mb", "nonfinite_worlds", "largest_q",
           "largest_qd", "mean_reward")  # fmt: skip


def host_bytes() -> int:
    """Memory of this process."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


def device_bytes(device: str) -> int:
    """Memory in use on the device, by all of it."""
    if device == "cpu":
        return 0
    free, total = torch.cuda.mem_get_info(torch.device(device))
    return total - free


def problems(rows: list[dict[str, float]]) -> list[str]:
    """What is wrong with the rows of a soak."""
    found = []
    settled = rows[len(rows) // 10 :]
    for name in ("host_mb", "device_mb"):
        first, last = settled[0][name], settled[-1][name]
        if last > first * (1.0 + GROWTH):
            found.append(f"{name}: grew from {first:.0f} to {last:.0f}")
    if rows[-1]["nonfinite_worlds"]:
        found.append(f"{rows[-1]['nonfinite_worlds']:.0f} worlds were not finite")
    for name in ("largest_q", "largest_qd", "mean_reward"):
        if any(not abs(row[name]) < float("inf") for row in rows):
            found.append(f"{name}: is not finite")
    return found


@torch.inference_mode()
def soak(args: argparse.Namespace) -> list[dict[str, float]]:
    """Step until one of the limits, and write a row now and then."""
    from stripe_newton.cli.tasks import load_cfg, make_env

    cfg = load_cfg(args.task, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = args.num_envs, args.device, 0
    if args.episode_s is not None:
        cfg.episode_length_s = args.episode_s
    env = make_env(args.task, cfg)
    inner = env.unwrapped
    env.reset(seed=0)
    shape = env.action_space.shape
    generator = torch.Generator(args.device).manual_seed(0)
    rows: list[dict[str, float]] = []
    began = last = time.monotonic()
    steps, before = 0, 0
    reward = torch.zeros((), device=args.device)
    with open(args.out / "soak.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        while steps < args.steps and time.monotonic() - began < args.seconds:
            actions = 2.0 * torch.rand(shape, generator=generator, device=args.device) - 1.0
            reward += env.step(actions)[1].mean()
            steps += args.num_envs
            now = time.monotonic()
            if now - last < args.interval and steps < args.steps:
                continue
            q, qd = (torch.as_tensor(array.numpy()).abs().max() for array in _joints(inner))
            count = (steps - before) / args.num_envs
            values = (now - began, steps, steps / args.num_envs * inner.step_dt, (steps - before) / (now - last))
            memory = (host_bytes() / 1e6, device_bytes(args.device) / 1e6)
            state = (float(inner.nonfinite_worlds), float(q), float(qd), float(reward) / count)
            row = dict(zip(COLUMNS, (*values, *memory, *state), strict=True))
            writer.writerow(row)
            file.flush()
            rows.append(row)
            reward.zero_()
            last, before = now, steps
            print(" ".join(f"{name} {value:.6g}" for name, value in row.items()), flush=True)
    env.close()
    return rows


def _joints(inner: object) -> tuple:
    sim = inner.sim  # type: ignore[attr-defined]
    return sim.state.joint_q, sim.state.joint_qd


def draw(rows: list[dict[str, float]], path: Path) -> None:
    """Draw the columns over time."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = COLUMNS[3:]
    figure = Figure(figsize=(10.0, 2.0 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, name in zip(figure.subplots(len(names), 1, sharex=True), names, strict=True):
        axes.plot([row["seconds"] / 60.0 for row in rows], [row[name] for row in rows], linewidth=1.2)
        axes.set_ylabel(name)
        axes.grid(alpha=0.3)
    axes.set_xlabel("minutes")
    figure.savefig(path, dpi=110)


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--task", default="Stripe-Velocity-Flat-Quadruped-v0")
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--steps", type=float, default=1e8)
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--interval", type=float, default=10.0, help="seconds from one row to the next")
    parser.add_argument("--episode-s", type=float, help="length of an episode [s]; by default the task's")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = soak(args)
    draw(rows, args.out / "soak.png")
    found = problems(rows)
    print("\n".join(found) or "memory is flat, all is finite")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
