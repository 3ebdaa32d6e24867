# SPDX-License-Identifier: Apache-2.0
"""Success manager: whether a condition holds after each step, for the success rate of an evaluation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
import warp as wp

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.fusion import Item
from stripe_newton.managers import CustomManager, CustomManagerCfg, ManagerContext

__all__ = ["SuccessEnv", "SuccessManager", "SuccessManagerCfg"]


class SuccessManager(CustomManager):
    """Records after the physics of each step, before anything is reset, whether a task is solved.

    Attributes:
        reached: Whether it was solved in the last step, int32, shape ``(num_envs,)``.
    """

    cfg: SuccessManagerCfg

    def __init__(self, name: str, cfg: CustomManagerCfg, context: ManagerContext):
        super().__init__(name, cfg, context)
        self.reached = self.array("reached", int)

    def physics_items(self) -> list[Item]:
        """Evaluate the condition."""
        return [self.call(self.cfg.func, reached=self.reached, **self.cfg.params)]


@configclass
class SuccessManagerCfg(CustomManagerCfg):
    """Config of the success manager."""

    class_type: type[CustomManager] = SuccessManager
    func: Callable[..., object] = MISSING
    """Warp function ``(env, reached: wp.array[int], ...)`` that writes 1 or 0."""
    params: dict[str, Any] = {}
    """Its other arguments."""


class SuccessEnv(ManagerBasedRLEnv):
    """Environment with a success manager, ``managers["success"]``."""

    @property
    def success(self) -> torch.Tensor:
        """Whether the task was solved in the last step, bool, shape ``(num_envs,)``."""
        manager = self.custom_managers["success"]
        assert isinstance(manager, SuccessManager)
        return wp.to_torch(manager.reached) != 0
