# SPDX-License-Identifier: Apache-2.0
"""Lift by camera: ``Stripe-Lift-Cube-Panda-Camera-v0``, in which the policy sees the cube in a picture alone.

It is the lift of :mod:`stripe_tasks.manipulation.lift` but for its observations. Light and colours differ between
episodes, so that a policy cannot rely on them. The critic knows where the cube is.
"""

from __future__ import annotations

import math

from scipy.spatial.transform import Rotation

from stripe_newton.configclass import configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import EventTermCfg, ObservationGroupCfg, ObservationTermCfg, SceneEntityCfg
from stripe_newton.rl import RslRlCNNModelCfg, RslRlMLPModelCfg, RslRlPpoAlgorithmCfg
from stripe_newton.sensors import PinholeCameraCfg, TiledCameraCfg

from .lift import GOAL, EventsCfg, LiftEnvCfg, LiftPPORunnerCfg, LiftSceneCfg
from .lift import ObservationsCfg as LiftObservationsCfg

__all__ = ["LiftCameraEnvCfg", "LiftCameraPPORunnerCfg"]

_CAMERA = SceneEntityCfg("tiled_camera")


def front_camera(pos: tuple[float, float, float], pitch: float) -> TiledCameraCfg:
    """Colour camera that looks back at the arm.

    Args:
        pos: Its place in the environment's frame [m].
        pitch: Angle by which it looks down [rad].
    """
    x, y, z, w = map(float, Rotation.from_euler("ZY", (math.pi, pitch)).as_quat())
    return TiledCameraCfg(
        prim_path="{ENV_REGEX_NS}/Camera",
        offset=TiledCameraCfg.OffsetCfg(pos=pos, rot=(x, y, z, w), convention="world"),
        spawn=PinholeCameraCfg(focal_length=1.0, horizontal_aperture=0.9, clipping_range=(0.05, 5.0)),
        width=64,
        height=64,
        data_types=("rgb",),
    )


@configclass
class LiftCameraSceneCfg(LiftSceneCfg):
    """Scene of the lift with a camera in front of the arm."""

    tiled_camera: TiledCameraCfg = front_camera(pos=(1.25, 0.0, 0.65), pitch=0.52)


@configclass
class ProprioceptionCfg(ObservationGroupCfg):
    """The joints, where the cube is to go, the last actions."""

    joint_pos: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos_rel)
    joint_vel: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_vel_rel)
    target_object_position: ObservationTermCfg = ObservationTermCfg(func=mdp.generated_commands, params=GOAL)
    actions: ObservationTermCfg = ObservationTermCfg(func=mdp.last_action)


@configclass
class PictureCfg(ObservationGroupCfg):
    """Picture of the camera: colours from 0 to 1 less their mean, channels first."""

    picture: ObservationTermCfg = ObservationTermCfg(
        func=mdp.image, params={"sensor_cfg": _CAMERA, "data_type": "rgb", "channels_first": True}
    )


@configclass
class ObservationsCfg:
    """Observations of the policy, its picture, and those of the critic, which knows where the cube is."""

    policy: ProprioceptionCfg = ProprioceptionCfg()
    picture: PictureCfg = PictureCfg()
    critic: LiftObservationsCfg.PolicyCfg = LiftObservationsCfg.PolicyCfg()


@configclass
class LiftCameraEventsCfg(EventsCfg):
    """Events of the lift; light, colours and the mounting of the camera differ between episodes."""

    light: EventTermCfg = EventTermCfg(
        func=mdp.randomize_light,
        mode="reset",
        params={
            "sensor_cfg": _CAMERA,
            "azimuth_range": (-math.pi, math.pi),
            "elevation_range": (0.6, 1.5),
            "sun_range": (0.5, 1.3),
            "sky_range": (0.6, 1.3),
            "tint": 0.1,
        },
    )
    cube_color: EventTermCfg = EventTermCfg(
        func=mdp.randomize_visual_color,
        mode="reset",
        params={
            "asset_cfg": SceneEntityCfg("object"),
            "colors": {"r": (0.6, 1.0), "g": (0.05, 0.35), "b": (0.0, 0.2)},
        },
    )
    camera_mounting: EventTermCfg = EventTermCfg(
        func=mdp.randomize_camera_pose,
        mode="reset",
        params={
            "sensor_cfg": _CAMERA,
            "pose_range": {
                "x": (-0.02, 0.02), "y": (-0.02, 0.02), "z": (-0.02, 0.02),
                "roll": (-0.02, 0.02), "pitch": (-0.02, 0.02), "yaw": (-0.02, 0.02),
            },
        },
    )  # fmt: skip


@configclass
class LiftCameraEnvCfg(LiftEnvCfg):
    """Lift by camera: 33 numbers and a picture of 64 by 64 pixels; ``tiled_camera`` sets another size."""

    scene: LiftCameraSceneCfg = LiftCameraSceneCfg(num_envs=4096, env_spacing=2.5)
    observations: ObservationsCfg = ObservationsCfg()  # type: ignore[assignment]  # groups of its own
    events: LiftCameraEventsCfg = LiftCameraEventsCfg()


@configclass
class LiftCameraPPORunnerCfg(LiftPPORunnerCfg):
    """PPO with convolutions for lifting by camera."""

    max_iterations: int = 3000
    experiment_name: str = "lift_cube_panda_camera"
    obs_groups: dict[str, list[str]] = {"actor": ["policy", "picture"], "critic": ["critic"]}
    actor: RslRlCNNModelCfg = RslRlCNNModelCfg(
        hidden_dims=(256, 128, 64),
        obs_normalization=True,
        cnn_cfg=RslRlCNNModelCfg.CNNCfg(output_channels=(16, 32, 32), kernel_size=(8, 4, 3), stride=(4, 2, 1)),
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    algorithm: RslRlPpoAlgorithmCfg = LiftPPORunnerCfg().algorithm.replace(max_learning_rate=1.0e-3)
