# SPDX-License-Identifier: Apache-2.0
"""Depth student: camera, observations, events and training of quadrupeds that walk by a depth camera.

A policy with the height scan, trained before, is the teacher. The student sees what a robot has: its joints, its IMU,
the command and the picture of a depth camera in its head. The ground below it is out of view, so it has a memory.
"""

from __future__ import annotations

import math

from scipy.spatial.transform import Rotation

from stripe_newton.configclass import configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import EventTermCfg, ObservationGroupCfg, ObservationTermCfg, SceneEntityCfg
from stripe_newton.rl import (
    RslRlDistillationAlgorithmCfg,
    RslRlDistillationRunnerCfg,
    RslRlMLPModelCfg,
    RslRlRecurrentCNNModelCfg,
)
from stripe_newton.sensors import DepthNoiseCfg, PinholeCameraCfg, TiledCameraCfg
from stripe_tasks.velocity.manager_terms import ProprioceptionCfg

__all__ = [
    "MOUNTING",
    "DepthDistillationRunnerCfg",
    "DepthPictureCfg",
    "StudentProprioceptionCfg",
    "depth_camera",
]

WIDTH, HEIGHT = 64, 48
"""Size of the picture [px]."""
VIEW = math.radians(87.0)
"""Horizontal field of view, that of an Intel RealSense D435's depth [rad]."""
FAR = 3.0
"""Largest depth that the policy is given [m]."""


def depth_camera(pitch: float) -> TiledCameraCfg:
    """Depth camera in the head of the quadruped, with the noise and the delay of a real one.

    25 pictures a second, which reach the policy 40 to 120 ms after they were taken.

    Args:
        pitch: Angle by which it looks down [rad].
    """
    x, y, z, w = map(float, Rotation.from_euler("y", pitch).as_quat())
    return TiledCameraCfg(
        prim_path="{ENV_REGEX_NS}/Robot/base/depth_camera",
        offset=TiledCameraCfg.OffsetCfg(
            pos=(0.345, 0.0, 0.0),
            rot=(x, y, z, w),
            convention="world",
        ),
        spawn=PinholeCameraCfg(
            focal_length=1.0, horizontal_aperture=2.0 * math.tan(0.5 * VIEW), clipping_range=(0.05, FAR)
        ),
        width=WIDTH,
        height=HEIGHT,
        data_types=["distance_to_image_plane"],
        update_period=0.04,
        noise=DepthNoiseCfg(std=0.003, quadratic_std=0.01, dropout=0.02, quantization=0.001),
        delay=(1, 3),
    )


MOUNTING = EventTermCfg(
    func=mdp.randomize_camera_pose,
    mode="reset",
    params={
        "sensor_cfg": SceneEntityCfg("depth_camera"),
        "pose_range": {
            "x": (-0.01, 0.01),
            "y": (-0.01, 0.01),
            "z": (-0.02, 0.02),
            "roll": (-0.03, 0.03),
            "pitch": (-0.08, 0.08),
            "yaw": (-0.03, 0.03),
        },
    },
)
"""Errors of the camera's mounting, drawn for each episode."""


@configclass
class StudentProprioceptionCfg(ProprioceptionCfg):
    """Proprioception without the velocity of the base, which a robot does not measure."""

    base_lin_vel: ObservationTermCfg | None = None  # type: ignore[assignment]  # None removes the base class's term


@configclass
class DepthPictureCfg(ObservationGroupCfg):
    """Picture of the depth camera: from 0 at the lens to 1 at the largest depth and where nothing is seen."""

    picture: ObservationTermCfg = ObservationTermCfg(
        func=mdp.image,
        params={
            "sensor_cfg": SceneEntityCfg("depth_camera"),
            "data_type": "distance_to_image_plane",
            "channels_first": True,
            "max_depth": FAR,
        },
    )


@configclass
class DepthDistillationRunnerCfg(RslRlDistillationRunnerCfg):
    """Distillation of a policy with a height scan to one with a depth camera and a memory."""

    num_steps_per_env: int = 60
    max_iterations: int = 600
    save_interval: int = 50
    obs_groups: dict[str, list[str]] = {"student": ["policy", "depth"], "teacher": ["teacher"]}
    student: RslRlRecurrentCNNModelCfg = RslRlRecurrentCNNModelCfg(
        hidden_dims=(256, 128),
        obs_normalization=True,
        cnn_cfg=RslRlRecurrentCNNModelCfg.CNNCfg(
            output_channels=(16, 32, 32), kernel_size=(5, 3, 3), stride=(2, 2, 2), activation="elu"
        ),
        rnn_type="gru",
        rnn_hidden_dim=256,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=0.1),
    )
    algorithm: RslRlDistillationAlgorithmCfg = RslRlDistillationAlgorithmCfg(
        gradient_length=15, learning_rate=5.0e-4, max_grad_norm=1.0
    )
