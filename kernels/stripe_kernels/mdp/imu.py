# SPDX-License-Identifier: Apache-2.0
"""Observations of an IMU, named by ``sensor_cfg`` or, as in Isaac Lab, by ``asset_cfg``; the only one there
is needs no name.
"""

import warp as wp

from ..sensors.imu import ImuData
from ..term_info import writes

__all__ = ["imu_ang_vel", "imu_lin_acc", "imu_orientation", "imu_projected_gravity"]


@writes(3)
@wp.func
def imu_ang_vel(env: int, asset: ImuData, out: wp.array[float]):
    """Angular velocity in the IMU's frame.

    Formula: ``R^T w`` [rad/s].

    Source: Isaac Lab, ``mdp.imu_ang_vel``.
    """
    for k in range(3):
        out[k] = asset.ang_vel_b[env][k]


@writes(3)
@wp.func
def imu_lin_acc(env: int, asset: ImuData, out: wp.array[float]):
    """Acceleration in the IMU's frame, the sensor's gravity bias included.

    Formula: ``R^T (a + bias)`` [m/s^2].

    Source: Isaac Lab, ``mdp.imu_lin_acc``.
    """
    for k in range(3):
        out[k] = asset.lin_acc_b[env][k]


@writes(4)
@wp.func
def imu_orientation(env: int, asset: ImuData, out: wp.array[float]):
    """Orientation of the IMU's frame in the world, (x, y, z, w).

    Formula: ``q``.

    Source: Isaac Lab, ``mdp.imu_orientation``, there (w, x, y, z) before version 3.
    """
    for k in range(4):
        out[k] = asset.quat_w[env][k]


@writes(3)
@wp.func
def imu_projected_gravity(env: int, asset: ImuData, out: wp.array[float]):
    """Direction of gravity in the IMU's frame; (0, 0, -1) when upright.

    Formula: ``R^T g / |g|``.

    Source: Isaac Lab, ``mdp.imu_projected_gravity``.
    """
    for k in range(3):
        out[k] = asset.projected_gravity_b[env][k]
