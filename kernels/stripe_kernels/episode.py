# SPDX-License-Identifier: Apache-2.0
"""Episode bookkeeping of a step: the log, random streams, and guards against numbers that are not finite."""

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
    "reset_targets",
    "restore_row",
    "row_is_finite",
    "seed_streams",
]

LOG_MEAN = wp.constant(0)
"""Log entry: mean over the environments that added to it."""
LOG_COUNT = wp.constant(1)
"""Log entry: sum over the environments."""
LOG_LAST = wp.constant(2)
"""Log entry: sum in the last step in which an environment added to it."""


@wp.func
def log_add(sums: wp.array[float], counts: wp.array[int], index: int, value: float):
    """Add the value of one environment to an entry of the log."""
    # Threads add in any order, so the last digits of a logged float may differ from run to run; nothing is trained on
    # them.
    wp.atomic_add(sums, index, value)
    wp.atomic_add(counts, index, 1)


@wp.func
def row_is_finite(values: wp.array[float]) -> bool:
    """Whether all numbers of a slice are finite."""
    total = wp.float32(0.0)
    for i in range(values.shape[0]):
        # 0 * inf and 0 * NaN are NaN, and a NaN stays in the sum. No branch, so all loads are in flight at once.
        total += 0.0 * values[i]
    return wp.isfinite(total)


@wp.kernel(enable_backward=False)
def finish_log(kinds: wp.array[int], sums: wp.array[float], counts: wp.array[int], values: wp.array[float]):
    """Turn the sums of a step into the values of the log, and clear the sums; one thread an entry.

    ``LOG_MEAN``: ``sum / count``, or the value of the step before where nothing was added. ``LOG_COUNT``: ``sum``.
    ``LOG_LAST``: ``sum``, or the value of the step before where nothing was added.
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
    """Set the targets of all joints to the default joint state, and the effort targets to 0."""
    for j in range(robot.joint_pos_target.shape[1]):
        robot.joint_pos_target[env, j] = robot.default_joint_pos[env, j]
    for j in range(robot.joint_vel_target.shape[1]):
        robot.joint_vel_target[env, j] = robot.default_joint_vel[env, j]
        robot.joint_effort_target[env, j] = 0.0


@wp.func
def clear_wrench(env: int, robot: ArticulationData):
    """Set the external wrenches of all bodies to zero."""
    for b in range(robot.external_wrench.shape[1]):
        robot.external_wrench[env, b] = wp.spatial_vector()


@wp.func
def finite_action(value: float, bad: wp.array[int]) -> float:
    """An action with NaN replaced by 0 and infinities by +-1e6; counts the replacements in ``bad[0]``."""
    result = value
    if not wp.isfinite(value):
        wp.atomic_add(bad, 0, 1)
        result = wp.where(wp.isnan(value), 0.0, wp.sign(value) * 1.0e6)
    return result


@wp.kernel(enable_backward=False)
def make_actions_finite(actions: wp.array[float], bad: wp.array[int]):
    """Apply :func:`finite_action` to each number, in place; one thread a number."""
    i = wp.tid()
    actions[i] = finite_action(actions[i], bad)
