# SPDX-License-Identifier: Apache-2.0
"""The face that Stable-Baselines3 sees of an environment: NumPy in and out, one copy from the device a step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from gymnasium import spaces

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    raise ImportError("stripe_newton.rl.sb3 needs Stable-Baselines3: pip install stripe-newton[sb3]") from error

__all__ = ["Sb3VecEnvWrapper"]

UNBOUNDED = 100.0
"""Bound that takes the place of an infinite one of the actions, as Stable-Baselines3 wants finite ones."""


class Sb3VecEnvWrapper(VecEnv):
    """Wraps an environment (``DirectRLEnv``, ``ManagerBasedRLEnv``) as a ``VecEnv`` of Stable-Baselines3.

    The episode's end is told as ``VecEnv`` tells it: where an episode ends, the observation is the first of the next
    one, and the environment's info has

    - ``"terminal_observation"``: the last observation of the episode that ended,
    - ``"TimeLimit.truncated"``: whether the clock alone ended it; never in a task of finite horizon, whose end is real,
    - ``"episode"``: ``{"r": return, "l": steps}`` of the episode, as ``Monitor`` gives it. No ``VecMonitor`` is needed.

    The environments are one object: a method called with :meth:`env_method` is called once, and one seed seeds all.
    """

    def __init__(self, env: Any, obs_group: str | Sequence[str] = "policy", clip_actions: float | None = None):
        """Wrap ``env``.

        Args:
            env: The environment, made with ``compute_final_obs=True`` in its config.
            obs_group: Which observation group the policy sees. Of several names the observation is a dict by group,
                for ``MultiInputPolicy``.
            clip_actions: Bound of every action, ``[-clip_actions, clip_actions]``. Where neither it nor the environment
                bounds an action, the bound is 100. Algorithms that scale a policy's output to the bounds (SAC, TD3)
                need one that fits the task.

        Raises:
            ValueError: if the environment has several agents, keeps no final observations or has no such group.
        """
        inner = env.unwrapped
        if getattr(env, "single_action_space", None) is None:
            raise ValueError(
                f"{type(inner).__name__} is of several agents; wrap multi_agent_to_single_agent(env) instead"
            )
        if not getattr(inner.cfg, "compute_final_obs", False):
            raise ValueError(
                "cfg.compute_final_obs is False, must be True: Stable-Baselines3 values the last observation of an "
                "episode (set it in the config that the environment is made with)"
            )
        self.env = env
        self._device = inner.device
        self._finite_horizon = bool(getattr(inner.cfg, "is_finite_horizon", False))
        self._actions: np.ndarray | None = None
        self._reset_options: dict[str, Any] = {}
        observation = self._observation_space(env.single_observation_space, obs_group)
        action = _bounded(env.single_action_space, clip_actions)
        super().__init__(inner.num_envs, observation, action)
        self.metadata["render_fps"] = round(1.0 / inner.step_dt)
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, dtype=np.int64)

    def _observation_space(self, groups: spaces.Dict, obs_group: str | Sequence[str]) -> spaces.Space:
        names = [obs_group] if isinstance(obs_group, str) else list(obs_group)
        unknown = [name for name in names if name not in groups.spaces]
        if unknown or not names:
            raise ValueError(f"obs_group is {obs_group!r}, must be of the groups {', '.join(groups.spaces)}")
        nested = [name for name in names if isinstance(groups[name], spaces.Dict)]
        if isinstance(obs_group, str):
            space = groups[obs_group]
        elif nested:
            raise ValueError(f"obs_group: '{nested[0]}' is a dict itself, which can only be had alone: '{nested[0]}'")
        else:
            space = spaces.Dict({name: groups[name] for name in names})
        self._groups = set(names)
        self._single_group = obs_group if isinstance(obs_group, str) else None
        leaves = space.spaces if isinstance(space, spaces.Dict) else {"": space}
        self._dtypes = {key: torch.from_numpy(np.empty(0, leaf.dtype)).dtype for key, leaf in leaves.items()}
        return space

    @property
    def unwrapped(self) -> Any:
        """The environment itself, under all wrappers."""
        return self.env.unwrapped

    # -- episodes

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next :meth:`reset`. What an environment draws follows from this one seed and its number."""
        return super().seed(seed)

    def set_options(self, options: Any = None) -> None:
        """Options of the next :meth:`reset`, one dict for all environments: ``{"reset_mask": mask}``.

        Raises:
            ValueError: for a list.
        """
        if options is not None and not isinstance(options, dict):
            raise ValueError(
                f"options are a {type(options).__name__}, must be one dict: the environments are one object"
            )
        self._reset_options = dict(options or {})

    def reset(self) -> np.ndarray | dict[str, np.ndarray]:
        """Begin new episodes and return their first observations."""
        obs, _ = self.env.reset(seed=self._seeds[0], options=self._reset_options or None)
        begun = (
            torch.as_tensor(self._reset_options.get("reset_mask", [True] * self.num_envs)).cpu().numpy().astype(bool)
        )
        self._returns[begun] = 0.0
        self._lengths[begun] = 0
        self._reset_seeds()
        self.set_options()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return self._observation(_to_host(self._leaves("obs", obs)), "obs")

    def step_async(self, actions: np.ndarray) -> None:
        """Keep ``actions``, shape ``(num_envs, *action_shape)``, clipped to their bounds, for :meth:`step_wait`."""
        space = self.action_space
        self._actions = np.clip(actions, space.low, space.high) if isinstance(space, spaces.Box) else actions

    def step_wait(
        self,
    ) -> tuple[np.ndarray | dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Take the step: observations, rewards float32 ``(num_envs,)``, dones bool ``(num_envs,)``, and infos.

        All arrays are new. They come from the device in one copy.

        Raises:
            RuntimeError: if an episode ended and the environment did not say with which observation.
        """
        action = torch.as_tensor(self._actions, device=self._device)
        obs, reward, terminated, truncated, extras = self.env.step(action)
        tensors = {"reward": reward.float(), "terminated": terminated, "truncated": truncated}
        tensors |= self._leaves("obs", obs)
        final = extras.get("final_obs", {})
        if self._groups <= final.keys():
            tensors |= self._leaves("final", final)
        host = _to_host(tensors)
        rewards, failed, dones = host["reward"], host["terminated"], host["terminated"] | host["truncated"]
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        ended = np.flatnonzero(dones)
        if len(ended) and not self._groups <= final.keys():
            missing = ", ".join(f"'{name}'" for name in sorted(self._groups - final.keys()))
            raise RuntimeError(
                f"episodes ended, and extras['final_obs'] lacks {missing}, which Stable-Baselines3 values"
            )
        for i in ended.tolist():
            infos[i] = {
                "TimeLimit.truncated": not failed[i] and not self._finite_horizon,
                "terminal_observation": self._observation(host, "final", i),
                "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
            }
        self._returns[ended] = 0.0
        self._lengths[ended] = 0
        return self._observation(host, "obs"), rewards, dones, infos

    def _leaves(self, prefix: str, groups: dict[str, Any]) -> dict[str, torch.Tensor]:
        """The tensors that make up an observation, in the types of their spaces."""
        value = groups if self._single_group is None else groups[self._single_group]
        leaves = value if isinstance(value, dict) else {"": value}
        return {f"{prefix}.{key}": leaves[key].to(dtype) for key, dtype in self._dtypes.items()}

    def _observation(self, host: dict[str, np.ndarray], prefix: str, index: Any = ...) -> Any:
        found = {key: host[f"{prefix}.{key}"][index] for key in self._dtypes}
        return found if isinstance(self.observation_space, spaces.Dict) else found[""]

    # -- the environment's attributes and methods

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute for each index: the row, as an array, of a tensor that leads with the environment."""
        value = self._find(attr_name)
        ids = list(self._get_indices(indices))
        return list(value.detach().cpu().numpy()[ids]) if self._has_rows(value) else [value] * len(ids)

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute; of a tensor that leads with the environment, its rows ``indices``, in place.

        Raises:
            ValueError: if anything else is to be set for some of the environments only.
        """
        inner = self.env.unwrapped
        ids = list(self._get_indices(indices))
        now: Any = getattr(inner, attr_name, None)
        if self._has_rows(now):
            now[ids] = torch.as_tensor(value, dtype=now.dtype, device=now.device)
        elif set(ids) == set(range(self.num_envs)):
            setattr(inner, attr_name, value)
        else:
            raise ValueError(f"'{attr_name}' is shared by all environments, cannot be set for {ids} alone")

    def env_method(self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any) -> list[Any]:
        """Call a method of the environment, once; what it returns, for each index."""
        result = self._find(method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Whether a wrapper is around the environment; true of ``Monitor``, whose ``info["episode"]`` is given here."""
        env, found = self.env, wrapper_class is Monitor
        while not found and env is not self.env.unwrapped:
            found = isinstance(env, wrapper_class)
            env = env.env
        return [found] * len(list(self._get_indices(indices)))

    def _find(self, name: str) -> Any:
        """An attribute of the outermost wrapper that has it; gymnasium's hand on only some."""
        return getattr(self.env if hasattr(self.env, name) else self.env.unwrapped, name)

    def _has_rows(self, value: Any) -> bool:
        return isinstance(value, torch.Tensor) and value.ndim > 0 and len(value) == self.num_envs

    def get_images(self) -> list[np.ndarray | None]:
        """The picture of the scene, uint8 ``(height, width, 3)``, alone in a list."""
        return [self.env.render()]

    def close(self) -> None:
        """Close the environment."""
        self.env.close()


def _bounded(space: spaces.Space, clip: float | None) -> spaces.Space:
    """The action space with finite bounds."""
    if not isinstance(space, spaces.Box):
        if clip is not None:
            raise ValueError(f"clip_actions is {clip!r}, must be None: the actions are {space}, not a Box")
        return space
    if clip is not None and not 0.0 < clip < np.inf:
        raise ValueError(f"clip_actions is {clip!r}, must be a finite number above 0")
    low, high = space.low, space.high
    if clip is None:
        low, high = (np.where(np.isfinite(v), v, s * UNBOUNDED) for s, v in ((-1, low), (1, high)))
    else:
        low, high = np.maximum(low, -clip), np.minimum(high, clip)
    return spaces.Box(low.astype(space.dtype), high.astype(space.dtype), dtype=space.dtype)


def _to_host(tensors: dict[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """New arrays with the values of tensors, which are put side by side on the device and copied at once."""
    order = sorted(tensors, key=lambda name: -tensors[name].element_size())  # so that each lies aligned
    joined = torch.cat([tensors[name].contiguous().view(-1).view(torch.uint8) for name in order])
    host, found, start = joined.cpu().numpy(), {}, 0
    for name in order:
        value = tensors[name]
        end = start + value.numel() * value.element_size()
        kind = torch.empty(0, dtype=value.dtype).numpy().dtype
        found[name], start = host[start:end].view(kind).reshape(value.shape), end
    return found
