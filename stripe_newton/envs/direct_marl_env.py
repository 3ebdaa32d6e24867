# SPDX-License-Identifier: Apache-2.0
"""Environments of several agents in the direct workflow: subclass, fill the hooks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
import warp as wp
from gymnasium import spaces

from stripe_newton.fusion import Captured, Eager, Item, Section, Stage

from .by_agent import (
    AgentNoise,
    ByAgent,
    check_observations,
    checked_actions,
    checked_state,
    ends_of_envs,
    of_all,
    tensors_by_agent,
)
from .direct_marl_env_cfg import DirectMARLEnvCfg
from .events import EventRunner
from .rl_env import RLEnv
from .spaces import to_space
from .substeps import Substeps

__all__ = ["DirectMARLEnv"]


class DirectMARLEnv(RLEnv):
    """Base class of environments in which several agents act at once, each with observations and rewards of its own.

    The interface is the ``parallel`` one of PettingZoo, for ``num_envs`` environments at once: what an agent gives and
    gets are tensors whose first dimension is ``num_envs``. A step runs in the order of :class:`DirectRLEnv`, with hooks
    in torch that take and return dicts by agent.

    An environment is reset, within the step, when all of its agents are done, terminated or timed out, in the same
    step. An agent that is done before the others says so in every step until then; all agents are always there.

    Attributes:
        agents: Names of the agents, as :attr:`possible_agents`.
        observation_spaces: Space of one environment's observations by agent.
        action_spaces: Space of one environment's actions by agent.
        state_space: Space of one environment's state; ``None`` where there is none.
        obs_dict: Observations of the last step by agent.
        reward_dict: Rewards of the last step by agent, float, shape ``(num_envs,)``.
        terminated_dict: Agents that failed or succeeded in it, bool, shape ``(num_envs,)``.
        time_out_dict: Agents whose time was up in it, bool, shape ``(num_envs,)``.
        reward_buf: Sum of the agents' rewards, shape ``(num_envs,)``.
        reset_terminated: Environments all of whose agents terminated, bool, shape ``(num_envs,)``.
        reset_time_outs: Environments that ended otherwise, bool, shape ``(num_envs,)``.
    """

    cfg: DirectMARLEnvCfg

    def __init__(self, cfg: DirectMARLEnvCfg, render_mode: str | None = None, **kwargs: Any):
        """Build scene and simulation; arguments and errors are those of :class:`RLEnv`."""
        super().__init__(cfg, render_mode, **kwargs)
        cfg, agents = self.cfg, list(self.cfg.possible_agents)
        self.agents, self.possible_agents = agents, list(agents)
        self.observation_spaces = {a: to_space(cfg.observation_spaces[a]) for a in agents}
        self.action_spaces = {a: to_space(cfg.action_spaces[a]) for a in agents}
        self.state_space: spaces.Space | None = None
        if cfg.state_space == -1:
            self.state_space = to_space(sum(spaces.flatdim(s) for s in self.observation_spaces.values()))
        elif cfg.state_space:
            self.state_space = to_space(cfg.state_space)
        self._observation_noise = AgentNoise(cfg.observation_noise_model, self.num_envs, self.device)
        self._action_noise = AgentNoise(cfg.action_noise_model, self.num_envs, self.device)
        self.obs_dict, self.reward_dict = ByAgent(), ByAgent()
        self.terminated_dict, self.time_out_dict = ByAgent(), ByAgent()
        self._state: torch.Tensor | None = None
        self._checked = False
        self._events = EventRunner(cfg.events, self) if cfg.events is not None else None
        self._substeps = Substeps(cfg.apply_action, cfg.decimation)
        if self._events is not None:
            self._events.startup()

    # -- PettingZoo

    @property
    def num_agents(self) -> int:
        """Number of agents."""
        return len(self.agents)

    max_num_agents = num_agents

    def observation_space(self, agent: str) -> spaces.Space:
        """Space of an agent's observations in one environment."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space:
        """Space of an agent's actions in one environment."""
        return self.action_spaces[agent]

    def state(self) -> torch.Tensor | None:
        """What there is to know about the environments, as of the last observations, shape ``(num_envs, n)``; ``None``
        where the config says no ``state_space``."""
        return self._state

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ByAgent, dict[str, Any]]:
        """See :meth:`RLEnv.reset`: observations by agent, and infos as of :meth:`step`."""
        _, infos = super().reset(seed=seed, options=options)
        return self.obs_dict, infos

    def step(  # type: ignore[override]  # by agent
        self, actions: Mapping[str, torch.Tensor]
    ) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, dict[str, Any]]:
        """Advance all environments by ``step_dt``; those all of whose agents are done are reset within the step.

        Args:
            actions: Of each agent, shape ``(num_envs, *action_shape)``.

        Returns:
            By agent: observations (of the new episode where one began), rewards float ``(num_envs,)``, terminated and
            truncated bool ``(num_envs,)``, and infos. Infos have a dict for each agent and, beside them, ``"log"``.
            All are new tensors.

        Raises:
            ValueError: if an agent is missing or unknown, the shape of its actions does not fit, or they are not finite
                and the config says to raise.
            RuntimeError: if contacts or constraints were dropped, naming the size to set.
        """
        infos = super().step(actions)[-1]  # type: ignore[arg-type]
        return self.obs_dict, self.reward_dict, self.terminated_dict, self.time_out_dict, infos

    # -- the step

    def _stages(self) -> list[Stage]:
        measured = self._measure("launch_measured")
        count = Section("count", ["if env == 0:", "    step[0] = step[0] + wp.int64(1)"], condition="stepping[0] != 0")
        steps, mode = self.cfg.decimation, self._substeps.mode
        physics = f"_apply_action ({mode}), {type(self.sim.solver).__name__}, {steps} physics steps"
        graph = self.device != "cpu" and self.cfg.sim.use_cuda_graph
        how = f"torch hook; the physics is {'one CUDA graph' if graph else 'kernel by kernel'}"
        outcome: list[Item] = [count, self._safety.after_physics()]
        hooks = {"_get_dones": self._dones, "_get_rewards": self._rewards_of}
        outcome += [Eager(name, function, "torch hook") for name, function in hooks.items()]
        reset: list[Item] = [Eager("_reset_idx, forward kinematics", self._reset_ended, "torch hook")]
        if self.cfg.compute_final_obs:
            reset.insert(0, Eager("final observations", self._final_observations, "torch copies"))
        events: list[Item] = []
        if self._events is not None and self._events.has_intervals:
            events.append(Eager("interval events", self._run_interval_events, "torch terms"))
        sensors = self._measure("launch_observed")
        if self.scene.needs_update:
            sensors.insert(0, Eager("assets", lambda: self.scene.update_assets(self.step_dt), "host update"))
        log = [Captured("log", self.context.log.finish)] if self.context.log.keys else []
        return [
            Stage("actions", [Eager("_pre_physics_step", lambda: self._pre_physics_step(self._action), "torch hook")]),
            Stage("physics", [Eager(physics, lambda: self._substeps.run(self), how)]),
            *([Stage("measurements", measured)] if measured else []),
            Stage("outcome", outcome),
            Stage("reset", [*reset, *self._measure("launch_reset")]),
            Stage("events", events),
            Stage("sensors", sensors),
            Stage("observations", [Eager("_get_observations", self._observe, "torch hook"), *log]),
        ]

    def _checked_action(self, action: Any) -> Any:
        refuse = self.cfg.nonfinite_actions == "raise" and self.device == "cpu"
        return checked_actions(action, self.action_spaces, self.num_envs, self.device, refuse)

    def _take_action(self, action: Any) -> None:
        self._steps_before = self.common_step_counter
        self._action: ByAgent = {}
        for agent, value in action.items():
            value = self._action_noise(agent, value)
            self._action[agent] = value = value.clone(memory_format=torch.contiguous_format)
            if value.is_floating_point():
                self._safety.make_finite(value)

    def _dones(self) -> None:
        self.common_step_counter = self._steps_before + 1
        broken = wp.to_torch(self._safety.nonfinite)
        terminated, time_outs = (of_all(self.agents, "_get_dones", v) for v in self._get_dones())
        self.terminated_dict = {a: v.bool() | broken for a, v in terminated.items()}
        self.time_out_dict = {a: v.bool().clone() for a, v in time_outs.items()}
        ended, failed, late = ends_of_envs(self.terminated_dict, self.time_out_dict)
        self.reset_buf[:], self.reset_terminated[:], self.reset_time_outs[:] = ended, failed, late
        wp.to_torch(self.context.moved)[:] = self.reset_buf

    def _rewards_of(self) -> None:
        broken = wp.to_torch(self._safety.nonfinite)
        rewards = of_all(self.agents, "_get_rewards", self._get_rewards())
        self.reward_dict = {a: torch.where(broken, 0.0, v.float()) for a, v in rewards.items()}
        self.reward_buf[:] = torch.stack([*self.reward_dict.values()]).sum(dim=0)

    def _reset_ended(self) -> None:
        ids = self.reset_buf.nonzero().squeeze(-1)
        if len(ids):
            self._reset_idx(ids)
            mask = torch.zeros_like(self.reset_buf)
            mask[ids] = True
            self.sim.forward(mask)

    def _final_observations(self) -> None:
        if not bool(self._stepping[0]) or not bool(self.reset_buf.any()):
            return
        for agent, value in self._observations().items():
            self.extras[agent] |= {"final_obs": value.clone(), "_final_obs": self.reset_buf.clone()}

    def _observations(self) -> ByAgent:
        groups = of_all(self.agents, "_get_observations", self._get_observations())
        if not self._checked:
            check_observations(groups, self.observation_spaces, self.num_envs)
            self._checked = True
        return {a: self._observation_noise(a, v) for a, v in groups.items()}

    def _observe(self) -> None:
        self.obs_dict = {a: v.clone() for a, v in self._observations().items()}
        if self.cfg.state_space == -1:
            self._state = torch.cat([v.flatten(1) for v in self.obs_dict.values()], dim=-1)
        elif self.state_space is not None:
            self._state = checked_state(self._get_states(), self.state_space, self.num_envs).clone()

    def _hand_out(self, values: dict[str, torch.Tensor]) -> ByAgent:
        return self.obs_dict

    def _begin_extras(self) -> None:
        super()._begin_extras()
        self.extras |= {agent: {} for agent in self.possible_agents}

    # -- continuing where it stopped

    def get_state(self) -> dict[str, Any]:
        """See :meth:`RLEnv.get_state`; tensors that the subclass keeps in dicts by agent are part of it too."""
        arrays = [*self._arrays().values(), self.sim.state.body_q, self.sim.state.body_qd]
        found = tensors_by_agent(vars(self), self.possible_agents, arrays)
        return super().get_state() | {"by_agent": {k: v.clone() for k, v in found}}

    def set_state(self, state: dict[str, Any]) -> None:
        """See :meth:`RLEnv.set_state`."""
        self._state = None  # handed out: not to be written into
        super().set_state(state)
        for (name, agent), value in state["by_agent"].items():  # new dicts: others may hold the old ones
            setattr(self, name, getattr(self, name, {}) | {agent: value.to(self.device).clone()})

    def _parts(self) -> list[dict[str, Any]]:
        noise = [*self._observation_noise.parts(), *self._action_noise.parts()]
        return [*noise, *(self._events.clocks() if self._events is not None else [])]

    # -- hooks

    def _setup_scene(self) -> None:
        """Create assets, spawn ground and lights, call ``self.scene.clone_environments``. The default adds nothing:
        the fields of the scene config are there already."""

    def _pre_physics_step(self, actions: ByAgent) -> None:
        """Process the actions once, before the physics.

        Args:
            actions: Of each agent, shape ``(num_envs, *action_shape)``; yours to keep.
        """
        raise NotImplementedError(f"{type(self).__name__} needs '_pre_physics_step(self, actions)'")

    def _apply_action(self) -> None:
        """Set targets or forces, before the physics steps; see ``DirectRLEnvCfg.apply_action``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_apply_action(self)'")

    def _get_observations(self) -> ByAgent:
        """Observations by agent, shapes ``(num_envs, *shape)``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_observations(self)' that returns a dict")

    def _get_states(self) -> torch.Tensor | None:
        """What :meth:`state` returns, shape ``(num_envs, n)``; called where ``state_space`` is a space."""
        return None

    def _get_rewards(self) -> ByAgent:
        """Rewards by agent, float, shape ``(num_envs,)``; ``self.terminated_dict`` is that of this step already."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_rewards(self)' that returns a dict")

    def _get_dones(self) -> tuple[ByAgent, ByAgent]:
        """Terminated and timed out by agent, bool, shape ``(num_envs,)`` each."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_dones(self)' that returns two dicts")

    def _reset_idx(self, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        """Begin new episodes; a subclass calls this first, then writes its initial states.

        Args:
            env_ids: Environments, int64, shape ``(n,)``; ``None`` means all.
        """
        ids = torch.as_tensor(range(self.num_envs) if env_ids is None else env_ids, device=self.device)
        self.scene.reset(ids)
        if self._events is not None:
            self._events.reset(ids)
        self._observation_noise.reset(ids)
        self._action_noise.reset(ids)
        self._episode_length_buf[ids] = 0

    def _run_interval_events(self) -> None:
        if self._events is not None and self._events.interval(self.step_dt):
            self.sim.forward()
