# SPDX-License-Identifier: Apache-2.0
"""A step as a list of stages: what of it is fused, what is captured, what runs on the host."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import warp as wp

from stripe_newton.sim.capture import capture_graph

from .items import Captured, Eager, Item, Section
from .kernels import FusedKernel, fuse
from .scope import Scope

__all__ = ["GraphCaptureError", "Plan", "Stage"]


class GraphCaptureError(RuntimeError):
    """Work that was promised to be one CUDA graph cannot be recorded as one."""


@dataclass
class Stage:
    """A named part of a step."""

    name: str
    items: Sequence[Item]
    note: str = ""
    """Said in the description where there are no items."""


@dataclass
class _Operation:
    stage: str
    name: str
    launch: Callable[[], None]
    fused: FusedKernel | None = None
    beside: bool = False


@dataclass
class _Segment:
    """Operations between two interruptions by the host."""

    operations: list[_Operation] = field(default_factory=list)
    eager: Eager | None = None
    stage: str = ""
    graph: wp.Graph | None = None


class Plan:
    """Runs the stages of a step in order; what lies between two host functions is one CUDA graph.

    The first run is eager and loads the kernels, then the graphs are recorded. On the CPU, and without
    ``use_graph``, the same kernels run one by one.
    """

    def __init__(self, name: str, stages: Sequence[Stage], scope: Scope, num_envs: int, device: str, use_graph: bool):
        self.name, self.stages = name, list(stages)
        self.captures = use_graph and device != "cpu"
        """Whether it is replayed as graphs."""
        self._device, self._scope, self._num_envs = device, scope, num_envs
        self._streams: list[wp.Stream] = []
        self._segments = self._cut()
        self._ready = False

    def _cut(self) -> list[_Segment]:
        segments = [_Segment()]
        waiting: list[tuple[str, Section]] = []
        held: list[_Operation] = []

        def flush() -> None:
            if waiting:
                stages = list(dict.fromkeys(stage for stage, _ in waiting))
                title = "_".join([self.name, *stages]).replace(" ", "_")
                fused = fuse(title, [s for _, s in waiting], self._scope, self._num_envs, self._device)
                segments[-1].operations.append(_Operation(" + ".join(stages), title, fused.launch, fused))
                waiting.clear()
            segments[-1].operations.extend(held)
            held.clear()

        for stage in self.stages:
            for item in stage.items:
                if isinstance(item, Section):
                    if not item.body:
                        continue
                    if waiting and not _fit(waiting[-1], (stage.name, item)):
                        flush()
                    waiting.append((stage.name, item))
                    continue
                if isinstance(item, Captured) and item.beside and waiting:  # the kernel that it waits for may yet grow
                    held.append(_Operation(stage.name, item.name, item.function, beside=True))
                    continue
                flush()
                if isinstance(item, Eager):
                    segments.append(_Segment(eager=item, stage=stage.name))
                    segments.append(_Segment())
                else:
                    segments[-1].operations.append(_Operation(stage.name, item.name, item.function, beside=item.beside))
        flush()
        return [s for s in segments if s.operations or s.eager]

    @property
    def kernels(self) -> list[FusedKernel]:
        """The kernels that were made of sections, in order."""
        return [o.fused for s in self._segments for o in s.operations if o.fused is not None]

    @property
    def graph_count(self) -> int:
        """Graph launches in a run."""
        return sum(s.eager is None for s in self._segments) if self.captures else 0

    def run(self) -> None:
        """Run all stages.

        Raises:
            GraphCaptureError: if a stage that was promised to be captured cannot be.
        """
        with wp.ScopedDevice(self._device):
            for segment in self._segments:
                if segment.eager is not None:
                    segment.eager.function()
                elif segment.graph is not None:
                    wp.capture_launch(segment.graph)
                else:
                    for operation in segment.operations:
                        operation.launch()
            if self.captures and not self._ready:
                for segment in self._segments:
                    if segment.eager is None:
                        segment.graph = self._record(segment)
        self._ready = True

    def run_without_graph(self, stages: Sequence[str]) -> None:
        """Run only some stages, kernel by kernel; for what happens outside of a step."""
        with wp.ScopedDevice(self._device):
            for segment in self._segments:
                if segment.eager is not None and segment.stage in stages:
                    segment.eager.function()
                for operation in segment.operations:
                    if set(operation.stage.split(" + ")) & set(stages):
                        operation.launch()

    def recapture(self) -> None:
        """Record the graphs anew at the next run; for whoever replaced an array that a captured function reads."""
        self._ready = False
        for segment in self._segments:
            segment.graph = None

    def launch(self) -> None:
        """Launch the kernels of all stages on the current stream, for whoever records them in a graph of their own.

        Raises:
            GraphCaptureError: if something in it runs on the host; see :attr:`eager`.
        """
        if self.eager:
            raise GraphCaptureError("stage '{}': {} runs on the host ({})".format(*self.eager[0]))
        with wp.ScopedDevice(self._device):
            for segment in self._segments:
                self._launch(segment.operations)

    @property
    def eager(self) -> list[tuple[str, str, str]]:
        """Stage, name and reason of what runs on the host."""
        return [(s.stage, s.eager.name, s.eager.reason) for s in self._segments if s.eager is not None]

    def _launch(self, operations: list[_Operation]) -> None:
        beside = list[wp.Stream]()
        for operation in operations:
            if operation.beside and self._device != "cpu":
                beside.append(self._side_stream(len(beside)))
                with wp.ScopedStream(beside[-1], sync_enter=True):
                    operation.launch()
            else:
                operation.launch()
        for stream in beside:
            wp.get_stream(self._device).wait_stream(stream)

    def _record(self, segment: _Segment) -> wp.Graph:
        try:
            return capture_graph(self._device, lambda: self._launch(segment.operations))
        except Exception as error:
            raise GraphCaptureError(self._culprit(segment, error)) from error

    def _side_stream(self, index: int) -> wp.Stream:
        while len(self._streams) <= index:
            self._streams.append(wp.Stream(self._device))
        return self._streams[index]

    def _culprit(self, segment: _Segment, error: Exception) -> str:
        """Which operation it is that cannot be recorded."""
        for operation in segment.operations:
            try:
                capture_graph(self._device, operation.launch)
            except Exception as own:
                return (
                    f"stage '{operation.stage}': {operation.name} cannot be captured ({_first_line(own)}); it may only "
                    "launch kernels on arrays that exist: use the torch hook or a torch term for what needs the host"
                )
        return f"the step cannot be captured: {_first_line(error)}"

    # -- description

    def rows(self) -> list[tuple[str, str, str]]:
        """Stage, what runs in it, and how, one row an item."""
        how = "graph" if self.captures else "kernel by kernel"
        rows = []
        for stage in self.stages:
            for item in stage.items:
                terms = f"{item.name}: {', '.join(item.terms)}" if item.terms else item.name
                if isinstance(item, Eager):
                    rows.append((stage.name, terms, f"eager: {item.reason}"))
                elif isinstance(item, Captured):
                    rows.append((stage.name, terms, how))
                elif item.body:
                    rows.append((stage.name, terms, f"{how}, fused"))
            if not stage.items:
                rows.append((stage.name, stage.note or "-", "-"))
        return rows

    def describe(self, kernels: bool = False) -> str:
        """The stages as a table in plain text, and with ``kernels`` the source of what was fused."""
        rows = self.rows()
        first, second = (max(len(row[i]) for row in rows) for i in (0, 2))
        out = [f"{stage:<{first}}  {how:<{second}}  {what}" for stage, what, how in rows]
        graphs, made = self.graph_count, self.kernels
        count = f"{graphs} graph launch{'es' * (graphs != 1)} a step, " if self.captures else ""
        out.append(f"{count}{len(made)} fused kernel{'s' * (len(made) != 1)}")
        if kernels:
            out += ["", *(f"# {k.path}\n{k.source}" for k in made)]
        return "\n".join(out)


def _fit(before: tuple[str, Section], after: tuple[str, Section]) -> bool:
    """Whether two neighbouring sections may be in one kernel."""
    if before[1].parts and after[1].parts:
        return before[0] == after[0]  # parts of a stage do not depend on each other
    return not before[1].parts and not after[1].parts


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0] or type(error).__name__
