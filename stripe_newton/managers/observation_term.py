# SPDX-License-Identifier: Apache-2.0
"""Observation term: its config, its call, the number of its values and their place in the memory of its group."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar

import torch

from stripe_kernels.term_info import Each, observation_size
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Code, Name, TermCall, bind_term, code, resolve_entities
from stripe_newton.noise import NoiseCfg, NoiseModelCfg
from stripe_newton.value_types import AnyFloat, NonNegativeInt, PositiveInt

from .context import ManagerContext
from .image import Picture, find_picture, image
from .manager_base import is_warp_term
from .modifiers import ModifierCfg
from .normalization import RunningNormCfg
from .term_evaluation import TermEvaluation
from .term_manager import TorchCall
from .torch_processing import TorchProcessing, needs_torch

__all__ = [
    "ObservationGroupCfg",
    "ObservationManagerCfg",
    "ObservationTerm",
    "ObservationTermCfg",
    "make_observation_term",
]

_FLAT = "is False, but histories are always flat; reshape them in the network"


@configclass
class ObservationTermCfg:
    """Config of an observation term. Values pass modifiers, noise, clip, scale, delay and history, in this order."""

    MAY_BE_NONE: ClassVar[bool] = True

    func: Callable[..., object] = MISSING
    """Warp function ``(env, ..., out)``, or torch function ``(env, **params)`` that returns ``(num_envs, size)``."""
    params: dict[str, Any] = {}
    """Further arguments of the function."""
    size: PositiveInt | Callable[[Mapping[str, int]], int] | None = None
    """Number of values, or a function of the lengths of its index arrays. None where ``@writes`` declares it, as for
    the terms of ``mdp``, and for a torch term: it is called once, when the environment is made, to find its size."""
    modifiers: Sequence[ModifierCfg] | None = ()
    """Modifiers of the values, applied first."""
    noise: NoiseCfg | NoiseModelCfg | None = None
    """Noise; a model with bias draws the bias at the start of an episode."""
    clip: tuple[AnyFloat, AnyFloat] | None = None
    """Bounds of the values."""
    scale: float | Sequence[float] | None = None
    """Factor for all values, or one for each."""
    delay_min_lag: NonNegativeInt = 0
    """Least delay [steps]."""
    delay_max_lag: NonNegativeInt = 0
    """Largest delay [steps]; each episode draws one within the bounds."""
    history_length: NonNegativeInt = 0
    """Number of past and current steps in the observation, oldest first; 0 for the current one alone."""
    flatten_history_dim: bool = True
    """Join the steps of the history in one dimension; only True is supported."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.clip is not None and not (len(self.clip) == 2 and self.clip[0] <= self.clip[1]):
            yield "clip", f"is {self.clip}, must be (low, high) with low <= high"
        if not 0 <= self.delay_min_lag <= self.delay_max_lag:
            bounds = f"({self.delay_min_lag}, {self.delay_max_lag})"
            yield "delay_min_lag", f"lags are {bounds}, must be 0 <= delay_min_lag <= delay_max_lag"
        if not self.flatten_history_dim:
            yield "flatten_history_dim", _FLAT


@configclass
class ObservationGroupCfg:
    """Config of a group of observations, such as those of the policy: settings, and a field for each term.

    Subclass it, or name the terms: ``ObservationGroupCfg(height=ObservationTermCfg(...))``.
    """

    MAY_BE_NONE: ClassVar[bool] = True

    OPEN: ClassVar[tuple[type, ...]] = (ObservationTermCfg,)

    concatenate_terms: bool = True
    """Join the terms in one tensor; False gives a dict of tensors by term."""
    concatenate_dim: int = -1
    """Dimension along which terms are joined; only the last (-1) is supported."""
    enable_corruption: bool = False
    """Apply the noise of the terms."""
    history_length: NonNegativeInt | None = None
    """Overrides the history length of the terms."""
    flatten_history_dim: bool = True
    """See :class:`ObservationTermCfg`."""
    normalization: RunningNormCfg | None = None
    """Running normalisation of the whole group."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.concatenate_dim != -1:
            yield "concatenate_dim", f"is {self.concatenate_dim}, only the last dimension (-1) is supported"
        if self.normalization is not None and not self.concatenate_terms:
            yield "normalization", "is set, but concatenate_terms is False; a normalised group is one tensor"
        if not self.flatten_history_dim:
            yield "flatten_history_dim", _FLAT


@configclass
class ObservationManagerCfg:
    """Config of the observation manager: a field for each group.

    Subclass it, or name the groups: ``ObservationManagerCfg(policy=ObservationGroupCfg(...))``. Terms without a group
    are those of the group ``policy``, with their noise::

        ObservationManagerCfg(height=ObservationTermCfg(func=mdp.base_pos_z))
    """

    OPEN: ClassVar[tuple[type, ...]] = (ObservationGroupCfg, ObservationTermCfg)

    def problems(self) -> Iterator[tuple[str, str]]:
        loose = [n for n in type(self).__dataclass_fields__ if isinstance(getattr(self, n), ObservationTermCfg)]
        if loose and isinstance(getattr(self, "policy", None), ObservationGroupCfg):
            yield loose[0], "is a term without a group, and there is a group 'policy'; move it into a group"


@dataclass
class ObservationTerm:
    """An observation term whose config has been read without problems.

    Attributes:
        path: Path of its config.
        cfg: The config.
        call: Call of its Warp function; None for a torch term or a picture.
        values: Function that returns its values to the host, for a torch term and for torch modifiers and noise.
        processing: Its modifiers and noise, where these are torch.
        size: Number of values in a step.
        history: Number of steps in the observation; 0 for the current one alone.
        picture: The picture of a camera that it observes, if it is an image term.
        scratch: Array that it writes first, if its values pass a delay or a history or come from torch.
        target: Array of the group, or of the term if it is not concatenated.
        first: Index of its first value in ``target``.
    """

    path: str
    cfg: ObservationTermCfg
    call: TermCall | None
    size: int
    values: Callable[[], torch.Tensor] | None = None
    processing: TorchProcessing | None = None
    history: int = 0
    picture: Picture | None = None
    scratch: Name | None = None
    target: Name = field(default_factory=lambda: Name(""))
    first: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the observation for one environment."""
        return self.picture.shape if self.picture else (self.width,)

    @property
    def width(self) -> int:
        """Number of values for one environment, history included."""
        return self.size * max(1, self.history)

    @property
    def parts(self) -> int:
        """Number of parts that do not depend on each other, one for each joint, body or ray; 0 if there are none."""
        size = observation_size(self.cfg.func)
        if self.call is None or self.scratch or self.cfg.modifiers or not isinstance(size, Each):
            return 0
        return self.call.counts[size.name] if size.name in self.call.arguments else 0

    @property
    def element(self) -> Code:
        """Source code of its value of index ``i``, before history."""
        if self.scratch is not None:
            return code("{}[env, i]", self.scratch)
        return code("{}[env, {} + i]", self.target, self.first) if self.first else code("{}[env, i]", self.target)

    def span(self, first: str, last: str) -> Code:
        """Source code of a slice of its values in the memory of the group."""
        return code("{}[env, {begin} + {}:{begin} + {}]", self.target, first, last, begin=self.first)


def make_observation_term(
    context: ManagerContext, path: str, cfg: ObservationTermCfg, group: ObservationGroupCfg
) -> ObservationTerm | None:
    """Read the config of a term; returns None if problems have been added to ``context.problems``."""
    if cfg.func is image:
        return _make_picture(context, path, cfg, group)
    call, size = None, cfg.size
    if is_warp_term(cfg.func):
        call = bind_term(context, cfg.func, cfg.params, path, "observation")
        if call is None:
            return None
        size = observation_size(cfg.func) if size is None else size
        if callable(size):
            size = size(call.counts)
    elif size is None:
        size = _infer_size(context, path, cfg)
        if size is None:
            return None
    if not isinstance(size, int) or size < 1:
        context.problems.append(f"{path}.size: is {size!r}, must be the number of values that the term writes")
        return None
    if isinstance(cfg.scale, Sequence) and len(cfg.scale) != size:
        context.problems.append(f"{path}.scale: has {len(cfg.scale)} numbers, the term {size}; give one or {size}")
        return None
    history = cfg.history_length if group.history_length is None else group.history_length
    term = ObservationTerm(path, cfg, call, size, history=history)
    if needs_torch(cfg, group.enable_corruption):
        term.processing = TorchProcessing(context, path, cfg, size, group.enable_corruption)
    if call is None:
        term.values = TorchCall(context, cfg)
    elif term.processing is not None:
        term.call, term.values = None, partial(TermEvaluation(context).value, cfg.func, cfg.params)
    if history or cfg.delay_max_lag or term.values is not None:
        term.scratch = context.scope.name(f"{path}_now", context.array(f"{path}.now", float, size))
    return term


def _infer_size(context: ManagerContext, path: str, cfg: ObservationTermCfg) -> int | None:
    """Size of a torch term's values, by calling it once; None if a problem has been added to ``context.problems``."""
    try:
        values = cfg.func(context.owner, **resolve_entities(cfg.params, context.scene.__getitem__))
    except Exception as error:  # the term is the user's code, which may raise anything
        text = f"raised {type(error).__name__}: {error}; it was called once to find its size: fix it, or set 'size'"
        context.problems.append(f"{path}.func: {text}")
        return None
    shape = tuple(values.shape) if isinstance(values, torch.Tensor) else type(values).__name__
    if isinstance(values, torch.Tensor) and values.is_complex():
        context.problems.append(f"{path}.func: returned {values.dtype}, must return real numbers")
        return None
    if shape == (context.num_envs,):
        return 1
    if not isinstance(shape, tuple) or len(shape) != 2 or shape[0] != context.num_envs or shape[1] < 1:
        text = f"returned {shape}, must return (num_envs, size) or (num_envs,) with num_envs = {context.num_envs}"
        context.problems.append(f"{path}.func: {text}")
        return None
    return shape[1]


def _make_picture(
    context: ManagerContext, path: str, cfg: ObservationTermCfg, group: ObservationGroupCfg
) -> ObservationTerm | None:
    """An image term. Its picture is the whole observation and is written by kernels of its own."""
    fields = {k: getattr(group, k) for k in group.__dataclass_fields__ if isinstance(getattr(group, k), type(cfg))}
    if group.normalization is not None or (group.concatenate_terms and len(fields) > 1):
        text = "is a picture: give it a group of its own, without normalization, or set concatenate_terms=False"
        context.problems.append(f"{path}: {text}")
    given = {k: getattr(cfg, k) for k in ("modifiers", "noise", "clip", "scale", "delay_max_lag", "history_length")}
    for name in (k for k, v in given.items() if v):
        context.problems.append(f"{path}.{name}: is set, but it has no effect on pictures; remove it")
    picture = find_picture(context, cfg.params, path)
    if picture is None:
        return None
    height, width, channels = picture.shape
    return ObservationTerm(path, cfg, None, height * width * channels, picture=picture)
