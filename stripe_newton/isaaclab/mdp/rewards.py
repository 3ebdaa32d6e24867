# SPDX-License-Identifier: Apache-2.0
"""Rewards of ``isaaclab.envs.mdp``: Warp terms, whose values are ``(num_envs,)`` when they are called."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from stripe_kernels import mdp
from stripe_newton.envs import RLEnv

from ..scene_entity import SceneEntityCfg
from .warp_term import term_of

__all__ = [
    "action_l2",
    "action_rate_l2",
    "ang_vel_xy_l2",
    "applied_torque_limits",
    "base_height_l2",
    "body_lin_acc_l2",
    "contact_forces",
    "desired_contacts",
    "flat_orientation_l2",
    "is_alive",
    "is_terminated",
    "is_terminated_term",
    "joint_acc_l2",
    "joint_deviation_l1",
    "joint_pos_limits",
    "joint_torques_l2",
    "joint_vel_l1",
    "joint_vel_l2",
    "joint_vel_limits",
    "lin_vel_z_l2",
    "track_ang_vel_z_exp",
    "track_lin_vel_xy_exp",
    "undesired_contacts",
]

ROBOT = SceneEntityCfg("robot")

# -- the episode


@term_of(mdp.is_alive)
def is_alive(env: RLEnv) -> object:
    """1 where the episode has not ended by a termination."""


@term_of(mdp.is_terminated)
def is_terminated(env: RLEnv) -> object:
    """1 where the episode ended by a termination."""


@term_of(mdp.is_terminated_term)
def is_terminated_term(env: RLEnv, term_keys: str | Sequence[str] = ".*") -> object:
    """Number of the named terminations that ended the episode, unless it ran out of time."""


# -- root


@term_of(mdp.lin_vel_z_l2)
def lin_vel_z_l2(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Square of the root's velocity along its z axis."""


@term_of(mdp.ang_vel_xy_l2)
def ang_vel_xy_l2(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Square of the root's angular velocity about its x and y axes."""


@term_of(mdp.flat_orientation_l2)
def flat_orientation_l2(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Square of the projected gravity's x and y components."""


@term_of(mdp.base_height_l2, unless="sensor_cfg")
def base_height_l2(
    env: RLEnv, target_height: float, asset_cfg: SceneEntityCfg = ROBOT, sensor_cfg: SceneEntityCfg | None = None
) -> object:
    """Square of the root's height less ``target_height`` [m], above the mean of a ray caster's hits if one is given."""
    target: torch.Tensor | float = target_height
    if sensor_cfg is not None:
        target = target_height + env.scene[sensor_cfg.name].data.ray_hits_w[..., 2].mean(dim=1)
    return torch.square(env.scene[asset_cfg.name].data.root_pos_w[:, 2] - target)


@term_of(mdp.track_lin_vel_xy_exp)
def track_lin_vel_xy_exp(env: RLEnv, std: float, command_name: str, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Exponential of the squared error of the root's velocity in its x and y axes."""


@term_of(mdp.track_ang_vel_z_exp)
def track_ang_vel_z_exp(env: RLEnv, std: float, command_name: str, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Exponential of the squared error of the root's yaw rate."""


# -- bodies and joints


@term_of(mdp.body_lin_acc_l2)
def body_lin_acc_l2(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Sum of the magnitudes of bodies' linear accelerations."""


@term_of(mdp.joint_torques_l2)
def joint_torques_l2(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Sum of squared efforts."""


@term_of(mdp.joint_vel_l1)
def joint_vel_l1(env: RLEnv, asset_cfg: SceneEntityCfg) -> object:
    """Sum of the magnitudes of joint velocities."""


@term_of(mdp.joint_vel_l2)
def joint_vel_l2(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Sum of squared joint velocities."""


@term_of(mdp.joint_acc_l2)
def joint_acc_l2(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Sum of squared joint accelerations."""


@term_of(mdp.joint_deviation_l1)
def joint_deviation_l1(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Sum of the distances to the default joint positions."""


@term_of(mdp.joint_pos_limits)
def joint_pos_limits(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Sum of what joint positions exceed their soft limits by."""


@term_of(mdp.joint_vel_limits)
def joint_vel_limits(env: RLEnv, soft_ratio: float, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Sum of what joint velocities exceed a share of their limits by, at most 1 each."""


@term_of(mdp.applied_torque_limits)
def applied_torque_limits(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """Sum of the differences between wanted and applied efforts."""


# -- actions


@term_of(mdp.action_rate_l2)
def action_rate_l2(env: RLEnv) -> object:
    """Sum of squared changes of the actions."""


@term_of(mdp.action_l2)
def action_l2(env: RLEnv) -> object:
    """Sum of squared actions."""


# -- contacts


@term_of(mdp.undesired_contacts)
def undesired_contacts(env: RLEnv, threshold: float, sensor_cfg: SceneEntityCfg) -> object:
    """Number of bodies whose largest contact force of late exceeds ``threshold`` [N]."""


@term_of(mdp.desired_contacts)
def desired_contacts(env: RLEnv, sensor_cfg: SceneEntityCfg, threshold: float = 1.0) -> object:
    """1 where no body has a contact force above ``threshold`` [N]."""


@term_of(mdp.contact_forces)
def contact_forces(env: RLEnv, threshold: float, sensor_cfg: SceneEntityCfg) -> object:
    """Sum of what contact forces exceed ``threshold`` by [N]."""
