# SPDX-License-Identifier: Apache-2.0
"""Soak: many steps of a task, with memory, speed and state over time, as a table and curves.

    python tools/benchmarks/soak.py OUT [--task T] [--device cuda:0] [--num-envs 4096] [--steps 1e8] [--seconds 3600]
                                        [--train]

Actions are random, or with ``--train`` those of a training, whose rewards may change. It ends after that many steps of
all environments together and that many seconds, whichever comes later. OUT gets ``soak.csv``, a row for each interval,
``soak.png`` and ``soak.md``, ten rows of it. The command fails if memory of the host or the device grows by more than
2 % after the first fifth, if rewards or speed drift from the first third after it to the last, if a world was not
finite, or if an observation, a reward or a joint was not. With ``--episode-s`` episodes are longer, for simulated time
without an end.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

if TYPE_CHECKING:
    import gymnasium

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


def problems(rows: list[dict[str, float]], learns: bool = False) -> list[str]:
    """What is wrong with the rows of a soak; rewards of one that ``learns`` may change."""
    found = []
    settled = rows[len(rows) // 5 :]
    for name in ("host_mb", "device_mb"):
        first, last = settled[0][name], settled[-1][name]
        if last > first * (1.0 + GROWTH):
            found.append(f"{name}: grew from {first:.0f} to {last:.0f}")
    for name in ("steps_per_s",) if learns else ("mean_reward", "steps_per_s"):
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


class Recorder:
    """Sums what steps return, and writes a row now and then."""

    def __init__(self, args: argparse.Namespace, env: RLEnv):
        self.rows: list[dict[str, float]] = []
        self._args, self._env = args, env
        self._file = open(args.out / "soak.csv", "w", newline="")  # noqa: SIM115  (closed by `close`)
        self._writer = csv.DictWriter(self._file, COLUMNS)
        self._writer.writeheader()
        self._began = self._last = time.monotonic()
        self._steps = self._before = 0
        self._reward, self._largest = (torch.zeros((), device=args.device) for _ in range(2))

    def count(self, observations: Mapping[str, torch.Tensor], reward: torch.Tensor, steps: int) -> bool:
        """Count environment steps, with the mean reward of one and the last observations; returns whether to go on."""
        args, now = self._args, time.monotonic()
        self._steps += steps * args.num_envs
        self._reward += steps * reward
        for observation in observations.values():
            self._largest = torch.maximum(self._largest, observation.abs().max())  # which keeps a NaN
        goes_on = self._steps < args.steps or now - self._began < args.seconds
        if not goes_on or now - self._last >= args.interval:
            self._write(now)
        return goes_on

    def _write(self, now: float) -> None:
        done = self._steps - self._before
        seen = float(self._largest), float(self._reward) * self._args.num_envs / done
        values = (now - self._began, self._steps, done / (now - self._last), *seen)
        self.rows.append(_row(self._env, self._args, *values))
        self._writer.writerow(self.rows[-1])
        self._file.flush()
        self._reward.zero_()
        self._largest.zero_()
        self._last, self._before = now, self._steps
        print("\n" + " ".join(f"{name} {value:.6g}" for name, value in self.rows[-1].items()), flush=True)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def soak(args: argparse.Namespace) -> list[dict[str, float]]:
    """Step until both limits are reached."""
    from stripe_newton.cli.tasks import load_cfg, make_env

    cfg = load_cfg(args.task, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = args.num_envs, args.device, 0
    if args.episode_s is not None:
        cfg.episode_length_s = args.episode_s
    env = make_env(args.task, cfg)
    recorder = Recorder(args, env.unwrapped)
    (_train if args.train else _act_at_random)(args, env, recorder)
    recorder.close()
    env.close()
    return recorder.rows


def _act_at_random(args: argparse.Namespace, env: gymnasium.vector.VectorEnv, recorder: Recorder) -> None:
    env.reset(seed=0)
    generator = torch.Generator(args.device).manual_seed(0)
    goes_on = True
    while goes_on:
        actions = 2.0 * torch.rand(env.action_space.shape, generator=generator, device=args.device) - 1.0
        observations, rewards, *_ = env.step(actions)
        goes_on = recorder.count(observations, rewards.mean(), 1)


def _train(args: argparse.Namespace, env: gymnasium.vector.VectorEnv, recorder: Recorder) -> None:
    from stripe_newton.cli.tasks import load_cfg
    from stripe_newton.rl import OnPolicyRunner, RslRlVecEnvWrapper

    agent = load_cfg(args.task, "agent")
    agent.save_interval = 1000
    runner = OnPolicyRunner(RslRlVecEnvWrapper(env), agent, args.out / "run")

    def look(_: int) -> None:
        rewards = runner.alg.storage.rewards
        if not recorder.count(runner.env.get_observations(), rewards.mean(), agent.num_steps_per_env):
            runner.logger.stop_requested = True

    runner.logger.iteration_hooks.append(look)
    runner.learn(10**9)


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
    """Draw the columns over time. The axes of memory and counts begin at zero: a tiny growth looks like one."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = COLUMNS[3:]
    figure = Figure(figsize=(11.0, 1.7 * len(names) / 2.0), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, name in zip(figure.subplots(len(names) // 2, 2, sharex=True).flat, names, strict=True):
        axes.plot([row["seconds"] / 60.0 for row in rows], [row[name] for row in rows], linewidth=1.2)
        axes.set_title(name, fontsize=9)
        axes.grid(alpha=0.3)
        if name in ("host_mb", "device_mb", "nonfinite_worlds"):
            top = 1.1 * max(*(row[name] for row in rows), 1.0)
            axes.set_ylim(-0.05 * top, top)  # a line of zeros is seen, too
        axes.set_xlabel("minutes" if name in names[-2:] else "")
    figure.savefig(path, dpi=80)


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
    parser.add_argument("--train", action="store_true", help="train, rather than act at random")
    parser.add_argument("--episode-s", type=float, help="length of an episode [s]; by default the task's")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    rows = soak(args)
    draw(rows, args.out / "soak.png")
    (args.out / "soak.md").write_text(table(rows))
    found = problems(rows, args.train)
    print("\n".join(found) or "memory is flat, nothing drifts, all is finite")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
