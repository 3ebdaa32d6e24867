# SPDX-License-Identifier: Apache-2.0
"""Observation manager: groups of observation terms, with noise, history and normalisation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import torch
import warp as wp

from stripe_newton.configclass import config_with
from stripe_newton.fusion import Code, HostFunction, Item, KernelLaunches, Section, code, only

from .context import ManagerContext
from .image import image_writer
from .manager_base import ManagerBase, terms_of, with_terms
from .normalization import running_normalization
from .observation_source import MIN_PARTS_FOR_PARALLEL_NOISE, ObservationSource
from .observation_term import ObservationGroupCfg, ObservationTerm, ObservationTermCfg, make_observation_term
from .shared_observation import SharedObservation

__all__ = ["ObservationManager"]

Allocate = Callable[[str, int], wp.array]
"""Function that makes an array ``(num_envs, size)`` for ``GROUP`` or ``GROUP.TERM``."""
Shape = tuple[int, ...]


class ObservationManager(ManagerBase):
    """Writes each group of observations into one array, or with ``concatenate_terms=False`` each term into its own.

    Attributes:
        buffers: Arrays of shape ``(num_envs, n)`` by group; a dict by term where the terms are not concatenated.
    """

    name = "observations"
    path = "observations"
    """Path of its arrays and parameters."""

    def __init__(self, cfg: object, context: ManagerContext, allocate: Allocate | None = None):
        """Make the terms and their arrays.

        Args:
            cfg: Config or dict of :class:`ObservationGroupCfg`.
            context: The context of the managers.
            allocate: ``allocate(name, size)`` makes the array ``(num_envs, size)`` of ``GROUP`` or ``GROUP.TERM``.
        """
        super().__init__(cfg, context)
        cfg = _grouped(cfg)
        self._groups = self.terms(cfg, ObservationGroupCfg)
        self._terms = {group: self._make_terms(group, group_cfg) for group, group_cfg in self._groups.items()}
        shown = {g: with_terms(c, {n: t.cfg for n, t in self._terms[g].items()}) for g, c in self._groups.items()}
        self.cfg = with_terms(cfg, shown)
        self.buffers: dict[str, wp.array | dict[str, wp.array]] = {}
        self._raw: dict[str, wp.array] = {}
        """Arrays of the groups before normalisation."""
        for group in self._groups:
            self._allocate(group, allocate or (lambda name, size: context.array(f"{self.path}.{name}", float, size)))

    def _make_terms(self, group: str, cfg: ObservationGroupCfg) -> dict[str, ObservationTerm]:
        own = set(ObservationGroupCfg.__dataclass_fields__)
        fields = {k: getattr(cfg, k) for k in cfg.__dataclass_fields__ if k not in own}
        made = {}
        for name, term in self.terms(fields, ObservationTermCfg, f"{self.path}.{group}").items():
            one = make_observation_term(self.context, f"{self.path}.{group}.{name}", term, cfg)
            if one is not None:
                made[name] = one
                self._instances |= one.processing.instances if one.processing is not None else {}
        return made

    def _allocate(self, group: str, allocate: Allocate) -> None:
        """Make the arrays of a group and give its terms their places in them."""
        cfg, terms, name = self._groups[group], self._terms[group], self.context.scope.name
        if not cfg.concatenate_terms:
            arrays = {n: allocate(f"{group}.{n}", t.width) for n, t in terms.items()}
            self.buffers[group] = arrays
            for n, term in terms.items():
                term.target = name(f"obs_{group}_{n}", arrays[n])
            return
        width = sum(t.width for t in terms.values())
        self.buffers[group] = self._raw[group] = allocate(group, width)
        # Normalisation writes to another array: histories have values from before it, which later steps read again.
        if cfg.normalization is not None:
            self._raw[group] = self.context.array(f"{self.path}.{group}.raw", float, width)
        target, first = name(f"obs_{group}", self._raw[group]), 0
        for term in terms.values():
            term.target, term.first = target, first
            first += term.width

    # -- properties

    @property
    def active_terms(self) -> dict[str, list[str]]:
        """Names of the terms by group."""
        return {group: list(terms) for group, terms in self._terms.items()}

    @property
    def group_obs_dim(self) -> dict[str, Shape | list[Shape]]:
        """Shape of each group for one environment; a list of shapes where its terms are not concatenated."""
        return {
            g: [self.shape(g, t) for t in buffer] if isinstance(buffer, dict) else self.shape(g)
            for g, buffer in self.buffers.items()
        }

    def shape(self, group: str, term: str | None = None) -> Shape:
        """Shape of a group, or of a term that is not concatenated, for one environment; three numbers for a picture."""
        terms = self._terms[group]
        alone = next(iter(terms.values())) if term is None and len(terms) == 1 else terms.get(term or "")
        if alone is not None and alone.picture:
            return alone.shape
        return (sum(t.width for t in terms.values()) if term is None else terms[term].width,)

    @property
    def group_obs_term_dim(self) -> dict[str, list[Shape]]:
        """Shape of each term by group, history included."""
        return {g: [t.shape for t in terms.values()] for g, terms in self._terms.items()}

    def flat_buffers(self) -> dict[str, wp.array]:
        """All arrays by ``GROUP`` or ``GROUP.TERM``."""
        flat: dict[str, wp.array] = {}
        for group, buffer in self.buffers.items():
            flat |= {f"{group}.{n}": b for n, b in buffer.items()} if isinstance(buffer, dict) else {group: buffer}
        return flat

    # -- between steps

    def compute(self) -> dict[str, torch.Tensor | dict[str, torch.Tensor]]:
        """Observations of the present state by group; a dict by term where the terms are not concatenated.

        In histories and delays the present values take the place of the last ones. So right after a step they are those
        of the step, but for noise, which is drawn anew, and for modifiers, which go on from their state. Histories,
        statistics, random streams and states of terms stay as they are.
        """
        with self._outside.computed("observations", partial(self.compute_items, again=True), self.instance_states()):
            return {group: self._copied(group, buffer) for group, buffer in self.buffers.items()}

    def _copied(self, group: str, buffer: wp.array | dict[str, wp.array]) -> torch.Tensor | dict[str, torch.Tensor]:
        if isinstance(buffer, dict):
            return {k: self.context.torch(v).clone().view(-1, *self.shape(group, k)) for k, v in buffer.items()}
        return self.context.torch(buffer).clone().view(-1, *self.shape(group))

    # -- items

    def compute_items(self, where_reset: bool = False, again: bool = False) -> list[Item]:
        """Items that write all groups.

        Args:
            where_reset: Write them only where an episode just ended, before these environments are reset.
            again: Replace the last values in delays and histories, and leave the statistics of normalisation.
        """
        # A term that several groups share is written with the first group that has it. So all groups are read before
        # their sections are made.
        shared: list[SharedObservation] = []
        gather = not where_reset and not again
        groups = [self._group_items(group, shared, gather, again) for group in self._terms]
        items = [item for group in groups for item in group.items()]
        return only(items, self.context.is_reset) if where_reset else items

    def _group_items(self, group: str, shared: list[SharedObservation], gather: bool, again: bool) -> _GroupItems:
        """Items of one group. Wide terms join an equal one in ``shared``, or are added to it for later groups."""
        corrupt, made, parts = self._groups[group].enable_corruption, _GroupItems(group), 0
        for name, term in self._terms[group].items():
            if term.picture:
                array = self.context.scope.values[term.target.text]
                write = image_writer(term.picture, array, term.first)
                made.first.append(KernelLaunches(name, write, [name], fields=frozenset()))
                continue
            if term.values is not None:
                made.first.append(
                    HostFunction("observations", self._torch(term, term.values), f"torch term '{name}'", [name])
                )
            source = ObservationSource(self.context, term, corrupt, again)
            if source.parts >= MIN_PARTS_FOR_PARALLEL_NOISE:
                if not any(other.add(f"{group}.{name}", term, source) for other in shared):
                    made.shared.append(SharedObservation(group, name, term, source))
                    shared.append(made.shared[-1])
                continue
            made.names.append(name)
            lines, count = source.lines(parts)
            made.body += [code("# {}", name), *lines] if lines else []
            parts += count
        made.parts = parts
        norm = self._groups[group].normalization
        if norm is not None:
            arrays = self._raw[group], self.buffers[group]
            made.last.append(running_normalization(self.context, group, norm, *arrays, gather=gather))
        return made

    def reset_items(self) -> list[Item]:
        """Items that draw biases and lags where an episode begins, and mark histories for refilling."""
        body: list[Code] = []
        for group, terms in self._terms.items():
            corrupt = self._groups[group].enable_corruption
            for term in terms.values():
                body += ObservationSource(self.context, term, corrupt).reset()
        return [Section("observations_reset", body).only(self.context.is_reset)] if body else []

    def _torch(self, term: ObservationTerm, call: Callable[[], torch.Tensor]) -> Callable[[], None]:
        shape = self.context.num_envs, term.size
        target, first = (term.scratch, 0) if term.scratch else (term.target, term.first)

        def evaluate() -> None:
            values = call()
            if term.size == 1 and values.dim() == 1:
                values = values.unsqueeze(-1)
            if tuple(values.shape) != shape:
                raise ValueError(
                    f"{term.path}: returned shape {tuple(values.shape)}, must be (num_envs, size) = {shape}"
                )
            if term.processing is not None:
                values = term.processing(values)
            self.context.torch(self.context.scope.values[target.text])[:, first : first + term.size] = values

        return evaluate

    def __str__(self) -> str:
        rows = [(g, i, n, t.width) for g, terms in self._terms.items() for i, (n, t) in enumerate(terms.items())]
        return self.table("Observation terms", ("Group", "Index", "Name", "Size"), rows)


def _grouped(cfg: object) -> object:
    """The config; where it has terms without a group, a dict in which these are the group of the policy."""
    groups = terms_of(cfg)
    loose = {name: term for name, term in groups.items() if isinstance(term, ObservationTermCfg)}
    if not loose or "policy" in groups:  # both of them are an error, which the terms in place of groups will be
        return cfg
    policy = config_with(ObservationGroupCfg(enable_corruption=True), loose)
    return {"policy": policy, **{name: group for name, group in groups.items() if name not in loose}}


@dataclass
class _GroupItems:
    """Items of one group, under construction."""

    group: str
    first: list[Item] = field(default_factory=list)
    """Pictures, and torch terms, whose values must exist before noise and history use them."""
    body: list[Code] = field(default_factory=list)
    names: list[str] = field(default_factory=list)
    parts: int = 0
    shared: list[SharedObservation] = field(default_factory=list)
    last: list[Item] = field(default_factory=list)

    def items(self) -> list[Item]:
        own = Section(f"observations_{self.group}", self.body, self.names, parts=self.parts)
        return [*self.first, own, *(s.section() for s in self.shared), *self.last]
