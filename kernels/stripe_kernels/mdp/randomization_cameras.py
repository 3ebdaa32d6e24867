# SPDX-License-Identifier: Apache-2.0
"""Randomisation of cameras: events that change where a camera is mounted."""

import warp as wp

from ..sensors.camera import CameraData
from . import random

__all__ = ["randomize_camera_pose"]


@wp.func
def randomize_camera_pose(env: int, sensor: CameraData, rng: wp.array[wp.uint32], pose_range: wp.array[wp.vec2]):
    """Randomise where a camera is mounted, about its pose by the config and in its own frame (x forward, z up).

    ``pose_range`` holds the bounds of ``x``, ``y``, ``z`` [m], ``roll``, ``pitch`` and ``yaw`` [rad].

    Formula: ``p = p_default + q_default U`` [m], ``q = q_default Rz(U) Ry(U) Rx(U)``.

    Source: this project, after mjlab's ``dr.cam_pos`` and ``dr.cam_quat``.
    """
    offset = random.uniform_vec3(env, rng, pose_range, 0)
    angles = random.uniform_vec3(env, rng, pose_range, 3)
    turn = wp.quat_rpy(angles[0], angles[1], angles[2])
    sensor.mount[env] = sensor.default_mount[env] * wp.transform(offset, turn)
