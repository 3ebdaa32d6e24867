# SPDX-License-Identifier: Apache-2.0
"""The face that rsl_rl sees of an environment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict

__all__ = ["RslRlVecEnvWrapper"]


class RslRlVecEnvWrapper(VecEnv):
    """Wraps a vector environment that speaks torch (``DirectRLEnv`` and its kin) for rsl_rl.

    rsl_rl keeps observations and ``extras["log"]`` by reference past the next step. The environment returns
    new tensors each step; this wrapper adds no buffer of its own and copies nothing.
    """

    def __init__(self, env: Any, clip_actions: float | None = None):
        """Wrap ``env``; actions are clipped to ``[-clip_actions, clip_actions]`` if that is given.

        Raises:
            ValueError: if the action space of one environment is not a flat box.
        """
        shape = getattr(env.unwrapped.single_action_space, "shape", None)
        if shape is None or len(shape) != 1:
            raise ValueError(f"single_action_space has shape {shape}; rsl_rl needs a flat Box, shape (num_actions,)")
        self.env = env
        self.clip_actions = clip_actions
        self.num_envs: int = env.unwrapped.num_envs
        self.num_actions: int = shape[0]
        self.device = env.unwrapped.device
        self.max_episode_length: int = env.unwrapped.max_episode_length
        self.step_hooks: list[Callable[[], None]] = []
        """Called after each step."""
        self._obs: TensorDict | None = None

    @property
    def unwrapped(self) -> Any:
        """The environment itself, under all wrappers."""
        return self.env.unwrapped

    @property
    def cfg(self) -> Any:
        """The environment's config."""
        return self.env.unwrapped.cfg

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps in the current episode, int64 (num_envs,). Assigning writes into the environment's own buffer."""
        return self.env.unwrapped.episode_length_buf

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        with torch.inference_mode():
            self.env.unwrapped.episode_length_buf = value

    def get_observations(self) -> TensorDict:
        """The observations of the last step or reset; the first call resets the environment."""
        return self.reset() if self._obs is None else self._obs

    @torch.inference_mode()
    def reset(self, seed: int | None = None) -> TensorDict:
        """Start a new episode in every environment and return its observations."""
        obs, _ = self.env.reset(seed=seed)
        self._obs = self._as_tensordict(obs)
        return self._obs

    @torch.inference_mode()
    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Take one step with ``actions`` (num_envs, num_actions).

        Returns:
            observations, rewards (num_envs,), dones int64 (num_envs,), and extras with ``"time_outs"`` (num_envs,):
            episodes that were cut off by the clock alone. A task with a finite horizon has none, since its end is real.
        """
        if self.clip_actions is not None:
            actions = actions.clamp(-self.clip_actions, self.clip_actions)
        obs, rewards, terminated, truncated, extras = self.env.step(actions)
        self._obs = self._as_tensordict(obs)
        extras = dict(extras)
        if not getattr(self.cfg, "is_finite_horizon", False):
            extras["time_outs"] = truncated & ~terminated
        for hook in list(self.step_hooks):
            hook()
        return self._obs, rewards, (terminated | truncated).long(), extras

    def hand_out(self, obs: dict[str, torch.Tensor]) -> TensorDict:
        """Take over the observations of a step that the environment took without :meth:`step`."""
        self._obs = self._as_tensordict(obs)
        return self._obs

    def render(self) -> Any:
        """A picture of the environment, uint8 (height, width, 3)."""
        return self.env.render()

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    @torch.inference_mode()
    def regenerate(self, seed: int) -> None:
        """Cut all episodes and go on in another scene; the last observations, which a loop holds, become the first."""
        self.unwrapped.regenerate(seed)
        if self._obs is not None:
            self._obs.update_(self._as_tensordict(self.unwrapped.obs_buf))

    def get_state(self) -> dict[str, Any] | None:
        """What the environment needs to go on, with its last observations; None if it keeps no state."""
        if self._obs is None or not hasattr(self.unwrapped, "get_state"):
            return None
        return {"env": self.unwrapped.get_state(), "obs": dict(self._obs.items())}

    @torch.inference_mode()
    def set_state(self, state: dict[str, Any]) -> None:
        """Put back what :meth:`get_state` returned.

        Raises:
            ValueError: if it is the state of another number of environments.
        """
        sizes = {len(value) for value in state["obs"].values()}
        if sizes != {self.num_envs}:
            raise ValueError(f"the state is of {sizes.pop()} environments, there are {self.num_envs} here")
        self.unwrapped.set_state(state["env"])
        self._obs = self._as_tensordict({name: value.to(self.device) for name, value in state["obs"].items()})

    def _as_tensordict(self, obs: dict[str, torch.Tensor]) -> TensorDict:
        return TensorDict(dict(obs), batch_size=[self.num_envs])
