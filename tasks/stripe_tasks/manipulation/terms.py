# SPDX-License-Identifier: Apache-2.0
"""Manipulation terms: a hand near an object, an object lifted and carried, a drawer pulled open.

Names and formulas are those of Isaac Lab's ``mdp`` of its lift and cabinet tasks. ``e`` is the point between the
fingers, ``point`` in the frame of the hand; ``h`` the handle, ``handle`` in the frame of its drawer.
"""

import warp as wp

from stripe_kernels.data import ArticulationData, PoseCommandData
from stripe_kernels.mdp.tracking import orientation_command_error, position_command_error
from stripe_kernels.term_info import writes

__all__ = [
    "align_ee_handle",
    "align_grasp_around_handle",
    "approach_ee_handle",
    "approach_gripper_handle",
    "drawer_is_open",
    "grasp_handle",
    "hand_at_pose",
    "held_object_goal_distance",
    "held_object_is_lifted",
    "multi_stage_open_drawer",
    "object_at_goal",
    "object_ee_distance",
    "object_goal_distance",
    "object_is_lifted",
    "object_position_in_robot_root_frame",
    "open_drawer_bonus",
    "rel_ee_drawer_distance",
]


@wp.func
def _point(env: int, asset: ArticulationData, body: int, point: wp.vec3) -> wp.vec3:
    """A point of a body in the world [m]."""
    return wp.transform_point(asset.body_pose[env, body], point)


@wp.func
def _object_height(env: int, object: ArticulationData) -> float:
    """Height of an object above the origin of its environment [m]."""
    return wp.transform_get_translation(object.root_pose[env])[2] - object.env_origin[env][2]


# -- reach


@wp.func
def hand_at_pose(
    env: int,
    reached: wp.array[int],
    robot: ArticulationData,
    command: PoseCommandData,
    body_ids: wp.array[int],
    distance: float,
    angle: float,
) -> None:
    """Record whether a link is at the commanded pose: within a distance [m] and an angle [rad] of it."""
    near = position_command_error(env, robot, command, body_ids) < distance
    aligned = orientation_command_error(env, robot, command, body_ids) < angle
    reached[env] = wp.where(near and aligned, 1, 0)


# -- lift


@writes(3)
@wp.func
def object_position_in_robot_root_frame(
    env: int, robot: ArticulationData, object: ArticulationData, out: wp.array[float]
) -> None:
    """Position of an object in the frame of the robot's root.

    Formula: ``R^T (p_o - p)`` [m].
    """
    inverse = wp.transform_inverse(robot.root_pose[env])
    pos = wp.transform_point(inverse, wp.transform_get_translation(object.root_pose[env]))
    for k in range(3):
        out[k] = pos[k]


@wp.func
def object_ee_distance(
    env: int, robot: ArticulationData, object: ArticulationData, body_ids: wp.array[int], point: wp.vec3, std: float
) -> float:
    """Nearness of the hand to an object, from 0 to 1.

    Formula: ``1 - tanh(|p_o - e| / std)``.
    """
    away = wp.transform_get_translation(object.root_pose[env]) - _point(env, robot, body_ids[0], point)
    return 1.0 - wp.tanh(wp.length(away) / std)


@wp.func
def object_is_lifted(env: int, object: ArticulationData, minimal_height: float) -> float:
    """Whether an object is above a height.

    Formula: ``p_o.z > minimal_height`` [m], 1 or 0.
    """
    return wp.where(_object_height(env, object) > minimal_height, 1.0, 0.0)


@wp.func
def _goal_distance(env: int, robot: ArticulationData, object: ArticulationData, command: PoseCommandData) -> float:
    """Distance of an object from the commanded position, which is in the frame of the robot's root [m]."""
    goal = wp.transform_point(robot.root_pose[env], wp.transform_get_translation(command.pose[env]))
    return wp.length(goal - wp.transform_get_translation(object.root_pose[env]))


@wp.func
def object_goal_distance(
    env: int,
    robot: ArticulationData,
    object: ArticulationData,
    command: PoseCommandData,
    minimal_height: float,
    std: float,
) -> float:
    """Nearness of a lifted object to the commanded position, from 0 to 1.

    Formula: ``(p_o.z > minimal_height) (1 - tanh(|goal - p_o| / std))``.
    """
    near = 1.0 - wp.tanh(_goal_distance(env, robot, object, command) / std)
    return object_is_lifted(env, object, minimal_height) * near


@wp.func
def _is_held(
    env: int, robot: ArticulationData, object: ArticulationData, hand: int, point: wp.vec3, reach: float
) -> float:
    """1 where an object's middle is within ``reach`` [m] of the point between the fingers, else 0."""
    away = wp.transform_get_translation(object.root_pose[env]) - _point(env, robot, hand, point)
    return wp.where(wp.length(away) < reach, 1.0, 0.0)


@wp.func
def held_object_is_lifted(
    env: int,
    robot: ArticulationData,
    object: ArticulationData,
    body_ids: wp.array[int],
    point: wp.vec3,
    reach: float,
    minimal_height: float,
) -> float:
    """Whether an object is above a height between the fingers: one that was thrown up is not.

    Formula: ``(|p_o - e| < reach) (p_o.z > minimal_height)`` [m], 1 or 0.
    """
    return _is_held(env, robot, object, body_ids[0], point, reach) * object_is_lifted(env, object, minimal_height)


@wp.func
def held_object_goal_distance(
    env: int,
    robot: ArticulationData,
    object: ArticulationData,
    command: PoseCommandData,
    body_ids: wp.array[int],
    point: wp.vec3,
    reach: float,
    minimal_height: float,
    std: float,
) -> float:
    """Nearness to the commanded position of a lifted object between the fingers, from 0 to 1.

    Formula: ``(|p_o - e| < reach) (p_o.z > minimal_height) (1 - tanh(|goal - p_o| / std))``.
    """
    held = _is_held(env, robot, object, body_ids[0], point, reach)
    return held * object_goal_distance(env, robot, object, command, minimal_height, std)


@wp.func
def object_at_goal(
    env: int,
    reached: wp.array[int],
    robot: ArticulationData,
    object: ArticulationData,
    command: PoseCommandData,
    threshold: float,
) -> None:
    """Record whether an object is at the commanded position: ``|goal - p_o| < threshold`` [m]."""
    reached[env] = wp.where(_goal_distance(env, robot, object, command) < threshold, 1, 0)


# -- cabinet


@wp.func
def _to_handle(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    hand: int,
    point: wp.vec3,
    drawer: int,
    handle: wp.vec3,
) -> wp.vec3:
    """Vector from the point between the fingers to the handle [m]."""
    return _point(env, cabinet, drawer, handle) - _point(env, robot, hand, point)


@wp.func
def _grasps(
    env: int, robot: ArticulationData, cabinet: ArticulationData, fingers: wp.array[int], tip: wp.vec3, drawer: int,
    handle: wp.vec3,
) -> bool:  # fmt: skip
    """Whether one fingertip is above the handle and the other below it."""
    height = _point(env, cabinet, drawer, handle)[2]
    one = _point(env, robot, fingers[0], tip)[2] - height
    two = _point(env, robot, fingers[1], tip)[2] - height
    return one * two < 0.0


@writes(3)
@wp.func
def rel_ee_drawer_distance(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    robot_body_ids: wp.array[int],
    cabinet_body_ids: wp.array[int],
    point: wp.vec3,
    handle: wp.vec3,
    out: wp.array[float],
) -> None:
    """Vector from the point between the fingers to the handle, in the world's axes.

    Formula: ``h - e`` [m].
    """
    way = _to_handle(env, robot, cabinet, robot_body_ids[0], point, cabinet_body_ids[0], handle)
    for k in range(3):
        out[k] = way[k]


@wp.func
def approach_ee_handle(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    robot_body_ids: wp.array[int],
    cabinet_body_ids: wp.array[int],
    point: wp.vec3,
    handle: wp.vec3,
    threshold: float,
) -> float:
    """Nearness of the hand to the handle.

    Formula: ``1 / (1 + |h - e|^2)^2``, twice that within ``threshold`` [m].
    """
    way = _to_handle(env, robot, cabinet, robot_body_ids[0], point, cabinet_body_ids[0], handle)
    near = 1.0 / (1.0 + wp.length_sq(way))
    return wp.where(wp.length(way) <= threshold, 2.0, 1.0) * near * near


@wp.func
def align_ee_handle(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    robot_body_ids: wp.array[int],
    cabinet_body_ids: wp.array[int],
) -> float:
    """Alignment of the hand with the handle, a bar along the drawer's y: it points into the drawer, fingers upright.

    Formula: ``(z |z| + y |y|) / 2``, ``z`` the product of the hand's z and the drawer's x axis, ``y`` the size of that
    of the hand's y, along which the fingers move, and the drawer's z axis.
    """
    hand = wp.transform_get_rotation(robot.body_pose[env, robot_body_ids[0]])
    drawer = wp.transform_get_rotation(cabinet.body_pose[env, cabinet_body_ids[0]])
    forward = wp.dot(wp.quat_rotate(hand, wp.vec3(0.0, 0.0, 1.0)), wp.quat_rotate(drawer, wp.vec3(1.0, 0.0, 0.0)))
    # The gripper is the same when it is turned by half a turn, so that the sign does not matter.
    upright = wp.dot(wp.quat_rotate(hand, wp.vec3(0.0, 1.0, 0.0)), wp.quat_rotate(drawer, wp.vec3(0.0, 0.0, 1.0)))
    return 0.5 * (forward * wp.abs(forward) + upright * upright)


@wp.func
def align_grasp_around_handle(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    finger_body_ids: wp.array[int],
    cabinet_body_ids: wp.array[int],
    tip: wp.vec3,
    handle: wp.vec3,
) -> float:
    """Whether one fingertip is above the handle and the other below it, 1 or 0."""
    return wp.where(_grasps(env, robot, cabinet, finger_body_ids, tip, cabinet_body_ids[0], handle), 1.0, 0.0)


@wp.func
def approach_gripper_handle(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    finger_body_ids: wp.array[int],
    cabinet_body_ids: wp.array[int],
    tip: wp.vec3,
    handle: wp.vec3,
    offset: float,
) -> float:
    """Nearness of both fingertips to the handle between them.

    Formula: ``sum_k (offset - |f_k.z - h.z|)`` [m] where one is above and the other below, else 0.
    """
    height = _point(env, cabinet, cabinet_body_ids[0], handle)[2]
    total = wp.float32(0.0)
    for k in range(2):
        total += offset - wp.abs(_point(env, robot, finger_body_ids[k], tip)[2] - height)
    grasps = _grasps(env, robot, cabinet, finger_body_ids, tip, cabinet_body_ids[0], handle)
    return wp.where(grasps, total, 0.0)


@wp.func
def grasp_handle(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    robot_body_ids: wp.array[int],
    cabinet_body_ids: wp.array[int],
    finger_joint_ids: wp.array[int],
    point: wp.vec3,
    handle: wp.vec3,
    threshold: float,
    open_joint_pos: float,
) -> float:
    """How far the fingers are closed near the handle.

    Formula: ``sum_k (open_joint_pos - q_k)`` [m] where ``|h - e| <= threshold`` [m], else 0.
    """
    way = _to_handle(env, robot, cabinet, robot_body_ids[0], point, cabinet_body_ids[0], handle)
    total = wp.float32(0.0)
    for k in range(finger_joint_ids.shape[0]):
        total += open_joint_pos - robot.joint_pos[env, finger_joint_ids[k]]
    return wp.where(wp.length(way) <= threshold, total, 0.0)


@wp.func
def open_drawer_bonus(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    finger_body_ids: wp.array[int],
    cabinet_body_ids: wp.array[int],
    drawer_joint_ids: wp.array[int],
    tip: wp.vec3,
    handle: wp.vec3,
) -> float:
    """How far the drawer is open, twice that with the handle between the fingers [m]."""
    grasp = align_grasp_around_handle(env, robot, cabinet, finger_body_ids, cabinet_body_ids, tip, handle)
    return (grasp + 1.0) * cabinet.joint_pos[env, drawer_joint_ids[0]]


@wp.func
def multi_stage_open_drawer(
    env: int,
    robot: ArticulationData,
    cabinet: ArticulationData,
    finger_body_ids: wp.array[int],
    cabinet_body_ids: wp.array[int],
    drawer_joint_ids: wp.array[int],
    tip: wp.vec3,
    handle: wp.vec3,
) -> float:
    """Bonus in three stages of a drawer that opens.

    Formula: ``(q > 0.01) / 2 + g ((q > 0.2) + (q > 0.3))``, ``q`` how far it is open [m], ``g`` 1 with the handle
    between the fingers.
    """
    q = cabinet.joint_pos[env, drawer_joint_ids[0]]
    grasp = align_grasp_around_handle(env, robot, cabinet, finger_body_ids, cabinet_body_ids, tip, handle)
    stages = wp.where(q > 0.2, 1.0, 0.0) + wp.where(q > 0.3, 1.0, 0.0)
    return wp.where(q > 0.01, 0.5, 0.0) + grasp * stages


@wp.func
def drawer_is_open(
    env: int, reached: wp.array[int], cabinet: ArticulationData, joint_ids: wp.array[int], threshold: float
) -> None:
    """Record whether a drawer is open: ``q > threshold`` [m]."""
    reached[env] = wp.where(cabinet.joint_pos[env, joint_ids[0]] > threshold, 1, 0)
