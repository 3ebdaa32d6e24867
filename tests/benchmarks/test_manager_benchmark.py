# SPDX-License-Identifier: Apache-2.0
"""Benchmark of the managers of ``Stripe-Ant-v0``: with one kernel each, and with a kernel for each term.

    pytest tests/benchmarks/test_manager_benchmark.py --benchmark-only              # CPU
    pytest tests/benchmarks/test_manager_benchmark.py --benchmark-only -m gpu       # GPU, up to 16384 environments

On the GPU a round is a graph of many repeats; ``us`` in the extra columns is the time of one.
"""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from stripe_newton.envs.fusion_gain import fused_kernels, term_configs
from tests.helpers.benchmark_ant import SIZES, ant

REPEATS = 100
MANAGERS = ("termination_manager", "reward_manager", "observation_manager")


@pytest.mark.parametrize("how", ["fused", "apart"])
@pytest.mark.parametrize("name", MANAGERS)
@pytest.mark.parametrize(("device", "num_envs"), SIZES)
def test_manager(device, num_envs, name, how, benchmark):
    manager = getattr(ant(num_envs, device), name)
    terms = list(term_configs(manager.cfg))
    kernels = [k for cfg in ([manager.cfg] if how == "fused" else terms) for k in fused_kernels([manager], [cfg])]
    assert len(kernels) == (1 if how == "fused" else len(terms)) > 0
    benchmark.extra_info["terms"] = len(terms)

    def launch() -> None:
        for kernel in kernels:
            kernel.launch()

    launch()
    if device == "cpu":
        benchmark(launch)
        return
    with wp.ScopedCapture(device) as capture:
        for _ in range(REPEATS):
            launch()

    def round_of_launches() -> None:
        wp.capture_launch(capture.graph)
        wp.synchronize_device(device)

    round_of_launches()
    benchmark(round_of_launches)
    if benchmark.stats is not None:
        benchmark.extra_info["us"] = 1e6 * float(np.median(benchmark.stats.stats.data)) / REPEATS
