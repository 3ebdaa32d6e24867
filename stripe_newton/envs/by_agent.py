# SPDX-License-Identifier: Apache-2.0
"""By agent: checks of dicts of tensors, as callers pass them in and hooks return them, and noise by agent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import torch
import warp as wp
from gymnasium import spaces

from stripe_newton.call_checks import to_tensor
from stripe_newton.configclass import ConfigError
from stripe_newton.noise import NoiseModelCfg

__all__ = [
    "AgentNoise",
    "ByAgent",
    "check_observations",
    "checked_actions",
    "checked_state",
    "ends_of_envs",
    "of_all",
    "tensors_by_agent",
    "zero_actions",
]

ByAgent = dict[str, torch.Tensor]
"""A tensor for each agent, by the agent's name."""


def of_all(agents: Sequence[str], what: str, values: object) -> ByAgent:
    """``values`` in the order of the agents.

    Args:
        agents: Names of the agents.
        what: Name of the values, for the error.
        values: A dict by agent.

    Raises:
        ValueError: if it is not a dict, or its keys are not exactly the agents.
    """
    if not isinstance(values, Mapping) or set(values) != set(agents):
        got = ", ".join(map(str, values)) if isinstance(values, Mapping) else type(values).__name__
        raise ValueError(f"{what}: has {got or 'nothing'}, must be a dict of exactly {', '.join(agents)}")
    return {a: values[a] for a in agents}


def checked_actions(
    actions: object, action_spaces: Mapping[str, spaces.Space], num_envs: int, device: str, refuse_nonfinite: bool
) -> ByAgent:
    """Actions as tensors on the device, in the order of the agents.

    Raises:
        ValueError: if an agent is missing or unknown, a shape does not fit, or numbers are not finite where that is to
            be refused.
    """
    checked = {}
    for agent, value in of_all(list(action_spaces), "actions", actions).items():
        expected = (num_envs, *(action_spaces[agent].shape or ()))
        value = to_tensor(f"actions of {agent}", value, f"a tensor of shape {expected}", device)
        if tuple(value.shape) != expected:
            raise ValueError(f"actions of '{agent}' have shape {tuple(value.shape)}, expected {expected}")
        if refuse_nonfinite and value.is_floating_point() and not bool(torch.isfinite(value).all()):
            raise ValueError(
                f"actions of '{agent}' are not finite; look at the policy, or set nonfinite_actions='clamp'"
            )
        checked[agent] = value
    return checked


def zero_actions(space: spaces.Space, num_envs: int, device: str) -> torch.Tensor:
    """Actions 0 of all environments, in the shape and type of a space."""
    dtype = torch.float32 if isinstance(space, spaces.Box) else torch.int64
    return torch.zeros((num_envs, *(space.shape or ())), dtype=dtype, device=device)


def check_observations(groups: ByAgent, observation_spaces: Mapping[str, spaces.Space], num_envs: int) -> None:
    """Compare observations with their spaces.

    Raises:
        ConfigError: with every shape that does not fit.
    """
    problems = []
    for agent, value in groups.items():
        expected = (num_envs, *(observation_spaces[agent].shape or ()))
        if tuple(value.shape) != expected:
            path = f"observation_spaces[{agent!r}]"
            problems.append(f"{path}: asks for shape {expected}, _get_observations returned {tuple(value.shape)}")
    if problems:
        raise ConfigError(problems)


def checked_state(state: torch.Tensor | None, space: spaces.Space, num_envs: int) -> torch.Tensor:
    """The state, compared with its space.

    Raises:
        ConfigError: if it does not fit.
    """
    expected = (num_envs, *(space.shape or ()))
    if state is None or tuple(state.shape) != expected:
        got = "None" if state is None else f"shape {tuple(state.shape)}"
        raise ConfigError([f"state_space: asks for shape {expected}, _get_states returned {got}"])
    return state


def ends_of_envs(terminated: ByAgent, time_outs: ByAgent) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Ends of episodes from ends of agents.

    Returns:
        Environments all of whose agents are done; environments all of whose agents terminated; environments that ended
        otherwise, or all of whose agents ran out of time. Bool, shape ``(num_envs,)`` each.
    """
    failed, late = torch.stack([*terminated.values()]), torch.stack([*time_outs.values()])
    ended, all_failed = (failed | late).all(dim=0), failed.all(dim=0)
    return ended, all_failed, late.all(dim=0) | (ended & ~all_failed)


def tensors_by_agent(
    attributes: Mapping[str, object], agents: Sequence[str], elsewhere: Sequence[wp.array]
) -> Iterator[tuple[tuple[str, str], torch.Tensor]]:
    """Tensors in attributes that are dicts by agent, as ``(attribute, agent), tensor``.

    Args:
        attributes: Attributes of an object.
        agents: Names of the agents.
        elsewhere: Arrays that are saved elsewhere; tensors that share memory with them are left out.
    """
    shared = {wp.to_torch(a).untyped_storage().data_ptr() for a in elsewhere}
    for name, values in attributes.items():
        if isinstance(values, dict) and values and set(values) <= set(agents):
            for agent, value in values.items():
                if isinstance(value, torch.Tensor) and value.untyped_storage().data_ptr() not in shared:
                    yield (name, agent), value


class AgentNoise:
    """Noise models by agent; the values of agents without one pass unchanged."""

    def __init__(self, cfgs: Mapping[str, NoiseModelCfg | None] | None, num_envs: int, device: str):
        given = {a: c for a, c in (cfgs or {}).items() if c is not None}
        self._models = {a: c.class_type(c, num_envs, device) for a, c in given.items()}

    def __call__(self, agent: str, value: torch.Tensor) -> torch.Tensor:
        """``value`` of an agent with its noise; float32 where it is a floating-point tensor."""
        if value.is_floating_point():
            value = value.float()
        return self._models[agent](value.float()) if agent in self._models else value

    def reset(self, env_ids: torch.Tensor) -> None:
        """Begin new episodes."""
        for model in self._models.values():
            model.reset(env_ids)

    def parts(self) -> list[dict[str, torch.Tensor]]:
        """State of the models, as the dicts in which they keep it."""
        return [model.__dict__ for model in self._models.values()]
