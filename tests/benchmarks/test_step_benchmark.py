# SPDX-License-Identifier: Apache-2.0
"""Benchmark of a whole step of ``Stripe-Ant-v0``, with more or fewer episodes that end in it.

    pytest tests/benchmarks/test_step_benchmark.py --benchmark-only              # CPU
    pytest tests/benchmarks/test_step_benchmark.py --benchmark-only -m gpu       # GPU, up to 16384 environments

A round is one step and, on a GPU, the wait for its end; ``stripe-newton bench`` measures without that wait.
"""

from __future__ import annotations

import pytest
import torch

from stripe_newton.envs.measure import random_actions
from tests.helpers.benchmark_ant import SIZES, ant


@pytest.mark.parametrize("ending", [0.0, 0.01, 1.0], ids=lambda share: f"{100 * share:g}%")
@pytest.mark.parametrize(("device", "num_envs"), SIZES)
def test_step_in_which_episodes_end(device, num_envs, ending, benchmark):
    env = ant(num_envs, device)
    actions = random_actions(env, 8)
    count = round(ending * num_envs)
    if ending and not count:
        pytest.skip(f"{100 * ending:g} % of {num_envs} environments are none")
    lengths = torch.zeros(num_envs, dtype=torch.long, device=device)
    lengths[:count] = env.max_episode_length
    index = 0

    def prepare() -> None:
        env.episode_length_buf = lengths
        if device != "cpu":
            torch.cuda.synchronize(device)

    def step() -> None:
        nonlocal index
        env.step(actions[index % len(actions)])
        index += 1
        if device != "cpu":
            torch.cuda.synchronize(device)

    for _ in range(4):
        prepare()
        step()
    assert bool(env.reset_buf[:count].all()), "the episodes did not end"
    benchmark.pedantic(step, setup=prepare, rounds=40)
    benchmark.extra_info["env_steps_per_s"] = None
    if benchmark.stats is not None:
        benchmark.extra_info["env_steps_per_s"] = num_envs / benchmark.stats.stats.median
