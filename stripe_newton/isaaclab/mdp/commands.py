# SPDX-License-Identifier: Apache-2.0
"""Command terms of ``isaaclab.envs.mdp``: configs with Isaac Lab's fields and quaternions (w, x, y, z)."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from stripe_kernels import scalar_first
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.managers import commands_cfg as native

__all__ = [
    "NormalVelocityCommandCfg",
    "NullCommandCfg",
    "TerrainBasedPose2dCommandCfg",
    "UniformPose2dCommandCfg",
    "UniformPoseCommandCfg",
    "UniformVelocityCommandCfg",
]


def _not_drawn(*fields: str) -> dict[str, str]:
    return dict.fromkeys(("debug_vis", *fields), "commands are not drawn")


@configclass
class NullCommandCfg(native.NullCommandCfg):
    """:class:`stripe_newton.envs.mdp.NullCommandCfg`."""


@configclass
class UniformVelocityCommandCfg(native.UniformVelocityCommandCfg):
    """:class:`stripe_newton.envs.mdp.UniformVelocityCommandCfg`."""

    asset_name: str = MISSING
    goal_vel_visualizer_cfg: object = None
    current_vel_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_vel_visualizer_cfg", "current_vel_visualizer_cfg")


@configclass
class NormalVelocityCommandCfg(native.NormalVelocityCommandCfg):
    """:class:`stripe_newton.envs.mdp.NormalVelocityCommandCfg`."""

    asset_name: str = MISSING
    heading_command: bool = False
    goal_vel_visualizer_cfg: object = None
    current_vel_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_vel_visualizer_cfg", "current_vel_visualizer_cfg")


@configclass
class UniformPoseCommandCfg(native.UniformPoseCommandCfg):
    """:class:`stripe_newton.envs.mdp.UniformPoseCommandCfg`, whose command has a quaternion (w, x, y, z)."""

    asset_name: str = MISSING
    resample: Callable[..., object] | None = scalar_first.resample_uniform_pose
    update: Callable[..., object] | None = scalar_first.pose_of_command
    goal_pose_visualizer_cfg: object = None
    current_pose_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_pose_visualizer_cfg", "current_pose_visualizer_cfg")


@configclass
class UniformPose2dCommandCfg(native.UniformPose2dCommandCfg):
    """:class:`stripe_newton.envs.mdp.UniformPose2dCommandCfg`."""

    asset_name: str = MISSING
    simple_heading: bool = MISSING
    goal_pose_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_pose_visualizer_cfg")


@configclass
class TerrainBasedPose2dCommandCfg(native.TerrainBasedPose2dCommandCfg):
    """:class:`stripe_newton.envs.mdp.TerrainBasedPose2dCommandCfg`."""

    asset_name: str = MISSING
    simple_heading: bool = MISSING
    goal_pose_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_pose_visualizer_cfg")
