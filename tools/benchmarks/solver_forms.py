# SPDX-License-Identifier: Apache-2.0
"""Solver forms: time of a task's physics in the general form of the fused step and in that for a hub with limbs.

    python tools/benchmarks/solver_forms.py Stripe-Velocity-Flat-Quadruped-v0 Stripe-Ant-v0 --num-envs 256 --device cpu
    python tools/benchmarks/solver_forms.py Stripe-Velocity-Flat-Quadruped-v0 --num-envs 4096 32768 --device cuda:0

The worlds are driven by random actions for a while. Then both forms advance them by the physics steps of a control
step, from the same states, and the least time of some launches counts: on a CPU that of the process, on a GPU that of
the device.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
import torch
import warp as wp

import stripe_tasks  # noqa: F401  (registers the tasks)
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.envs.rl_env import RLEnv
from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.launch_arguments import StepCall

_STATE = "qpos", "qvel", "qacc_warmstart"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("tasks", nargs="+")
    parser.add_argument("--num-envs", type=int, nargs="+", default=[256])
    parser.add_argument("--scenery", help="a stage, in which the tasks take place")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--launches", type=int, default=20)
    parser.add_argument("--warm-up", type=int, default=30, help="environment steps before states are taken")
    args = parser.parse_args()
    print(
        "| task | worlds | rows | iterations | general [ms] | limbs [ms] | largest difference of velocities, relative "
        "| worlds with more than 1e-3 |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for task in args.tasks:
        for num_envs in args.num_envs:
            print(row(task, num_envs, args), flush=True)


def row(task: str, num_envs: int, args: argparse.Namespace) -> str:
    """Row of the table for a task.

    Raises:
        ValueError: if the fused step does not step the task, or its robot is no hub with limbs.
    """
    device = args.device
    cfg = load_cfg(task, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = num_envs, device, 1
    if args.scenery is not None:
        cfg.scene.scenery = args.scenery
    env = make_env(task, cfg).unwrapped
    assert isinstance(env, RLEnv)
    env.reset(seed=1)
    generator = torch.Generator(device=device).manual_seed(0)
    for _ in range(args.warm_up):
        shape = num_envs, *env.single_action_space.shape
        env.step(2.0 * torch.rand(shape, generator=generator, device=device) - 1.0)
    solver = env.sim.solver
    if not isinstance(solver, SolverFused) or not solver.one_launch:
        raise ValueError(f"{task}: {env.sim.describe_solver()}")
    before = {name: wp.clone(getattr(solver.mjw_data, name)) for name in _STATE}
    times, speeds = [], []
    for limbs in (False, True):
        solver.limbs = limbs
        solver.launcher.remake()
        if solver.fused.layout.is_limbs != limbs:
            raise ValueError(f"{task}: its robot is no hub with limbs, or touches what the form has no routine for")
        times.append(least_time(solver, before, cfg.decimation, device, args.launches))
        speeds.append(solver.mjw_data.qvel.numpy().copy())
    rows, iterations = (getattr(solver.mjw_data, name).numpy().mean() for name in ("nefc", "solver_niter"))
    off = np.linalg.norm(speeds[1] - speeds[0], axis=1) / np.linalg.norm(speeds[0], axis=1)
    env.close()
    general, limb = (f"{1e3 * seconds:.3f}" for seconds in times)
    return (
        f"| {task} | {num_envs:,} | {rows:.1f} | {iterations:.2f} | {general} | {limb} | {off.max():.1e} "
        f"| {np.count_nonzero(off > 1e-3)} |"
    )


def least_time(solver: SolverFused, before: dict[str, wp.array], steps: int, device: str, launches: int) -> float:
    """Least time of a launch from the same states [s]."""
    data, best = solver.mjw_data, np.inf
    arguments = solver.launcher.arguments(StepCall())

    def launch() -> None:
        solver.fused.launch(arguments, data.nworld, device, steps)

    for _ in range(launches):
        for name, value in before.items():
            wp.copy(getattr(data, name), value)
        best = min(best, seconds_of(launch, device))
    return float(best)


def seconds_of(launch: Callable[[], None], device: str) -> float:
    """Time of a launch: that of the process on a CPU, that of the device on a GPU."""
    if device == "cpu":
        start = time.process_time()
        launch()
        return time.process_time() - start
    start, end = wp.Event(device, enable_timing=True), wp.Event(device, enable_timing=True)
    wp.record_event(start)
    launch()
    wp.record_event(end)
    return wp.get_event_elapsed_time(start, end) / 1e3


if __name__ == "__main__":
    main()
