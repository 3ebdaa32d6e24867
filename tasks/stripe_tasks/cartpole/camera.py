# SPDX-License-Identifier: Apache-2.0
"""Cart-pole by camera: ``Stripe-Cartpole-Camera-Direct-v0``, which sees a picture of cart and pole and nothing else.

It is the cart-pole of :mod:`stripe_tasks.cartpole.direct_warp` but for its observation, as in Isaac Lab's
``Isaac-Cartpole-RGB-Camera-Direct-v0``. Unlike there, the critic knows angles, positions and rates: it has no
convolutions, which are most of a training, and the rates are not in a picture.
"""

from __future__ import annotations

from typing import Any, ClassVar

from stripe_newton.configclass import configclass
from stripe_newton.managers.image import Picture, image_writer
from stripe_newton.rl import RslRlCNNModelCfg, RslRlMLPModelCfg, RslRlPpoAlgorithmCfg
from stripe_newton.sensors import Camera, PinholeCameraCfg, TiledCameraCfg

from .direct import CartpoleEnvCfg, CartpolePPORunnerCfg
from .direct_warp import CartpoleWarpEnv, compute_observations

__all__ = ["CartpoleCameraEnv", "CartpoleCameraEnvCfg", "CartpoleCameraPPORunnerCfg"]


@configclass
class CartpoleCameraEnvCfg(CartpoleEnvCfg):
    """Cart-pole by camera: a picture of 64 by 64 pixels, its colours less their mean over the picture.

    ``tiled_camera.width`` and ``tiled_camera.height`` set another size.
    """

    FIXED_SPACES: ClassVar[tuple[str, ...]] = ("action_space", "state_space")

    tiled_camera: TiledCameraCfg = TiledCameraCfg(
        prim_path="{ENV_REGEX_NS}/Camera",
        offset=TiledCameraCfg.OffsetCfg(pos=(-5.0, 0.0, 2.0), rot=(0.0, 0.0, 0.0, 1.0), convention="world"),
        data_types=("rgb",),
        spawn=PinholeCameraCfg(
            focal_length=24.0, focus_distance=400.0, horizontal_aperture=20.955, clipping_range=(0.1, 20.0)
        ),
        width=64,
        height=64,
    )
    """The camera, 5 m in front of the rail."""
    observation_space: list[int] = [3, 64, 64]  # type: ignore[assignment]  # a picture rather than numbers
    """Channels, height and width."""
    state_space: int = 4
    """Numbers of the critic: those of the cart-pole without a camera."""

    def __post_init__(self) -> None:
        self.observation_space = [3, self.tiled_camera.height, self.tiled_camera.width]


class CartpoleCameraEnv(CartpoleWarpEnv):
    """Balance a pole on a cart by its picture.

    Observation: colours from 0 to 1 less their mean over the picture, shape ``(num_envs, 3, height, width)``. The
    critic's: pole angle [rad], its rate, cart position [m], its rate.
    """

    cfg: CartpoleCameraEnvCfg

    def __init__(self, cfg: CartpoleCameraEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        # In Warp rather than in torch, which would pass over the pictures five times: they are most of a step.
        picture = Picture(self.camera.image("rgb"), normalize=True, channels_first=True)
        self._write_picture = image_writer(picture, self.warp.observations["policy"], 0)

    def _setup_scene(self) -> None:
        self.camera = Camera(self.cfg.tiled_camera)
        self.scene.sensors["camera"] = self.camera
        super()._setup_scene()

    def _launch_observations(self) -> None:
        self._write_picture()
        state = self.warp.observations["critic"]
        self._launch(compute_observations, self.robot.data.struct, self._cart, self._pole, state)


@configclass
class CartpoleCameraPPORunnerCfg(CartpolePPORunnerCfg):
    """PPO with convolutions for the cart-pole by camera."""

    num_steps_per_env: int = 64
    max_iterations: int = 500
    experiment_name: str = "cartpole_camera_direct"
    obs_groups: dict[str, list[str]] = {"actor": ["policy"], "critic": ["critic"]}
    actor: RslRlCNNModelCfg = RslRlCNNModelCfg(
        hidden_dims=(512,),
        cnn_cfg=RslRlCNNModelCfg.CNNCfg(output_channels=(32, 64, 64), kernel_size=(8, 4, 3), stride=(4, 2, 1)),
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(64, 64), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(
        entropy_coef=0.005,
        learning_rate=1.0e-4,
        max_learning_rate=2.0e-3,
        num_mini_batches=16,
        num_learning_epochs=4,
    )
