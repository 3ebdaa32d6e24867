# SPDX-License-Identifier: Apache-2.0
"""Motion command: the frame of the reference at which an episode starts, and the frame to reach in each step.

In the formulas a hat marks the reference, as in :mod:`.motion`.
"""

import warp as wp

from ..data import ArticulationData, EpisodeData
from ..motion import MotionCommandData
from . import frames, random

__all__ = ["resample_motion", "update_motion"]

MODE_ADAPTIVE = wp.constant(0)
"""Frames are drawn by the failures of their bins."""
MODE_UNIFORM = wp.constant(1)
"""Frames are drawn alike. Any other mode begins at the first frame of a motion."""


@wp.func
def _find_bin(command: MotionCommandData, value: float) -> int:
    """The first bin whose summed weight is above a value."""
    low = wp.int32(0)
    high = command.cumulative.shape[0] - 1
    while low < high:
        middle = (low + high) // 2
        if command.cumulative[middle] > value:
            high = middle
        else:
            low = middle + 1
    return low


@wp.func
def _draw_frame(env: int, command: MotionCommandData, rng: wp.array[wp.uint32], sampling_mode: int) -> int:
    """Draw the frame at which an episode begins."""
    # Two draws in every mode: the mode does not change what else an environment draws.
    u = random.uniform(env, rng)
    v = random.uniform(env, rng)
    if sampling_mode == MODE_ADAPTIVE:
        index = _find_bin(command, u * command.cumulative[command.cumulative.shape[0] - 1])
        return command.bin_start[index] + wp.min(int(v * float(command.bin_size[index])), command.bin_size[index] - 1)
    if sampling_mode == MODE_UNIFORM:
        frame = wp.min(int(u * float(command.last.shape[0])), command.last.shape[0] - 1)
        return wp.min(frame, command.last[frame] - 1)
    count = command.motion_start.shape[0]
    return command.motion_start[wp.min(int(u * float(count)), count - 1)]


@wp.func
def resample_motion(
    env: int,
    command: MotionCommandData,
    robot: ArticulationData,
    episode: EpisodeData,
    rng: wp.array[wp.uint32],
    step: wp.array[wp.int64],
    sampling_mode: int,
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
    joint_position_range: wp.vec2,
):
    """Start at a random frame of the motions: place the robot there, with noise; count a failure of the last episode.

    Formula: root ``p = ^p + U`` [m], ``q = Rz(U) Ry(U) Rx(U) ^q``, ``v = ^v + U``; joints
    ``q_i = clamp(^q_i + U(joint_position_range))`` to the soft limits, ``qd_i = ^qd_i``. The frame is drawn from the
    bins by their failures (mode 0), from all frames alike (1), or is the first of a motion (2).

    Source: BeyondMimic (Liao et al. 2025) and mjlab, ``MotionCommand``.
    """
    if episode.terminated[env]:
        wp.atomic_add(command.failures, command.bin[command.frame[env]], 1.0)
    frame = _draw_frame(env, command, rng, sampling_mode)
    command.start[env] = frame
    command.started_at[env] = step[0]
    pose = command.body_pose[frame, 0]
    pos = wp.transform_get_translation(pose) + robot.env_origin[env] + random.uniform_vec3(env, rng, pose_range, 0)
    angles = random.uniform_vec3(env, rng, pose_range, 3)
    rot = wp.quat_rpy(angles[0], angles[1], angles[2]) * wp.transform_get_rotation(pose)
    robot.root_pose[env] = wp.transform(pos, rot)
    robot.root_vel[env] = command.body_vel[frame, 0] + random.uniform_twist(env, rng, velocity_range)
    for joint in range(robot.joint_pos.shape[1]):
        limits = frames.soft_joint_pos_limits(env, robot, joint)
        value = command.joint_pos[frame, joint] + random.uniform_range(env, rng, joint_position_range)
        robot.joint_pos[env, joint] = wp.clamp(value, limits[0], limits[1])
        robot.joint_vel[env, joint] = command.joint_vel[frame, joint]


@wp.func
def update_motion(env: int, command: MotionCommandData, step: wp.array[wp.int64]):
    """Advance to the frame that the robot should reach by the end of the next step; stop at the last frame.

    Formula: ``frame = min(start + n + 1, last)``, ``n`` the steps since the start; ``c = (^q, ^qd)`` of that frame.

    Source: BeyondMimic and mjlab, ``MotionCommand``, which begin again after the last frame.
    """
    start = command.start[env]
    frame = wp.min(start + wp.int32(step[0] - command.started_at[env]) + 1, command.last[start])
    command.frame[env] = frame
    count = command.joint_pos.shape[1]
    for joint in range(count):
        command.command[env, joint] = command.joint_pos[frame, joint]
        command.command[env, count + joint] = command.joint_vel[frame, joint]
