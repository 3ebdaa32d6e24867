# SPDX-License-Identifier: Apache-2.0
"""Randomisation of cameras: events that change where a camera is mounted, and the light of its pictures."""

import warp as wp

from ..sensors.camera import CameraData
from . import random

__all__ = ["randomize_camera_pose", "randomize_light"]


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


@wp.func
def randomize_light(
    env: int,
    sensor: CameraData,
    rng: wp.array[wp.uint32],
    azimuth_range: wp.vec2,
    elevation_range: wp.vec2,
    sun_range: wp.vec2,
    sky_range: wp.vec2,
    tint: float = 0.0,
):
    """Randomise the light of a camera's colours: direction and strength of the sun, strength of sky and ground, tint.

    The azimuth is about +z from +x, the elevation above the horizon [rad]; strengths are factors on the scene's light.
    ``tint`` is the largest change of a colour channel, as a share.

    Formula: ``to_sun = (cos e cos a, cos e sin a, sin e)``, ``sun_k = sun_default,k U(sun_range)
    U(1 - tint, 1 + tint)``, ``sky`` alike, ``ground`` with the draws of ``sky``.

    Source: this project, after mjlab's ``dr.light_dir``.
    """
    azimuth = random.uniform_range(env, rng, azimuth_range)
    elevation = random.uniform_range(env, rng, elevation_range)
    flat = wp.cos(elevation)
    sensor.to_sun[env] = wp.vec3(flat * wp.cos(azimuth), flat * wp.sin(azimuth), wp.sin(elevation))
    channel = wp.vec2(1.0 - tint, 1.0 + tint)
    sun, sky = random.uniform_range(env, rng, sun_range), random.uniform_range(env, rng, sky_range)
    direct, ambient = wp.vec3(0.0), wp.vec3(0.0)
    for k in range(3):
        direct[k] = sun * random.uniform_range(env, rng, channel)
        ambient[k] = sky * random.uniform_range(env, rng, channel)
    sensor.sun[env] = wp.cw_mul(sensor.default_sun[env], direct)
    sensor.sky[env] = wp.cw_mul(sensor.default_sky[env], ambient)
    sensor.ground[env] = wp.cw_mul(sensor.default_ground[env], ambient)
