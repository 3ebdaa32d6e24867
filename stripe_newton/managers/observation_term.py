# SPDX-License-Identifier: Apache-2.0
"""Observation term: its config, its call, how many numbers it writes, and where they lie in the memory of its group."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from stripe_kernels.term_info import Each, observation_size
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Code, Name, TermCall, bind_term, code
from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from .context import ManagerContext
from .image import Picture, find_picture, image
from .manager_base import is_warp_term
from .modifiers import ModifierCfg
from .normalization import RunningNormCfg

__all__ = ["ObservationGroupCfg", "ObservationTerm", "ObservationTermCfg", "make_observation_term"]

_FLAT = "is False, but histories are handed out flat; reshape them in the network"


@configclass
class ObservationTermCfg:
    """One observation. Its numbers pass modifiers, noise, clip, scale, delay, history, in this order."""

    func: Callable[..., object] = MISSING
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
    """Terms are joined along their last dimension; only that is supported."""
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


@dataclass
class ObservationTerm:
    """A term of a group, as its config was read.

    Attributes:
        path: Path of its config.
        cfg: The config.
        call: Its call; None for a torch term or a picture.
        size: Numbers that it writes in a step.
        history: Steps that are handed out together; 0 for the present alone.
        picture: The picture that it shows, for one of a camera.
        scratch: Array of its own that it writes first, where the numbers go further from there.
        target: Array of the group, or of the term where it is handed out by itself.
        first: Where its numbers begin in that.
    """

    path: str
    cfg: ObservationTermCfg
    call: TermCall | None
    size: int
    history: int = 0
    picture: Picture | None = None
    scratch: Name | None = None
    target: Name = field(default_factory=lambda: Name(""))
    first: int = 0

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of what is handed out for one environment."""
        return self.picture.shape if self.picture else (self.width,)

    @property
    def width(self) -> int:
        """Numbers that are handed out for one environment, history included."""
        return self.size * max(1, self.history)

    @property
    def parts(self) -> int:
        """Parts of it that do not depend on each other: one for each joint, body or ray; 0 if it is one piece."""
        size = observation_size(self.cfg.func)
        if self.call is None or self.scratch or self.cfg.modifiers or not isinstance(size, Each):
            return 0
        return self.call.counts[size.name] if size.name in self.call.arguments else 0

    @property
    def element(self) -> Code:
        """Source of its number of index ``i``, before history."""
        if self.scratch is not None:
            return code("{}[env, i]", self.scratch)
        return code("{}[env, {} + i]", self.target, self.first) if self.first else code("{}[env, i]", self.target)

    def span(self, first: str, last: str) -> Code:
        """Source of a slice of its numbers in the memory of the group."""
        return code("{}[env, {begin} + {}:{begin} + {}]", self.target, first, last, begin=self.first)


def make_observation_term(
    context: ManagerContext, path: str, cfg: ObservationTermCfg, group: ObservationGroupCfg
) -> ObservationTerm | None:
    """Read the config of a term; None after problems were added to ``context.problems``."""
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
    if not isinstance(size, int) or size < 1:
        context.problems.append(f"{path}.size: is {size!r}, say how many numbers the term writes")
        return None
    if isinstance(cfg.scale, Sequence) and len(cfg.scale) != size:
        context.problems.append(f"{path}.scale: has {len(cfg.scale)} numbers, the term {size}; give one or {size}")
        return None
    history = cfg.history_length if group.history_length is None else group.history_length
    term = ObservationTerm(path, cfg, call, size, history)
    if history or cfg.delay_max_lag or call is None:
        term.scratch = context.scope.name(f"{path}_now", context.array(f"{path}.now", float, size))
    return term


def _make_picture(
    context: ManagerContext, path: str, cfg: ObservationTermCfg, group: ObservationGroupCfg
) -> ObservationTerm | None:
    """A picture, which stands for itself and is written by its own kernels."""
    fields = {k: getattr(group, k) for k in group.__dataclass_fields__ if isinstance(getattr(group, k), type(cfg))}
    if group.normalization is not None or (group.concatenate_terms and len(fields) > 1):
        text = "is a picture: give it a group of its own, without normalization, or set concatenate_terms=False"
        context.problems.append(f"{path}: {text}")
    given = {k: getattr(cfg, k) for k in ("modifiers", "noise", "clip", "scale", "delay_max_lag", "history_length")}
    for name in (k for k, v in given.items() if v):
        context.problems.append(f"{path}.{name}: is set, but pictures are handed out as the camera saw them")
    picture = find_picture(context, cfg.params, path)
    if picture is None:
        return None
    height, width, channels = picture.shape
    return ObservationTerm(path, cfg, None, height * width * channels, picture=picture)
