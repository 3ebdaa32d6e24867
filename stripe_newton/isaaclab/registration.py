# SPDX-License-Identifier: Apache-2.0
"""Registered tasks of Isaac Lab, as the command line and ``gymnasium.make_vec`` know tasks."""

from __future__ import annotations

from collections.abc import Callable

import gymnasium

from stripe_newton.configclass import resolve_name
from stripe_newton.registration import vector_env_creator
from stripe_newton.rl import RslRlOnPolicyRunnerCfg as NativeRunnerCfg

from .rl_configs import RslRlOnPolicyRunnerCfg
from .skrl_configs import read_skrl_config

__all__ = ["adopt_tasks"]

_ENV_CFG, _AGENT_CFG = "env_cfg_entry_point", "rsl_rl_cfg_entry_point"
_SKRL_CFG = "skrl_cfg_entry_point"


class _NativeAgentCfg:
    """Entry point of an agent's config: makes the one that Isaac Lab's task names, and translates it."""

    def __init__(self, entry_point: str | Callable[[], object]):
        self.entry_point = entry_point

    def __call__(self) -> NativeRunnerCfg:
        cfg = (resolve_name(self.entry_point) if isinstance(self.entry_point, str) else self.entry_point)()
        if isinstance(cfg, RslRlOnPolicyRunnerCfg):
            return cfg.to_native()
        if isinstance(cfg, NativeRunnerCfg):
            return cfg
        raise TypeError(
            f"'{self.entry_point}' is a {type(cfg).__name__}; the dialect translates RslRlOnPolicyRunnerCfg"
        )

    def __str__(self) -> str:
        return str(self.entry_point)


class _SkrlAgentCfg(_NativeAgentCfg):
    """Entry point of a config of skrl: makes a config for rsl_rl of it."""

    def __call__(self) -> NativeRunnerCfg:
        return read_skrl_config(str(self.entry_point))


def adopt_tasks() -> list[str]:
    """Make vector environments of all tasks that Isaac Lab's files have registered, also by ``gymnasium.make_vec``.

    Isaac Lab registers ``entry_point="module:Class"`` with configs in ``kwargs``. Tasks that have a vector environment
    are left alone, so that this can be called again after further imports.

    Returns:
        Names of the tasks that were adopted by this call.
    """
    found = []
    for name, spec in gymnasium.registry.items():
        if spec.vector_entry_point is not None or _ENV_CFG not in spec.kwargs or spec.entry_point is None:
            continue
        spec.vector_entry_point = vector_env_creator(spec.entry_point, spec.kwargs[_ENV_CFG])
        agent = spec.kwargs.get(_AGENT_CFG)
        if isinstance(agent, str) or (isinstance(agent, type) and issubclass(agent, RslRlOnPolicyRunnerCfg)):
            spec.kwargs[_AGENT_CFG] = _NativeAgentCfg(agent)
        elif agent is None and isinstance(spec.kwargs.get(_SKRL_CFG), str):
            spec.kwargs[_AGENT_CFG] = _SkrlAgentCfg(spec.kwargs[_SKRL_CFG])
        found.append(name)
    return found
