# SPDX-License-Identifier: Apache-2.0
"""Direct MARL environment: several agents in the direct workflow, with hooks in torch."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import torch
from gymnasium import spaces

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import HostFunction, Item, Stage
from stripe_newton.noise import NoiseModelCfg

from .by_agent import (
    AgentNoise,
    ByAgent,
    check_observations,
    checked_actions,
    checked_state,
    ends_of_envs,
    of_all,
    tensors_by_agent,
    zero_actions,
)
from .direct_env_base import DirectEnvBase
from .env_state import EnvState, state_arrays
from .rl_env import Extras, ResetOptions
from .rl_env_cfg import RLEnvCfg
from .spaces import SpaceSpec, to_space
from .stage_items import count_section, sensor_items

__all__ = ["DirectMARLEnv", "DirectMARLEnvCfg"]


@configclass
class DirectMARLEnvCfg(RLEnvCfg):
    """Base config of direct environments of several agents; subclass it and add fields of your own."""

    possible_agents: list[str] = MISSING
    """Names of the agents, in the order in which they are joined."""
    observation_spaces: Mapping[str, SpaceSpec] = MISSING
    """Space of the observations by agent, as :func:`to_space` reads it."""
    action_spaces: Mapping[str, SpaceSpec] = MISSING
    """Space of the actions by agent."""
    state_space: SpaceSpec = 0
    """Space of what ``state()`` returns, which ``_get_states`` fills; -1 for the observations of all agents joined, 0
    for none."""
    observation_noise_model: dict[str, NoiseModelCfg | None] | None = None
    """Noise on the observations by agent; agents that are not named have none."""
    action_noise_model: dict[str, NoiseModelCfg | None] | None = None
    """Noise on the actions by agent; agents that are not named have none."""
    apply_action: str = "auto"
    """Rate of ``_apply_action``: ``"auto"``, ``"step"`` or ``"substep"``, as in :class:`DirectRLEnvCfg`."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from RLEnvCfg.problems(self)
        if self.apply_action not in ("auto", "step", "substep"):
            yield "apply_action", f"is '{self.apply_action}', must be 'auto', 'step' or 'substep'"
        if self.state_space not in (0, None, -1):
            yield from _space_problems("state_space", self.state_space)
        agents = self.possible_agents
        if agents is MISSING:
            return
        if not agents or len(set(agents)) < len(agents) or "log" in agents:
            yield "possible_agents", f"is {agents!r}, must be names that differ, one or more, and not 'log'"
        for name in ("observation_spaces", "action_spaces"):
            spaces = getattr(self, name)
            if spaces is MISSING:
                continue
            if set(spaces) != set(agents):
                yield name, f"is for {_names(spaces)}, must be for possible_agents: {_names(agents)}"
            for agent, space in spaces.items():
                yield from _space_problems(f"{name}[{agent!r}]", space)
        for name in ("observation_noise_model", "action_noise_model"):
            unknown = [a for a in getattr(self, name) or () if a not in agents]
            if unknown:
                yield name, f"names {_names(unknown)}, must be among possible_agents: {_names(agents)}"


def _names(agents: Iterable[str]) -> str:
    return ", ".join(map(repr, agents)) or "no agent"


def _space_problems(path: str, space: SpaceSpec) -> Iterator[tuple[str, str]]:
    try:
        to_space(space)
    except ValueError as error:
        yield path, str(error)


class DirectMARLEnv(DirectEnvBase):
    """Base class of environments in which several agents act at once, each with observations and rewards of its own.

    The interface is the ``parallel`` one of PettingZoo, for ``num_envs`` environments at once: what an agent gives and
    gets are tensors whose first dimension is ``num_envs``. A step runs in the order of :class:`DirectRLEnv`, with hooks
    in torch that take and return dicts by agent.

    An environment is reset, within the step, when all of its agents are done in that step, terminated or timed out. An
    agent that is done before the others must return so in every step until then; agents never leave.

    Attributes:
        agents: Names of the agents, as :attr:`possible_agents`.
        observation_spaces: Space of one environment's observations by agent.
        action_spaces: Space of one environment's actions by agent.
        state_space: Space of one environment's state; ``None`` where there is none.
        actions: Actions by agent that hooks may keep; zeros until a hook assigns them.
        obs_dict: Observations of the last step by agent.
        reward_dict: Rewards of the last step by agent, float, shape ``(num_envs,)``.
        terminated_dict: Agents that failed or succeeded in the last step, bool, shape ``(num_envs,)``.
        time_out_dict: Agents that ran out of time in the last step, bool, shape ``(num_envs,)``.
        reward_buf: Sum of the agents' rewards, shape ``(num_envs,)``.
        reset_terminated: Environments all of whose agents terminated, bool, shape ``(num_envs,)``.
        reset_time_outs: Environments that ended otherwise, bool, shape ``(num_envs,)``.
    """

    cfg: DirectMARLEnvCfg

    def __init__(self, cfg: DirectMARLEnvCfg, render_mode: str | None = None, **kwargs: object):
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
        # Hooks may read the actions before the first step, as Isaac Lab's do.
        self.actions = {a: zero_actions(s, self.num_envs, self.device) for a, s in self.action_spaces.items()}
        self._observation_noise = AgentNoise(cfg.observation_noise_model, self.num_envs, self.device)
        self._action_noise = AgentNoise(cfg.action_noise_model, self.num_envs, self.device)
        self.obs_dict, self.reward_dict = ByAgent(), ByAgent()
        self.terminated_dict, self.time_out_dict = ByAgent(), ByAgent()
        self._state: torch.Tensor | None = None
        self._make_hook_helpers(cfg)
        self._run_startup_events()

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
        """Global state of the environments at the last observations, shape ``(num_envs, n)``; ``None`` where the config
        has no ``state_space``."""
        return self._state

    def reset(self, *, seed: int | None = None, options: ResetOptions | None = None) -> tuple[ByAgent, Extras]:
        """See :meth:`RLEnv.reset`: observations by agent, and infos as of :meth:`step`."""
        _, infos = super().reset(seed=seed, options=options)
        return self.obs_dict, infos

    def step(  # type: ignore[override]  # by agent
        self, actions: Mapping[str, torch.Tensor]
    ) -> tuple[ByAgent, ByAgent, ByAgent, ByAgent, Extras]:
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
        count = count_section(self.context).only(self.context.within_step)
        outcome: list[Item] = [count, self._safety.after_physics(), self._hook("_get_dones", self._take_dones)]
        reset: list[Item] = [HostFunction("_reset_idx, forward kinematics", self._torch_reset, "torch hook")]
        if self.cfg.compute_final_obs:
            reset.insert(0, HostFunction("final observations", self._keep_final_observations, "torch copies"))
        events: list[Item] = []
        if self._events is not None and self._events.has_intervals:
            events.append(HostFunction("interval events", self._run_interval_events, "torch terms"))
        return [
            Stage("actions", [self._hook("_pre_physics_step", lambda: self._pre_physics_step(self._action))]),
            Stage("physics", [self._torch_physics()]),
            *self._measurements_stage(),
            Stage("outcome", [*outcome, self._hook("_get_rewards", self._take_rewards)]),
            Stage("reset", [*reset, *sensor_items(self.scene, self.context, "launch_reset")]),
            Stage("events", events),
            Stage("sensors", self._sensor_items()),
            Stage("observations", [self._hook("_get_observations", self._observe), *self._log_items()]),
        ]

    def _hook(self, name: str, function: Callable[[], None]) -> HostFunction:
        return HostFunction(name, function, "torch hook")

    def _checked_action(self, action: object) -> ByAgent:  # type: ignore[override]  # by agent
        refuse = self.cfg.nonfinite_actions == "raise" and self.device == "cpu"
        return checked_actions(action, self.action_spaces, self.num_envs, self.device, refuse)

    def _take_action(self, action: ByAgent) -> None:  # type: ignore[override]  # by agent
        self._action: ByAgent = {}
        for agent, value in action.items():
            value = self._action_noise(agent, value)
            self._action[agent] = value = value.clone(memory_format=torch.contiguous_format)
            if value.is_floating_point():
                self._safety.make_finite(value)

    def _take_dones(self) -> None:
        self.count_step()  # from here on hooks see this step counted, as in Isaac Lab
        broken = self._safety.nonfinite
        terminated, time_outs = (self._of_agents("_get_dones", v) for v in self._get_dones())
        self.terminated_dict = {a: v.bool() | broken for a, v in terminated.items()}
        self.time_out_dict = {a: v.bool().clone() for a, v in time_outs.items()}
        ended, failed, late = ends_of_envs(self.terminated_dict, self.time_out_dict)
        self.reset_buf[:], self.reset_terminated[:], self.reset_time_outs[:] = ended, failed, late
        self.context.torch(self.context.moved)[:] = self.reset_buf

    def _take_rewards(self) -> None:
        rewards = self._of_agents("_get_rewards", self._get_rewards())
        self.reward_dict = {a: torch.where(self._safety.nonfinite, 0.0, v.float()) for a, v in rewards.items()}
        self.reward_buf[:] = torch.stack([*self.reward_dict.values()]).sum(dim=0)

    def _of_agents(self, hook: str, values: Mapping[str, object]) -> ByAgent:
        """Results of a hook for each agent, shape ``(num_envs,)``."""
        return {a: self._per_env(v, f"{hook}['{a}']") for a, v in of_all(self.agents, hook, values).items()}

    def _keep_final_observations(self) -> None:
        if not self._is_final():
            return
        for agent, value in self._noisy_observations().items():
            self.extras[agent] |= {"final_obs": value.clone(), "_final_obs": self.reset_buf.clone()}

    def _noisy_observations(self) -> ByAgent:
        groups = of_all(self.agents, "_get_observations", self._get_observations())
        if not self._checked:
            check_observations(groups, self.observation_spaces, self.num_envs)
            self._checked = True
        return {a: self._observation_noise(a, v) for a, v in groups.items()}

    def _observe(self) -> None:
        self.obs_dict = {a: v.clone() for a, v in self._noisy_observations().items()}
        if self.cfg.state_space == -1:
            self._state = torch.cat([v.flatten(1) for v in self.obs_dict.values()], dim=-1)
        elif self.state_space is not None:
            self._state = checked_state(self._get_states(), self.state_space, self.num_envs).clone()

    def _collect_observations(self, values: dict[str, torch.Tensor]) -> ByAgent:
        return self.obs_dict

    def _begin_extras(self) -> None:
        super()._begin_extras()
        self.extras |= {agent: {} for agent in self.possible_agents}

    # -- continuing where it stopped

    def get_state(self) -> EnvState:
        """See :meth:`RLEnv.get_state`; tensors that the subclass keeps in dicts by agent are part of it too."""
        arrays = [*state_arrays(self).values(), self.sim.state.body_q, self.sim.state.body_qd]
        found = tensors_by_agent(vars(self), self.possible_agents, arrays)
        return super().get_state() | {"by_agent": {k: v.clone() for k, v in found}}

    def set_state(self, state: EnvState) -> None:
        """See :meth:`RLEnv.set_state`."""
        self._state = None  # the caller of state() owns the tensor; restoring must not write into it
        super().set_state(state)
        by_agent: dict[tuple[str, str], torch.Tensor] = state["by_agent"]  # type: ignore[assignment]
        for (name, agent), value in by_agent.items():  # new dicts: others may hold the old ones
            setattr(self, name, getattr(self, name, {}) | {agent: value.to(self.device).clone()})

    def state_parts(self) -> list[dict[str, torch.Tensor]]:
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
        """Global state that :meth:`state` returns, shape ``(num_envs, n)``; called where ``state_space`` is a space."""
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
        ids = self._env_indices(env_ids)
        self.scene.reset(ids)
        if self._events is not None:
            self._events.reset(ids)
        self._observation_noise.reset(ids)
        self._action_noise.reset(ids)
        self._episode_length_buf[ids] = 0

    def _run_interval_events(self) -> None:
        if self._events is not None and self._events.interval(self.step_dt):
            self.sim.forward()
