# SPDX-License-Identifier: Apache-2.0
"""Small tasks: environments of registered tasks as tests run them, few and on the CPU."""

from __future__ import annotations

from typing import Any

from stripe_newton.cli.tasks import load_cfg

__all__ = ["small_cfg"]


def small_cfg(task: str, num_envs: int = 4, seed: int | None = 1) -> Any:
    """Config of a task with few environments on the CPU, and few tiles of terrain."""
    cfg = load_cfg(task, "env")
    cfg.sim.device, cfg.scene.num_envs = "cpu", num_envs
    if seed is not None:
        cfg.seed = seed
    if "Velocity-Rough" in task:
        tiles = cfg.scene.terrain.terrain_generator
        tiles.num_rows, tiles.num_cols, tiles.border_width = 3, 6, 4.0
    return cfg
