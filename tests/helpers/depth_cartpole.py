# SPDX-License-Identifier: Apache-2.0
"""Cart-pole by a depth camera, distilled from one that observes its joints: a small task for ``train --teacher``."""

from __future__ import annotations

from stripe_newton.configclass import configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import ObservationGroupCfg, ObservationTermCfg, SceneEntityCfg
from stripe_newton.registration import register_task
from stripe_newton.rl import (
    RslRlDistillationAlgorithmCfg,
    RslRlDistillationRunnerCfg,
    RslRlMLPModelCfg,
    RslRlRecurrentCNNModelCfg,
)
from stripe_newton.sensors import PinholeCameraCfg, TiledCameraCfg
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg

TASK = "Test-Cartpole-Depth-v0"
TEACHER_TASK = "Stripe-Cartpole-v0"


@configclass
class DepthCartpoleSceneCfg(type(CartpoleManagerEnvCfg().scene)):
    """The cart-pole with a camera before its rail."""

    eye: TiledCameraCfg = TiledCameraCfg(
        prim_path="{ENV_REGEX_NS}/eye",
        offset=TiledCameraCfg.OffsetCfg(pos=(-3.5, 0.0, 2.0), rot=(0.0, 0.0, 0.0, 1.0), convention="world"),
        spawn=PinholeCameraCfg(focal_length=1.0, horizontal_aperture=1.6, clipping_range=(0.1, 8.0)),
        width=24,
        height=16,
        data_types=["depth"],
    )


@configclass
class SpeedsCfg(ObservationGroupCfg):
    """Observation of the student beside its picture."""

    joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel)


@configclass
class EyeCfg(ObservationGroupCfg):
    """The picture."""

    picture: ObservationTermCfg = ObservationTermCfg(
        func=mdp.image,
        params={
            "sensor_cfg": SceneEntityCfg("eye"), "data_type": "depth", "channels_first": True, "max_depth": 8.0
        },
    )  # fmt: skip


@configclass
class DepthCartpoleObservationsCfg:
    """Observations of student and teacher."""

    policy: SpeedsCfg = SpeedsCfg()
    depth: EyeCfg = EyeCfg()
    teacher: ObservationGroupCfg = CartpoleManagerEnvCfg().observations.policy


@configclass
class DepthCartpoleEnvCfg(CartpoleManagerEnvCfg):
    """The environment."""

    scene: DepthCartpoleSceneCfg = DepthCartpoleSceneCfg(
        num_envs=32, env_spacing=4.0, robot=CartpoleManagerEnvCfg().scene.robot
    )
    observations: DepthCartpoleObservationsCfg = DepthCartpoleObservationsCfg()


@configclass
class DepthCartpoleRunnerCfg(RslRlDistillationRunnerCfg):
    """A small student."""

    experiment_name: str = "depth_cartpole"
    num_steps_per_env: int = 20
    save_interval: int = 100
    obs_groups: dict[str, list[str]] = {"student": ["policy", "depth"], "teacher": ["teacher"]}
    student: RslRlRecurrentCNNModelCfg = RslRlRecurrentCNNModelCfg(
        hidden_dims=(32,),
        obs_normalization=True,
        rnn_hidden_dim=16,
        cnn_cfg=RslRlRecurrentCNNModelCfg.CNNCfg(output_channels=(4, 8), kernel_size=(5, 3), stride=(2, 2)),
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=0.1),
    )
    algorithm: RslRlDistillationAlgorithmCfg = RslRlDistillationAlgorithmCfg(
        num_learning_epochs=4, gradient_length=10, learning_rate=5.0e-3
    )


def register() -> str:
    """Register the task; returns its name."""
    register_task(TASK, env="stripe_newton.envs:ManagerBasedRLEnv", env_cfg=DepthCartpoleEnvCfg,
                  rsl_rl_cfg=DepthCartpoleRunnerCfg)  # fmt: skip
    return TASK
