# SPDX-License-Identifier: Apache-2.0
"""IMU observations; ``sensor_cfg``, or ``asset_cfg`` as in Isaac Lab, names the IMU if a scene has several."""

from typing import TYPE_CHECKING

import warp as wp

from ..removed_tables import forward_tables
from ..sensors.imu import ImuData
from ..term_info import writes

__all__ = ["imu_ang_vel", "imu_lin_acc", "imu_orientation", "imu_projected_gravity"]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, sizes={"IMU_OBSERVATION_SIZES": __name__})


@writes(3)
@wp.func
def imu_ang_vel(env: int, asset: ImuData, out: wp.array[float]):
    """IMU angular velocity, in the IMU's frame.

    Formula: ``R^T w`` [rad/s].

    Source: Isaac Lab, ``mdp.imu_ang_vel``.
    """
    for k in range(3):
        out[k] = asset.ang_vel_b[env][k]


@writes(3)
@wp.func
def imu_lin_acc(env: int, asset: ImuData, out: wp.array[float]):
    """IMU linear acceleration, in the IMU's frame, with the sensor's gravity bias.

    Formula: ``R^T (a + bias)`` [m/s^2].

    Source: Isaac Lab, ``mdp.imu_lin_acc``.
    """
    for k in range(3):
        out[k] = asset.lin_acc_b[env][k]


@writes(4)
@wp.func
def imu_orientation(env: int, asset: ImuData, out: wp.array[float]):
    """IMU orientation in the world, quaternion (x, y, z, w).

    Formula: ``q``.

    Source: Isaac Lab, ``mdp.imu_orientation``, there (w, x, y, z) before version 3.
    """
    for k in range(4):
        out[k] = asset.quat_w[env][k]


@writes(3)
@wp.func
def imu_projected_gravity(env: int, asset: ImuData, out: wp.array[float]):
    """IMU projected gravity: direction of gravity in the IMU's frame; (0, 0, -1) when upright.

    Formula: ``R^T g / |g|``.

    Source: Isaac Lab, ``mdp.imu_projected_gravity``.
    """
    for k in range(3):
        out[k] = asset.projected_gravity_b[env][k]
