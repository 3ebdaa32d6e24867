# SPDX-License-Identifier: Apache-2.0
"""Differential inverse kinematics: actions that command the pose of a body by position targets of its joints.

``process_differential_ik`` runs once a step and stores the desired pose as 7 numbers, position [m] and quaternion
(x, y, z, w) in the root's frame. One of ``DIFFERENTIAL_IK_METHODS`` runs before each physics step, with the Jacobian of
that moment. The controlled frame is the body's, shifted by ``body_offset_pos`` [m] and turned by ``body_offset_rot``.

All methods solve in the space of the error, ``dq = J^T y`` with ``y`` from ``J J^T``: at most six equations, for any
number of joints.
"""

import warp as wp

from ..data import ArticulationData
from . import frames, kinematics, least_squares

__all__ = [
    "DIFFERENTIAL_IK_METHODS",
    "apply_differential_ik_dls",
    "apply_differential_ik_pinv",
    "apply_differential_ik_svd",
    "apply_differential_ik_trans",
    "process_differential_ik",
]


@wp.func
def _frame_pose(
    env: int, robot: ArticulationData, body_ids: wp.array[int], body_offset_pos: wp.vec3, body_offset_rot: wp.quat
) -> wp.transform:
    """Pose of the controlled frame in the world [m]."""
    return robot.body_pose[env, body_ids[0]] * wp.transform(body_offset_pos, wp.normalize(body_offset_rot))


@wp.func
def _pose_error(env: int, processed: wp.array[float], robot: ArticulationData, now: wp.transform) -> wp.spatial_vectord:
    """Error of the pose in the world: position [m] and rotation vector [rad] from ``now`` to the desired pose."""
    wanted = robot.root_pose[env] * wp.transform(
        wp.vec3(processed[0], processed[1], processed[2]),
        wp.quat(processed[3], processed[4], processed[5], processed[6]),
    )
    shift = wp.transform_get_translation(wanted) - wp.transform_get_translation(now)
    turn = frames.quat_error(wp.transform_get_rotation(now), wp.transform_get_rotation(wanted))
    out = wp.spatial_vectord()
    for k in range(3):
        out[k] = wp.float64(shift[k])
        out[3 + k] = wp.float64(turn[k])
    return out


@wp.func
def _set_targets(
    env: int,
    robot: ArticulationData,
    joint_ids: wp.array[int],
    chain: kinematics.KinematicChain,
    point: wp.vec3,
    rows: int,
    factor: float,
    y: wp.spatial_vectord,
):
    """Set the joint position targets ``q* = q + factor J^T y``."""
    # Columns of the Jacobian are computed again rather than stored: their number is unknown when Warp compiles.
    for i in range(joint_ids.shape[0]):
        column = kinematics.jacobian_column(env, robot, joint_ids, chain, i, point)
        step = wp.float64(0.0)
        for k in range(rows):
            step += wp.float64(column[k]) * y[k]
        joint = joint_ids[i]
        robot.joint_pos_target[env, joint] = robot.joint_pos[env, joint] + factor * wp.float32(step)


# -- once a step


@wp.func
def process_differential_ik(
    env: int,
    action: wp.array[float],
    robot: ArticulationData,
    body_ids: wp.array[int],
    body_offset_pos: wp.vec3,
    body_offset_rot: wp.quat,
    scale: wp.array[float],
    has_rotation: bool,
    is_relative: bool,
    processed: wp.array[float],
    scalar_first: bool = False,
):
    """Process an inverse kinematics action: compute the desired pose of a body in the root's frame.

    Formula: with ``u_i = scale_i a_i``: ``p* = u_0..2``, ``q* = u_3..6 / |u_3..6|``, the present one where that is 0;
    relative ``p* = p + u_0..2`` [m], ``q* = exp(u_3..5) q`` [rad]; without ``has_rotation`` ``q*`` is ``q`` and does
    not count. With ``scalar_first`` quaternions among the actions are (w, x, y, z).

    Source: Isaac Lab, ``DifferentialInverseKinematicsAction``, ``DifferentialIKController.set_command``; there
    quaternions are wxyz and not normalised.
    """
    pose = _frame_pose(env, robot, body_ids, body_offset_pos, body_offset_rot)
    now = wp.transform_inverse(robot.root_pose[env]) * pose
    pos = wp.vec3(scale[0] * action[0], scale[1] * action[1], scale[2] * action[2])
    turn = wp.transform_get_rotation(now)
    if is_relative:
        pos = pos + wp.transform_get_translation(now)
    if has_rotation:
        u = wp.vec3(scale[3] * action[3], scale[4] * action[4], scale[5] * action[5])
        if is_relative:
            angle = wp.length(u)
            if angle > 1.0e-6:  # below, the axis is undefined and the rotation negligible
                turn = wp.quat_from_axis_angle(u / angle, angle) * turn
        else:
            # A policy's four numbers are no unit quaternion; near zero they have no direction, and the body keeps its.
            last = scale[6] * action[6]
            q = wp.quat(u[0], u[1], u[2], last)
            if scalar_first:
                q = wp.quat(u[1], u[2], last, u[0])
            if wp.length(q) > 1.0e-6:
                turn = wp.normalize(q)
    for k in range(3):
        processed[k] = pos[k]
    for k in range(4):
        processed[3 + k] = turn[k]


# -- before each physics step


@wp.func
def apply_differential_ik_pinv(
    env: int,
    processed: wp.array[float],
    robot: ArticulationData,
    joint_ids: wp.array[int],
    body_ids: wp.array[int],
    chain: kinematics.KinematicChain,
    body_offset_pos: wp.vec3,
    body_offset_rot: wp.quat,
    has_rotation: bool,
    k_val: float,
):
    """Set joint targets towards the desired pose by the pseudo-inverse of the Jacobian.

    Singular values below 1e-4 of the largest one, about the precision of float32 poses, count as zero.

    Formula: ``q*_i = q_i + k_val (J^+ e)_i`` [m or rad], ``e = (p* - p, log(q* q^-1))``, of which the first three
    without ``has_rotation``.

    Source: Isaac Lab, ``DifferentialIKController``, ``ik_method="pinv"``; there the limit is 7e-7 of the largest one.
    """
    rows = wp.where(has_rotation, 6, 3)
    now = _frame_pose(env, robot, body_ids, body_offset_pos, body_offset_rot)
    point = wp.transform_get_translation(now)
    # J^+ = J^T (J J^T)^+
    gram = kinematics.gram(env, robot, joint_ids, chain, point, rows)
    y = least_squares.solve_truncated(
        gram, _pose_error(env, processed, robot, now), rows, wp.float64(0.0), wp.float64(1.0e-4)
    )
    _set_targets(env, robot, joint_ids, chain, point, rows, k_val, y)


@wp.func
def apply_differential_ik_svd(
    env: int,
    processed: wp.array[float],
    robot: ArticulationData,
    joint_ids: wp.array[int],
    body_ids: wp.array[int],
    chain: kinematics.KinematicChain,
    body_offset_pos: wp.vec3,
    body_offset_rot: wp.quat,
    has_rotation: bool,
    k_val: float,
    min_singular_value: float,
):
    """Set joint targets towards the desired pose by the pseudo-inverse of the Jacobian without small singular values.

    Formula: ``q*_i = q_i + k_val (V S^+ U^T e)_i`` [m or rad] for ``J = U S V^T``, ``1 / s`` only where
    ``s > min_singular_value``; ``U`` and ``S^2`` are those of ``J J^T``. ``e`` as in ``apply_differential_ik_pinv``.

    Source: Isaac Lab, ``DifferentialIKController``, ``ik_method="svd"``.
    """
    rows = wp.where(has_rotation, 6, 3)
    now = _frame_pose(env, robot, body_ids, body_offset_pos, body_offset_rot)
    point = wp.transform_get_translation(now)
    gram = kinematics.gram(env, robot, joint_ids, chain, point, rows)
    error = _pose_error(env, processed, robot, now)
    # 1e-7 of the largest singular value bounds the rest where ``min_singular_value`` is 0: its square is the precision
    # of float64 in J J^T.
    y = least_squares.solve_truncated(gram, error, rows, wp.float64(min_singular_value), wp.float64(1.0e-7))
    _set_targets(env, robot, joint_ids, chain, point, rows, k_val, y)


@wp.func
def apply_differential_ik_trans(
    env: int,
    processed: wp.array[float],
    robot: ArticulationData,
    joint_ids: wp.array[int],
    body_ids: wp.array[int],
    chain: kinematics.KinematicChain,
    body_offset_pos: wp.vec3,
    body_offset_rot: wp.quat,
    has_rotation: bool,
    k_val: float,
):
    """Set joint targets towards the desired pose by the transpose of the Jacobian.

    Formula: ``q*_i = q_i + k_val (J^T e)_i`` [m or rad], ``e`` as in ``apply_differential_ik_pinv``.

    Source: Isaac Lab, ``DifferentialIKController``, ``ik_method="trans"``.
    """
    rows = wp.where(has_rotation, 6, 3)
    now = _frame_pose(env, robot, body_ids, body_offset_pos, body_offset_rot)
    error = _pose_error(env, processed, robot, now)
    _set_targets(env, robot, joint_ids, chain, wp.transform_get_translation(now), rows, k_val, error)


@wp.func
def apply_differential_ik_dls(
    env: int,
    processed: wp.array[float],
    robot: ArticulationData,
    joint_ids: wp.array[int],
    body_ids: wp.array[int],
    chain: kinematics.KinematicChain,
    body_offset_pos: wp.vec3,
    body_offset_rot: wp.quat,
    has_rotation: bool,
    lambda_val: float,
):
    """Set joint targets towards the desired pose by damped least squares.

    Formula: ``q*_i = q_i + (J^T (J J^T + lambda_val^2 1)^-1 e)_i`` [m or rad], ``e`` as in
    ``apply_differential_ik_pinv``.

    Source: Isaac Lab, ``DifferentialIKController``, ``ik_method="dls"``.
    """
    rows = wp.where(has_rotation, 6, 3)
    now = _frame_pose(env, robot, body_ids, body_offset_pos, body_offset_rot)
    point = wp.transform_get_translation(now)
    gram = kinematics.gram(env, robot, joint_ids, chain, point, rows)
    # J^T (J J^T + l^2 1)^-1 = (J^T J + l^2 1)^-1 J^T, so that six equations do here too. The damping makes the matrix
    # definite unless ``lambda_val`` is 0.
    for k in range(rows):
        gram[k, k] += wp.float64(lambda_val) * wp.float64(lambda_val)
    y = least_squares.solve_definite(gram, _pose_error(env, processed, robot, now), rows)
    _set_targets(env, robot, joint_ids, chain, point, rows, 1.0, y)


DIFFERENTIAL_IK_METHODS: dict[str, wp.Function] = {
    "pinv": apply_differential_ik_pinv,
    "svd": apply_differential_ik_svd,
    "trans": apply_differential_ik_trans,
    "dls": apply_differential_ik_dls,
}
"""Functions that run before each physics step, by Isaac Lab's names of ``ik_method``."""
