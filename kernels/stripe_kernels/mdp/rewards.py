# SPDX-License-Identifier: Apache-2.0
"""Rewards: ``term(env, ...) -> float``, the value of one environment before its weight and the time step.

Sums run over the joints of ``joint_ids`` or the bodies of ``body_ids``. Penalties are positive: their weight is
negative. Rewards for following a command are in ``tracking``.
"""

import warp as wp

from ..data import ActionData, ArticulationData, EpisodeData
from . import frames

__all__ = [
    "action_l2",
    "action_rate_l2",
    "ang_vel_xy_l2",
    "applied_torque_limits",
    "base_height_l2",
    "body_lin_acc_l2",
    "flat_orientation_l2",
    "is_alive",
    "is_terminated",
    "is_terminated_term",
    "joint_acc_l2",
    "joint_deviation_l1",
    "joint_pos_limits",
    "joint_pos_target_l2",
    "joint_torques_l2",
    "joint_vel_l1",
    "joint_vel_l2",
    "joint_vel_limits",
    "lin_vel_z_l2",
]


# -- episode


@wp.func
def is_alive(env: int, episode: EpisodeData) -> float:
    """Reward of 1 unless the episode has terminated, in failure or success.

    Formula: ``0`` if terminated, else ``1``.

    Source: Isaac Lab, ``mdp.is_alive``.
    """
    return wp.where(episode.terminated[env], 0.0, 1.0)


@wp.func
def is_terminated(env: int, episode: EpisodeData) -> float:
    """Penalty of 1 if the episode has terminated, in failure or success.

    Formula: ``1`` if terminated, else ``0``.

    Source: Isaac Lab, ``mdp.is_terminated``.
    """
    return wp.where(episode.terminated[env], 1.0, 0.0)


@wp.func
def is_terminated_term(env: int, episode: EpisodeData, term_ids: wp.array[int]) -> float:
    """Number of the named termination terms that ended the episode (a penalty).

    Formula: ``sum_k terminated_k``, ``0`` in an episode that was cut off.

    Source: Isaac Lab, ``mdp.is_terminated_term``, there ``term_keys``.
    """
    total = wp.float32(0.0)
    for k in range(term_ids.shape[0]):
        if episode.term_terminated[env, term_ids[k]] and not episode.truncated[env]:
            total += 1.0
    return total


# -- root


@wp.func
def lin_vel_z_l2(env: int, robot: ArticulationData) -> float:
    """Squared velocity of the root along its own z axis.

    Formula: ``v_b.z^2`` [m^2/s^2].

    Source: Isaac Lab, ``mdp.lin_vel_z_l2``.
    """
    z = frames.root_lin_vel_b(env, robot)[2]
    return z * z


@wp.func
def ang_vel_xy_l2(env: int, robot: ArticulationData) -> float:
    """Squared roll and pitch rates of the root in its own frame.

    Formula: ``w_b.x^2 + w_b.y^2`` [rad^2/s^2].

    Source: Isaac Lab, ``mdp.ang_vel_xy_l2``.
    """
    w = frames.root_ang_vel_b(env, robot)
    return w[0] * w[0] + w[1] * w[1]


@wp.func
def flat_orientation_l2(env: int, robot: ArticulationData) -> float:
    """Squared sine of the root's tilt: penalty for an orientation that is not flat.

    Formula: ``g_b.x^2 + g_b.y^2``, ``g_b`` the direction of gravity in the root's frame.

    Source: Isaac Lab, ``mdp.flat_orientation_l2``.
    """
    g = frames.projected_gravity_b(env, robot)
    return g[0] * g[0] + g[1] * g[1]


@wp.func
def base_height_l2(env: int, robot: ArticulationData, target_height: float) -> float:
    """Squared error of the root link's height in the world.

    Formula: ``(p.z - target_height)^2`` [m^2].

    Source: Isaac Lab, ``mdp.base_height_l2``, on flat ground.
    """
    error = wp.transform_get_translation(robot.root_pose[env])[2] - target_height
    return error * error


@wp.func
def body_lin_acc_l2(env: int, robot: ArticulationData, body_ids: wp.array[int]) -> float:
    """Norm of the linear accelerations of the bodies' centres of mass, summed; not squared, despite its name.

    Formula: ``sum_i |a_i|`` [m/s^2].

    Source: Isaac Lab, ``mdp.body_lin_acc_l2``.
    """
    total = wp.float32(0.0)
    for i in range(body_ids.shape[0]):
        total += wp.length(wp.spatial_top(robot.body_acc[env, body_ids[i]]))
    return total


# -- joints


@wp.func
def joint_torques_l2(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> float:
    """Squared joint efforts in the last physics step, summed.

    Formula: ``sum_i tau_i^2`` [N^2 or N^2 m^2], ``tau = tau_drive + tau_other``.

    Source: Isaac Lab, ``mdp.joint_torques_l2``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        effort = robot.joint_drive_effort[env, joint] + robot.joint_other_effort[env, joint]
        total += effort * effort
    return total


@wp.func
def joint_vel_l1(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> float:
    """Absolute joint velocities, summed.

    Formula: ``sum_i |qd_i|`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.joint_vel_l1``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        total += wp.abs(robot.joint_vel[env, joint_ids[i]])
    return total


@wp.func
def joint_vel_l2(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> float:
    """Squared joint velocities, summed.

    Formula: ``sum_i qd_i^2`` [m^2/s^2 or rad^2/s^2].

    Source: Isaac Lab, ``mdp.joint_vel_l2``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        vel = robot.joint_vel[env, joint_ids[i]]
        total += vel * vel
    return total


@wp.func
def joint_acc_l2(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> float:
    """Squared joint accelerations over the last physics step, summed.

    Formula: ``sum_i ((qd_i - qd_before,i) / dt)^2`` [m^2/s^4 or rad^2/s^4], ``dt`` of the physics.

    Source: Isaac Lab, ``mdp.joint_acc_l2``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        acc = (robot.joint_vel[env, joint] - robot.previous_joint_vel[env, joint]) / robot.physics_dt
        total += acc * acc
    return total


@wp.func
def joint_deviation_l1(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> float:
    """Deviation of the joints from their default positions, absolute values summed.

    Formula: ``sum_i |q_i - q_default,i|`` [m or rad].

    Source: Isaac Lab, ``mdp.joint_deviation_l1``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        total += wp.abs(robot.joint_pos[env, joint] - robot.default_joint_pos[env, joint])
    return total


@wp.func
def joint_pos_target_l2(env: int, robot: ArticulationData, joint_ids: wp.array[int], target: float) -> float:
    """Squared error of the joints from one target position, summed; angles are wrapped.

    Formula: ``sum_i (wrap(q_i) - target)^2`` [m^2 or rad^2], ``wrap`` to (-pi, pi].

    Source: Isaac Lab, ``mdp.joint_pos_target_l2``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        error = frames.wrap_to_pi(robot.joint_pos[env, joint_ids[i]]) - target
        total += error * error
    return total


@wp.func
def joint_pos_limits(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> float:
    """Excess of the joint positions beyond their soft limits, summed (a penalty).

    Formula: ``sum_i max(lower_i - q_i, 0) + max(q_i - upper_i, 0)`` [m or rad].

    Source: Isaac Lab, ``mdp.joint_pos_limits``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        limits = frames.soft_joint_pos_limits(env, robot, joint_ids[i])
        pos = robot.joint_pos[env, joint_ids[i]]
        total += wp.max(limits[0] - pos, 0.0) + wp.max(pos - limits[1], 0.0)
    return total


@wp.func
def joint_vel_limits(env: int, robot: ArticulationData, joint_ids: wp.array[int], soft_ratio: float) -> float:
    """Excess of the joint speeds over a share of their rated speeds, at most 1 a joint, summed (a penalty).

    Formula: ``sum_i clamp(|qd_i| - soft_ratio limit_i, 0, 1)`` [m/s or rad/s].

    Source: Isaac Lab, ``mdp.joint_vel_limits``.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        excess = wp.abs(robot.joint_vel[env, joint]) - soft_ratio * robot.joint_vel_limit[env, joint]
        total += wp.clamp(excess, 0.0, 1.0)
    return total


@wp.func
def applied_torque_limits(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> float:
    """Excess of the drives' computed efforts over their limits, at the present state, summed (a penalty).

    Formula: ``sum_i |tau_i - clamp(tau_i, -limit_i, limit_i)|`` [N or N m],
    ``tau = kp (q* - q) + kd (qd* - qd) + tau*``.

    Source: Isaac Lab, ``mdp.applied_torque_limits``, there with the law as it was before the physics step.
    """
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        total += frames.effort_excess(env, robot, joint_ids[i])[0]
    return total


# -- actions


@wp.func
def action_rate_l2(env: int, actions: ActionData) -> float:
    """Squared change of the actions since the step before, summed.

    Formula: ``sum_i (a_i - a_before,i)^2``.

    Source: Isaac Lab, ``mdp.action_rate_l2``.
    """
    total = wp.float32(0.0)
    for i in range(actions.action.shape[1]):
        change = actions.action[env, i] - actions.prev_action[env, i]
        total += change * change
    return total


@wp.func
def action_l2(env: int, actions: ActionData) -> float:
    """Squared actions, summed.

    Formula: ``sum_i a_i^2``.

    Source: Isaac Lab, ``mdp.action_l2``.
    """
    total = wp.float32(0.0)
    for i in range(actions.action.shape[1]):
        total += actions.action[env, i] * actions.action[env, i]
    return total
