# SPDX-License-Identifier: Apache-2.0
"""Benchmark of each term alone, at 4096 environments.

    pytest tests/benchmarks/test_terms_benchmark.py --benchmark-only              # CPU
    pytest tests/benchmarks/test_terms_benchmark.py --benchmark-only -m gpu       # GPU

On the GPU a round is a graph of many launches; ``us_per_launch`` in the extra columns is the time of one.
"""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from tests.helpers import term_kernels as tk
from tests.helpers.term_launch import CASES, Launch, kernels, params_of, values
from tests.helpers.term_reference_random import Stream

NUM_ENVS = 4096
LAUNCHES_PER_GRAPH = 100
TERMS = [(kind, name) for kind in tk.KINDS for name in tk.term_names(kind)]


@pytest.mark.parametrize(("kind", "name"), TERMS, ids=[name for _, name in TERMS])
def test_term_alone(kind, name, device, benchmark):
    params = params_of(CASES.get(name, [{}])[0], NUM_ENVS, size=64)
    launch = Launch(kind, name, values(NUM_ENVS), params, Stream(0, NUM_ENVS).n, device)
    kernel, inputs = getattr(kernels(kind), name), list(launch.arguments.values())
    command = wp.launch(kernel, dim=NUM_ENVS, inputs=inputs, device=device, record_cmd=True)
    if device == "cpu":
        benchmark(command.launch)
        return

    with wp.ScopedCapture(device) as capture:
        for _ in range(LAUNCHES_PER_GRAPH):
            command.launch()

    def round_of_launches() -> None:
        wp.capture_launch(capture.graph)
        wp.synchronize_device(device)

    round_of_launches()
    benchmark(round_of_launches)
    if benchmark.stats is not None:
        benchmark.extra_info["us_per_launch"] = 1e6 * float(np.median(benchmark.stats.stats.data)) / LAUNCHES_PER_GRAPH
