# SPDX-License-Identifier: Apache-2.0
"""Rough walk by a depth camera: ``Stripe-Velocity-Rough-Quadruped-Depth-v0``, distilled from a policy with a scan.

The teacher is a run of ``Stripe-Velocity-Rough-Quadruped-v0``::

    stripe-newton train Stripe-Velocity-Rough-Quadruped-Depth-v0 --teacher RUN --num-envs 1024
"""

from __future__ import annotations

from stripe_newton.configclass import configclass
from stripe_newton.managers import EventTermCfg
from stripe_newton.sensors import TiledCameraCfg
from stripe_tasks.depth_student import (
    MOUNTING,
    DepthDistillationRunnerCfg,
    DepthPictureCfg,
    StudentProprioceptionCfg,
    depth_camera,
)

from .manager_based import RoughSceneCfg
from .manager_terms import RoughEventsCfg, ScanningCfg
from .quadruped import ROBOT_CFG, QuadrupedRoughEnvCfg

__all__ = ["QuadrupedDepthEnvCfg", "QuadrupedDepthRunnerCfg"]


@configclass
class DepthSceneCfg(RoughSceneCfg):
    """Rough scene with a depth camera that looks at the ground before the robot."""

    depth_camera: TiledCameraCfg = depth_camera(pitch=0.6)


@configclass
class DepthObservationsCfg:
    """Observations of the student, its picture, and those of the teacher without noise."""

    policy: StudentProprioceptionCfg = StudentProprioceptionCfg()
    depth: DepthPictureCfg = DepthPictureCfg()
    teacher: ScanningCfg = ScanningCfg(enable_corruption=False)


@configclass
class DepthEventsCfg(RoughEventsCfg):
    """Events on rough ground, and a camera that is never mounted exactly alike."""

    camera_mounting: EventTermCfg | None = MOUNTING


@configclass
class QuadrupedDepthEnvCfg(QuadrupedRoughEnvCfg):
    """Quadruped on rough ground by depth: 45 numbers and a picture of 64 by 48 pixels."""

    scene: DepthSceneCfg = DepthSceneCfg(num_envs=1024, env_spacing=2.5, robot=ROBOT_CFG)
    observations: DepthObservationsCfg = DepthObservationsCfg()  # type: ignore[assignment]  # groups of its own
    events: DepthEventsCfg = DepthEventsCfg()


@configclass
class QuadrupedDepthRunnerCfg(DepthDistillationRunnerCfg):
    """Distillation for the quadruped on rough ground."""

    experiment_name: str = "velocity_rough_quadruped_depth"
