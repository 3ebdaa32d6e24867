# SPDX-License-Identifier: Apache-2.0
"""What policy and critic see."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
import warp as wp

from stripe_kernels.mdp import OBSERVATION_SIZES
from stripe_kernels.mdp.contact import CONTACT_OBSERVATION_SIZES
from stripe_kernels.mdp.imu import IMU_OBSERVATION_SIZES
from stripe_kernels.mdp.objects import OBJECT_OBSERVATION_SIZES
from stripe_kernels.mdp.observations import Each
from stripe_kernels.mdp.obstacles import OBSTACLE_OBSERVATION_SIZES
from stripe_kernels.mdp.randomization_encoder import ENCODER_OBSERVATION_SIZES
from stripe_kernels.mdp.scan import SCAN_OBSERVATION_SIZES
from stripe_newton.fusion import Captured, Eager, Item, Section, TermCall, bind_term
from stripe_newton.noise import NoiseModelCfg, NoiseModelWithAdditiveBiasCfg

from .context import ManagerContext
from .image import image, image_shape, image_source, image_writer
from .manager_base import ManagerBase, is_warp_term
from .modifiers import modified
from .normalization import running_normalization
from .observation_cfg import ObservationGroupCfg, ObservationTermCfg
from .processing import delayed, noisy, sampled

__all__ = ["ObservationManager"]

_TUNED = re.compile(r"\w*parameters\[\d+\]")
_OWN_STREAMS = 32
"""From so many independent parts on, each part of a noisy term too has its own thread, and its own random streams;
neighbouring threads are then its parts."""


@dataclass
class _Term:
    path: str
    cfg: ObservationTermCfg
    call: TermCall | None
    size: int
    history: int
    target: str = ""
    first: int = 0
    scratch: str = ""
    picture: tuple[wp.array, bool] | None = None
    """What an image term shows, and whether that is normalised."""

    @property
    def shape(self) -> tuple[int, ...]:
        return image_shape(self.picture[0]) if self.picture else (self.width,)

    @property
    def width(self) -> int:
        return self.size * max(1, self.history)


class _Wide:
    """A section of a term whose parts have their own threads, and of terms of other groups that compute the same.

    Those copy its numbers before noise, clip and scale, which are each term's own; while a parameter of theirs has
    another value they compute themselves.
    """

    def __init__(self, term: _Term, call: str, process: list[str], section: Section):
        self._term, self._call, self._copies, self._process = term, call, list[str](), process
        self.section = section
        self._write()

    def takes(self, term: _Term, count: int, where: str, call: str, process: list[str]) -> bool:
        """Add a term, if it computes the same; ``where`` is its element of index ``i``."""
        tuned = _tuned_apart(self._term.call, term.call)
        if tuned is None or count != self.section.parts or term.size != self._term.size:
            return False
        size = term.size // count
        self._copies += [f"for i in range(k * {size}, (k + 1) * {size}):", f"    {where} = {_element(self._term)}"]
        if tuned:
            self._copies += [f"if {' or '.join(f'{a} != {b}' for a, b in tuned)}:", f"    {call}"]
        self._process += process
        self.section.terms = [*self.section.terms, term.path.partition(".")[2]]
        self._write()
        return True

    def _write(self) -> None:
        self.section.body = ["k = part", self._call, *self._copies, *self._process]


class ObservationManager(ManagerBase):
    """Writes each group of observations into one array; with ``concatenate_terms=False`` into one a term."""

    name = "observations"

    def __init__(self, cfg: Any, context: ManagerContext, allocate: Callable[[str, int], wp.array] | None = None):
        """``allocate(name, size)`` makes the array ``(num_envs, size)`` of a group, or of ``GROUP.TERM``."""
        super().__init__(cfg, context)
        self._groups: dict[str, ObservationGroupCfg] = self.terms(cfg, ObservationGroupCfg)
        self._terms: dict[str, dict[str, _Term]] = {}
        self.buffers: dict[str, Any] = {}
        """Arrays by group; a dict by term where the terms are not concatenated."""
        self._raw: dict[str, wp.array] = {}
        allocate = allocate or (lambda name, size: context.array(f"observations.{name}", float, size))
        common = set(ObservationGroupCfg.__dataclass_fields__)
        for group, group_cfg in self._groups.items():
            fields = {k: getattr(group_cfg, k) for k in group_cfg.__dataclass_fields__ if k not in common}
            made = {}
            for name, term in self.terms(fields, ObservationTermCfg, f"observations.{group}").items():
                one = self._make(f"observations.{group}.{name}", term, group_cfg)
                if one is not None:
                    made[name] = one
            self._terms[group] = made
            self._allocate(group, group_cfg, made, allocate)

    def _make(self, path: str, cfg: ObservationTermCfg, group: ObservationGroupCfg) -> _Term | None:
        context, call = self.context, None
        if cfg.func is image:
            return self._make_image(path, cfg, group)
        size: Any = cfg.size
        if is_warp_term(cfg.func):
            call = bind_term(context, cfg.func, cfg.params, path, "observation")
            if call is None:
                return None
            size = _known_size(cfg.func) if size is None else size
            if callable(size):
                size = size(call.counts)
        if not isinstance(size, int) or size < 1:
            context.problems.append(f"{path}.size: is {size!r}, say how many numbers the term writes")
            return None
        if isinstance(cfg.scale, Sequence) and len(cfg.scale) != size:
            context.problems.append(f"{path}.scale: has {len(cfg.scale)} numbers, the term {size}; give one or {size}")
            return None
        history = cfg.history_length if group.history_length is None else group.history_length
        term = _Term(path, cfg, call, size, history)
        if history or cfg.delay_max_lag or call is None:
            term.scratch = context.scope.name(f"{path}_now", context.array(f"{path}.now", float, size))
        return term

    def _make_image(self, path: str, cfg: ObservationTermCfg, group: ObservationGroupCfg) -> _Term | None:
        """A picture, which stands for itself and is written by its own kernels."""
        fields = {k: getattr(group, k) for k in group.__dataclass_fields__ if isinstance(getattr(group, k), type(cfg))}
        if group.normalization is not None or (group.concatenate_terms and len(fields) > 1):
            text = "is a picture: give it a group of its own, without normalization, or set concatenate_terms=False"
            self.context.problems.append(f"{path}: {text}")
        given = {k: getattr(cfg, k) for k in ("modifiers", "noise", "clip", "scale", "delay_max_lag", "history_length")}
        for name in (k for k, v in given.items() if v):
            self.context.problems.append(f"{path}.{name}: is set, but pictures are handed out as the camera saw them")
        picture = image_source(self.context, cfg.params, path)
        if picture is None:
            return None
        height, width, channels = image_shape(picture[0])
        return _Term(path, cfg, None, height * width * channels, 0, picture=picture)

    def _allocate(
        self, group: str, cfg: ObservationGroupCfg, terms: dict[str, _Term], allocate: Callable[[str, int], wp.array]
    ) -> None:
        name = self.context.scope.name
        if not cfg.concatenate_terms:
            self.buffers[group] = {n: allocate(f"{group}.{n}", t.width) for n, t in terms.items()}
            for n, term in terms.items():
                term.target = name(f"obs_{group}_{n}", self.buffers[group][n])
            return
        width = sum(t.width for t in terms.values())
        self.buffers[group] = self._raw[group] = allocate(group, width)
        if cfg.normalization is not None:  # histories are kept as they were before it
            self._raw[group] = self.context.array(f"observations.{group}.raw", float, width)
        target, first = name(f"obs_{group}", self._raw[group]), 0
        for term in terms.values():
            term.target, term.first = target, first
            first += term.width

    # -- what it is

    @property
    def active_terms(self) -> dict[str, list[str]]:  # type: ignore[override]
        """Names of the terms by group."""
        return {group: list(terms) for group, terms in self._terms.items()}

    @property
    def group_obs_dim(self) -> dict[str, Any]:
        """Shape of each group for one environment; a list of shapes where its terms are not concatenated."""
        return {
            g: [self.shape(g, t) for t in buffer] if isinstance(buffer, dict) else self.shape(g)
            for g, buffer in self.buffers.items()
        }

    def shape(self, group: str, term: str | None = None) -> tuple[int, ...]:
        """Shape of a group, or of a term that is handed out by itself, for one environment; a picture's has three."""
        terms = self._terms[group]
        alone = next(iter(terms.values())) if term is None and len(terms) == 1 else terms.get(term or "")
        if alone is not None and alone.picture:
            return alone.shape
        buffer = self.buffers[group] if term is None else self.buffers[group][term]
        return (buffer.shape[1],)

    @property
    def group_obs_term_dim(self) -> dict[str, list[tuple[int, ...]]]:
        """Shape of each term by group, history included."""
        return {g: [t.shape for t in terms.values()] for g, terms in self._terms.items()}

    def flat_buffers(self) -> dict[str, wp.array]:
        """All arrays by ``GROUP`` or ``GROUP.TERM``."""
        flat: dict[str, wp.array] = {}
        for group, buffer in self.buffers.items():
            flat |= {f"{group}.{n}": b for n, b in buffer.items()} if isinstance(buffer, dict) else {group: buffer}
        return flat

    # -- items

    def compute(self, where_reset: bool = False) -> list[Item]:
        """Items that write all groups.

        Args:
            where_reset: Only in the environments whose episode just ended, which must not have been reset yet.
        """
        items, wide = list[Item](), list[_Wide]()
        for group, terms in self._terms.items():
            corrupt, body, parts, own = self._groups[group].enable_corruption, list[str](), 0, list[str]()
            first = len(wide)
            for name, term in terms.items():
                if term.picture:
                    array = self.context.scope.values[term.target]
                    items.append(Captured(name, image_writer(*term.picture, array, term.first), [name]))
                    continue
                if term.call is None:
                    items.append(Eager("observations", self._torch(term), f"torch term '{name}'", [name]))
                count = self._independent(term, corrupt)
                if count >= _OWN_STREAMS:
                    call, process = self._part(term, corrupt, count)
                    if not any(w.takes(term, count, _element(term), call, process) for w in wide):
                        title = f"observations_{group}_{name}"
                        section = Section(title, [], [name], where_reset, parts=count, neighbours=True)
                        wide.append(_Wide(term, call, process, section))
                    continue
                own.append(name)
                lines, count = self._lines(term, corrupt, parts, count)
                if lines:
                    body += [f"# {name}", *lines]
                    parts += count
            if own or not terms:
                items.append(Section(f"observations_{group}", body, own, where_reset, parts=parts))
            items += [w.section for w in wide[first:]]
            norm = self._groups[group].normalization
            if norm is not None:
                buffers = self._raw[group], self.buffers[group]
                items.append(running_normalization(self.context, group, norm, *buffers, gather=not where_reset))
        return items

    def reset(self) -> list[Item]:
        """Items that start episodes: biases and lags are drawn, histories wait for the first observation."""
        body: list[str] = []
        for group, terms in self._terms.items():
            for term in terms.values():
                if term.cfg.delay_max_lag:
                    body += delayed(self.context, term.path, term.size, term.cfg).reset()
                if term.history or term.cfg.modifiers:
                    body.append(f"{self._fresh(term)}[env] = 1")
                noise = term.cfg.noise
                if isinstance(noise, NoiseModelWithAdditiveBiasCfg) and self._groups[group].enable_corruption:
                    body += self._draw_bias(term, noise)
        return [Section("observations_reset", body, where_reset=True)] if body else []

    def _independent(self, term: _Term, corrupt: bool) -> int:
        """How many parts of a term can have a thread each, one for each joint, body or ray; 0 if it is one piece."""
        call, kind = term.call, _known_size(term.cfg.func)
        if call is None or term.scratch or term.cfg.modifiers or not isinstance(kind, Each):
            return 0
        count = call.counts[kind.name] if kind.name in call.names else 0
        return 0 if corrupt and term.cfg.noise is not None and count < _OWN_STREAMS else count

    def _part(self, term: _Term, corrupt: bool, count: int) -> tuple[str, list[str]]:
        """The call of part ``k`` of a term, and the lines after it."""
        kind, call = _known_size(term.cfg.func), term.call
        assert call is not None
        first, last = f"k * {kind.size}", f"(k + 1) * {kind.size}"
        line = call.expression(self._slice(term, first, last), sliced=(kind.name,), span="k:k + 1")
        return line, self._process(term, corrupt, first, last, streams=count)

    def _lines(self, term: _Term, corrupt: bool, part: int, count: int) -> tuple[list[str], int]:
        """Lines of a term in the section of its group, whose ``count`` parts begin at ``part``; and their number."""
        if count:
            call, process = self._part(term, corrupt, count)
            body = [f"k = part - {part}", call, *process]
            return [f"if part >= {part} and part < {part + count}:", *_indent(body)], count
        place = f"{term.scratch}[env]" if term.scratch else self._slice(term, "0", str(term.width))
        lines = [term.call.expression(place)] if term.call is not None else []
        lines += self._process(term, corrupt, "0", str(term.size))
        return ([f"if part == {part}:", *_indent(lines)], 1) if lines else ([], 0)

    def _slice(self, term: _Term, first: str, last: str) -> str:
        return f"{term.target}[env, {term.first} + {first}:{term.first} + {last}]"

    def _fresh(self, term: _Term) -> str:
        return self.context.scope.name(f"{term.path}_fresh", self.context.array(f"{term.path}.fresh", int, fill=1))

    def _process(self, term: _Term, corrupt: bool, first: str, last: str, streams: int = 1) -> list[str]:
        """Lines after the call of the term: its numbers from ``first`` to ``last``, then delay and history.

        Noise draws from a stream of the term's, or where it has several from the one of part ``k``.
        """
        context, cfg, element = self.context, term.cfg, _element(term)
        lines: list[str] = []
        for index, modifier in enumerate(cfg.modifiers):
            lines += modified(
                context, f"{term.path}.modifiers.{index}", modifier, term.size, element, self._fresh(term)
            )
        noise = cfg.noise
        if noise is not None and corrupt:
            model = noise.noise_cfg if isinstance(noise, NoiseModelCfg) else noise
            rng = context.scope.name(f"{term.path}_rng", context.stream(f"{term.path}.rng", streams))
            stream = f"env * {streams} + k" if streams > 1 else "env"
            lines += noisy(context, f"{term.path}.noise", model, term.size, element, rng, stream)
            if isinstance(noise, NoiseModelWithAdditiveBiasCfg):
                lines.append(f"{element} = {element} + {self._bias(term, noise)}")
        if cfg.clip is not None:
            low, high = (
                context.parameters.add(f"{term.path}.clip.{n}", v, float)
                for n, v in zip(("low", "high"), cfg.clip, strict=True)
            )
            lines.append(f"{element} = wp.clamp({element}, {low}, {high})")
        if cfg.scale is not None:
            lines.append(f"{element} = {element} * {self._scale(term)}")
        out = [f"for i in range({first}, {last}):", *(f"    {line}" for line in lines)] if lines else []
        if cfg.delay_max_lag:
            out += delayed(context, term.path, term.size, cfg).step(element)
        if term.history:
            out += self._push(term, element)
        elif term.scratch:
            out += [f"for i in range({term.size}):", f"    {term.target}[env, {term.first} + i] = {element}"]
        if cfg.modifiers and not term.history:
            out.append(f"{self._fresh(term)}[env] = 0")
        return out

    def _scale(self, term: _Term) -> str:
        scale = term.cfg.scale
        if not isinstance(scale, Sequence):
            return self.context.parameters.add(f"{term.path}.scale", scale, float)
        array = self.context.shared(f"{term.path}.scale", float, term.size)
        self.context.torch(array)[:] = torch.tensor([float(s) for s in scale])
        return f"{self.context.scope.name(f'{term.path}_scale', array)}[i]"

    def _push(self, term: _Term, element: str) -> list[str]:
        """The history, oldest first; a new episode fills it with its first observation."""
        fresh, size, target, first = self._fresh(term), term.size, term.target, term.first
        return [
            f"for i in range({size}):",
            f"    for k in range({term.history - 1}):",
            f"        {target}[env, {first} + k * {size} + i] = "
            f"wp.where({fresh}[env] != 0, {element}, {target}[env, {first} + (k + 1) * {size} + i])",
            f"    {target}[env, {first} + {(term.history - 1) * size} + i] = {element}",
            f"{fresh}[env] = 0",
        ]

    def _bias(self, term: _Term, cfg: NoiseModelWithAdditiveBiasCfg) -> str:
        count = term.size if cfg.sample_bias_per_component else 1
        array = self.context.array(f"{term.path}.bias", float, count)
        return f"{self.context.scope.name(f'{term.path}_bias', array)}[env, {'i' if count > 1 else 0}]"

    def _draw_bias(self, term: _Term, cfg: NoiseModelWithAdditiveBiasCfg) -> list[str]:
        count = term.size if cfg.sample_bias_per_component else 1
        draw = sampled(self.context, f"{term.path}.bias_noise", cfg.bias_noise_cfg, count)
        if cfg.bias_noise_cfg.operation == "scale":
            draw = "0.0"  # a bias is its noise applied to zero
        return [f"for i in range({count}):", f"    {self._bias(term, cfg)} = {draw}"]

    def _torch(self, term: _Term) -> Callable[[], None]:
        call, shape = self.torch_term(term.cfg.func, term.cfg.params), (self.context.num_envs, term.size)
        target, first = (term.scratch, 0) if term.scratch else (term.target, term.first)

        def evaluate() -> None:
            values = call()
            if tuple(values.shape) != shape:
                raise ValueError(
                    f"{term.path}: returned shape {tuple(values.shape)}, must be (num_envs, size) = {shape}"
                )
            self.context.torch(self.context.scope.values[target])[:, first : first + term.size] = values

        return evaluate

    def __str__(self) -> str:
        rows = [(g, i, n, t.width) for g, terms in self._terms.items() for i, (n, t) in enumerate(terms.items())]
        return self.table("Observation terms", ("Group", "Index", "Name", "Size"), rows)


def _element(term: _Term) -> str:
    if term.scratch:
        return f"{term.scratch}[env, i]"
    return f"{term.target}[env, {term.first} + i]" if term.first else f"{term.target}[env, i]"


def _tuned_apart(one: TermCall | None, other: TermCall | None) -> list[tuple[str, str]] | None:
    """Pairs of parameters in which two calls may differ; None if they differ otherwise."""
    if one is None or other is None or one.function != other.function or len(one.arguments) != len(other.arguments):
        return None
    apart = [(a, b) for a, b in zip(one.arguments, other.arguments, strict=True) if a != b]
    return apart if all(_TUNED.fullmatch(a) and _TUNED.fullmatch(b) for a, b in apart) else None


def _indent(lines: list[str]) -> list[str]:
    return [f"    {line}" for line in lines]


def _known_size(func: Any) -> Any:
    """How many numbers a term of the package writes, as a function of the lengths of its index arrays."""
    known = OBSERVATION_SIZES | OBJECT_OBSERVATION_SIZES | SCAN_OBSERVATION_SIZES
    known = known | CONTACT_OBSERVATION_SIZES | IMU_OBSERVATION_SIZES | ENCODER_OBSERVATION_SIZES
    known = known | OBSTACLE_OBSERVATION_SIZES
    function = getattr(func, "func", None)
    if function is None or not function.__module__.startswith("stripe_kernels."):
        return None
    return known.get(function.__name__)
