# SPDX-License-Identifier: Apache-2.0
"""Observation terms for tests, and the joints of the ant that they are of."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.configclass import configclass
from stripe_newton.managers import SceneEntityCfg

N = 4
J = 8  # joints of the ant: legs and feet in turn
LEGS, FEET = [0, 2, 4, 6], [1, 3, 5, 7]


def joints(*names: str, preserve_order: bool = False) -> dict[str, Any]:
    return {"asset_cfg": SceneEntityCfg("robot", joint_names=list(names), preserve_order=preserve_order)}


ALL_LEGS, ALL_FEET = joints(".*_leg"), joints(".*_foot")
ONE = joints("left_back_foot")  # joint 5


@wp.func
def moment(env: int, robot: ArticulationData, joint_ids: wp.array[int], gain: float, out: wp.array[float]):
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        total += robot.joint_pos[env, joint_ids[i]]
        out[i] = gain * robot.joint_vel[env, joint_ids[i]] * robot.joint_vel[env, joint_ids[i]]
    out[joint_ids.shape[0]] = total


@wp.func
def first_joint(env: int, robot: ArticulationData, out: wp.array[float]):
    out[0] = robot.joint_pos[env, 0]


def torch_squares(env: Any, asset_cfg: SceneEntityCfg) -> torch.Tensor:
    return env.scene[asset_cfg.name].data.joint_pos[:, asset_cfg.joint_ids] ** 2


@configclass
class Whole:
    """Config of an environment, as far as it has observations."""

    observations: Any = None
