# SPDX-License-Identifier: Apache-2.0
"""Actions: ``process_*`` scales a policy's action once a step, ``apply_*`` sets targets before each physics step.

``action`` and ``processed`` are the slices of one environment; ``scale``, ``offset``, ``alpha`` and ``clip`` have one
entry a number. An infinite bound of ``clip`` does nothing. ``ACTIONS`` pairs the functions under the names of Isaac
Lab's action terms.
"""

from collections.abc import Callable
from typing import NamedTuple

import warp as wp

from ..data import ArticulationData
from . import frames

__all__ = [
    "ACTIONS",
    "ActionTerm",
    "apply_joint_effort",
    "apply_joint_position",
    "apply_joint_velocity",
    "apply_non_holonomic",
    "apply_relative_joint_position",
    "process_action",
    "process_binary_joint",
    "process_ema_joint_position_to_limits",
    "process_joint_position",
    "process_joint_position_to_limits",
    "process_joint_velocity",
    "reset_ema_joint_position_to_limits",
]


# -- once a step


@wp.func
def process_action(
    env: int,
    action: wp.array[float],
    scale: wp.array[float],
    offset: wp.array[float],
    clip: wp.array[wp.vec2],
    processed: wp.array[float],
):
    """Process actions by scale, offset and clip.

    Formula: ``u_i = clamp(scale_i a_i + offset_i, clip_i)``, in the units of the command.

    Source: Isaac Lab, ``JointEffortAction``, ``RelativeJointPositionAction``, ``NonHolonomicAction``.
    """
    for i in range(action.shape[0]):
        processed[i] = wp.clamp(scale[i] * action[i] + offset[i], clip[i][0], clip[i][1])


@wp.func
def process_joint_position(
    env: int,
    action: wp.array[float],
    robot: ArticulationData,
    joint_ids: wp.array[int],
    scale: wp.array[float],
    offset: wp.array[float],
    clip: wp.array[wp.vec2],
    use_default_offset: bool,
    processed: wp.array[float],
):
    """Process joint position actions: scale, offset by the default positions or ``offset``, and clip.

    Formula: ``u_i = clamp(scale_i a_i + o_i, clip_i)`` [m or rad], ``o_i = q_default,i`` or ``offset_i``.

    Source: Isaac Lab, ``JointPositionAction``.
    """
    for i in range(joint_ids.shape[0]):
        o = wp.where(use_default_offset, robot.default_joint_pos[env, joint_ids[i]], offset[i])
        processed[i] = wp.clamp(scale[i] * action[i] + o, clip[i][0], clip[i][1])


@wp.func
def process_joint_velocity(
    env: int,
    action: wp.array[float],
    robot: ArticulationData,
    joint_ids: wp.array[int],
    scale: wp.array[float],
    offset: wp.array[float],
    clip: wp.array[wp.vec2],
    use_default_offset: bool,
    processed: wp.array[float],
):
    """Process joint velocity actions: scale, offset by the default velocities or ``offset``, and clip.

    Formula: ``u_i = clamp(scale_i a_i + o_i, clip_i)`` [m/s or rad/s], ``o_i = qd_default,i`` or ``offset_i``.

    Source: Isaac Lab, ``JointVelocityAction``.
    """
    for i in range(joint_ids.shape[0]):
        o = wp.where(use_default_offset, robot.default_joint_vel[env, joint_ids[i]], offset[i])
        processed[i] = wp.clamp(scale[i] * action[i] + o, clip[i][0], clip[i][1])


@wp.func
def _to_limits(value: float, clip: wp.vec2, limits: wp.vec2, rescale_to_limits: bool) -> float:
    """Clip a number and, with ``rescale_to_limits``, map [-1, 1] to the limits."""
    y = wp.clamp(value, clip[0], clip[1])
    if rescale_to_limits:
        x = wp.clamp(y, -1.0, 1.0)
        y = 0.5 * (x * (limits[1] - limits[0]) + limits[1] + limits[0])
    return y


@wp.func
def process_joint_position_to_limits(
    env: int,
    action: wp.array[float],
    robot: ArticulationData,
    joint_ids: wp.array[int],
    scale: wp.array[float],
    clip: wp.array[wp.vec2],
    rescale_to_limits: bool,
    processed: wp.array[float],
):
    """Process joint position actions: scale, clip, and map [-1, 1] to the soft limits.

    Formula: ``u_i = (x upper_i - x lower_i + upper_i + lower_i) / 2`` [m or rad], ``x = clamp(y, -1, 1)``,
    ``y = clamp(scale_i a_i, clip_i)``; without ``rescale_to_limits`` it is ``y``.

    Source: Isaac Lab, ``JointPositionToLimitsAction``.
    """
    for i in range(joint_ids.shape[0]):
        limits = frames.soft_joint_pos_limits(env, robot, joint_ids[i])
        processed[i] = _to_limits(scale[i] * action[i], clip[i], limits, rescale_to_limits)


@wp.func
def process_ema_joint_position_to_limits(
    env: int,
    action: wp.array[float],
    robot: ArticulationData,
    joint_ids: wp.array[int],
    scale: wp.array[float],
    clip: wp.array[wp.vec2],
    rescale_to_limits: bool,
    alpha: wp.array[float],
    processed: wp.array[float],
):
    """Exponential moving average of ``process_joint_position_to_limits``; ``processed`` holds that of the step before.

    Formula: ``u_i = clamp(alpha_i v_i + (1 - alpha_i) u_before,i)`` [m or rad] to the soft limits, ``v`` as in
    ``process_joint_position_to_limits``.

    Source: Isaac Lab, ``EMAJointPositionToLimitsAction``.
    """
    for i in range(joint_ids.shape[0]):
        limits = frames.soft_joint_pos_limits(env, robot, joint_ids[i])
        y = _to_limits(scale[i] * action[i], clip[i], limits, rescale_to_limits)
        average = alpha[i] * y + (1.0 - alpha[i]) * processed[i]
        # Without ``rescale_to_limits`` nothing else keeps the average within the limits.
        processed[i] = wp.clamp(average, limits[0], limits[1])


@wp.func
def reset_ema_joint_position_to_limits(
    env: int, robot: ArticulationData, joint_ids: wp.array[int], processed: wp.array[float]
):
    """Reset the moving average to the joint positions at the start of an episode.

    Formula: ``u_i = q_i`` [m or rad].

    Source: Isaac Lab, ``EMAJointPositionToLimitsAction``.
    """
    for i in range(joint_ids.shape[0]):
        processed[i] = robot.joint_pos[env, joint_ids[i]]


@wp.func
def process_binary_joint(
    env: int,
    action: wp.array[float],
    open_command: wp.array[float],
    close_command: wp.array[float],
    clip: wp.array[wp.vec2],
    processed: wp.array[float],
):
    """Process a binary action: choose the open or the close command by the sign of one number.

    Formula: ``u_i = clamp(close_i if a < 0 else open_i, clip_i)``, in the units of the command.

    Source: Isaac Lab, ``BinaryJointPositionAction``, ``BinaryJointVelocityAction``.
    """
    for i in range(open_command.shape[0]):
        u = wp.where(action[0] < 0.0, close_command[i], open_command[i])
        processed[i] = wp.clamp(u, clip[i][0], clip[i][1])


# -- before each physics step


@wp.func
def apply_joint_position(env: int, processed: wp.array[float], robot: ArticulationData, joint_ids: wp.array[int]):
    """Set joint position targets.

    Formula: ``q*_i = u_i`` [m or rad].

    Source: Isaac Lab, ``JointPositionAction``.
    """
    for i in range(joint_ids.shape[0]):
        robot.joint_pos_target[env, joint_ids[i]] = processed[i]


@wp.func
def apply_relative_joint_position(
    env: int, processed: wp.array[float], robot: ArticulationData, joint_ids: wp.array[int]
):
    """Set joint position targets relative to the positions of that moment.

    Formula: ``q*_i = q_i + u_i`` [m or rad].

    Source: Isaac Lab, ``RelativeJointPositionAction``.
    """
    # Before each physics step, as in Isaac Lab: the target moves on with the joint within a step of the environment.
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        robot.joint_pos_target[env, joint] = robot.joint_pos[env, joint] + processed[i]


@wp.func
def apply_joint_velocity(env: int, processed: wp.array[float], robot: ArticulationData, joint_ids: wp.array[int]):
    """Set joint velocity targets.

    Formula: ``qd*_i = u_i`` [m/s or rad/s].

    Source: Isaac Lab, ``JointVelocityAction``.
    """
    for i in range(joint_ids.shape[0]):
        robot.joint_vel_target[env, joint_ids[i]] = processed[i]


@wp.func
def apply_joint_effort(env: int, processed: wp.array[float], robot: ArticulationData, joint_ids: wp.array[int]):
    """Set joint effort targets.

    Formula: ``tau*_i = u_i`` [N or N m].

    Source: Isaac Lab, ``JointEffortAction``.
    """
    for i in range(joint_ids.shape[0]):
        robot.joint_effort_target[env, joint_ids[i]] = processed[i]


@wp.func
def apply_non_holonomic(
    env: int, processed: wp.array[float], robot: ArticulationData, body_ids: wp.array[int], joint_ids: wp.array[int]
):
    """Set velocity targets of a planar base that drives like a car: forward velocity and yaw rate, no sideways motion.

    The base moves on joints along x, along y and about z, in the order of ``joint_ids``.

    Formula: ``qd* = (u_0 cos(yaw), u_0 sin(yaw), u_1)`` [m/s, m/s, rad/s], ``yaw`` of the first of ``body_ids``.

    Source: Isaac Lab, ``NonHolonomicAction``.
    """
    # The yaw of the body, as in Isaac Lab, not the position of the joint about z.
    yaw = frames.yaw_of(wp.transform_get_rotation(robot.body_pose[env, body_ids[0]]))
    robot.joint_vel_target[env, joint_ids[0]] = wp.cos(yaw) * processed[0]
    robot.joint_vel_target[env, joint_ids[1]] = wp.sin(yaw) * processed[0]
    robot.joint_vel_target[env, joint_ids[2]] = processed[1]


class ActionTerm(NamedTuple):
    """Functions of an action term, and its sizes as functions of the number of joints."""

    process: wp.Function
    """Function that runs once a step."""
    apply: wp.Function
    """Function that runs before each physics step."""
    action_size: Callable[[int], int]
    """Number of actions of the policy."""
    processed_size: Callable[[int], int]
    """Number of floats that ``process`` writes and ``apply`` reads."""
    reset: wp.Function | None = None
    """Function that runs when an episode starts."""


def _same(joints: int) -> int:
    return joints


def _one(joints: int) -> int:
    return 1


def _two(joints: int) -> int:
    return 2


ACTIONS: dict[str, ActionTerm] = {
    "JointPosition": ActionTerm(process_joint_position, apply_joint_position, _same, _same),
    "RelativeJointPosition": ActionTerm(process_action, apply_relative_joint_position, _same, _same),
    "JointVelocity": ActionTerm(process_joint_velocity, apply_joint_velocity, _same, _same),
    "JointEffort": ActionTerm(process_action, apply_joint_effort, _same, _same),
    "JointPositionToLimits": ActionTerm(process_joint_position_to_limits, apply_joint_position, _same, _same),
    "EMAJointPositionToLimits": ActionTerm(
        process_ema_joint_position_to_limits, apply_joint_position, _same, _same, reset_ema_joint_position_to_limits
    ),
    "BinaryJointPosition": ActionTerm(process_binary_joint, apply_joint_position, _one, _same),
    "BinaryJointVelocity": ActionTerm(process_binary_joint, apply_joint_velocity, _one, _same),
    "NonHolonomic": ActionTerm(process_action, apply_non_holonomic, _two, _two),
}
"""Action terms by the names of Isaac Lab's classes, without the word Action."""
