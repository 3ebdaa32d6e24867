# SPDX-License-Identifier: Apache-2.0
"""Class terms: torch terms that keep a state between steps, such as a potential or a count."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import torch

from stripe_newton.scene import InteractiveScene

if TYPE_CHECKING:
    from .context import ManagerContext

__all__ = ["HasReset", "ManagerTermBase", "TermEnv", "has_own_reset", "make_instance"]


class TermEnv(Protocol):
    """The environment that torch terms are called with, as far as every term can rely on it."""

    @property
    def scene(self) -> InteractiveScene:
        """The scene."""
        ...

    @property
    def context(self) -> ManagerContext:
        """Arrays and names that its managers share."""
        ...

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        ...

    @property
    def device(self) -> str:
        """Device of every tensor."""
        ...

    @property
    def step_dt(self) -> float:
        """Time step of the environment [s]."""
        ...


class ManagerTermBase:
    """Base of class terms: torch terms with a state.

    A config names the class as ``func``. The manager makes one instance, ``func(cfg=term_cfg, env=env)``, whose
    parameters have the joints and bodies of each :class:`SceneEntityCfg` as indices, and calls it as it would call a
    torch function::

        class Progress(ManagerTermBase):
            def __init__(self, cfg, env):
                super().__init__(cfg, env)
                self.last = torch.zeros(self.num_envs, device=self.device)

            def reset(self, env_ids=None):
                self.last[env_ids] = distance(self._env)[env_ids]

            def __call__(self, env) -> torch.Tensor: ...

    Attributes:
        cfg: The config of the term.
    """

    def __init__(self, cfg: Any, env: TermEnv):
        """Keep the config of the term and the environment."""
        self.cfg, self._env = cfg, env

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return self._env.num_envs

    @property
    def device(self) -> str:
        """Device of the environment's tensors."""
        return self._env.device

    @property
    def __name__(self) -> str:
        """Name of the class."""
        return type(self).__name__

    def reset(self, env_ids: Sequence[int] | torch.Tensor | None = None) -> None:
        """Begin new episodes in the environments ``env_ids``, after the reset events have set their states.

        The default does nothing.
        """

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Compute the term, as a torch function of its manager does."""
        raise NotImplementedError(f"{type(self).__name__} has no __call__, by which a manager computes it")


class HasReset(Protocol):
    """An object with a state that begins anew with each episode."""

    def reset(self, env_ids: torch.Tensor | None = None) -> object:
        """Begin new episodes in the environments ``env_ids``."""
        ...


def has_own_reset(instance: HasReset) -> bool:
    """Whether the reset of an object does anything."""
    return not isinstance(instance, ManagerTermBase) or type(instance).reset is not ManagerTermBase.reset


Instance = TypeVar("Instance", bound=ManagerTermBase)


def make_instance(path: str, func: type[Instance], cfg: Any, env: TermEnv) -> Instance:
    """The instance of a class term.

    Args:
        path: Path of the field that names the class, for the error.
        func: The class.
        cfg: Config of the term, with resolved parameters.
        env: The environment.

    Raises:
        RuntimeError: the class raised an error.
    """
    try:
        return func(cfg=cfg, env=env)
    except Exception as error:
        text = f"{path}: making '{func.__name__}' raised {type(error).__name__}: {error}"
        raise RuntimeError(text) from error
