# SPDX-License-Identifier: Apache-2.0
"""Terminations of ``isaaclab.envs.mdp``: Warp terms, whose values are bool ``(num_envs,)`` when they are called."""

from __future__ import annotations

from stripe_kernels import mdp
from stripe_newton.envs import RLEnv

from ..scene_entity import SceneEntityCfg
from .warp_term import term_of

__all__ = [
    "bad_orientation",
    "command_resample",
    "illegal_contact",
    "joint_effort_out_of_limit",
    "joint_pos_out_of_limit",
    "joint_pos_out_of_manual_limit",
    "joint_vel_out_of_limit",
    "joint_vel_out_of_manual_limit",
    "root_height_below_minimum",
    "time_out",
]

ROBOT = SceneEntityCfg("robot")


@term_of(mdp.time_out)
def time_out(env: RLEnv) -> object:
    """The episode has its full length."""


@term_of(mdp.command_resample)
def command_resample(env: RLEnv, command_name: str, num_resamples: int = 1) -> object:
    """The time of a command is up, which was the ``num_resamples``-th one."""


@term_of(mdp.bad_orientation)
def bad_orientation(env: RLEnv, limit_angle: float, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """The root leans by more than ``limit_angle`` [rad]."""


@term_of(mdp.root_height_below_minimum)
def root_height_below_minimum(env: RLEnv, minimum_height: float, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """The root is below ``minimum_height`` [m]."""


@term_of(mdp.joint_pos_out_of_limit)
def joint_pos_out_of_limit(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """A joint is outside of its soft limits."""


@term_of(mdp.joint_pos_out_of_manual_limit)
def joint_pos_out_of_manual_limit(env: RLEnv, bounds: tuple[float, float], asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """A joint is outside of ``bounds`` [m or rad]."""


@term_of(mdp.joint_vel_out_of_limit)
def joint_vel_out_of_limit(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """A joint is faster than its limit."""


@term_of(mdp.joint_vel_out_of_manual_limit)
def joint_vel_out_of_manual_limit(env: RLEnv, max_velocity: float, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """A joint is faster than ``max_velocity`` [m/s or rad/s]."""


@term_of(mdp.joint_effort_out_of_limit)
def joint_effort_out_of_limit(env: RLEnv, asset_cfg: SceneEntityCfg = ROBOT) -> object:
    """The effort of an actuator has been clipped."""


@term_of(mdp.illegal_contact)
def illegal_contact(env: RLEnv, threshold: float, sensor_cfg: SceneEntityCfg) -> object:
    """A body's largest contact force of late exceeds ``threshold`` [N]."""
