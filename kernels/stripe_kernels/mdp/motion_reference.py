# SPDX-License-Identifier: Apache-2.0
"""Reference poses of a motion command: in the world of an environment, and moved to where the robot is."""

import warp as wp

from ..data import ArticulationData
from ..motion import MotionCommandData
from . import frames

__all__ = ["anchor_error", "reference_alignment", "reference_pose"]


@wp.func
def reference_pose(env: int, command: MotionCommandData, robot: ArticulationData, body: int) -> wp.transform:
    """Pose of a body of the reference in the world."""
    pose = command.body_pose[command.frame[env], body]
    return wp.transform(wp.transform_get_translation(pose) + robot.env_origin[env], wp.transform_get_rotation(pose))


@wp.func
def reference_alignment(env: int, command: MotionCommandData, robot: ArticulationData) -> wp.transform:
    """Map of the world that brings the reference's anchor to the robot's, by a yaw and a horizontal shift."""
    own = robot.body_pose[env, command.anchor]
    reference = reference_pose(env, command, robot, command.anchor)
    turn = frames.yaw_quat(wp.transform_get_rotation(own) * wp.quat_inverse(wp.transform_get_rotation(reference)))
    at = wp.transform_get_translation(reference)
    to = wp.transform_get_translation(own)
    shift = wp.vec3(to[0], to[1], at[2]) - wp.quat_rotate(turn, at)
    return wp.transform(shift, turn)


@wp.func
def anchor_error(env: int, command: MotionCommandData, robot: ArticulationData) -> wp.vec3:
    """Vector from the robot's anchor to the reference's [m]."""
    reference = reference_pose(env, command, robot, command.anchor)
    return wp.transform_get_translation(reference) - wp.transform_get_translation(robot.body_pose[env, command.anchor])
