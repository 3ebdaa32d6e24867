# SPDX-License-Identifier: Apache-2.0
"""Structs that terms read: arrays that lead with the environment and share memory with the simulation.

SI units, world frame unless a name ends in ``_b``; quaternions (x, y, z, w); spatial vectors (linear, angular); the
linear part of a velocity is that of the centre of mass. A term is a Warp function whose first argument is the
environment; a manager passes the other arguments by their types::

    @wp.func
    def joint_vel_l2(env: int, robot: ArticulationData, joint_ids: wp.array[int]) -> float: ...
"""

import warp as wp

__all__ = [
    "ActionData",
    "ArticulationData",
    "CommandData",
    "EpisodeData",
    "Parameter",
    "Pose2dCommandData",
    "PoseCommandData",
    "VelocityCommandData",
]


@wp.struct
class ArticulationData:
    """State, targets, limits and defaults of an articulation."""

    root_pose: wp.array[wp.transform]
    """Pose of the root link [m], shape ``(num_envs,)``."""
    root_vel: wp.array[wp.spatial_vector]
    """Velocity of the root's centre of mass [m/s, rad/s], shape ``(num_envs,)``."""
    default_root_pose: wp.array[wp.transform]
    """Pose of the root at the start of an episode, in the environment's frame [m], shape ``(num_envs,)``."""
    default_root_vel: wp.array[wp.spatial_vector]
    """Velocity of the root at the start of an episode [m/s, rad/s], shape ``(num_envs,)``."""
    body_pose: wp.array2d[wp.transform]
    """Poses of the link frames [m], shape ``(num_envs, num_bodies)``."""
    body_vel: wp.array2d[wp.spatial_vector]
    """Velocities of the centres of mass [m/s, rad/s], shape ``(num_envs, num_bodies)``."""
    body_acc: wp.array2d[wp.spatial_vector]
    """Accelerations of the centres of mass [m/s^2, rad/s^2], shape ``(num_envs, num_bodies)``."""
    body_parent_wrench: wp.array2d[wp.spatial_vector]
    """Wrench from the parent joint about the centre of mass [N, N m], shape ``(num_envs, num_bodies)``."""
    joint_pos: wp.array2d[float]
    """Joint positions [m or rad], shape ``(num_envs, num_joints)``."""
    joint_vel: wp.array2d[float]
    """Joint velocities [m/s or rad/s], shape ``(num_envs, num_joints)``."""
    previous_joint_vel: wp.array2d[float]
    """Joint velocities before the last physics step [m/s or rad/s], shape ``(num_envs, num_joints)``."""
    default_joint_pos: wp.array2d[float]
    """Joint positions at the start of an episode [m or rad], shape ``(num_envs, num_joints)``."""
    default_joint_vel: wp.array2d[float]
    """Joint velocities at the start of an episode [m/s or rad/s], shape ``(num_envs, num_joints)``."""
    joint_pos_target: wp.array2d[float]
    """Position targets [m or rad], shape ``(num_envs, num_joints)``."""
    joint_vel_target: wp.array2d[float]
    """Velocity targets [m/s or rad/s], shape ``(num_envs, num_joints)``."""
    joint_effort_target: wp.array2d[float]
    """Effort targets [N or N m], shape ``(num_envs, num_joints)``."""
    joint_drive_effort: wp.array2d[float]
    """Effort of the solver's drives in the last physics step [N or N m], shape ``(num_envs, num_joints)``."""
    joint_other_effort: wp.array2d[float]
    """Effort of explicit actuators and effort targets in the last physics step [N or N m], shape
    ``(num_envs, num_joints)``."""
    joint_stiffness: wp.array2d[float]
    """Position gains of the drives, implicit or explicit [N/m or N m/rad], shape ``(num_envs, num_joints)``."""
    joint_damping: wp.array2d[float]
    """Velocity gains of the drives, implicit or explicit [N s/m or N m s/rad], shape ``(num_envs, num_joints)``."""
    joint_pos_lower: wp.array2d[float]
    """Lower position limits [m or rad], shape ``(num_envs, num_joints)``."""
    joint_pos_upper: wp.array2d[float]
    """Upper position limits [m or rad], shape ``(num_envs, num_joints)``."""
    joint_vel_limit: wp.array2d[float]
    """Rated speeds [m/s or rad/s], shape ``(num_envs, num_joints)``."""
    joint_effort_limit: wp.array2d[float]
    """Largest efforts [N or N m], shape ``(num_envs, num_joints)``."""
    external_wrench: wp.array2d[wp.spatial_vector]
    """Wrench that acts on the bodies about their centres of mass until it is changed [N, N m], shape
    ``(num_envs, num_bodies)``; in the body's frame, or in the world's where ``Simulation.wrench_in_world`` is set."""
    soft_limit_factor: float
    """Width of the soft position limits as a share of the limits' range; both have the same middle."""
    env_origin: wp.array[wp.vec3]
    """Origins of the environments [m], shape ``(num_envs,)``."""
    gravity_dir: wp.vec3
    """Unit vector along gravity."""
    physics_dt: float
    """Time step of the physics [s]."""


@wp.struct
class ActionData:
    """Actions of the policy, before scale and offset."""

    action: wp.array2d[float]
    """Actions of this step, shape ``(num_envs, num_actions)``."""
    prev_action: wp.array2d[float]
    """Actions of the step before, shape ``(num_envs, num_actions)``."""


@wp.struct
class CommandData:
    """Command data common to all commands: the numbers that observations show, and the clock."""

    command: wp.array2d[float]
    """The command as the policy sees it, shape ``(num_envs, num_command)``."""
    time_left: wp.array[float]
    """Time until a new command is drawn [s], shape ``(num_envs,)``."""
    counter: wp.array[int]
    """Commands drawn in the episode, shape ``(num_envs,)``."""


@wp.struct
class VelocityCommandData:
    """Velocity command: a velocity to follow."""

    command: wp.array2d[float]
    """Forward and sideways velocity [m/s] and yaw rate [rad/s] in the root's frame, shape ``(num_envs, 3)``."""
    heading_target: wp.array[float]
    """Heading to turn to, in the world frame [rad], shape ``(num_envs,)``."""
    is_heading: wp.array[wp.bool]
    """Whether the yaw rate is computed from the heading's error, shape ``(num_envs,)``."""
    is_standing: wp.array[wp.bool]
    """Whether the command is to stand, shape ``(num_envs,)``."""


@wp.struct
class PoseCommandData:
    """Pose command: a pose of a body to reach."""

    pose: wp.array[wp.transform]
    """Pose in the root's frame [m], shape ``(num_envs,)``; its floats are the command, shape ``(num_envs, 7)``."""


@wp.struct
class Pose2dCommandData:
    """Position command on the ground: a position to walk to and a heading to have there."""

    command: wp.array2d[float]
    """Position relative to the root, in its yaw frame [m], and angle to the heading [rad], shape ``(num_envs, 4)``."""
    pos: wp.array[wp.vec3]
    """Position in the world frame [m], shape ``(num_envs,)``."""
    heading: wp.array[float]
    """Heading in the world frame [rad], shape ``(num_envs,)``."""


@wp.struct
class EpisodeData:
    """Episode data: steps so far, and whether the episode ended in this step."""

    length: wp.array[wp.int64]
    """Steps taken, shape ``(num_envs,)``."""
    terminated: wp.array[wp.bool]
    """Whether the episode ended in failure or success, shape ``(num_envs,)``."""
    truncated: wp.array[wp.bool]
    """Whether the episode was cut off, by the time limit for example, shape ``(num_envs,)``."""
    term_terminated: wp.array2d[wp.bool]
    """Result of each termination term, time-outs included, shape ``(num_envs, num_terms)``."""
    max_length: wp.int64
    """Steps in an episode."""
    max_length_s: float
    """Length of an episode [s], as configured."""
    step_dt: float
    """Time step of the environment [s]."""


@wp.struct
class Parameter:
    """Reference to a tunable number in the device's memory, a reward's weight for example."""

    values: wp.array[float]
    """Tunable numbers of all terms."""
    index: int
    """Index of this number in ``values``."""
