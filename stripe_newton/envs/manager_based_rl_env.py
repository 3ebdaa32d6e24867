# SPDX-License-Identifier: Apache-2.0
"""Manager-based RL environment: a lab scene with the interface of gymnasium."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from gymnasium import spaces

from .lab_scene import LabScene
from .manager_based_rl_env_cfg import ManagerBasedRLEnvCfg
from .rl_env import RLEnv

__all__ = ["ManagerBasedRLEnv"]


class ManagerBasedRLEnv(LabScene, RLEnv):
    """Environment whose config lists the terms of its managers: a :class:`LabScene` with the interface of gymnasium."""

    needs_policy: ClassVar[bool] = True

    def __init__(self, cfg: ManagerBasedRLEnvCfg, render_mode: str | None = None, **kwargs: object):
        """Build scene, simulation and managers.

        Args:
            cfg: The config; it is copied.
            render_mode: ``"rgb_array"`` for :meth:`render` to return pictures.
            kwargs: Not used; a subclass may have arguments of its own, and unknown ones are an error.

        Raises:
            ConfigError: all problems of the config at once.
            TypeError: for an unknown argument.
        """
        super().__init__(cfg, render_mode, **kwargs)  # type: ignore[arg-type]  # which are refused

    def _make_spaces(self) -> None:
        def box(*shape: int) -> spaces.Box:
            return spaces.Box(-np.inf, np.inf, shape, np.float32)

        groups, manager = {}, self.observation_manager
        for name, buffer in manager.buffers.items():
            if isinstance(buffer, dict):
                groups[name] = spaces.Dict({k: box(*manager.shape(name, k)) for k in buffer})
            else:
                groups[name] = box(*manager.shape(name))
        self._set_spaces(groups, box(self.action_manager.total_action_dim))
