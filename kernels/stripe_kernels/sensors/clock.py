# SPDX-License-Identifier: Apache-2.0
"""Sensor clock: counts environment steps between measurements, and flags the environments that measure.

Kernels of sensors return where ``due`` is False. A sensor that measures within the step (contacts, IMU, frames) ends
each step with ``advance``. One that measures before the observations (rays, cameras) counts the step with
``count_step`` and ends its measurement with ``settle``. ``restart`` starts an episode.
"""

import warp as wp

__all__ = ["advance", "count_step", "mark", "restart", "settle"]


@wp.kernel(enable_backward=False)
def advance(period: int, age: wp.array[int], due: wp.array[wp.bool]):
    """Advance the clock at the end of a step: decide which environments measure in the next step.

    Args:
        period: Environment steps from one measurement to the next.
        age: Steps from the last measurement to the next step, shape ``(num_envs,)``.
        due: Whether an environment measures in a step, shape ``(num_envs,)``.
    """
    env = wp.tid()
    steps = age[env] + 1
    if due[env]:  # this step has measured, so that the next one is the first after it
        steps = 1
    age[env] = steps
    due[env] = steps >= period


@wp.kernel(enable_backward=False)
def count_step(period: int, age: wp.array[int], due: wp.array[wp.bool]):
    """Count a step after its physics, and flag environments whose period is over; ``age`` counts since the measurement.

    Unlike :func:`advance` it does not clear a flag: an environment that is due stays due until :func:`settle`.
    """
    env = wp.tid()
    age[env] = age[env] + 1
    due[env] = due[env] or age[env] >= period


@wp.kernel(enable_backward=False)
def settle(age: wp.array[int], due: wp.array[wp.bool]):
    """Clear the flags of environments that have measured, and start their periods anew."""
    env = wp.tid()
    if due[env]:
        age[env] = 0
        due[env] = False


@wp.kernel(enable_backward=False)
def restart(mask: wp.array[wp.bool], start: int, period: int, age: wp.array[int], due: wp.array[wp.bool]):
    """Restart the clock with ``age = start`` in the environments of ``mask``, which start an episode."""
    env = wp.tid()
    if mask[env]:
        age[env] = start
        due[env] = start >= period


@wp.kernel(enable_backward=False)
def mark(mask: wp.array[wp.bool], marked: wp.array[wp.bool]):
    """Add the environments of ``mask`` to the set ``marked``."""
    env = wp.tid()
    if mask[env]:
        marked[env] = True
