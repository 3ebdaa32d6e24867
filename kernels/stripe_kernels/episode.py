# SPDX-License-Identifier: Apache-2.0
"""Beginning and end of a step: episode lengths, worlds that are not finite, the log."""

from typing import Any

import warp as wp

from .data import ArticulationData

__all__ = [
    "LOG_COUNT",
    "LOG_LAST",
    "LOG_MEAN",
    "clear_row",
    "clear_wrench",
    "finish_log",
    "finite_action",
    "log_add",
    "make_actions_finite",
    "prefetch_row",
    "reset_targets",
    "restore_row",
    "row_is_finite",
    "seed_streams",
]

LOG_MEAN = wp.constant(0)
LOG_COUNT = wp.constant(1)
LOG_LAST = wp.constant(2)


_PREFETCH = """
#if defined(__CUDA_ARCH__)
    asm volatile("prefetch.global.L1 [%0];" :: "l"((const char*)array.data + (size_t)row * array.strides[0]));
#endif
"""


@wp.func_native(_PREFETCH)
def prefetch_row(array: wp.array(dtype=Any, ndim=1), row: int):
    """Ask for ``array[row]`` without waiting for it; nothing on the CPU."""


@wp.func
def log_add(sums: wp.array[float], counts: wp.array[int], index: int, value: float):
    """Add the value of one environment to an entry of the log."""
    wp.atomic_add(sums, index, value)
    wp.atomic_add(counts, index, 1)


@wp.func
def row_is_finite(values: wp.array[float]) -> bool:
    """Whether all numbers of a slice are finite."""
    total = wp.float32(0.0)
    for i in range(values.shape[0]):
        total += 0.0 * values[i]  # what is not finite makes a NaN; nothing to wait for in between
    return wp.isfinite(total)


@wp.kernel(enable_backward=False)
def finish_log(kinds: wp.array[int], sums: wp.array[float], counts: wp.array[int], values: wp.array[float]):
    """Turn the sums of a step into what is handed out, and clear them; one thread an entry.

    ``LOG_MEAN``: ``sum / count``, which stays as it is in a step without any. ``LOG_COUNT``: ``sum``. ``LOG_LAST``:
    the sum of the last step that had any.
    """
    k = wp.tid()
    if kinds[k] == LOG_COUNT:
        values[k] = sums[k]
    elif counts[k] > 0:
        if kinds[k] == LOG_MEAN:
            values[k] = sums[k] / float(counts[k])
        else:
            values[k] = sums[k]
    sums[k] = 0.0
    counts[k] = 0


@wp.kernel(enable_backward=False)
def seed_streams(seed: int, rng: wp.array[wp.uint32]):
    """Start the random stream of each environment; shape ``(num_envs,)``."""
    env = wp.tid()
    rng[env] = wp.rand_init(seed, env)


@wp.func
def restore_row(values: wp.array[float], source: wp.array[float]):
    """Copy a row."""
    for i in range(values.shape[0]):
        values[i] = source[i]


@wp.func
def clear_row(values: wp.array[float]):
    """Set a row to zero."""
    for i in range(values.shape[0]):
        values[i] = 0.0


@wp.func
def reset_targets(env: int, robot: ArticulationData):
    """Bring the targets of all joints back to their state at the start of an episode; no effort is asked for."""
    for j in range(robot.joint_pos_target.shape[1]):
        robot.joint_pos_target[env, j] = robot.default_joint_pos[env, j]
    for j in range(robot.joint_vel_target.shape[1]):
        robot.joint_vel_target[env, j] = robot.default_joint_vel[env, j]
        robot.joint_effort_target[env, j] = 0.0


@wp.func
def clear_wrench(env: int, robot: ArticulationData):
    """Remove the external wrenches."""
    for b in range(robot.external_wrench.shape[1]):
        robot.external_wrench[env, b] = wp.spatial_vector()


@wp.func
def finite_action(value: float, bad: wp.array[int]) -> float:
    """``value``, or 0 where it is no number and +-1e6 where it is infinite; counts those in ``bad[0]``."""
    result = value
    if not wp.isfinite(value):
        wp.atomic_add(bad, 0, 1)
        result = wp.where(wp.isnan(value), 0.0, wp.sign(value) * 1.0e6)
    return result


@wp.kernel(enable_backward=False)
def make_actions_finite(actions: wp.array[float], bad: wp.array[int]):
    """``finite_action`` of each number, in place."""
    i = wp.tid()
    actions[i] = finite_action(actions[i], bad)
