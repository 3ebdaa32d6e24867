# SPDX-License-Identifier: Apache-2.0
"""Curriculum terms of ``isaaclab.envs.mdp``: weights of rewards, and values of configs, that change in training."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

from stripe_kernels import mdp
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.managers import CurriculumTermCfg, ManagerTermBase
from stripe_newton.managers.term_manager import TermManager

from .warp_term import WarpTerm

__all__ = ["modify_env_param", "modify_reward_weight", "modify_term_cfg"]

_PART = re.compile(r"""\.?([A-Za-z_]\w*)|\[(?:(\d+)|['"]([^'"]+)['"])\]""")
"""A part of an address: an attribute or key, an index, or a quoted key."""
_MANAGER = re.compile(r"(\w+)_manager\.cfg\.(.+)")
_PATHS = {
    "action": "actions",
    "command": "commands",
    "curriculum": "curriculum",
    "event": "events",
    "observation": "observations",
    "reward": "rewards",
    "termination": "terminations",
}
"""Paths of parameters on the device, by the name of their manager."""


class _ModifyRewardWeight(WarpTerm):
    """The Warp term, which torch code may call too."""

    _GIVEN = ("env", "env_ids")

    def __call__(  # type: ignore[override]  # a curriculum has environments and a number
        self, env: ManagerBasedRLEnv, env_ids: object, term_name: str, weight: float, num_steps: int
    ) -> float:
        """Set the weight if the step has come; returns it."""
        term = env.reward_manager.get_term_cfg(term_name)
        if env.common_step_counter > num_steps:
            term.weight = weight
            env.reward_manager.set_term_cfg(term_name, term)
        return term.weight


def _modify_reward_weight(
    env: ManagerBasedRLEnv, env_ids: Sequence[int], term_name: str, weight: float, num_steps: int
) -> None:
    """Set the weight of a reward after ``num_steps`` steps."""


_modify_reward_weight.__name__ = _modify_reward_weight.__qualname__ = "modify_reward_weight"
modify_reward_weight = _ModifyRewardWeight(_modify_reward_weight, mdp.modify_reward_weight)


class modify_env_param(ManagerTermBase):
    """Change any value of the environment by a function of the user.

    ``address`` is its path below the environment, such as ``"reward_manager.cfg.lift.params['std']"``.
    ``modify_fn(env, env_ids, old_value, **modify_params)`` returns the new value, or :attr:`NO_CHANGE`. Values in
    configs of terms take effect in the next step.
    """

    NO_CHANGE: ClassVar[object] = object()
    """Result of a function that leaves the value as it is."""

    def __init__(self, cfg: CurriculumTermCfg, env: ManagerBasedRLEnv):
        """Take the address from the parameters."""
        super().__init__(cfg, env)
        self._address: str = cfg.params["address"]

    def __call__(
        self,
        env: ManagerBasedRLEnv,
        env_ids: Sequence[int],
        address: str,
        modify_fn: Callable[..., object],
        modify_params: Mapping[str, object] | None = None,
    ) -> float | None:
        """Apply the function; returns the value if it is a number, for the log."""
        container, last = self._find(env)
        old = _get(container, last)
        value = modify_fn(env, env_ids, old, **(modify_params or {}))
        if value is not self.NO_CHANGE:
            _set(container, last, value)
            self._take_effect(env, value)
            old = value
        return float(old) if isinstance(old, (int, float)) else None

    def _find(self, env: ManagerBasedRLEnv) -> tuple[Any, str | int]:
        """The object that holds the value, and the value's name, key or index in it."""
        parts = [int(m[2]) if m[2] else m[1] or m[3] for m in _PART.finditer(self._address)]
        holder: Any = env
        for part in parts[:-1]:
            holder = _get(holder, part)
        return holder, parts[-1]

    def _take_effect(self, env: ManagerBasedRLEnv, value: Any) -> None:
        """Let a term whose config was changed follow it."""
        found = _MANAGER.fullmatch(self._address)
        if found is None:
            return
        manager, rest = getattr(env, f"{found[1]}_manager"), found[2]
        name = _PART.match(rest)
        if isinstance(manager, TermManager) and name is not None:
            manager.set_term_cfg(name[1], manager.get_term_cfg(name[1]))
            return
        path = f"{_PATHS[found[1]]}.{rest}".replace(".params.", ".")
        if path in env.context.parameters:
            env.context.parameters[path] = value
        elif found[1] == "command" and name is not None and name[1] not in env.command_manager.torch_terms:
            raise ValueError(f"'{self._address}' cannot change while the environment runs: no term reads it then")


class modify_term_cfg(modify_env_param):
    """Change a value in the config of a term, such as ``address="rewards.lift.params['std']"``."""

    def __init__(self, cfg: CurriculumTermCfg, env: ManagerBasedRLEnv):
        super().__init__(cfg, env)
        self._address = self._address.replace("s.", "_manager.cfg.", 1)


def _get(holder: Any, part: str | int) -> Any:
    return holder[part] if isinstance(part, int) or isinstance(holder, Mapping) else getattr(holder, part)


def _set(holder: Any, part: str | int, value: object) -> None:
    if isinstance(part, int) or isinstance(holder, dict):
        holder[part] = value
    else:
        setattr(holder, part, value)
