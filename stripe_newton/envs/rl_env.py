# SPDX-License-Identifier: Apache-2.0
"""RL environment: the base class of all environments, a stepped scene with the interface of gymnasium."""

from __future__ import annotations

from typing import ClassVar

import torch
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from .built_scene import RENDER_MODES, Extras, Observations
from .stepped_scene import ResetOptions, SteppedScene

__all__ = ["Extras", "Observations", "RLEnv", "ResetOptions"]


class RLEnv(SteppedScene, VectorEnv):
    """Base class of environments: a scene with a step, as a :class:`gymnasium.vector.VectorEnv` of torch tensors.

    :class:`DirectRLEnv` and :class:`ManagerBasedRLEnv` define the stages of the step. It resets environments within the
    step (``SAME_STEP``).
    """

    metadata: ClassVar[dict[str, object]] = {
        "render_modes": list(RENDER_MODES),
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def _set_spaces(self, observations: dict[str, spaces.Space], action: spaces.Space) -> None:
        self.single_observation_space = spaces.Dict(observations)
        self.single_action_space = action
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(action, self.num_envs)

    @property
    def _action_shape(self) -> tuple[int, ...] | None:
        shape = self.action_space.shape
        return None if shape is None else tuple(shape)

    def _checked_action(self, action: object) -> torch.Tensor:
        if isinstance(self.single_action_space, spaces.Discrete):
            given = torch.as_tensor(action, device=self.device)
            if tuple(given.shape) == (self.num_envs, 1):
                return given  # a column of choices, as learners of Isaac Lab give them
        return super()._checked_action(action)
