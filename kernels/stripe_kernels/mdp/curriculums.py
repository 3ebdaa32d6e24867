# SPDX-License-Identifier: Apache-2.0
"""Curriculums: ``term(step, parameter, ...) -> float`` changes a tunable number for all environments.

One thread runs them at the end of each step. A change takes effect from the next step on; the returned value is logged.
A term whose first argument is ``env: int`` runs for each environment that ends its episode instead.
"""

import warp as wp

from ..data import Parameter

__all__ = ["modify_env_param", "modify_reward_weight", "modify_term_cfg"]


@wp.func
def modify_reward_weight(step: wp.array[wp.int64], parameter: Parameter, weight: float, num_steps: int) -> float:
    """Set the weight of a reward to ``weight`` after ``num_steps`` steps; returns the weight.

    The reward is named by ``params={"term_name": ...}``.

    Formula: ``w = weight`` if ``step >= num_steps``; the step after the first ``num_steps`` is the first to use it.

    Source: Isaac Lab, ``mdp.modify_reward_weight``.
    """
    if step[0] >= wp.int64(num_steps):
        parameter.values[parameter.index] = weight
    return parameter.values[parameter.index]


@wp.func
def modify_term_cfg(
    step: wp.array[wp.int64],
    parameter: Parameter,
    memory: wp.array[float],
    value: float,
    num_steps: int,
    start_step: int = -1,
) -> float:
    """Set any tunable parameter to ``value`` after ``num_steps`` steps, at once or by a ramp; returns the parameter.

    The parameter is named by ``params={"address": ...}``. With ``start_step`` of 0 or more it changes linearly from
    ``v0``, its value after ``start_step`` steps. ``memory`` stores ``v0``, one number, NaN until then.

    Formula: ``v = value`` if ``step >= num_steps``, else after ``start_step``
    ``v = v0 + (value - v0) (step - start_step) / (num_steps - start_step)``.

    Source: Isaac Lab, ``mdp.modify_term_cfg``, there with a function that changes the value.
    """
    now = step[0]
    start = wp.int64(start_step)
    end = wp.int64(num_steps)
    if now >= end:
        parameter.values[parameter.index] = value
    elif start_step >= 0 and now >= start:
        if wp.isnan(memory[0]):
            memory[0] = parameter.values[parameter.index]
        # float64, since float32 cannot count the steps of a long training one by one.
        share = wp.float32(wp.float64(now - start) / wp.float64(end - start))
        parameter.values[parameter.index] = memory[0] + (value - memory[0]) * share
    return parameter.values[parameter.index]


@wp.func
def modify_env_param(
    step: wp.array[wp.int64],
    parameter: Parameter,
    memory: wp.array[float],
    value: float,
    num_steps: int,
    start_step: int = -1,
) -> float:
    """Set a tunable parameter of the environment, one that belongs to no term, as ``modify_term_cfg`` does.

    Formula: that of ``modify_term_cfg``.

    Source: Isaac Lab, ``mdp.modify_env_param``, there with a function that changes the value.
    """
    return modify_term_cfg(step, parameter, memory, value, num_steps, start_step)
