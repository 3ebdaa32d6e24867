# SPDX-License-Identifier: Apache-2.0
"""A four-legged ant runs forward: ``Stripe-Ant-Direct-v0``."""

from __future__ import annotations

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_tasks.locomotion import LocomotionEnv, LocomotionEnvCfg
from stripe_tasks.robots import ANT_CFG

__all__ = ["AntEnv", "AntEnvCfg", "AntPPORunnerCfg"]


@configclass
class AntEnvCfg(LocomotionEnvCfg):
    """36 observations, 8 joint torques."""

    observation_space: int = 36
    action_space: int = 8
    robot: ArticulationCfg = ANT_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    joint_gears: dict[str, float] = {".*": 15.0}
    action_scale: float = 0.5
    termination_height: float = 0.31


class AntEnv(LocomotionEnv):
    """See :class:`LocomotionEnv`."""

    cfg: AntEnvCfg


@configclass
class AntPPORunnerCfg(RslRlOnPolicyRunnerCfg):
    """PPO that makes the ant run."""

    num_steps_per_env: int = 32
    max_iterations: int = 300
    save_interval: int = 100
    experiment_name: str = "ant_direct"
    actor: RslRlMLPModelCfg = RslRlMLPModelCfg(
        hidden_dims=(400, 200, 100),
        obs_normalization=True,
        distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0),
    )
    critic: RslRlMLPModelCfg = RslRlMLPModelCfg(hidden_dims=(400, 200, 100), obs_normalization=True)
    algorithm: RslRlPpoAlgorithmCfg = RslRlPpoAlgorithmCfg(entropy_coef=0.0, learning_rate=5.0e-4)
