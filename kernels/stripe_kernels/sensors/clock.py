# SPDX-License-Identifier: Apache-2.0
"""When a sensor measures: a count of environment steps for each environment, and a flag that kernels look at.

``due`` says whether the next measurement is taken; kernels exit where it is not. A sensor that measures within the step
(contacts, IMU, frames) ends each step with ``advance``; one that measures before the observations (rays, cameras)
counts the step with ``count_step`` and ends its measurement with ``settle``. ``restart`` begins an episode.
"""

import warp as wp

__all__ = ["advance", "count_step", "mark", "restart", "settle"]


@wp.kernel(enable_backward=False)
def advance(period: int, age: wp.array[int], due: wp.array[wp.bool]):
    """After the measurement of a step: whether there is one in the next.

    Args:
        period: Environment steps from one measurement to the next.
        age: Which step after the last measurement the next one is, shape ``(num_envs,)``.
        due: Whether it measures, shape ``(num_envs,)``.
    """
    env = wp.tid()
    steps = age[env] + 1
    if due[env]:
        steps = 1
    age[env] = steps
    due[env] = steps >= period


@wp.kernel(enable_backward=False)
def count_step(period: int, age: wp.array[int], due: wp.array[wp.bool]):
    """After the physics of a step: whether the period is over; ``age`` counts steps since the last measurement."""
    env = wp.tid()
    age[env] = age[env] + 1
    due[env] = due[env] or age[env] >= period


@wp.kernel(enable_backward=False)
def settle(age: wp.array[int], due: wp.array[wp.bool]):
    """After a measurement before the observations: the next one waits for its period."""
    env = wp.tid()
    if due[env]:
        age[env] = 0
        due[env] = False


@wp.kernel(enable_backward=False)
def restart(mask: wp.array[wp.bool], start: int, period: int, age: wp.array[int], due: wp.array[wp.bool]):
    """Begin an episode where ``mask`` says so, with ``age = start``."""
    env = wp.tid()
    if mask[env]:
        age[env] = start
        due[env] = start >= period


@wp.kernel(enable_backward=False)
def mark(mask: wp.array[wp.bool], marked: wp.array[wp.bool]):
    """Add the environments of ``mask`` to those that are marked."""
    env = wp.tid()
    if mask[env]:
        marked[env] = True
