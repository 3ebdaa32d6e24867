# SPDX-License-Identifier: Apache-2.0
"""Motion terms: how a robot follows a reference motion, under the names of BeyondMimic and mjlab.

``command`` is a motion command, ``p_i, q_i, v_i, w_i`` are position, orientation, velocity of the centre of mass and
angular velocity of body ``i``, a hat marks those of the reference, ``a`` is the anchor body. Sums run over the bodies
that ``asset_cfg`` names, by default all. The relative reference of a body is that of the reference which has been
turned about the vertical and shifted horizontally so that its anchor is above or below the robot's:

``q'_i = T ^q_i``, ``p'_i = (p_a.x, p_a.y, ^p_a.z) + T (^p_i - ^p_a)``, ``T`` the yaw of ``q_a ^q_a^-1``.
"""

import warp as wp

from ..data import ArticulationData
from ..motion import MotionCommandData
from ..term_info import Each, writes
from . import frames
from .motion_command import resample_motion, update_motion
from .motion_reference import anchor_error, reference_alignment, reference_pose

__all__ = [
    "bad_anchor_ori",
    "bad_anchor_pos",
    "bad_anchor_pos_z_only",
    "bad_motion_body_pos",
    "bad_motion_body_pos_z_only",
    "motion_anchor_ori_b",
    "motion_anchor_pos_b",
    "motion_anchor_position_error",
    "motion_body_orientation_error",
    "motion_body_position_error",
    "motion_finished",
    "motion_global_anchor_orientation_error_exp",
    "motion_global_anchor_position_error_exp",
    "motion_global_body_angular_velocity_error_exp",
    "motion_global_body_linear_velocity_error_exp",
    "motion_joint_position_error",
    "motion_relative_body_orientation_error_exp",
    "motion_relative_body_position_error_exp",
    "resample_motion",
    "robot_body_ori_b",
    "robot_body_pos_b",
    "update_motion",
]


# -- observations


@wp.func
def _write_two_columns(q: wp.quat, first: int, out: wp.array[float]):
    """Write the first two columns of a rotation matrix, row by row."""
    x = wp.quat_rotate(q, wp.vec3(1.0, 0.0, 0.0))
    y = wp.quat_rotate(q, wp.vec3(0.0, 1.0, 0.0))
    for k in range(3):
        out[first + 2 * k] = x[k]
        out[first + 2 * k + 1] = y[k]


@writes(3)
@wp.func
def motion_anchor_pos_b(env: int, command: MotionCommandData, robot: ArticulationData, out: wp.array[float]):
    """Position of the reference's anchor in the frame of the robot's anchor.

    Formula: ``R_a^T (^p_a - p_a)`` [m].

    Source: BeyondMimic and mjlab, ``mdp.motion_anchor_pos_b``.
    """
    q = wp.transform_get_rotation(robot.body_pose[env, command.anchor])
    v = wp.quat_rotate_inv(q, anchor_error(env, command, robot))
    for k in range(3):
        out[k] = v[k]


@writes(6)
@wp.func
def motion_anchor_ori_b(env: int, command: MotionCommandData, robot: ArticulationData, out: wp.array[float]):
    """Orientation of the reference's anchor in the frame of the robot's, as two columns of its rotation matrix.

    Formula: the first two columns of ``R_a^T ^R_a``, row by row.

    Source: BeyondMimic and mjlab, ``mdp.motion_anchor_ori_b``.
    """
    own = wp.transform_get_rotation(robot.body_pose[env, command.anchor])
    reference = wp.transform_get_rotation(command.body_pose[command.frame[env], command.anchor])
    _write_two_columns(wp.quat_inverse(own) * reference, 0, out)


@writes(Each("body_ids", 3))
@wp.func
def robot_body_pos_b(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int], out: wp.array[float]
):
    """Positions of the robot's bodies in the frame of its anchor.

    Formula: ``R_a^T (p_i - p_a)`` [m], three numbers a body.

    Source: BeyondMimic and mjlab, ``mdp.robot_body_pos_b``.
    """
    inverse = wp.transform_inverse(robot.body_pose[env, command.anchor])
    for i in range(body_ids.shape[0]):
        v = wp.transform_point(inverse, wp.transform_get_translation(robot.body_pose[env, body_ids[i]]))
        for k in range(3):
            out[3 * i + k] = v[k]


@writes(Each("body_ids", 6))
@wp.func
def robot_body_ori_b(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int], out: wp.array[float]
):
    """Orientations of the robot's bodies in the frame of its anchor, as two columns of their rotation matrices.

    Formula: the first two columns of ``R_a^T R_i``, row by row, six numbers a body.

    Source: BeyondMimic and mjlab, ``mdp.robot_body_ori_b``.
    """
    inverse = wp.quat_inverse(wp.transform_get_rotation(robot.body_pose[env, command.anchor]))
    for i in range(body_ids.shape[0]):
        _write_two_columns(inverse * wp.transform_get_rotation(robot.body_pose[env, body_ids[i]]), 6 * i, out)


# -- rewards


@wp.func
def motion_global_anchor_position_error_exp(
    env: int, command: MotionCommandData, robot: ArticulationData, std: float
) -> float:
    """Nearness of the anchor to the reference in the world, exponential kernel, from 0 to 1.

    Formula: ``exp(-|^p_a - p_a|^2 / std^2)``, ``std`` [m].

    Source: BeyondMimic and mjlab, ``mdp.motion_global_anchor_position_error_exp``.
    """
    return wp.exp(-wp.length_sq(anchor_error(env, command, robot)) / (std * std))


@wp.func
def motion_global_anchor_orientation_error_exp(
    env: int, command: MotionCommandData, robot: ArticulationData, std: float
) -> float:
    """Nearness of the anchor's orientation to the reference in the world, exponential kernel, from 0 to 1.

    Formula: ``exp(-angle(^q_a, q_a)^2 / std^2)``, ``std`` [rad].

    Source: BeyondMimic and mjlab, ``mdp.motion_global_anchor_orientation_error_exp``.
    """
    own = wp.transform_get_rotation(robot.body_pose[env, command.anchor])
    reference = wp.transform_get_rotation(command.body_pose[command.frame[env], command.anchor])
    angle = frames.quat_error_magnitude(own, reference)
    return wp.exp(-angle * angle / (std * std))


@wp.func
def motion_relative_body_position_error_exp(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int], std: float
) -> float:
    """Nearness of bodies to their relative reference, exponential kernel, from 0 to 1.

    Formula: ``exp(-mean_i |p'_i - p_i|^2 / std^2)``, ``std`` [m].

    Source: BeyondMimic and mjlab, ``mdp.motion_relative_body_position_error_exp``.
    """
    align = reference_alignment(env, command, robot)
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        target = align * reference_pose(env, command, robot, body_ids[i])
        own = wp.transform_get_translation(robot.body_pose[env, body_ids[i]])
        total += wp.length_sq(wp.transform_get_translation(target) - own)
    return wp.exp(-total / (float(body_ids.shape[0]) * std * std))


@wp.func
def motion_relative_body_orientation_error_exp(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int], std: float
) -> float:
    """Nearness of the orientations of bodies to their relative reference, exponential kernel, from 0 to 1.

    Formula: ``exp(-mean_i angle(q'_i, q_i)^2 / std^2)``, ``std`` [rad].

    Source: BeyondMimic and mjlab, ``mdp.motion_relative_body_orientation_error_exp``.
    """
    turn = wp.transform_get_rotation(reference_alignment(env, command, robot))
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        target = turn * wp.transform_get_rotation(command.body_pose[command.frame[env], body_ids[i]])
        angle = frames.quat_error_magnitude(wp.transform_get_rotation(robot.body_pose[env, body_ids[i]]), target)
        total += angle * angle
    return wp.exp(-total / (float(body_ids.shape[0]) * std * std))


@wp.func
def motion_global_body_linear_velocity_error_exp(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int], std: float
) -> float:
    """Nearness of the velocities of bodies to the reference in the world, exponential kernel, from 0 to 1.

    Formula: ``exp(-mean_i |^v_i - v_i|^2 / std^2)``, ``std`` [m/s], of the centres of mass.

    Source: BeyondMimic and mjlab, ``mdp.motion_global_body_linear_velocity_error_exp``; in mjlab of the link frames.
    """
    frame = command.frame[env]
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        error = command.body_vel[frame, body_ids[i]] - robot.body_vel[env, body_ids[i]]
        total += wp.length_sq(wp.spatial_top(error))
    return wp.exp(-total / (float(body_ids.shape[0]) * std * std))


@wp.func
def motion_global_body_angular_velocity_error_exp(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int], std: float
) -> float:
    """Nearness of the angular velocities of bodies to the reference in the world, exponential kernel, from 0 to 1.

    Formula: ``exp(-mean_i |^w_i - w_i|^2 / std^2)``, ``std`` [rad/s].

    Source: BeyondMimic and mjlab, ``mdp.motion_global_body_angular_velocity_error_exp``.
    """
    frame = command.frame[env]
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        error = command.body_vel[frame, body_ids[i]] - robot.body_vel[env, body_ids[i]]
        total += wp.length_sq(wp.spatial_bottom(error))
    return wp.exp(-total / (float(body_ids.shape[0]) * std * std))


# -- terminations


@wp.func
def bad_anchor_pos(env: int, command: MotionCommandData, robot: ArticulationData, threshold: float) -> bool:
    """Termination if the anchor is far from the reference.

    Formula: ``|^p_a - p_a| > threshold`` [m].

    Source: BeyondMimic and mjlab, ``mdp.bad_anchor_pos``.
    """
    return wp.length(anchor_error(env, command, robot)) > threshold


@wp.func
def bad_anchor_pos_z_only(env: int, command: MotionCommandData, robot: ArticulationData, threshold: float) -> bool:
    """Termination if the anchor is far above or below the reference.

    Formula: ``|^p_a.z - p_a.z| > threshold`` [m].

    Source: BeyondMimic and mjlab, ``mdp.bad_anchor_pos_z_only``.
    """
    return wp.abs(anchor_error(env, command, robot)[2]) > threshold


@wp.func
def bad_anchor_ori(env: int, command: MotionCommandData, robot: ArticulationData, threshold: float) -> bool:
    """Termination if the tilt of the anchor differs from the reference by more than a threshold.

    Formula: ``|(^R_a^T g).z - (R_a^T g).z| > threshold``, ``g`` the direction of gravity.

    Source: BeyondMimic and mjlab, ``mdp.bad_anchor_ori``.
    """
    own = wp.transform_get_rotation(robot.body_pose[env, command.anchor])
    reference = wp.transform_get_rotation(command.body_pose[command.frame[env], command.anchor])
    difference = wp.quat_rotate_inv(reference, robot.gravity_dir) - wp.quat_rotate_inv(own, robot.gravity_dir)
    return wp.abs(difference[2]) > threshold


@wp.func
def bad_motion_body_pos(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int], threshold: float
) -> bool:
    """Termination if a body is far from its relative reference.

    Formula: any ``|p'_i - p_i| > threshold`` [m].

    Source: BeyondMimic and mjlab, ``mdp.bad_motion_body_pos``.
    """
    align = reference_alignment(env, command, robot)
    worst = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        target = wp.transform_get_translation(align * reference_pose(env, command, robot, body_ids[i]))
        worst = wp.max(worst, wp.length(target - wp.transform_get_translation(robot.body_pose[env, body_ids[i]])))
    return worst > threshold


@wp.func
def bad_motion_body_pos_z_only(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int], threshold: float
) -> bool:
    """Termination if a body is far above or below its relative reference.

    Formula: any ``|p'_i.z - p_i.z| > threshold`` [m].

    Source: BeyondMimic and mjlab, ``mdp.bad_motion_body_pos_z_only``.
    """
    align = reference_alignment(env, command, robot)
    worst = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        target = wp.transform_get_translation(align * reference_pose(env, command, robot, body_ids[i]))
        own = wp.transform_get_translation(robot.body_pose[env, body_ids[i]])
        worst = wp.max(worst, wp.abs(target[2] - own[2]))
    return worst > threshold


@wp.func
def motion_finished(env: int, command: MotionCommandData) -> bool:
    """Termination if the last frame of the motion has been reached.

    Formula: ``frame >= last``.

    Source: this project; BeyondMimic and mjlab go on at another frame.
    """
    return command.frame[env] >= command.last[command.frame[env]]


# -- metrics


@wp.func
def motion_anchor_position_error(env: int, command: MotionCommandData, robot: ArticulationData) -> float:
    """Distance of the anchor from the reference in the world, for the metric ``error_anchor_pos``.

    Formula: ``|^p_a - p_a|`` [m].

    Source: mjlab, ``MotionCommand``.
    """
    return wp.length(anchor_error(env, command, robot))


@wp.func
def motion_body_position_error(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int]
) -> float:
    """Mean distance of bodies from their relative reference, for the metric ``error_body_pos``.

    Formula: ``mean_i |p'_i - p_i|`` [m].

    Source: mjlab, ``MotionCommand``.
    """
    align = reference_alignment(env, command, robot)
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        target = wp.transform_get_translation(align * reference_pose(env, command, robot, body_ids[i]))
        total += wp.length(target - wp.transform_get_translation(robot.body_pose[env, body_ids[i]]))
    return total / float(body_ids.shape[0])


@wp.func
def motion_body_orientation_error(
    env: int, command: MotionCommandData, robot: ArticulationData, body_ids: wp.array[int]
) -> float:
    """Mean angle between bodies and their relative reference, for the metric ``error_body_rot``.

    Formula: ``mean_i angle(q'_i, q_i)`` [rad].

    Source: mjlab, ``MotionCommand``.
    """
    turn = wp.transform_get_rotation(reference_alignment(env, command, robot))
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        target = turn * wp.transform_get_rotation(command.body_pose[command.frame[env], body_ids[i]])
        total += frames.quat_error_magnitude(wp.transform_get_rotation(robot.body_pose[env, body_ids[i]]), target)
    return total / float(body_ids.shape[0])


@wp.func
def motion_joint_position_error(env: int, command: MotionCommandData, robot: ArticulationData) -> float:
    """Distance of the joint positions from the reference, for the metric ``error_joint_pos``.

    Formula: ``sqrt(sum_i (^q_i - q_i)^2)`` [rad].

    Source: mjlab, ``MotionCommand``.
    """
    frame = command.frame[env]
    total = wp.float32(0.0)
    for joint in range(command.joint_pos.shape[1]):
        error = command.joint_pos[frame, joint] - robot.joint_pos[env, joint]
        total += error * error
    return wp.sqrt(total)
