# SPDX-License-Identifier: Apache-2.0
"""RslRlVecEnvWrapper: an environment with the interface of rsl_rl's VecEnv."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from stripe_newton.configclass import Config
from stripe_newton.rl.torch_vector_env import (
    EnvState,
    Extras,
    Observations,
    TorchVectorEnv,
    is_finite_horizon,
    is_resumable,
    rl_env_of,
)
from stripe_newton.value_types import PositiveFloat, mismatches, short

__all__ = ["RslRlVecEnvWrapper"]


class RslRlVecEnvWrapper(VecEnv):
    """Wraps a vector environment of torch tensors, such as :class:`DirectRLEnv`, for rsl_rl.

    rsl_rl keeps observations and ``extras["log"]`` by reference beyond the next step. The environment returns new
    tensors in each step, so this wrapper adds no buffer of its own and copies nothing.
    """

    def __init__(self, env: TorchVectorEnv, clip_actions: float | None = None):
        """Wrap an environment.

        Args:
            env: The environment, or a gymnasium wrapper around it.
            clip_actions: Actions are clipped to ``[-clip_actions, clip_actions]``; ``None`` for no clipping.

        Raises:
            TypeError: if it is no vector environment.
            ValueError: if the action space of one environment is not a flat box, or a bound of actions is not above 0.
        """
        if not hasattr(env, "unwrapped") or not hasattr(env.unwrapped, "single_action_space"):
            raise TypeError(f"env: is {short(env)}, must be a vector environment, such as gymnasium.make_vec returns")
        if clip_actions is not None and (problem := next(mismatches(clip_actions, PositiveFloat), "")):
            raise ValueError(f"clip_actions: {problem}")
        space = env.unwrapped.single_action_space
        shape = None if space is None else space.shape
        if shape is None or len(shape) != 1:
            raise ValueError(f"single_action_space has shape {shape}; rsl_rl needs a flat Box, shape (num_actions,)")
        self.env = env
        # torch takes no int beyond 64 bits for a bound
        self.clip_actions = None if clip_actions is None else float(clip_actions)
        self.num_envs: int = env.unwrapped.num_envs
        self.num_actions: int = shape[0]
        self.device = env.unwrapped.device
        self.max_episode_length: int = env.unwrapped.max_episode_length
        self.step_hooks: list[Callable[[], None]] = []
        """Functions that are called after each step."""
        self._obs: TensorDict | None = None

    @property
    def unwrapped(self) -> TorchVectorEnv:
        """The environment itself, under all wrappers."""
        return self.env.unwrapped

    @property
    def cfg(self) -> Config:
        """The environment's config."""
        return self.env.unwrapped.cfg

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps in the current episode, int64 ``(num_envs,)``. Assigning writes into the environment's own buffer."""
        return self.env.unwrapped.episode_length_buf

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        # rsl_rl assigns this attribute. The environment copies into its buffer, which recorded graphs read.
        with torch.inference_mode():
            self.env.unwrapped.episode_length_buf = value

    def get_observations(self) -> TensorDict:
        """The observations of the last step or reset. The first call resets the environment."""
        return self.reset() if self._obs is None else self._obs

    @torch.inference_mode()
    def reset(self, seed: int | None = None) -> TensorDict:
        """Begin a new episode in every environment and return its observations."""
        obs, _ = self.env.reset(seed=seed)
        return self.set_observations(obs)

    @torch.inference_mode()
    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, Extras]:
        """Take one step.

        Args:
            actions: ``(num_envs, num_actions)``.

        Returns:
            Observations, rewards ``(num_envs,)``, dones int64 ``(num_envs,)``, and extras. ``extras["time_outs"]``,
            ``(num_envs,)``, are the episodes that the clock alone cut off. A task with a finite horizon has none, since
            its end is real.
        """
        if self.clip_actions is not None:
            actions = actions.clamp(-self.clip_actions, self.clip_actions)
        obs, rewards, terminated, truncated, extras = self.env.step(actions)
        found = self.set_observations(obs)
        # A new dict: the environment keeps its own extras, to which rsl_rl's key does not belong.
        extras = dict(extras)
        if not is_finite_horizon(self.env.unwrapped):
            extras["time_outs"] = truncated & ~terminated
        for hook in list(self.step_hooks):
            hook()
        return found, rewards, (terminated | truncated).long(), extras

    def set_observations(self, obs: Observations) -> TensorDict:
        """Take ``obs`` for the last observations, where the environment was stepped without :meth:`step`."""
        self._obs = TensorDict(_channels_first(obs), batch_size=[self.num_envs])
        return self._obs

    def render(self) -> np.ndarray | None:
        """A picture of the environment, uint8 ``(height, width, 3)``."""
        return self.env.render()

    def close(self) -> None:
        """Close the environment."""
        self.env.close()

    @torch.inference_mode()
    def regenerate(self, seed: int) -> None:
        """End all episodes and go on in the scene of another seed.

        Raises:
            ValueError: if the environment has no scene that can be generated anew.
        """
        env = rl_env_of(self.unwrapped)
        if env is None:
            raise ValueError(f"{type(self.unwrapped).__name__} is not an environment of this package")
        env.regenerate(seed)
        if self._obs is not None:
            # In place: rsl_rl's loop holds the last observations and would act on those of the old scene.
            self._obs.update_(TensorDict(_channels_first(env.obs_buf), batch_size=[self.num_envs]))

    def get_state(self) -> EnvState | None:
        """The environment's state and its last observations; None if the environment keeps no state."""
        env = self.unwrapped
        if self._obs is None or not is_resumable(env):
            return None
        state = env.get_state()
        return {"env": state, "obs": {name: _same_of(value, state) for name, value in self._obs.items()}}

    @torch.inference_mode()
    def set_state(self, state: EnvState) -> None:
        """Put back what :meth:`get_state` returned.

        Raises:
            ValueError: if the state is that of another number of environments, or the environment cannot take one.
        """
        env = self.unwrapped
        if not is_resumable(env):
            raise ValueError(f"{type(env).__name__} keeps no state")
        sizes = {len(value) for value in state["obs"].values()}
        if sizes != {self.num_envs}:
            count = sizes.pop()
            here = f"there are {self.num_envs} here: scene.num_envs must be {count}"
            raise ValueError(f"the state is of {count} environments, {here}")
        env.set_state(state["env"])
        self.set_observations({name: value.to(self.device) for name, value in state["obs"].items()})


def _same_of(value: torch.Tensor, state: EnvState) -> torch.Tensor:
    """The tensor of a state that has the same bits, or ``value`` if none has: a checkpoint contains a tensor once.

    The last observations are usually still in the environment's own buffer.
    """
    groups = [group for group in state.values() if isinstance(group, dict)]
    for other in (item for group in groups for item in group.values()):
        if not isinstance(other, torch.Tensor) or (other.shape, other.dtype) != (value.shape, value.dtype):
            continue
        # By bytes: NaN is the same as NaN, and 0.0 is not the same as -0.0.
        if other.device == value.device and torch.equal(_bytes(other), _bytes(value)):
            return other
    return value


def _bytes(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.detach().contiguous().view(torch.uint8)


def _channels_first(obs: Observations) -> dict[str, torch.Tensor]:
    """Observations in which images (height, width, channels), as cameras give them, are (channels, height, width).

    rsl_rl's encoders expect these. They are views. A last axis of up to four behind a longer one is that of channels.
    """
    return {
        name: value.permute(0, 3, 1, 2) if value.dim() == 4 and value.shape[3] <= 4 < value.shape[1] else value
        for name, value in obs.items()
    }
