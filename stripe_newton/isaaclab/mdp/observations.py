# SPDX-License-Identifier: Apache-2.0
"""Observations of ``isaaclab.envs.mdp``: Warp terms, whose values are ``(num_envs, n)`` when they are called."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch

from stripe_kernels import mdp, scalar_first
from stripe_newton.envs import RLEnv
from stripe_newton.managers.image import image as native_image

from ..scene_entity import SceneEntityCfg
from .warp_term import SettledTerm, term_of

if TYPE_CHECKING:
    from stripe_newton.managers import ObservationTermCfg

__all__ = [
    "base_ang_vel",
    "base_lin_vel",
    "base_pos_z",
    "body_incoming_wrench",
    "body_pose_w",
    "body_projected_gravity_b",
    "current_time_s",
    "generated_commands",
    "height_scan",
    "image",
    "imu_ang_vel",
    "imu_lin_acc",
    "imu_orientation",
    "imu_projected_gravity",
    "joint_effort",
    "joint_pos",
    "joint_pos_limit_normalized",
    "joint_pos_rel",
    "joint_vel",
    "joint_vel_rel",
    "last_action",
    "projected_gravity",
    "remaining_time_s",
    "root_ang_vel_w",
    "root_lin_vel_w",
    "root_pos_w",
    "root_quat_w",
]

ROBOT, IMU, CAMERA = SceneEntityCfg("robot"), SceneEntityCfg("imu"), SceneEntityCfg("tiled_camera")

# -- root


@term_of(mdp.base_pos_z)
def base_pos_z(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Height of the root link [m]."""


@term_of(mdp.base_lin_vel)
def base_lin_vel(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Linear velocity of the root in its frame [m/s]."""


@term_of(mdp.base_ang_vel)
def base_ang_vel(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Angular velocity of the root in its frame [rad/s]."""


@term_of(mdp.projected_gravity)
def projected_gravity(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Direction of gravity in the root's frame."""


@term_of(mdp.root_pos_w)
def root_pos_w(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Position of the root, relative to the environment's origin [m]."""


@term_of(scalar_first.root_quat_w)
def root_quat_w(env: RLEnv, make_quat_unique: bool = False, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Orientation of the root, (w, x, y, z)."""


@term_of(mdp.root_lin_vel_w)
def root_lin_vel_w(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Linear velocity of the root in the world [m/s]."""


@term_of(mdp.root_ang_vel_w)
def root_ang_vel_w(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Angular velocity of the root in the world [rad/s]."""


# -- bodies


@term_of(scalar_first.body_pose_w)
def body_pose_w(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Poses of bodies, relative to the environment's origin [m], quaternions (w, x, y, z)."""


@term_of(mdp.body_projected_gravity_b)
def body_projected_gravity_b(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Direction of gravity in the frames of bodies."""


@term_of(mdp.body_incoming_wrench)
def body_incoming_wrench(env: RLEnv, asset_cfg: SceneEntityCfg) -> object:
    """Wrenches of the joints on bodies [N, N m]."""


# -- joints


@term_of(mdp.joint_pos)
def joint_pos(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Joint positions [m or rad]."""


@term_of(mdp.joint_pos_rel)
def joint_pos_rel(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Joint positions relative to the default ones [m or rad]."""


@term_of(mdp.joint_pos_limit_normalized)
def joint_pos_limit_normalized(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Joint positions, -1 and 1 at the soft limits."""


@term_of(mdp.joint_vel)
def joint_vel(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Joint velocities [m/s or rad/s]."""


@term_of(mdp.joint_vel_rel)
def joint_vel_rel(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Joint velocities relative to the default ones [m/s or rad/s]."""


@term_of(mdp.joint_effort)
def joint_effort(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Efforts of the actuators [N or N m]."""


# -- sensors


@term_of(mdp.height_scan)
def height_scan(env: RLEnv, sensor_cfg: SceneEntityCfg, offset: float = 0.5) -> object:
    """Heights of a ray caster above the points that its rays hit, less ``offset`` [m]."""


@term_of(scalar_first.imu_orientation)
def imu_orientation(env: RLEnv, asset_cfg: SceneEntityCfg = IMU) -> object:
    """Orientation of an IMU, (w, x, y, z)."""


@term_of(mdp.imu_projected_gravity)
def imu_projected_gravity(env: RLEnv, asset_cfg: SceneEntityCfg = IMU) -> object:
    """Direction of gravity in the frame of an IMU."""


@term_of(mdp.imu_ang_vel)
def imu_ang_vel(env: RLEnv, asset_cfg: SceneEntityCfg = IMU) -> object:
    """Angular velocity in the frame of an IMU [rad/s]."""


@term_of(mdp.imu_lin_acc)
def imu_lin_acc(env: RLEnv, asset_cfg: SceneEntityCfg = IMU) -> object:
    """Linear acceleration in the frame of an IMU [m/s^2]."""


class _Image(SettledTerm):
    """The picture of a camera; in a config it stands for :func:`stripe_newton.managers.image.image`."""

    __name__ = __qualname__ = "image"

    def __call__(
        self,
        env: RLEnv,
        sensor_cfg: SceneEntityCfg = CAMERA,
        data_type: str = "rgb",
        convert_perspective_to_orthogonal: bool = False,
        normalize: bool = True,
    ) -> torch.Tensor:
        """The picture, float32, shape ``(num_envs, height, width, channels)``.

        Raises:
            ValueError: ``convert_perspective_to_orthogonal``; ``distance_to_image_plane`` is such a depth.
        """
        _refuse_conversion(convert_perspective_to_orthogonal)
        return native_image(env, sensor_cfg, data_type, normalize)

    def settle(self, term: ObservationTermCfg) -> None:
        """Let the config of a term have the package's function, which a manager writes by kernels."""
        params: dict[str, Any] = {"sensor_cfg": CAMERA, **term.params}
        _refuse_conversion(params.pop("convert_perspective_to_orthogonal", False))
        term.func, term.params = native_image, params


def _refuse_conversion(wanted: object) -> None:
    if wanted:
        raise ValueError("convert_perspective_to_orthogonal: use the camera's data type 'distance_to_image_plane'")


image = _Image()

# -- actions, commands, time


@term_of(mdp.last_action)
def last_action(env: RLEnv, action_name: str | None = None) -> object:
    """Actions of the last step, of all action terms or of one."""


@term_of(mdp.generated_commands)
def generated_commands(env: RLEnv, command_name: str | None = None) -> object:
    """A command."""


@term_of(mdp.current_time_s)
def current_time_s(env: RLEnv) -> object:
    """Time since the start of the episode [s]."""


@term_of(mdp.remaining_time_s)
def remaining_time_s(env: RLEnv) -> object:
    """Time until the end of the episode [s]."""
