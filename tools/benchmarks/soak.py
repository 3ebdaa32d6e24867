# SPDX-License-Identifier: Apache-2.0
"""Soak: many steps of a task under random actions, with memory, speed and state over time, as a table and curves.

    python tools/benchmarks/soak.py OUT [--task T] [--device cuda:0] [--num-envs 4096] [--steps 1e8] [--seconds 3600]

It ends after that many steps of all environments together and that many seconds, whichever comes later. OUT gets
``soak.csv``, a row for each interval, ``soak.png`` and ``soak.md``, ten rows of it. The command fails if memory of the
host or the device grows by more than 2 % after the first fifth, if rewards or speed drift from the first third after
it to the last, if a world was not finite, or if an observation, a reward or a joint was not. With ``--episode-s``
episodes are longer, for simulated time without an end.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnv

__all__ = ["main", "problems", "table"]

GROWTH = 0.02
"""Share by which memory may grow after the first fifth."""
DRIFT, ERRORS = 0.05, 5.0
"""Share by which a mean may change, if that is also more than so many standard errors."""
COLUMNS = ("seconds", "steps", "simulated_s", "steps_per_s", "host_mb", "device_mb", "nonfinite_worlds", "largest_q",
           "largest_qd", "largest_obs", "mean_reward")  # fmt: skip


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
    settled = rows[len(rows) // 5 :]
    for name in ("host_mb", "device_mb"):
        first, last = settled[0][name], settled[-1][name]
        if last > first * (1.0 + GROWTH):
            found.append(f"{name}: grew from {first:.0f} to {last:.0f}")
    for name in ("mean_reward", "steps_per_s"):
        if drift := _drift([row[name] for row in settled]):
            found.append(f"{name}: {drift}")
    if rows[-1]["nonfinite_worlds"]:
        found.append(f"{rows[-1]['nonfinite_worlds']:.0f} worlds were not finite")
    for name in ("largest_q", "largest_qd", "largest_obs", "mean_reward"):
        if any(not abs(row[name]) < float("inf") for row in rows):
            found.append(f"{name}: is not finite")
    return found


def _drift(values: list[float]) -> str:
    """How the mean of the last third differs from that of the first; empty if it does not, or cannot be told."""
    third = len(values) // 3
    if third < 5:
        return ""
    first, last = np.array(values[:third]), np.array(values[-third:])
    change, error = abs(last.mean() - first.mean()), np.hypot(first.std(), last.std()) / third**0.5
    if change <= ERRORS * error or change <= DRIFT * abs(first.mean()):
        return ""
    return f"went from {first.mean():.6g} to {last.mean():.6g}"


@torch.inference_mode()
def soak(args: argparse.Namespace) -> list[dict[str, float]]:
    """Step until both limits are reached, and write a row now and then."""
    from stripe_newton.cli.tasks import load_cfg, make_env

    cfg = load_cfg(args.task, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = args.num_envs, args.device, 0
    if args.episode_s is not None:
        cfg.episode_length_s = args.episode_s
    env = make_env(args.task, cfg)
    env.reset(seed=0)
    shape = env.action_space.shape
    generator = torch.Generator(args.device).manual_seed(0)
    rows: list[dict[str, float]] = []
    began = last = time.monotonic()
    steps, before = 0, 0
    reward, largest = (torch.zeros((), device=args.device) for _ in range(2))
    with open(args.out / "soak.csv", "w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        goes_on = True
        while goes_on:
            actions = 2.0 * torch.rand(shape, generator=generator, device=args.device) - 1.0
            observations, rewards, *_ = env.step(actions)
            reward += rewards.mean()
            for observation in observations.values():
                largest = torch.maximum(largest, observation.abs().max())  # which keeps a NaN
            steps += args.num_envs
            now = time.monotonic()
            goes_on = steps < args.steps or now - began < args.seconds
            if goes_on and now - last < args.interval:
                continue
            seen = float(largest), float(reward) * args.num_envs / (steps - before)
            values = (now - began, steps, (steps - before) / (now - last), *seen)
            rows.append(_row(env.unwrapped, args, *values))
            writer.writerow(rows[-1])
            file.flush()
            reward.zero_()
            largest.zero_()
            last, before = now, steps
            print(" ".join(f"{name} {value:.6g}" for name, value in rows[-1].items()), flush=True)
    env.close()
    return rows


def _row(
    inner: RLEnv, args: argparse.Namespace, seconds: float, steps: int, rate: float, largest: float, reward: float
) -> dict[str, float]:
    state = inner.sim.state
    q, qd = (float(np.abs(array.numpy()).max()) for array in (state.joint_q, state.joint_qd))
    simulated = steps / args.num_envs * inner.step_dt
    memory = host_bytes() / 1e6, device_bytes(args.device) / 1e6
    values = (seconds, steps, simulated, rate, *memory, float(inner.nonfinite_worlds), q, qd, largest, reward)
    return dict(zip(COLUMNS, values, strict=True))


def table(rows: list[dict[str, float]]) -> str:
    """Ten rows in Markdown, equally far apart."""
    chosen = [rows[round(k * (len(rows) - 1) / 9)] for k in range(10)] if len(rows) > 10 else rows
    lines = [f"| {' | '.join(COLUMNS)} |", "|" + "---:|" * len(COLUMNS)]
    lines += [f"| {' | '.join(f'{row[name]:.6g}' for name in COLUMNS)} |" for row in chosen]
    return "\n".join(lines) + "\n"


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
    parser.add_argument("--steps", type=float, default=1e8, help="steps of all environments together, at least")
    parser.add_argument("--seconds", type=float, default=3600.0, help="at least")
    parser.add_argument("--interval", type=float, default=10.0, help="seconds from one row to the next")
    parser.add_argument("--episode-s", type=float, help="length of an episode [s]; by default the task's")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = soak(args)
    draw(rows, args.out / "soak.png")
    (args.out / "soak.md").write_text(table(rows))
    found = problems(rows)
    print("\n".join(found) or "memory is flat, nothing drifts, all is finite")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
