# SPDX-License-Identifier: Apache-2.0
"""Ant environments of several sizes, on CPU and GPU, for benchmarks."""

from __future__ import annotations

import functools
from typing import Any

import pytest

from stripe_newton.cli.tasks import load_cfg, make_env

TASK = "Stripe-Ant-v0"
SIZES = [
    *(("cpu", n) for n in (1, 16, 256)),
    *(pytest.param("cuda:0", n, marks=pytest.mark.gpu) for n in (1, 16, 256, 1024, 4096, 16384)),
]
"""Devices and numbers of environments."""


@functools.lru_cache(maxsize=1)  # tests of one size follow each other; the last one is enough to keep
def ant(num_envs: int, device: str) -> Any:
    """The ant, past its first reset."""
    cfg = load_cfg(TASK, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = num_envs, device, 0
    env = make_env(TASK, cfg).unwrapped
    env.reset()
    return env
