# SPDX-License-Identifier: Apache-2.0
"""Base of managers that a project writes itself in torch, which its own environment makes and calls."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Mapping, Sequence
from typing import Any

import torch

from stripe_newton.matching import match_names

from .scene_entity import SceneEntityCfg
from .strings import string_to_callable

__all__ = ["ManagerBase"]


class ManagerBase:
    """A config of terms and the environment; subclasses make their terms in ``_prepare_terms``.

    Attributes:
        cfg: A copy of the config, or ``None`` for no terms.
    """

    def __init__(self, cfg: object, env: Any):
        """Take a config or a dict of terms, and make them."""
        self.cfg, self._env = copy.deepcopy(cfg), env
        if self.cfg:
            self._prepare_terms()

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return int(self._env.num_envs)

    @property
    def device(self) -> str:
        """Torch device."""
        return str(self._env.device)

    @property
    def active_terms(self) -> list[str] | dict[str, list[str]]:
        """Names of the terms, by group where there are groups."""
        raise NotImplementedError(f"{type(self).__name__} has no active_terms")

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> dict[str, Any]:
        """Begin an episode; what it returns is logged."""
        return {}

    def find_terms(self, name_keys: str | Sequence[str]) -> list[str]:
        """Names of the terms that match expressions."""
        terms = self.active_terms
        names = [name for group in terms.values() for name in group] if isinstance(terms, Mapping) else terms
        return match_names(name_keys, names, what="term")[1]

    def _prepare_terms(self) -> None:
        """Make the terms of ``cfg``."""
        raise NotImplementedError(f"{type(self).__name__} has no _prepare_terms()")

    def _resolve_common_term_cfg(self, term_name: str, term_cfg: Any, min_argc: int = 1) -> None:
        """Find the function, joints and bodies that a term's config names, and make its class.

        Raises:
            TypeError: the function cannot be called.
            ValueError: an asset, a joint or a body does not exist.
        """
        if isinstance(term_cfg.func, str):
            term_cfg.func = string_to_callable(term_cfg.func)
        if not callable(term_cfg.func):
            raise TypeError(f"{term_name}.func: is {term_cfg.func!r}, which cannot be called")
        for name, value in term_cfg.params.items():
            if isinstance(value, SceneEntityCfg):
                try:
                    value.resolve(self._env.scene)
                except (KeyError, ValueError) as error:
                    raise ValueError(f"{term_name}.params.{name}: {error}") from error
        if inspect.isclass(term_cfg.func):
            make: Any = term_cfg.func
            term_cfg.func = make(cfg=term_cfg, env=self._env)
