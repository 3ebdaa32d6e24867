# SPDX-License-Identifier: Apache-2.0
"""Managers of the Isaac Lab dialect that a user's terms make themselves, with Isaac Lab's arguments."""

from __future__ import annotations

import torch
import warp as wp

from stripe_newton import managers as native
from stripe_newton.configclass import ConfigError
from stripe_newton.fusion import Plan, Stage

from .mdp.warp_term import use_warp_functions

__all__ = ["ObservationManager"]

Group = torch.Tensor | dict[str, torch.Tensor]


class ObservationManager(native.ObservationManager):
    """Observation manager of a term, beside that of the environment, whose groups are computed when asked for."""

    def __init__(self, cfg: object, env: native.TermEnv):
        """Make the terms of the groups in ``cfg``, a config or a dict.

        Raises:
            ConfigError: all problems of the config at once.
        """
        context = env.context
        number = next(n for n in range(len(context.arrays) + 1) if f"own_observations_{n}" not in context.arrays)
        context.shared(f"own_observations_{number}", int, 1)
        self.path = f"own_observations_{number}"
        use_warp_functions(cfg)
        before = len(context.problems)
        super().__init__(cfg, context)
        self._plans = {(group, again): self._plan(group, again) for group in self._terms for again in (False, True)}
        problems = context.problems[before:]
        del context.problems[before:]
        if problems:
            raise ConfigError(problems)

    def _plan(self, group: str, again: bool) -> Plan:
        items, context = self._group_items(group, [], gather=False, again=again).items(), self.context
        return Plan(self.path, [Stage(group, items)], context.scope, context.num_envs, context.device, False)

    def compute_group(self, group_name: str, update_history: bool = False) -> Group:
        """The observations of a group, shape ``(num_envs, n)``; by term where they are not concatenated.

        Args:
            group_name: Name of the group.
            update_history: Append to delays and histories; otherwise the values replace the last ones.

        Raises:
            KeyError: there is no such group.
        """
        if group_name not in self._terms:
            raise KeyError(f"no observation group '{group_name}'; there is {', '.join(self._terms)}")
        self._plans[group_name, not update_history].run()
        buffer = self.buffers[group_name]
        if isinstance(buffer, dict):
            return {name: wp.to_torch(array).clone() for name, array in buffer.items()}
        return wp.to_torch(buffer).clone()

    def compute(self, update_history: bool = False) -> dict[str, Group]:
        """The observations of all groups."""
        return {group: self.compute_group(group, update_history) for group in self._terms}
