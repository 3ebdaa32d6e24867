# SPDX-License-Identifier: Apache-2.0
"""Walking: the first checkpoint of a velocity task's run that walks, with its samples and its time.

    python tools/benchmarks/walking.py RUN [--robots 64]

Each checkpoint acts with its own robots for one episode of 20 s, without exploration noise, under the noise and the
pushes of the training. It walks if 95 % of its robots do not fall, and the error of the horizontal velocity is below
0.25 m/s, as a mean over the steps before a fall: the criterion of ``docs/comparison.md``.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import torch

from stripe_newton.cli.env_and_policy import build
from stripe_newton.cli.run_configs import load_configs, use_one_minibatch
from stripe_newton.rl import OnPolicyRunner, RunFolder

MAX_ERROR, MIN_UPRIGHT = 0.25, 0.95


def measure(run: RunFolder, robots: int, command: str = "base_velocity") -> list[dict[str, float]]:
    """Error of the velocity [m/s] and share of upright robots, for each checkpoint of a run."""
    task = run.read_task()
    if task is None:
        raise SystemExit(f"{run.path}: names no task")
    checkpoints = run.list_checkpoints()
    configs = load_configs(task, run)
    configs.env.sim.device, configs.env.scene.num_envs = "cpu", robots * len(checkpoints)
    use_one_minibatch(configs.need_agent())
    runner = build(task, configs)
    states = [torch.load(file, map_location="cpu", weights_only=True)["actor_state_dict"] for _, file in checkpoints]
    error, upright = act(runner, states, robots, command)
    with run.metrics.open(encoding="utf-8") as file:
        rows = {int(row["iteration"]): row for row in csv.DictReader(file)}
    return [
        {
            "iteration": number,
            "samples": float(rows[number]["total_steps"]),
            "seconds": float(rows[number]["elapsed_s"]),
            "error": float(off.mean()),
            "upright": float(up.float().mean()),
        }
        for (number, _), off, up in zip(checkpoints, error.split(robots), upright.split(robots), strict=True)
    ]


@torch.inference_mode()
def act(
    runner: OnPolicyRunner, states: list[dict[str, torch.Tensor]], robots: int, command: str
) -> tuple[torch.Tensor, torch.Tensor]:
    """Let each policy act with its own robots: mean error of the velocity [m/s] and whether they stay up, by robot."""
    env, actor, count = runner.env, runner.alg.actor.eval(), robots * len(states)
    inner = env.unwrapped
    robot, velocity = inner.scene["robot"], inner.command_manager.get_command(command)
    shares = torch.arange(count).split(robots)
    obs = env.reset()
    upright, error, steps = torch.ones(count, dtype=torch.bool), torch.zeros(count), torch.zeros(count)
    for _ in range(int(env.max_episode_length) - 1):
        pairs = zip(states, shares, strict=True)
        actions = [torch.func.functional_call(actor, state, (obs[rows],)) for state, rows in pairs]
        obs, _, done, _ = env.step(torch.cat(actions))
        upright &= done == 0
        off = (velocity[:, :2] - robot.data.root_link_lin_vel_b[:, :2]).norm(dim=1)
        error += torch.where(upright, off, 0.0)
        steps += upright
    return error / steps.clamp(min=1.0), upright


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--robots", type=int, default=64, help="robots of each checkpoint")
    args = parser.parse_args()
    print("| iteration | samples | training [s] | error [m/s] | upright | walks |")
    print("| ---: | ---: | ---: | ---: | ---: | --- |")
    for row in measure(RunFolder(args.run), args.robots):
        walks = "yes" if row["error"] < MAX_ERROR and row["upright"] >= MIN_UPRIGHT else "no"
        print(
            f"| {row['iteration'] + 1:.0f} | {row['samples']:,.0f} | {row['seconds']:.0f} | {row['error']:.3f}"
            f" | {100 * row['upright']:.0f} % | {walks} |"
        )


if __name__ == "__main__":
    main()
