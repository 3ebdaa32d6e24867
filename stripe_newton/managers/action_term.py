# SPDX-License-Identifier: Apache-2.0
"""Action terms as classes: those that a user writes in torch, and those of kernels, used from torch."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
import warp as wp

from stripe_newton.assets import AssetBase
from stripe_newton.configclass import ConfigError
from stripe_newton.fusion import Code, FusedKernel, Section, block, code, fuse

from .action_layout import lay_out
from .action_source import ActionSource
from .actions_cfg import ActionTermCfg
from .context import ManagerContext
from .term_class import ManagerTermBase, TermEnv

__all__ = ["ActionTerm", "KernelActionTerm"]


class ActionTerm(ManagerTermBase):
    """Base of action terms in torch.

    ``ActionTermCfg.class_type`` names the class. In each step :meth:`process_actions` is called once, and
    :meth:`apply_actions` before each physics step; both run on the host, between graphs.

    Attributes:
        cfg: The config.
    """

    cfg: ActionTermCfg

    def __init__(self, cfg: ActionTermCfg, env: TermEnv):
        """Find the asset of the config."""
        super().__init__(cfg, env)
        self._asset: AssetBase = env.scene[cfg.asset_name]

    @property
    def action_dim(self) -> int:
        """Number of actions that the term takes."""
        raise NotImplementedError(f"{type(self).__name__} has no action_dim, the number of its actions")

    @property
    def raw_actions(self) -> torch.Tensor:
        """Actions of the last step, shape ``(num_envs, action_dim)``."""
        raise NotImplementedError(f"{type(self).__name__} has no raw_actions")

    @property
    def processed_actions(self) -> torch.Tensor:
        """Actions as :meth:`process_actions` leaves them, shape ``(num_envs, n)``."""
        raise NotImplementedError(f"{type(self).__name__} has no processed_actions")

    def process_actions(self, actions: torch.Tensor) -> None:
        """Take the actions of a step, shape ``(num_envs, action_dim)``."""
        raise NotImplementedError(f"{type(self).__name__} has no process_actions")

    def apply_actions(self) -> None:
        """Set targets of the asset for the next physics step."""
        raise NotImplementedError(f"{type(self).__name__} has no apply_actions")


class KernelActionTerm(ActionTerm):
    """Action term of kernels, such as joint positions, as a torch term uses it.

    ``KernelActionTerm(cfg, env)`` is a term of its own, for a term that drives another one. Those of an action manager
    are handed out by :meth:`ActionManager.get_term`; within a step they run fused with all others.

    Raises:
        ConfigError: all problems of the config at once.
    """

    def __init__(self, cfg: ActionTermCfg, env: TermEnv, source: ActionSource | None = None):
        """Make the kernels, or take the ``source`` of a manager's term."""
        super().__init__(cfg, env)
        self._source = source or _source_of_its_own(cfg, env.context)
        context, term = self._source.context, self._source.term
        self._raw = context.torch(self._source.actions)[:, term.first : term.first + term.size]
        self._kernels: dict[str, FusedKernel] = {}

    @classmethod
    def is_fused(cls) -> bool:
        """Whether a manager may fuse terms of this class: a subclass that changes how they run is called instead."""
        own = ("process_actions", "apply_actions", "reset", "action_dim")
        return all(getattr(cls, name) is getattr(KernelActionTerm, name) for name in own)

    @property
    def action_dim(self) -> int:
        """Number of actions that the term takes."""
        return self._source.term.size

    @property
    def raw_actions(self) -> torch.Tensor:
        """Actions of the last step, shape ``(num_envs, action_dim)``."""
        return self._raw

    @property
    def processed_actions(self) -> torch.Tensor:
        """Actions after scale, offset and clip, shape ``(num_envs, n)``."""
        return self._source.context.torch(self._source.processed_array)

    def process_actions(self, actions: torch.Tensor) -> None:
        """Take the actions of a step, shape ``(num_envs, action_dim)``."""
        self._raw[:] = actions
        self._launch("process", self._source.process)

    def apply_actions(self) -> None:
        """Set the targets."""
        self._launch("apply", self._source.apply)

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Set the actions of environments to zero; None means all of them."""
        context = self._source.context
        chosen = context.torch(self._chosen())
        chosen.fill_(env_ids is None)
        if env_ids is not None:
            chosen[torch.as_tensor(env_ids, device=self.device)] = True
        self._raw[chosen] = 0.0
        if_chosen = code("if {}[env]:", context.scope.name("chosen_envs", self._chosen()))
        self._launch("reset", lambda: block(if_chosen, self._source.reset()))

    def _chosen(self) -> wp.array:
        return self._source.context.array("chosen_envs", wp.bool)

    def _launch(self, what: str, lines: Callable[[], list[Code]]) -> None:
        if what not in self._kernels:
            context, title = self._source.context, f"action_term_{what}"
            section = Section(f"{title}_body", lines(), [self._source.name])
            if context.problems:
                raise ConfigError(context.problems)
            self._kernels[what] = fuse(title, [section], context.scope, context.num_envs, context.device)
        self._kernels[what].launch()


def _source_of_its_own(cfg: ActionTermCfg, context: ManagerContext) -> ActionSource:
    """The source of a term that belongs to no manager, with an array of actions of its own."""
    number = next(n for n in range(len(context.arrays) + 1) if f"own_actions.{n}.action" not in context.arrays)
    path, before = f"own_actions.{number}", len(context.problems)
    term = lay_out(context, path, cfg, 0)
    if term is None:
        raise ConfigError(context.problems[before:])
    actions = context.array(f"{path}.action", float, term.size)
    return ActionSource(context, path, term, actions, context.scope.name(f"own_actions_{number}", actions))
