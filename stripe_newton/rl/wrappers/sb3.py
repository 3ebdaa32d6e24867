# SPDX-License-Identifier: Apache-2.0
"""Sb3VecEnvWrapper: an environment as a VecEnv of Stable-Baselines3, with NumPy arrays and one copy a step."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import EllipsisType
from typing import Any, TypeAlias, TypedDict, TypeGuard

import gymnasium
import numpy as np
import torch
from gymnasium import spaces

from stripe_newton.rl.torch_vector_env import is_finite_horizon

try:
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import VecEnv
except ImportError as error:
    text = "stripe_newton.rl.wrappers.sb3 needs Stable-Baselines3: pip install stripe-newton[sb3]"
    raise ImportError(text) from error

__all__ = ["Sb3VecEnvWrapper"]

UNBOUNDED = 100.0
"""Bound that replaces an infinite one of the actions, as Stable-Baselines3 wants finite ones."""

Obs: TypeAlias = np.ndarray | dict[str, np.ndarray]
"""Observations: an array, or arrays by name for a dict space."""
TensorObs: TypeAlias = torch.Tensor | Mapping[str, torch.Tensor]
"""The same on the device."""
Indices: TypeAlias = int | Iterable[int] | None
"""Numbers of environments; None for all."""

Info = TypedDict(
    "Info",
    {
        "TimeLimit.truncated": bool,
        "terminal_observation": Obs,
        "episode": dict[str, float],
    },
    total=False,
)
"""Info of one environment after a step."""


class Sb3VecEnvWrapper(VecEnv):
    """Wraps an environment (``DirectRLEnv``, ``ManagerBasedRLEnv``) as a ``VecEnv`` of Stable-Baselines3.

    Ends of episodes are reported as ``VecEnv`` does: where an episode ends, the observation is the first of the next
    one, and the environment's info has

    - ``"terminal_observation"``: the last observation of the episode that ended,
    - ``"TimeLimit.truncated"``: whether the clock alone ended it; never in a task of finite horizon, whose end is real,
    - ``"episode"``: ``{"r": return, "l": steps}`` of the episode, as ``Monitor`` gives it. No ``VecMonitor`` is needed.

    The environments are one object: a method called with :meth:`env_method` is called once, and one seed seeds all.
    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv,
        obs_group: str | Sequence[str] = "policy",
        clip_actions: float | None = None,
    ):
        """Wrap an environment.

        Args:
            env: The environment, made with ``compute_final_obs=True`` in its config.
            obs_group: The observation group for the policy. With several names the observation is a dict by group,
                for ``MultiInputPolicy``.
            clip_actions: Bound of every action, ``[-clip_actions, clip_actions]``. Where neither it nor the environment
                bounds an action, the bound is 100. Algorithms that scale a policy's output to the bounds (SAC, TD3)
                need one that fits the task.

        Raises:
            ValueError: if the environment has several agents, keeps no final observations or has no such group.
        """
        inner = env.unwrapped
        if getattr(env, "single_action_space", None) is None:  # a space for each agent instead
            raise ValueError(
                f"{type(inner).__name__} has several agents; wrap multi_agent_to_single_agent(env) instead"
            )
        if not getattr(inner.cfg, "compute_final_obs", False):
            raise ValueError(
                "cfg.compute_final_obs is False, must be True: Stable-Baselines3 values the last observation of an "
                "episode (set it in the config that the environment is made with)"
            )
        self.env = env
        self._device = inner.device
        self._finite_horizon = is_finite_horizon(inner)
        self._actions: np.ndarray | None = None
        self._reset_options: dict = {}
        # A single name gives the group itself, a list a dict, also of one group.
        self._groups = [obs_group] if isinstance(obs_group, str) else list(obs_group)
        self._single_group = obs_group if isinstance(obs_group, str) else None
        observation = self._observation_space(env.single_observation_space)
        leaves = observation.spaces if isinstance(observation, spaces.Dict) else {"": observation}
        self._dtypes = {key: torch.from_numpy(np.empty(0, leaf.dtype)).dtype for key, leaf in leaves.items()}
        super().__init__(inner.num_envs, observation, _bounded(env.single_action_space, clip_actions))
        self.metadata["render_fps"] = round(1.0 / inner.step_dt)
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, dtype=np.int64)

    def _observation_space(self, groups: spaces.Dict) -> spaces.Space:
        """The space of the wanted groups."""
        unknown = [name for name in self._groups if name not in groups.spaces]
        if unknown or not self._groups:
            wanted = self._groups if self._single_group is None else self._single_group
            raise ValueError(f"obs_group is {wanted!r}, must be of the groups {', '.join(groups.spaces)}")
        if self._single_group is not None:
            return groups[self._single_group]
        nested = [name for name in self._groups if isinstance(groups[name], spaces.Dict)]
        if nested:
            raise ValueError(f"obs_group: '{nested[0]}' is a dict itself, which can only be had alone: '{nested[0]}'")
        return spaces.Dict({name: groups[name] for name in self._groups})

    @property
    def unwrapped(self) -> gymnasium.vector.VectorEnv:
        """The environment itself, under all wrappers."""
        return self.env.unwrapped

    # -- episodes

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed the next :meth:`reset`. What an environment draws follows from this one seed and its number."""
        return super().seed(seed)

    def set_options(self, options: list[dict] | dict | None = None) -> None:
        """Set options of the next :meth:`reset`, one dict for all environments: ``{"reset_mask": mask}``.

        Raises:
            ValueError: for a list.
        """
        if options is not None and not isinstance(options, dict):
            raise ValueError(
                f"options are a {type(options).__name__}, must be one dict: the environments are one object"
            )
        self._reset_options = dict(options or {})

    def reset(self) -> Obs:
        """Begin new episodes and return their first observations."""
        obs, _ = self.env.reset(seed=self._seeds[0], options=self._reset_options or None)
        mask = torch.as_tensor(self._reset_options.get("reset_mask", [True] * self.num_envs))
        begun = mask.cpu().numpy().astype(bool)
        self._returns[begun] = 0.0
        self._lengths[begun] = 0
        # As Stable-Baselines3 does: seeds and options are for one reset.
        self._reset_seeds()
        self.set_options()
        self.reset_infos: list[dict] = [{} for _ in range(self.num_envs)]
        return self._observation(_to_host(self._leaves("obs", obs)), "obs")

    def step_async(self, actions: np.ndarray) -> None:
        """Keep ``actions``, shape ``(num_envs, *action_shape)``, clipped to their bounds, for :meth:`step_wait`."""
        space = self.action_space
        self._actions = np.clip(actions, space.low, space.high) if isinstance(space, spaces.Box) else actions

    def step_wait(self) -> tuple[Obs, np.ndarray, np.ndarray, list[Info]]:
        """Take the step: observations, rewards float32 ``(num_envs,)``, dones bool ``(num_envs,)``, and infos.

        All arrays are new. They come from the device in one copy.

        Raises:
            RuntimeError: if an episode ended and its last observation is missing.
        """
        action = torch.as_tensor(self._actions, device=self._device)
        obs, reward, terminated, truncated, extras = self.env.step(action)
        tensors = {"reward": reward.float(), "terminated": terminated, "truncated": truncated}
        tensors |= self._leaves("obs", obs)
        # With the rest in one copy, though most environments have not ended: whether any has is known on the host only
        # after that copy.
        final = extras.get("final_obs", {})
        missing = sorted(set(self._groups) - final.keys())
        if not missing:
            tensors |= self._leaves("final", final)
        host = _to_host(tensors)
        rewards, failed, dones = host["reward"], host["terminated"], host["terminated"] | host["truncated"]
        self._returns += rewards
        self._lengths += 1
        # Stable-Baselines3 looks at each environment's info, so each gets a dict of its own.
        infos: list[Info] = [{"TimeLimit.truncated": False} for _ in range(self.num_envs)]
        ended = np.flatnonzero(dones)
        if len(ended) and missing:
            names = ", ".join(f"'{name}'" for name in missing)
            raise RuntimeError(f"episodes ended, and extras['final_obs'] lacks {names}, which Stable-Baselines3 values")
        for i in ended.tolist():
            infos[i] = {
                "TimeLimit.truncated": not failed[i] and not self._finite_horizon,
                "terminal_observation": self._observation(host, "final", i),
                "episode": {"r": float(self._returns[i]), "l": int(self._lengths[i])},
            }
        self._returns[ended] = 0.0
        self._lengths[ended] = 0
        return self._observation(host, "obs"), rewards, dones, infos

    def _leaves(self, prefix: str, groups: Mapping[str, TensorObs]) -> dict[str, torch.Tensor]:
        """The tensors of an observation, in the types of their spaces, by ``prefix.key``."""
        value = groups if self._single_group is None else groups[self._single_group]
        leaves: Mapping = {"": value} if isinstance(value, torch.Tensor) else value
        return {f"{prefix}.{key}": leaves[key].to(dtype) for key, dtype in self._dtypes.items()}

    def _observation(self, host: Mapping[str, np.ndarray], prefix: str, index: int | EllipsisType = ...) -> Obs:
        """The arrays of :meth:`_leaves` as an observation, of all environments or of one."""
        found = {key: host[f"{prefix}.{key}"][index] for key in self._dtypes}
        return found if isinstance(self.observation_space, spaces.Dict) else found[""]

    # -- the environment's attributes and methods, of any type

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """An attribute for each index: the row, as an array, of a tensor that leads with the environment."""
        value = self._find(attr_name)
        ids = list(self._get_indices(indices))
        return list(value.detach().cpu().numpy()[ids]) if self._has_rows(value) else [value] * len(ids)

    def set_attr(self, attr_name: str, value: object, indices: Indices = None) -> None:
        """Set an attribute; of a tensor that leads with the environment, its rows ``indices``, in place.

        Raises:
            ValueError: if another attribute is to be set for some of the environments only.
        """
        inner = self.env.unwrapped
        ids = list(self._get_indices(indices))
        # In place, so that the simulation, whose memory it may be, sees the values.
        now = getattr(inner, attr_name, None)
        if self._has_rows(now):
            now[ids] = torch.as_tensor(value, dtype=now.dtype, device=now.device)
        elif set(ids) == set(range(self.num_envs)):
            setattr(inner, attr_name, value)
        else:
            raise ValueError(f"'{attr_name}' is shared by all environments, cannot be set for {ids} alone")

    def env_method(
        self, method_name: str, *method_args: object, indices: Indices = None, **method_kwargs: object
    ) -> list[Any]:
        """Call a method of the environment, once; its result for each index."""
        result = self._find(method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """Whether a wrapper is around the environment; true of ``Monitor``, whose ``info["episode"]`` is given here."""
        env, found = self.env, wrapper_class is Monitor
        while not found and env is not self.env.unwrapped:
            found = isinstance(env, wrapper_class)
            env = env.env
        return [found] * len(list(self._get_indices(indices)))

    def _find(self, name: str) -> Any:
        """An attribute of the outermost wrapper that has it; gymnasium's wrappers pass on only some."""
        return getattr(self.env if hasattr(self.env, name) else self.env.unwrapped, name)

    def _has_rows(self, value: object) -> TypeGuard[torch.Tensor]:
        """Whether a value is a tensor with a row for each environment."""
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


def _to_host(tensors: Mapping[str, torch.Tensor]) -> dict[str, np.ndarray]:
    """New arrays with the values of tensors, which are joined on the device and copied at once.

    Each copy to the host waits for the device, so one copy is one wait.
    """
    order = sorted(tensors, key=lambda name: -tensors[name].element_size())  # so that each is aligned
    joined = torch.cat([tensors[name].contiguous().view(-1).view(torch.uint8) for name in order])
    host, found, start = joined.cpu().numpy(), {}, 0
    for name in order:
        value = tensors[name]
        end = start + value.numel() * value.element_size()
        kind = torch.empty(0, dtype=value.dtype).numpy().dtype
        found[name], start = host[start:end].view(kind).reshape(value.shape), end
    return found
