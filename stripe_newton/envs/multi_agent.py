# SPDX-License-Identifier: Apache-2.0
"""Views of environments of several agents: as one agent, or as one environment of PettingZoo."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from stripe_newton.call_checks import to_tensor

from .by_agent import ByAgent
from .direct_marl_env import DirectMARLEnv
from .rl_env import Extras, ResetOptions

__all__ = ["ParallelEnvView", "SingleAgentView", "multi_agent_to_single_agent"]


def multi_agent_to_single_agent(env: DirectMARLEnv, state_as_observation: bool = False) -> SingleAgentView:
    """View an environment of several agents as one of a single agent, whose reward is the sum of their rewards.

    Args:
        env: The environment; it is not copied.
        state_as_observation: The group ``"policy"`` is ``env.state()`` rather than the joined observations.

    Raises:
        ValueError: if a space is not a flat box, or there is no state to observe.
    """
    return SingleAgentView(env, state_as_observation)


class SingleAgentView(VectorEnv):
    """A :class:`DirectMARLEnv` with the interface of :class:`DirectRLEnv`, made by :func:`multi_agent_to_single_agent`.

    Observations and actions of the agents are joined in the order of ``possible_agents``. The state, if the environment
    has one, is the group ``"critic"``. An episode terminates when all agents terminate. All other attributes are those
    of the environment.
    """

    def __init__(self, env: DirectMARLEnv, state_as_observation: bool = False):
        self.env, self._state_as_observation = env, state_as_observation
        if state_as_observation and env.state_space is None:
            raise ValueError(f"state_as_observation: {type(env).__name__} has none; set 'state_space' in its config")
        for what, by_agent in (("observation", env.observation_spaces), ("action", env.action_spaces)):
            for agent, space in by_agent.items():
                if not isinstance(space, spaces.Box) or len(space.shape) != 1:
                    raise ValueError(f"{what} space of '{agent}' is {space}: only flat boxes can be joined")
        self.num_envs, self.metadata, self.render_mode = env.num_envs, env.metadata, env.render_mode
        groups = {"policy": env.state_space if state_as_observation else _joined(env.observation_spaces)}
        if env.state_space is not None:
            groups["critic"] = env.state_space
        self.single_observation_space = spaces.Dict(groups)
        self.single_action_space = _joined(env.action_spaces)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._sizes = [space.shape[0] for space in env.action_spaces.values()]

    def __getattr__(self, name: str) -> Any:
        if name == "env":  # the constructor has not set it yet, or copy and pickle ask: no endless recursion
            raise AttributeError(name)
        return getattr(self.env, name)

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps since the last reset, int64, shape ``(num_envs,)``; assigning copies into the same memory."""
        return self.env.episode_length_buf

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        self.env.episode_length_buf = value

    def reset(self, *, seed: int | None = None, options: ResetOptions | None = None) -> tuple[ByAgent, Extras]:
        """See :meth:`DirectMARLEnv.reset`; observations by group."""
        _, infos = self.env.reset(seed=seed, options=options)
        return self._observations(self.env.obs_dict), self._extras(infos)

    def step(self, action: torch.Tensor) -> tuple[ByAgent, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
        """See :meth:`RLEnv.step`."""
        action = to_tensor("action", action, f"a tensor of shape {self.action_space.shape}", self.env.device)
        if tuple(action.shape) != tuple(self.action_space.shape):
            raise ValueError(f"actions have shape {tuple(action.shape)}, expected {tuple(self.action_space.shape)}")
        parts = action.split(self._sizes, dim=-1)
        obs, rewards, _, _, infos = self.env.step(dict(zip(self.env.possible_agents, parts, strict=True)))
        total = torch.stack([*rewards.values()]).sum(dim=0)
        ends = self.env.reset_terminated.clone(), self.env.reset_time_outs.clone()
        return self._observations(obs), total, *ends, self._extras(infos)

    def _observations(self, obs: ByAgent) -> ByAgent:
        groups, state = {"policy": torch.cat([*obs.values()], dim=-1)}, self.env.state()
        if state is not None:
            groups |= {"critic": state} | ({"policy": state} if self._state_as_observation else {})
        return groups

    def _extras(self, infos: Extras) -> Extras:
        """Infos without the entries by agent, and with the final observations joined."""
        by_agent = [infos[agent] for agent in self.env.possible_agents]
        extras = {k: v for k, v in infos.items() if k not in self.env.possible_agents}
        if "final_obs" in by_agent[0] and not self._state_as_observation:
            extras["final_obs"] = {"policy": torch.cat([info["final_obs"] for info in by_agent], dim=-1)}
            extras["_final_obs"] = by_agent[0]["_final_obs"]
        return extras

    def render(self) -> np.ndarray | None:
        """See :meth:`RLEnv.render`."""
        return self.env.render()

    def close(self, **kwargs: object) -> None:
        """Close the environment."""
        self.env.close(**kwargs)


def _joined(by_agent: Mapping[str, spaces.Space]) -> spaces.Box:
    low, high = (np.concatenate([getattr(s, side) for s in by_agent.values()]) for side in ("low", "high"))
    return spaces.Box(low, high, dtype=np.float32)


class ParallelEnvView:
    """A :class:`DirectMARLEnv` of one environment with the interface of PettingZoo's ``ParallelEnv``, in NumPy.

    An agent leaves :attr:`agents` when it is done. An episode is over when none is left; :meth:`reset` begins the next
    one. PettingZoo need not be installed.

    Attributes:
        env: The environment.
        agents: Agents that still act.
        possible_agents: All agents.
    """

    def __init__(self, env: DirectMARLEnv):
        """View ``env``.

        Raises:
            ValueError: if it has more than one environment.
        """
        if env.num_envs != 1:
            raise ValueError(f"there are {env.num_envs} environments, PettingZoo knows one: set scene.num_envs = 1")
        self.env, self.metadata = env, {**env.metadata, "name": type(env).__name__}
        self.possible_agents = list(env.possible_agents)
        self.agents: list[str] = []
        self.observation_spaces, self.action_spaces = env.observation_spaces, env.action_spaces
        self.render_mode = env.render_mode

    @property
    def unwrapped(self) -> ParallelEnvView:
        """This view."""
        return self

    @property
    def num_agents(self) -> int:
        """Number of agents that still act."""
        return len(self.agents)

    @property
    def max_num_agents(self) -> int:
        """Number of all agents."""
        return len(self.possible_agents)

    def observation_space(self, agent: str) -> spaces.Space:
        """Space of an agent's observations."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Space of an agent's actions."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: ResetOptions | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Extras]]:
        """Begin an episode; observations and infos by agent."""
        obs, infos = self.env.reset(seed=seed)
        self.agents = list(self.possible_agents)
        return {a: _numpy(obs[a]) for a in self.agents}, {a: infos[a] for a in self.agents}

    def step(self, actions: Mapping[str, object]) -> tuple[dict[str, object], ...]:
        """Advance the environment.

        Args:
            actions: Of the agents that still act; the others do nothing, which is zero.

        Returns:
            Observations, rewards, terminated, truncated and infos of the agents that acted, by agent. The last
            observation of an episode is the first one of the next, unless the config has ``compute_final_obs``.
        """
        device, acted = self.env.device, self.agents
        given = {}
        for agent, space in self.action_spaces.items():
            value = actions[agent] if agent in acted else np.zeros(space.shape or (), space.dtype)
            given[agent] = torch.as_tensor(np.asarray(value), device=device).unsqueeze(0)
        obs, rewards, terminated, truncated, infos = self.env.step(given)
        failed, late = ({a: bool(values[a]) for a in acted} for values in (terminated, truncated))
        last = {a: infos[a].get("final_obs", obs[a]) for a in acted}
        self.agents = [a for a in acted if not (failed[a] or late[a])]
        return (
            {a: _numpy(last[a]) for a in acted},
            {a: float(rewards[a]) for a in acted},
            dict(failed),
            dict(late),
            {a: infos[a] for a in acted},
        )

    def state(self) -> np.ndarray:
        """Global state of the environment.

        Raises:
            NotImplementedError: if the config says no ``state_space``.
        """
        state = self.env.state()
        if state is None:
            raise NotImplementedError(f"{type(self.env).__name__} has no state; set 'state_space' in its config")
        return _numpy(state)

    def render(self) -> np.ndarray | None:
        """See :meth:`RLEnv.render`."""
        return self.env.render()

    def close(self) -> None:
        """Close the environment."""
        self.env.close()


def _numpy(value: torch.Tensor) -> np.ndarray:
    return value[0].cpu().numpy()
