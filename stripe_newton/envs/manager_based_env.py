# SPDX-License-Identifier: Apache-2.0
"""Manager-based environment without rewards: actions, events and observations of a scene, for other than learning."""

from __future__ import annotations

from typing import ClassVar

import torch

from stripe_newton.configclass import configclass

from .manager_based_rl_env import ManagerBasedRLEnv
from .manager_based_rl_env_cfg import MAX_STEPS, ManagerBasedRLEnvCfg
from .rl_env import Extras, Observations

__all__ = ["ManagerBasedEnv", "ManagerBasedEnvCfg"]


@configclass
class ManagerBasedEnvCfg(ManagerBasedRLEnvCfg):
    """Config of an environment without rewards, terminations and an end of episodes."""

    rewards: object = None
    terminations: object = None
    episode_length_s: float = 1.0
    """Without effect: episodes have no end."""

    def complete(self) -> None:
        """Let an episode last for ever."""
        ManagerBasedRLEnvCfg.complete(self)
        self.episode_length_s = MAX_STEPS * self.decimation * self.sim.dt


class ManagerBasedEnv(ManagerBasedRLEnv):
    """Environment with actions, events and observations alone, whose episodes end by :meth:`reset`.

    A step is that of :class:`ManagerBasedRLEnv` without terms for rewards and terminations; worlds that become
    non-finite begin anew.
    """

    cfg: ManagerBasedEnvCfg
    needs_policy: ClassVar[bool] = False

    def step(self, action: torch.Tensor) -> tuple[Observations, Extras]:  # type: ignore[override]  # no learner takes it
        """Advance all environments by ``step_dt``.

        Args:
            action: Shape ``(num_envs, *action_shape)``.

        Returns:
            Observations by group, and extras. All are new tensors.

        Raises:
            ValueError: if the shape of the actions does not fit, or they are not finite and the config says to raise.
            RuntimeError: if contacts or constraints were dropped, naming the size to set.
        """
        observations, _, _, _, extras = super().step(action)
        return observations, extras
