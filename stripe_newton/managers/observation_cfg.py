# SPDX-License-Identifier: Apache-2.0
"""Configs of observation groups and terms."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg

__all__ = [
    "DigitalFilterCfg",
    "IntegratorCfg",
    "ModifierCfg",
    "ObservationGroupCfg",
    "ObservationTermCfg",
    "RunningNormCfg",
]

_FLAT = "is False, but histories are handed out flat; reshape them in the network"


@configclass
class ModifierCfg:
    """A change of each number of a term: ``func(env, value, ...) -> float``, a Warp function."""

    func: Callable[..., Any] | None = None
    """The function."""
    params: dict[str, Any] = {}
    """Its further arguments."""


@configclass
class DigitalFilterCfg(ModifierCfg):
    """``y_n = sum_k B_k x_{n-k} - sum_k A_{k+1} y_{n-1-k}``; all past values are those of the first step at a reset."""

    A: Sequence[float] = ()
    """Feedback coefficients; without any the filter has a finite response."""
    B: Sequence[float] = (1.0,)
    """Feed-forward coefficients, one or more."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.B:
            yield "B", "is empty, must have the coefficient of the present value at least"


@configclass
class IntegratorCfg(ModifierCfg):
    """``y_n = y_{n-1} + (x_n + x_{n-1}) / 2 dt``, zero at the start of an episode."""

    dt: float = MISSING
    """Time step [s]."""


@configclass
class RunningNormCfg:
    """Normalisation by the mean and variance of all that was seen: ``clamp((x - mean) / (std + eps), -clip, clip)``."""

    eps: float = 1.0e-2
    """Added to the standard deviation."""
    clip: float = 10.0
    """Bound of what is handed out."""
    update: bool = True
    """Whether statistics go on being gathered; parameter ``observations.GROUP.normalization.update``."""


@configclass
class ObservationTermCfg:
    """One observation. Its numbers pass modifiers, noise, clip, scale, delay, history, in this order."""

    func: Callable[..., Any] = MISSING
    """Warp function ``(env, ..., out)``, or torch function ``(env, **params)`` that returns ``(num_envs, size)``."""
    params: dict[str, Any] = {}
    """Its further arguments."""
    size: int | Callable[[Mapping[str, int]], int] | None = None
    """Numbers it writes, or a function of the lengths of its index arrays; known for the terms of ``mdp``."""
    modifiers: Sequence[ModifierCfg] = ()
    """What is done to each number first."""
    noise: NoiseCfg | NoiseModelCfg | None = None
    """Noise; a model with bias draws the bias at the start of an episode."""
    clip: tuple[float, float] | None = None
    """Bounds."""
    scale: float | Sequence[float] | None = None
    """Factor, or one a number."""
    delay_min_lag: int = 0
    """Least delay [steps]."""
    delay_max_lag: int = 0
    """Largest delay [steps]; each episode draws one within the bounds."""
    history_length: int = 0
    """Steps that are handed out together, oldest first; 0 for the present alone."""
    flatten_history_dim: bool = True
    """Whether the steps lie side by side in one dimension; only that is supported."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.clip is not None and not (len(self.clip) == 2 and self.clip[0] <= self.clip[1]):
            yield "clip", f"is {self.clip}, must be (low, high) with low <= high"
        if not 0 <= self.delay_min_lag <= self.delay_max_lag:
            bounds = f"({self.delay_min_lag}, {self.delay_max_lag})"
            yield "delay_min_lag", f"lags are {bounds}, must be 0 <= delay_min_lag <= delay_max_lag"
        if self.history_length < 0:
            yield "history_length", f"is {self.history_length}, must be 0 or more"
        if not self.flatten_history_dim:
            yield "flatten_history_dim", _FLAT


@configclass
class ObservationGroupCfg:
    """A group of observations, such as what the policy or the critic sees; its further fields are the terms."""

    concatenate_terms: bool = True
    """One tensor for the group, rather than a dict of its terms."""
    concatenate_dim: int = -1
    """Accepted for compatibility: terms are joined along their last dimension."""
    enable_corruption: bool = False
    """Whether the noise of the terms is applied."""
    history_length: int | None = None
    """Overrides that of the terms."""
    flatten_history_dim: bool = True
    """See :class:`ObservationTermCfg`."""
    normalization: RunningNormCfg | None = None
    """Running normalisation of the whole group."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.concatenate_dim != -1:
            yield "concatenate_dim", f"is {self.concatenate_dim}, only the last dimension (-1) is supported"
        if self.normalization is not None and not self.concatenate_terms:
            yield "normalization", "is set, but concatenate_terms is False; a normalised group is one tensor"
        if self.history_length is not None and self.history_length < 0:
            yield "history_length", f"is {self.history_length}, must be 0 or more"
        if not self.flatten_history_dim:
            yield "flatten_history_dim", _FLAT
