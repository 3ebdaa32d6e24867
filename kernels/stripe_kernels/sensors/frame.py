# SPDX-License-Identifier: Apache-2.0
"""Frame transformer: poses of frames fixed to bodies, in the world and relative to a source frame."""

import warp as wp

__all__ = ["FrameTransformerData", "measure_frames"]


@wp.struct
class FrameTransformerData:
    """Frame transformer data: poses of target frames in the world and in a source frame; quaternions (x, y, z, w)."""

    source_pos_w: wp.array[wp.vec3]
    """Origin of the source frame in the world [m], shape ``(num_envs,)``."""
    source_quat_w: wp.array[wp.quat]
    """Orientation of the source frame in the world, shape ``(num_envs,)``."""
    target_pos_w: wp.array2d[wp.vec3]
    """Origins of the target frames in the world [m], shape ``(num_envs, num_frames)``."""
    target_quat_w: wp.array2d[wp.quat]
    """Orientations of the target frames in the world, shape ``(num_envs, num_frames)``."""
    target_pos_source: wp.array2d[wp.vec3]
    """Origins of the target frames in the source frame [m], shape ``(num_envs, num_frames)``."""
    target_quat_source: wp.array2d[wp.quat]
    """Orientations of the target frames in the source frame, shape ``(num_envs, num_frames)``."""


@wp.func
def _pose_of(
    env: int, frame: int, bodies: wp.array[int], poses: wp.array[wp.transform], origin: wp.array[wp.vec3],
    body_q: wp.array2d[wp.transform],
) -> wp.transform:  # fmt: skip
    """Pose of a frame in the world [m]."""
    if bodies[frame] < 0:
        return wp.transform(origin[env], wp.quat_identity()) * poses[frame]
    return body_q[env, bodies[frame]] * poses[frame]


@wp.kernel(enable_backward=False)
def measure_frames(
    due: wp.array[wp.bool],
    bodies: wp.array[int],
    poses: wp.array[wp.transform],
    origin: wp.array[wp.vec3],
    body_q: wp.array2d[wp.transform],
    frames: FrameTransformerData,
):
    """Measure the poses of the target frames; threads (environment, target).

    Args:
        due: Environments that measure, shape ``(num_envs,)``.
        bodies: Bodies of the source frame and the targets, -1 for the environment's origin, shape ``(1 + targets,)``.
        poses: Poses of the frames in the frames of their bodies [m], same shape.
        origin: Origins of the environments in the world [m], shape ``(num_envs,)``.
        body_q: Poses of the bodies in the world [m], shape ``(num_envs, num_bodies)``.
        frames: Output, the measured poses.
    """
    env, target = wp.tid()
    if not due[env]:
        return
    source = _pose_of(env, 0, bodies, poses, origin, body_q)
    pose = _pose_of(env, target + 1, bodies, poses, origin, body_q)
    seen = wp.transform_inverse(source) * pose
    if target == 0:  # the source is the same for all targets: one thread writes it
        frames.source_pos_w[env] = wp.transform_get_translation(source)
        frames.source_quat_w[env] = wp.transform_get_rotation(source)
    frames.target_pos_w[env, target] = wp.transform_get_translation(pose)
    frames.target_quat_w[env, target] = wp.transform_get_rotation(pose)
    frames.target_pos_source[env, target] = wp.transform_get_translation(seen)
    frames.target_quat_source[env, target] = wp.transform_get_rotation(seen)
