# SPDX-License-Identifier: Apache-2.0
"""Command terms of ``isaaclab.envs.mdp``: configs with Isaac Lab's fields and quaternions (w, x, y, z)."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from stripe_kernels import scalar_first as wxyz
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.managers import commands_cfg as native

from .command_terms import (
    NormalVelocityCommand,
    NullCommand,
    TerrainBasedPose2dCommand,
    UniformPose2dCommand,
    UniformPoseCommand,
    UniformVelocityCommand,
)

__all__ = [
    "NormalVelocityCommandCfg",
    "NullCommandCfg",
    "TerrainBasedPose2dCommandCfg",
    "UniformPose2dCommandCfg",
    "UniformPoseCommandCfg",
    "UniformVelocityCommandCfg",
]


def _not_drawn(*fields: str) -> dict[str, str]:
    return dict.fromkeys(fields, "commands are drawn in the package's own way")


@configclass
class NullCommandCfg(native.NullCommandCfg):
    """:class:`stripe_newton.envs.mdp.NullCommandCfg`."""

    class_type: type | None = NullCommand


@configclass
class UniformVelocityCommandCfg(native.UniformVelocityCommandCfg):
    """:class:`stripe_newton.envs.mdp.UniformVelocityCommandCfg`."""

    class_type: type | None = UniformVelocityCommand
    asset_name: str = MISSING
    goal_vel_visualizer_cfg: object = None
    current_vel_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_vel_visualizer_cfg", "current_vel_visualizer_cfg")


@configclass
class NormalVelocityCommandCfg(native.NormalVelocityCommandCfg):
    """:class:`stripe_newton.envs.mdp.NormalVelocityCommandCfg`."""

    class_type: type | None = NormalVelocityCommand
    asset_name: str = MISSING
    heading_command: bool = False
    goal_vel_visualizer_cfg: object = None
    current_vel_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_vel_visualizer_cfg", "current_vel_visualizer_cfg")


@configclass
class UniformPoseCommandCfg(native.UniformPoseCommandCfg):
    """:class:`stripe_newton.envs.mdp.UniformPoseCommandCfg`, whose command has a quaternion (w, x, y, z)."""

    class_type: type | None = UniformPoseCommand
    scalar_first: ClassVar[bool] = True
    asset_name: str = MISSING
    body_name: str | list[str] = MISSING  # type: ignore[assignment]  # Isaac Lab takes any expressions of one body
    resample: Callable[..., object] | None = wxyz.resample_uniform_pose
    update: Callable[..., object] | None = wxyz.pose_of_command
    goal_pose_visualizer_cfg: object = None
    current_pose_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_pose_visualizer_cfg", "current_pose_visualizer_cfg")


@configclass
class UniformPose2dCommandCfg(native.UniformPose2dCommandCfg):
    """:class:`stripe_newton.envs.mdp.UniformPose2dCommandCfg`."""

    class_type: type | None = UniformPose2dCommand
    asset_name: str = MISSING
    simple_heading: bool = MISSING
    goal_pose_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_pose_visualizer_cfg")


@configclass
class TerrainBasedPose2dCommandCfg(native.TerrainBasedPose2dCommandCfg):
    """:class:`stripe_newton.envs.mdp.TerrainBasedPose2dCommandCfg`."""

    class_type: type | None = TerrainBasedPose2dCommand
    asset_name: str = MISSING
    simple_heading: bool = MISSING
    goal_pose_visualizer_cfg: object = None
    IGNORED: ClassVar[dict[str, str]] = _not_drawn("goal_pose_visualizer_cfg")
