# SPDX-License-Identifier: Apache-2.0
"""Profile of a step on a GPU: ``python tools/benchmarks/profile_step.py TASK [--num-envs N] [--own]``.

It prints the kernels of a step by their time; with ``--own`` only those that are not the solver's.
"""

from __future__ import annotations

import argparse

import gymnasium
import torch
from torch.autograd.profiler_util import EventList
from torch.profiler import ProfilerActivity, profile

import stripe_tasks  # noqa: F401

OWN = ("step_", "finish_log", "eval_articulation_fk", "reset_world_buffers", "Memcpy", "memcpy", "single_thread")
STEPS = 20


def rows(events: EventList) -> list[tuple[float, float, str]]:
    """Microseconds and launches in a step by kernel, the longest first."""
    found = [(e.device_time_total / STEPS, e.count / STEPS, e.key) for e in events if e.device_time_total > 0]
    return sorted(found, reverse=True)


def main() -> None:
    """Profile a task."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("task")
    parser.add_argument("--num-envs", type=int, default=4096)
    parser.add_argument("--own", action="store_true")
    args = parser.parse_args()
    env = gymnasium.make_vec(args.task, num_envs=args.num_envs).unwrapped
    env.reset(seed=1)
    size = env.single_action_space.shape[0]
    action = 2.0 * torch.rand(args.num_envs, size, device=env.device) - 1.0
    for _ in range(100):
        env.step(action)
    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CPU, ProfilerActivity.CUDA]) as prof:
        for _ in range(STEPS):
            env.step(action)
        torch.cuda.synchronize()
    table = rows(prof.key_averages())
    shown = [r for r in table if not args.own or any(name in r[2] for name in OWN)]
    for time, count, name in shown[:60]:
        print(f"{time:9.2f} us {count:6.2f}  {name[:90]}")
    print(f"{sum(r[0] for r in shown):9.2f} us of {sum(r[0] for r in table):.2f} us of all kernels")


if __name__ == "__main__":
    main()
