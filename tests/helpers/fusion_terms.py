# SPDX-License-Identifier: Apache-2.0
"""Terms for the tests of fusion, the problems that binding them finds, and the files of generated kernels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.fusion import bind_term
from stripe_newton.managers import ManagerContext


@wp.func
def cart_energy(env: int, robot: ArticulationData, joint_ids: wp.array[int], mass: float) -> float:
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        speed = robot.joint_vel[env, joint_ids[i]]
        total += 0.5 * mass * speed * speed
    return total


@wp.func
def count_up(env: int, counter: wp.array[float]) -> float:
    counter[env] = counter[env] + 1.0
    return counter[env]


@wp.func
def silent(env: int, robot: ArticulationData):
    robot.joint_pos[env, 0] = 0.0


def problems_of(context: ManagerContext, func: Any, params: dict[str, Any], kind: str = "reward") -> str:
    """The problems of a term that cannot be bound, a line for each."""
    before = len(context.problems)
    assert bind_term(context, func, params, "rewards.x", kind) is None
    return "\n".join(context.problems[before:])


def generated_files() -> set[str]:
    """The names of the files of all generated kernels in Warp's cache."""
    folder = Path(wp.config.kernel_cache_dir) / "stripe_newton"
    return {p.name for p in folder.glob("*")} if folder.exists() else set()
