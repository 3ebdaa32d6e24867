# SPDX-License-Identifier: Apache-2.0
"""Config of an environment of several agents in the direct workflow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseModelCfg

from .rl_env_cfg import RLEnvCfg
from .spaces import to_space

__all__ = ["DirectMARLEnvCfg"]


@configclass
class DirectMARLEnvCfg(RLEnvCfg):
    """What every direct environment of several agents has; subclass it and add fields of your own."""

    possible_agents: list[str] = MISSING
    """Names of the agents, in the order in which they are joined."""
    observation_spaces: dict[str, Any] = MISSING
    """Space of the observations by agent, as :func:`to_space` reads it."""
    action_spaces: dict[str, Any] = MISSING
    """Space of the actions by agent."""
    state_space: Any = 0
    """Space of what ``state()`` returns, which ``_get_states`` fills; -1 for the observations of all agents joined, 0
    for none."""
    observation_noise_model: dict[str, NoiseModelCfg | None] | None = None
    """Noise on the observations by agent; agents that are not named have none."""
    action_noise_model: dict[str, NoiseModelCfg | None] | None = None
    """Noise on the actions by agent; agents that are not named have none."""
    apply_action: str = "auto"
    """When ``_apply_action`` runs, as in :class:`DirectRLEnvCfg`."""

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


def _names(agents: Any) -> str:
    return ", ".join(map(repr, agents)) or "no agent"


def _space_problems(path: str, space: Any) -> Iterator[tuple[str, str]]:
    try:
        to_space(space)
    except ValueError as error:
        yield path, str(error)
