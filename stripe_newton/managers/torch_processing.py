# SPDX-License-Identifier: Apache-2.0
"""Torch processing: modifiers and noise of an observation term that are a user's torch functions and classes."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import torch

from stripe_newton.noise import NoiseCfg, NoiseModel, NoiseModelCfg, NoiseModelWithAdditiveBias

from .context import ManagerContext
from .manager_base import is_warp_term
from .modifiers import ModifierBase, ModifierCfg
from .processing import KINDS_OF_NOISE
from .term_class import HasReset

__all__ = ["ObservationCfg", "TorchProcessing", "needs_torch"]

Change = Callable[[torch.Tensor], torch.Tensor]


class ObservationCfg(Protocol):
    """The fields of an observation term's config that are processed here."""

    @property
    def modifiers(self) -> Sequence[ModifierCfg] | None: ...

    @property
    def noise(self) -> NoiseCfg | NoiseModelCfg | None: ...


def needs_torch(cfg: ObservationCfg, corrupt: bool) -> bool:
    """Whether a modifier or the noise of a term is a user's own, in torch.

    Args:
        cfg: Config of the term.
        corrupt: Whether its noise is applied.
    """
    return any(map(_is_torch_modifier, cfg.modifiers or ())) or (corrupt and _is_torch_noise(cfg.noise))


def _is_torch_modifier(cfg: ModifierCfg) -> bool:
    return callable(cfg.func) and not is_warp_term(cfg.func)


def _is_torch_noise(cfg: NoiseCfg | NoiseModelCfg | None) -> bool:
    if isinstance(cfg, NoiseModelCfg):
        known = cfg.class_type in (NoiseModel, NoiseModelWithAdditiveBias)
        return not known or _is_torch_noise(cfg.noise_cfg) or _is_torch_noise(getattr(cfg, "bias_noise_cfg", None))
    return cfg is not None and not isinstance(cfg, KINDS_OF_NOISE)


class TorchProcessing:
    """Modifiers and noise of a term, in the order of the config, applied to tensors ``(num_envs, size)``.

    Attributes:
        instances: Modifiers and noise models with a state, by path.
    """

    def __init__(self, context: ManagerContext, path: str, cfg: ObservationCfg, size: int, corrupt: bool):
        """Make the instances of classes.

        Args:
            context: The context of the managers; problems are added to it.
            path: Path of the term's config.
            cfg: The config.
            size: Number of values of the term.
            corrupt: Whether its noise is applied.
        """
        self._context = context
        self.instances: dict[str, HasReset] = {}
        self._changes = [
            self._modifier(f"{path}.modifiers.{index}", modifier, size)
            for index, modifier in enumerate(cfg.modifiers or ())
        ]
        if corrupt and cfg.noise is not None:
            self._changes.append(self._noise(f"{path}.noise", cfg.noise))

    def __call__(self, values: torch.Tensor) -> torch.Tensor:
        """The processed values, shape ``(num_envs, size)``."""
        for change in self._changes:
            values = change(values)
        return values

    def _modifier(self, path: str, cfg: ModifierCfg, size: int) -> Change:
        func = cfg.func
        if func is None or not _is_torch_modifier(cfg):
            text = "is computed by kernels, but another modifier or the noise of the term is torch; use torch for all"
            self._context.problems.append(f"{path}: {text}")
            return _same
        if not inspect.isclass(func):
            return partial(func, **cfg.params)  # type: ignore[return-value]  # of a user's function
        if not issubclass(func, ModifierBase):
            self._context.problems.append(f"{path}.func: is '{func.__name__}', must be derived from ModifierBase")
            return _same
        made = self.instances[path] = func(cfg, (self._context.num_envs, size), self._context.device)
        return partial(made, **cfg.params)

    def _noise(self, path: str, cfg: NoiseCfg | NoiseModelCfg) -> Change:
        if not isinstance(cfg, NoiseModelCfg):
            return lambda values: cfg.func(values, cfg)
        made = self.instances[path] = cfg.class_type(cfg, self._context.num_envs, self._context.device)
        return made  # type: ignore[no-any-return]  # a noise model is called with the data


def _same(values: torch.Tensor) -> torch.Tensor:
    return values
