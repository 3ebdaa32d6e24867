# SPDX-License-Identifier: Apache-2.0
"""Locomotion terms: observations, rewards and events of running, for the direct Warp and the manager-based form.

The target lies at ``(target_distance, 0)`` [m] from the origin of the environment, in the horizontal plane. Rewards are
0 in an environment that fell in this step: there the cost of falling replaces all other terms.
"""

import warp as wp

from stripe_kernels.data import ActionData, ArticulationData, EpisodeData
from stripe_kernels.mdp import frames

__all__ = [
    "FACING",
    "NEAR_LIMIT",
    "UPRIGHT",
    "action_l2",
    "base_angle_to_target",
    "base_heading_proj",
    "base_up_proj",
    "base_yaw_roll",
    "heading_projection",
    "joint_pos_limits_penalty",
    "last_action",
    "move_to_target_bonus",
    "power_consumption",
    "progress_reward",
    "remember_position",
    "to_target",
    "up_projection",
    "upright_posture_bonus",
]

UPRIGHT = wp.constant(0.93)
"""Component of the root's z axis along the vertical above which it counts as upright."""
FACING = wp.constant(0.8)
"""Component of the root's x axis along the direction to the target above which facing it is rewarded in full."""
NEAR_LIMIT = wp.constant(0.98)
"""Share of the way from the middle to a limit beyond which a joint is near it."""


# -- quantities that several terms read


@wp.func
def to_target(env: int, robot: ArticulationData, target_distance: float) -> wp.vec3:
    """Horizontal vector from the root link to the target [m]."""
    target = robot.env_origin[env] + wp.vec3(target_distance, 0.0, 0.0)
    offset = target - wp.transform_get_translation(robot.root_pose[env])
    return wp.vec3(offset[0], offset[1], 0.0)


@wp.func
def up_projection(env: int, robot: ArticulationData) -> float:
    """Component of the root's z axis along the vertical, in [-1, 1]."""
    return wp.quat_rotate(wp.transform_get_rotation(robot.root_pose[env]), wp.vec3(0.0, 0.0, 1.0))[2]


@wp.func
def heading_projection(env: int, robot: ArticulationData, target_distance: float) -> float:
    """Component of the root's x axis along the direction to the target, in [-1, 1]."""
    forward = wp.quat_rotate(wp.transform_get_rotation(robot.root_pose[env]), wp.vec3(1.0, 0.0, 0.0))
    return wp.dot(forward, wp.normalize(to_target(env, robot, target_distance)))


# -- observations


@wp.func
def base_yaw_roll(env: int, robot: ArticulationData, out: wp.array[float]) -> None:
    """Yaw and roll of the root.

    Formula: ``(yaw, roll)`` [rad], each in (-pi, pi], of ``R = Rz(yaw) Ry(pitch) Rx(roll)``.

    Source: Isaac Lab, ``base_yaw_roll`` of its humanoid task.
    """
    angles = frames.euler_xyz(wp.transform_get_rotation(robot.root_pose[env]))
    out[0] = angles[2]
    out[1] = angles[0]


@wp.func
def base_angle_to_target(env: int, robot: ArticulationData, target_distance: float, out: wp.array[float]) -> None:
    """Angle by which the root has to turn to face the target.

    Formula: ``wrap(atan2(d.y, d.x) - yaw)`` [rad] in (-pi, pi], ``d`` the vector to the target.

    Source: Isaac Lab, ``base_angle_to_target`` of its humanoid task.
    """
    d = to_target(env, robot, target_distance)
    yaw = frames.euler_xyz(wp.transform_get_rotation(robot.root_pose[env]))[2]
    out[0] = frames.wrap_to_pi(wp.atan2(d[1], d[0]) - yaw)


@wp.func
def base_up_proj(env: int, robot: ArticulationData, out: wp.array[float]) -> None:
    """Uprightness of the root.

    Formula: ``(R z).z``, 1 when upright.

    Source: Isaac Lab, ``base_up_proj`` of its humanoid task.
    """
    out[0] = up_projection(env, robot)


@wp.func
def base_heading_proj(env: int, robot: ArticulationData, target_distance: float, out: wp.array[float]) -> None:
    """Alignment of the root's heading with the direction to the target.

    Formula: ``(R x) . d / |d|``, 1 when level and facing it, ``d`` the vector to the target.

    Source: Isaac Lab, ``base_heading_proj`` of its humanoid task.
    """
    out[0] = heading_projection(env, robot, target_distance)


@wp.func
def last_action(env: int, actions: ActionData, out: wp.array[float]) -> None:
    """Actions of this step as they act on the joints.

    Formula: ``clamp(a_i, -1, 1)``.

    Source: Isaac Lab, ``actions`` of its direct locomotion task, there limited before.
    """
    for i in range(actions.action.shape[1]):
        out[i] = wp.clamp(actions.action[env, i], -1.0, 1.0)


# -- rewards


@wp.func
def progress_reward(
    env: int, robot: ArticulationData, episode: EpisodeData, last_pos: wp.array[wp.vec2], target_distance: float
) -> float:
    """Speed at which the distance to the target shrank over the step; stores the position for the next step.

    Formula: ``(|b| - |d|) / dt`` [m/s], ``b`` and ``d`` the vectors to the target before and now, computed as
    ``(b - d) . (b + d) / (|b| + |d|)``: the plain difference of two distances of a kilometre has steps of 4 mm/s in
    float32.

    Source: Isaac Lab, ``progress_reward`` of its humanoid task.
    """
    pos = wp.transform_get_translation(robot.root_pose[env])
    target = robot.env_origin[env] + wp.vec3(target_distance, 0.0, 0.0)
    now = wp.vec2(target[0] - pos[0], target[1] - pos[1])
    before = wp.vec2(target[0], target[1]) - last_pos[env]
    moved = wp.vec2(pos[0], pos[1]) - last_pos[env]
    last_pos[env] = wp.vec2(pos[0], pos[1])
    speed = wp.dot(moved, before + now) / ((wp.length(before) + wp.length(now)) * episode.step_dt)
    return wp.where(episode.terminated[env], 0.0, speed)


@wp.func
def upright_posture_bonus(env: int, robot: ArticulationData, episode: EpisodeData, threshold: float) -> float:
    """Whether the root is upright.

    Formula: ``1`` if ``(R z).z > threshold``, else ``0``.

    Source: Isaac Lab, ``upright_posture_bonus`` of its humanoid task.
    """
    upright = up_projection(env, robot) > threshold and not episode.terminated[env]
    return wp.where(upright, 1.0, 0.0)


@wp.func
def move_to_target_bonus(
    env: int, robot: ArticulationData, episode: EpisodeData, threshold: float, target_distance: float
) -> float:
    """Alignment of the root's heading with the direction to the target; full within a cone about it.

    Formula: ``min(h / threshold, 1)``, ``h`` as in ``base_heading_proj``.

    Source: Isaac Lab, ``move_to_target_bonus`` of its humanoid task.
    """
    bonus = wp.min(heading_projection(env, robot, target_distance) / threshold, 1.0)
    return wp.where(episode.terminated[env], 0.0, bonus)


@wp.func
def action_l2(env: int, actions: ActionData, episode: EpisodeData) -> float:
    """Square of the actions as they act on the joints.

    Formula: ``sum_i clamp(a_i, -1, 1)^2``.

    Source: Isaac Lab, ``mdp.action_l2``, there of actions without limits.
    """
    total = wp.float32(0.0)
    for i in range(actions.action.shape[1]):
        a = wp.clamp(actions.action[env, i], -1.0, 1.0)
        total += a * a
    return wp.where(episode.terminated[env], 0.0, total)


@wp.func
def power_consumption(
    env: int,
    robot: ArticulationData,
    actions: ActionData,
    episode: EpisodeData,
    joint_ids: wp.array[int],
    gear_ratio: wp.array[float],
) -> float:
    """Action times speed of the joints, weighted by their gears; action ``i`` drives the ``i``-th joint.

    Formula: ``sum_i |clamp(a_i, -1, 1) qd_i g_i|`` [m/s or rad/s], ``g`` the gears over the largest gear.

    Source: Isaac Lab, ``power_consumption`` of its humanoid task.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        a = wp.clamp(actions.action[env, i], -1.0, 1.0)
        total += wp.abs(a * robot.joint_vel[env, joint_ids[i]] * gear_ratio[i])
    return wp.where(episode.terminated[env], 0.0, total)


@wp.func
def joint_pos_limits_penalty(
    env: int, robot: ArticulationData, episode: EpisodeData, joint_ids: wp.array[int], threshold: float
) -> float:
    """Number of joints near a limit.

    Formula: ``sum_i [|s_i| > threshold]``, ``s_i`` as in ``mdp.joint_pos_limit_normalized``.

    Source: Isaac Lab, the direct locomotion task; ``joint_pos_limits_penalty_ratio`` of its humanoid task is graded.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        limits = frames.soft_joint_pos_limits(env, robot, joint_ids[i])
        middle = 0.5 * (limits[0] + limits[1])
        half = 0.5 * (limits[1] - limits[0])
        if wp.abs(robot.joint_pos[env, joint_ids[i]] - middle) > threshold * half:
            total += 1.0
    return wp.where(episode.terminated[env], 0.0, total)


# -- events


@wp.func
def remember_position(env: int, robot: ArticulationData, last_pos: wp.array[wp.vec2]) -> None:
    """Store the root's position, from which the progress of an episode counts.

    Formula: ``p_last = (p.x, p.y)`` [m].
    """
    pos = wp.transform_get_translation(robot.root_pose[env])
    last_pos[env] = wp.vec2(pos[0], pos[1])
