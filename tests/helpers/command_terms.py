# SPDX-License-Identifier: Apache-2.0
"""Command terms for tests: configs of the package's kinds, and a kind of its own."""

from __future__ import annotations

import math
from typing import Any

import warp as wp

from stripe_kernels import mdp
from stripe_kernels.data import CommandData
from stripe_newton.envs import mdp as cfgs
from stripe_newton.managers import CommandTermCfg

INF = math.inf


def velocity(**changes: Any) -> Any:
    ranges = cfgs.UniformVelocityCommandCfg.Ranges(
        lin_vel_x=(-1.0, 1.5), lin_vel_y=(-0.5, 0.5), ang_vel_z=(-1.0, 0.7), heading=(-3.0, 3.0)
    )
    cfg = cfgs.UniformVelocityCommandCfg(
        asset_name="robot",
        resampling_time_range=(0.04, 0.09),
        heading_command=True,
        heading_control_stiffness=0.5,
        rel_standing_envs=0.2,
        rel_heading_envs=0.6,
        ranges=ranges,
    )
    return cfg.replace(**changes)


def normal_velocity() -> Any:
    ranges = cfgs.NormalVelocityCommandCfg.Ranges(
        mean_vel=(0.5, 0.0, 1.0), std_vel=(0.1, 0.2, 0.0), zero_prob=(0.1, 0.0, 0.5)
    )
    return cfgs.NormalVelocityCommandCfg(resampling_time_range=(0.04, 0.09), rel_standing_envs=0.2, ranges=ranges)


def pose(**changes: Any) -> Any:
    ranges = cfgs.UniformPoseCommandCfg.Ranges(
        pos_x=(-0.5, 0.5), pos_y=(0.25, 0.25), pos_z=(0.0, 0.3), roll=(-0.7, 0.7), pitch=(-1.5, 1.5), yaw=(-3.1, 3.1)
    )
    cfg = cfgs.UniformPoseCommandCfg(
        asset_name="robot", body_name="left_back_foot", resampling_time_range=(0.04, 0.09), ranges=ranges
    )
    return cfg.replace(**changes)


def pose_2d(**changes: Any) -> Any:
    ranges = cfgs.UniformPose2dCommandCfg.Ranges(pos_x=(-3.0, 3.0), pos_y=(-2.0, 1.0), heading=(-3.0, 3.0))
    cfg = cfgs.UniformPose2dCommandCfg(asset_name="robot", resampling_time_range=(0.04, 0.09), ranges=ranges)
    return cfg.replace(**changes)


@wp.func
def count_up(env: int, command: CommandData, rng: wp.array[wp.uint32], stride: float):
    command.command[env, 0] = command.command[env, 0] + stride
    command.command[env, 1] = mdp.random.uniform(env, rng)


@wp.func
def age(env: int, command: CommandData):
    command.command[env, 2] = command.time_left[env]


@wp.func
def drawn(env: int, command: CommandData, scale: float) -> float:
    return scale * float(command.counter[env])


def own(**changes: Any) -> CommandTermCfg:
    cfg = CommandTermCfg(
        resampling_time_range=(0.095, 0.095),
        resample=count_up,
        update=age,
        size=3,
        params={"stride": 2.0, "scale": 10.0},
        metrics={"drawn": drawn},
    )
    return cfg.replace(**changes)
