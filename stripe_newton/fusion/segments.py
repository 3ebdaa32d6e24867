# SPDX-License-Identifier: Apache-2.0
"""Segments: a step, divided at its host functions, with neighbouring sections fused into kernels.

Within a segment there is no Python between the kernels, so that it can be recorded as one CUDA graph:

>>> from stripe_newton.fusion import HostFunction, KernelLaunches, Scope, Section, Stage, code
>>> from stripe_newton.fusion.segments import segments_of
>>> def section(name):
...     return Section(name, [code("pass")])
>>> nothing = lambda: None
>>> stages = [
...     Stage("actions", [section("actions")]),
...     Stage("physics", [KernelLaunches("solver", nothing)]),
...     Stage("outcome", [section("rewards"), section("reset"), HostFunction("hook", nothing, "torch")]),
...     Stage("observations", [section("observations")]),
... ]
>>> for segment in segments_of("step", stages, Scope(), num_envs=2, device="cpu"):
...     print(segment.host.name if segment.host else [operation.name for operation in segment.operations])
['step_actions', 'solver', 'step_outcome']
hook
['step_observations']
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from .fused_kernel import FusedKernel, fuse
from .host_function import HostFunction
from .scope import Scope
from .section import Section
from .stage import KernelLaunches, Stage

__all__ = ["Operation", "Segment", "segments_of"]


@dataclass(frozen=True)
class Operation:
    """A fused kernel, or a function that launches kernels."""

    stages: tuple[str, ...]
    """The stages that it belongs to: a fused kernel may have sections of several."""
    name: str
    """Its name, for errors."""
    launch: Callable[[], None]
    """Launches it on the current stream."""
    fused: FusedKernel | None = None
    """The kernel, if it is one."""
    concurrent: bool = False
    """Whether later operations of its graph may run at the same time."""


@dataclass
class Segment:
    """Consecutive operations without a host function among them, or one host function."""

    operations: list[Operation] = field(default_factory=list)
    """The operations, in order; empty for a host function."""
    host: HostFunction | None = None
    """The host function."""
    stage: str = ""
    """Its stage."""

    @property
    def is_capturable(self) -> bool:
        """Whether it may be a part of a graph now."""
        return self.host is None or (self.host.part is not None and self.host.part.is_capturable)


def segments_of(name: str, stages: Sequence[Stage], scope: Scope, num_envs: int, device: str) -> list[Segment]:
    """Divide stages at the host functions, and fuse consecutive sections that can be one kernel.

    Args:
        name: Beginning of the names of the kernels.
        stages: The step.
        scope: Arrays, structs and functions by the names that sections use.
        num_envs: Number of environments.
        device: Device of the kernels.
    """
    return _SegmentBuilder(name, scope, num_envs, device).build(stages)


class _SegmentBuilder:
    """Adds the items of the stages one by one, and ends a kernel where the next item cannot join it."""

    def __init__(self, name: str, scope: Scope, num_envs: int, device: str):
        self._name, self._scope, self._num_envs, self._device = name, scope, num_envs, device
        self._segments = [Segment()]
        self._pending: list[tuple[str, Section]] = []
        """Sections of the kernel under construction, with their stages."""
        self._deferred: list[Operation] = []
        """Concurrent launches, to be placed behind that kernel."""

    def build(self, stages: Sequence[Stage]) -> list[Segment]:
        for stage in stages:
            for item in stage.items:
                if isinstance(item, Section):
                    self._add_section(stage.name, item)
                elif isinstance(item, KernelLaunches):
                    self._add_launches(stage.name, item)
                else:
                    self._flush()
                    self._segments += [Segment(host=item, stage=stage.name), Segment()]
        self._flush()
        return [s for s in self._segments if s.operations or s.host]

    def _add_section(self, stage: str, section: Section) -> None:
        if not section.body:
            return
        if self._pending and not _can_share_kernel(self._pending[-1], (stage, section)):
            self._flush()
        self._pending.append((stage, section))

    def _add_launches(self, stage: str, item: KernelLaunches) -> None:
        operation = Operation((stage,), item.name, item.function, concurrent=item.concurrent)
        if item.concurrent and self._pending:
            # The sections after it need not wait for it, so they may join the kernel before it: one launch less.
            self._deferred.append(operation)
            return
        self._flush()
        self._segments[-1].operations.append(operation)

    def _flush(self) -> None:
        """End the kernel under construction."""
        if self._pending:
            stages = tuple(dict.fromkeys(stage for stage, _ in self._pending))
            title = "_".join([self._name, *stages]).replace(" ", "_")
            fused = fuse(title, [s for _, s in self._pending], self._scope, self._num_envs, self._device)
            self._segments[-1].operations.append(Operation(stages, title, fused.launch, fused))
            self._pending.clear()
        self._segments[-1].operations += self._deferred
        self._deferred.clear()


def _can_share_kernel(before: tuple[str, Section], after: tuple[str, Section]) -> bool:
    """Whether two neighbouring sections may be in one kernel."""
    if before[1].parts and after[1].parts:
        # Parts of one stage do not depend on each other. Parts of the next stage may depend on any part of this one,
        # and the threads of a launch do not wait for each other.
        return before[0] == after[0]
    # A section without parts is run by one thread of its environment, and no other thread of the launch waits for it.
    return not before[1].parts and not after[1].parts
