# SPDX-License-Identifier: Apache-2.0
"""Forest walk by a depth camera: ``Stripe-Forest-Walk-Quadruped-Depth-v0``, distilled from a policy with scans.

The teacher is a run of ``Stripe-Forest-Walk-Quadruped-v0``. ``Stripe-Forest-Walk-Quadruped-Depth-Play-v0`` is in
ordinary woods that neither was trained in.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from stripe_newton.configclass import configclass
from stripe_newton.managers import EventTermCfg
from stripe_newton.specifications import SceneSpec, TaskEnvCfg, TrainingSpec
from stripe_tasks.depth_student import (
    MOUNTING,
    DepthDistillationRunnerCfg,
    DepthPictureCfg,
    StudentProprioceptionCfg,
    depth_camera,
)

from .walk import PLAY_SEED, SCENE_SEED, VIEWER, ForestEventsCfg, WalkPolicyCfg, to_play, training

__all__ = ["ForestWalkDepthRunnerCfg", "depth_training", "play_cfg", "walk_cfg"]


@configclass
class WalkDepthObservationsCfg:
    """Observations of the student, its picture, and those of the teacher without noise."""

    policy: StudentProprioceptionCfg = StudentProprioceptionCfg()
    depth: DepthPictureCfg = DepthPictureCfg()
    teacher: WalkPolicyCfg = WalkPolicyCfg(enable_corruption=False)


@configclass
class WalkDepthEventsCfg(ForestEventsCfg):
    """Events of the forest, and a camera that is never mounted exactly alike."""

    camera_mounting: EventTermCfg | None = MOUNTING


def depth_training(scene: SceneSpec | None = None, **changes: Any) -> TrainingSpec:
    """Specification of the task of walking by a depth camera; arguments as of :func:`stripe_tasks.forest.training`."""
    spec = training(scene, observations=WalkDepthObservationsCfg(), events=WalkDepthEventsCfg(), **changes)
    # Less steep than on bare ground: trunks are seen from farther away.
    return replace(spec, sensors={**spec.sensors, "depth_camera": depth_camera(pitch=0.35)})


def walk_cfg() -> TaskEnvCfg:
    """Config of ``Stripe-Forest-Walk-Quadruped-Depth-v0``."""
    return depth_training(num_envs=1024).to_env_cfg(VIEWER, seed=SCENE_SEED)


def play_cfg() -> TaskEnvCfg:
    """Config of ``Stripe-Forest-Walk-Quadruped-Depth-Play-v0``."""
    return to_play(depth_training).to_env_cfg(VIEWER, seed=PLAY_SEED)


@configclass
class ForestWalkDepthRunnerCfg(DepthDistillationRunnerCfg):
    """Distillation for the forest walk."""

    experiment_name: str = "forest_walk_quadruped_depth"
