# SPDX-License-Identifier: Apache-2.0
"""Terms whose quaternions are (w, x, y, z): those of ``stripe_kernels.mdp`` with Isaac Lab 2's order.

They are for the Isaac Lab dialect alone; everywhere else quaternions are (x, y, z, w).
"""

import warp as wp

from .data import ArticulationData, CommandData, PoseCommandData
from .mdp import commands
from .sensors.imu import ImuData
from .term_info import Each, writes

__all__ = [
    "body_pose_w",
    "imu_orientation",
    "pose_of_command",
    "resample_uniform_pose",
    "root_quat_w",
]


@wp.func
def _write_quat(q: wp.quat, first: int, out: wp.array[float]):
    """Write the four numbers of a quaternion from index ``first`` on."""
    out[first] = q[3]
    for k in range(3):
        out[first + 1 + k] = q[k]


@writes(4)
@wp.func
def root_quat_w(env: int, robot: ArticulationData, make_quat_unique: bool, out: wp.array[float]):
    """Orientation of the root link in the world, (w, x, y, z), with ``w >= 0`` if ``make_quat_unique``.

    Formula: ``q``, or ``-q`` where ``w < 0``.

    Source: Isaac Lab, ``mdp.root_quat_w``.
    """
    q = wp.transform_get_rotation(robot.root_pose[env])
    if make_quat_unique and q[3] < 0.0:
        q = -q
    _write_quat(q, 0, out)


@writes(Each("body_ids", 7))
@wp.func
def body_pose_w(env: int, robot: ArticulationData, body_ids: wp.array[int], out: wp.array[float]):
    """Poses of bodies: position relative to the environment's origin, and quaternion (w, x, y, z).

    Formula: ``p_i - origin`` [m], ``q_i``.

    Source: Isaac Lab, ``mdp.body_pose_w``.
    """
    for i in range(body_ids.shape[0]):
        pose = robot.body_pose[env, body_ids[i]]
        place = wp.transform_get_translation(pose) - robot.env_origin[env]
        for k in range(3):
            out[7 * i + k] = place[k]
        _write_quat(wp.transform_get_rotation(pose), 7 * i + 3, out)


@writes(4)
@wp.func
def imu_orientation(env: int, asset: ImuData, out: wp.array[float]):
    """IMU orientation in the world, quaternion (w, x, y, z).

    Formula: ``q``.

    Source: Isaac Lab, ``mdp.imu_orientation``.
    """
    _write_quat(asset.quat_w[env], 0, out)


@wp.func
def resample_uniform_pose(
    env: int,
    pose: PoseCommandData,
    command: CommandData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    make_quat_unique: bool,
):
    """Draw a pose command as ``stripe_kernels.mdp.resample_uniform_pose`` does; the command is (p, w, x, y, z).

    Source: Isaac Lab, ``UniformPoseCommand``.
    """
    commands.resample_uniform_pose(env, pose, rng, pose_range, make_quat_unique)
    drawn = pose.pose[env]
    place = wp.transform_get_translation(drawn)
    for k in range(3):
        command.command[env, k] = place[k]
    _write_quat(wp.transform_get_rotation(drawn), 3, command.command[env])


@wp.func
def pose_of_command(env: int, pose: PoseCommandData, command: CommandData):
    """Pose of a command (p, w, x, y, z), which a user may have written."""
    row = command.command[env]
    pose.pose[env] = wp.transform(wp.vec3(row[0], row[1], row[2]), wp.quat(row[4], row[5], row[6], row[3]))
