# SPDX-License-Identifier: Apache-2.0
"""Hook methods: the methods that a direct environment's class fills, with torch or with Warp kernels.

========================== ============================ ==========================================================
torch                      Warp                         what it does
========================== ============================ ==========================================================
``_pre_physics_step``      ``_launch_pre_physics_step`` processes the actions, once in a step
``_apply_action``          ``_launch_apply_action``     sets targets or forces, before the physics steps
``_get_dones``             ``_launch_dones``            says which episodes end
``_get_rewards``           ``_launch_rewards``          computes the rewards
``_reset_idx``             ``_launch_reset``            begins episodes
``_get_observations``      ``_launch_observations``     computes the observations
========================== ============================ ==========================================================
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp

from stripe_newton.noise import NoiseModel

from .recording_env import RecordingEnv
from .rl_env import Observations

__all__ = ["HookMethods"]


class HookMethods(RecordingEnv):
    """The hooks of a direct environment, in the order in which a step calls them, and what they do by default."""

    _action_noise_model: NoiseModel | None
    _observation_noise_model: NoiseModel | None

    # -- torch hooks

    def _setup_scene(self) -> None:
        """Create assets, spawn ground and lights, call ``self.scene.clone_environments``. The default adds nothing:
        the fields of the scene config are there already."""

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        """Process the actions once, before the physics.

        Args:
            actions: Shape ``(num_envs, *action_shape)``.
        """
        raise NotImplementedError(f"{type(self).__name__} needs '_pre_physics_step(self, actions)'")

    def _apply_action(self) -> None:
        """Set targets or forces, before the physics steps; see ``DirectRLEnvCfg.apply_action``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_apply_action(self)'")

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Terminated and timed out, bool, shape ``(num_envs,)`` each."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_dones(self)'")

    def _get_rewards(self) -> torch.Tensor:
        """Rewards, float, shape ``(num_envs,)``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_rewards(self)'")

    def _reset_idx(self, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        """Begin new episodes; a subclass calls this first, then writes its initial states.

        Args:
            env_ids: Environments, int64, shape ``(n,)``; ``None`` means all.
        """
        ids = self._env_indices(env_ids)
        self.scene.reset(ids)
        self._reset_events(ids)
        for model in self._noise_models():
            model.reset(ids)
        self._episode_length_buf[ids] = 0

    def _reset_events(self, env_ids: torch.Tensor) -> None:
        """Runs at every reset, before the subclass writes its initial states; the default runs ``cfg.events``."""
        if self._events is not None:
            self._events.reset(env_ids)

    def _interval_events(self, dt: float) -> None:
        """Runs in every step after the resets; the default runs the interval terms of ``cfg.events`` that are due.

        A subclass that overrides it and writes positions calls ``self.sim.forward()`` after.
        """
        if self._events is not None and self._events.interval(dt):
            self.sim.forward()

    def _get_observations(self) -> Observations:
        """Observations by group; ``"policy"`` is needed. Shapes ``(num_envs, *shape)``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_observations(self)' that returns a dict")

    def _get_states(self) -> torch.Tensor | None:
        """Observations of the critic, shape ``(num_envs, n)``; called where ``state_space`` is set."""
        return None

    # -- Warp hooks: they launch kernels on the arrays of ``self.warp`` and do nothing else

    def _launch_pre_physics_step(self, actions: wp.array) -> None:
        """Process the actions once, before the physics.

        Args:
            actions: float, shape ``(num_envs, num_actions)``; finite.
        """
        raise NotImplementedError

    def _launch_apply_action(self) -> None:
        """Set targets or forces: before each physics step, or once with ``apply_action="step"``."""
        raise NotImplementedError

    def _launch_dones(self) -> None:
        """Write ``warp.terminated`` and ``warp.truncated``."""
        raise NotImplementedError

    def _launch_rewards(self) -> None:
        """Write ``warp.reward``."""
        raise NotImplementedError

    def _launch_reset(self, env_mask: wp.array) -> None:
        """Write the initial states of the environments whose episode begins; targets are their defaults already.

        Bodies follow and the solver's memory is cleared afterwards.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """
        raise NotImplementedError

    def _launch_observations(self) -> None:
        """Write ``warp.observations``."""
        raise NotImplementedError

    # -- noise, which resets concern, too

    def _noise_models(self) -> list[NoiseModel]:
        return [m for m in (self._action_noise_model, self._observation_noise_model) if m is not None]
