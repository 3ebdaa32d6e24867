# SPDX-License-Identifier: Apache-2.0
"""Plan: the stages of a step, with sections fused into kernels and kernels recorded in CUDA graphs."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise

import warp as wp

from stripe_newton.sim.capture import capture_graph

from .fused_kernel import FusedKernel, fuse
from .scope import Scope
from .stage import Captured, ChoicePart, Eager, Section, Stage

__all__ = ["GraphCaptureError", "Plan"]


class GraphCaptureError(RuntimeError):
    """A part of a step that must be captured in a CUDA graph cannot be."""


@dataclass(frozen=True)
class _Operation:
    """A fused kernel, or a function that launches kernels."""

    stages: tuple[str, ...]
    name: str
    launch: Callable[[], None]
    fused: FusedKernel | None = None
    concurrent: bool = False
    """Whether later operations of its graph may run at the same time."""


@dataclass
class _Segment:
    """Consecutive operations without a host function among them, or one host function."""

    operations: list[_Operation] = field(default_factory=list)
    eager: Eager | None = None
    stage: str = ""

    @property
    def is_capturable(self) -> bool:
        """Whether it may be a part of a graph now."""
        return self.eager is None or (self.eager.part is not None and self.eager.part.is_capturable)


@dataclass
class _Block:
    """Consecutive segments that are one graph, or a host function alone."""

    segments: list[_Segment]
    replay: Callable[[], None] | None = None
    after: list[Callable[[], None]] = field(default_factory=list)
    """What the host does after each replay."""
    chooser: ChoicePart | None = None
    """The host function that it is, if that chooses among forms and a graph follows it."""
    following: list[_Segment] = field(default_factory=list)
    """What that graph holds: each form is recorded together with it."""
    forms: dict[Hashable, tuple[object, _Block]] = field(default_factory=dict)
    """Graphs of such a function and what follows, by form, each with the object that stands for it."""

    def launch(self) -> None:
        """Launch its graph, and do the host's part after it."""
        assert self.replay is not None
        self.replay()
        for function in self.after:
            function()

    @property
    def is_graph(self) -> bool:
        return self.segments[0].is_capturable

    @property
    def is_mixed(self) -> bool:
        """Whether it holds the launches of host functions."""
        return self.is_graph and any(s.eager is not None for s in self.segments)


class Plan:
    """Runs the stages of a step in order. All kernels between two host functions are one CUDA graph.

    The first run launches kernel by kernel, which loads the kernels; then the graphs are recorded. On the CPU, and
    without ``use_graph``, every run launches kernel by kernel. Host functions that may be recorded join the graphs
    before and after them while they are capturable; call :meth:`recapture` when that changes.
    """

    record_mixed: Callable[[Callable[[], None]], Callable[[], None]]
    """Records what a function launches with torch and with Warp; returns the replay. Needed for host functions that
    may be recorded."""

    def __init__(self, name: str, stages: Sequence[Stage], scope: Scope, num_envs: int, device: str, use_graph: bool):
        self.name, self.stages = name, list(stages)
        self.captures = use_graph and device != "cpu"
        """Whether runs replay CUDA graphs."""
        self._device = device
        self._side_streams: list[wp.Stream] = []
        self._segments = _SegmentBuilder(name, scope, num_envs, device).build(stages)
        self._recorded: list[_Block] = []

    @property
    def kernels(self) -> list[FusedKernel]:
        """The kernels made from sections, in order."""
        return [o.fused for s in self._segments for o in s.operations if o.fused is not None]

    @property
    def graph_count(self) -> int:
        """Number of graph launches in a run, without those of host functions of their own."""
        return sum(b.is_graph for b in self._blocks()) if self.captures else 0

    @property
    def eager(self) -> list[tuple[str, str, str]]:
        """Stage, name and reason of each host function that is in no graph."""
        alone = [(s.stage, s.eager) for s in self._segments if s.eager is not None and not s.is_capturable]
        return [(stage, e.name, (e.part.status if e.part else "") or e.reason) for stage, e in alone]

    def _blocks(self) -> list[_Block]:
        """The segments, with those together that may be one graph now."""
        blocks: list[_Block] = []
        for segment in self._segments:
            if blocks and blocks[-1].is_graph and segment.is_capturable:
                blocks[-1].segments.append(segment)
            else:
                blocks.append(_Block([segment]))
        return blocks

    # -- running

    def compile_ahead(self) -> None:
        """Begin to compile all kernels side by side. Without it each is compiled at its first launch."""
        for kernel in self.kernels:
            kernel.compile_ahead()

    def run(self, replay: bool = True) -> None:
        """Run all stages.

        Args:
            replay: Whether graphs are launched; otherwise all runs kernel by kernel and hook by hook.

        Raises:
            GraphCaptureError: if a captured item does something that cannot be recorded in a graph.
        """
        with wp.ScopedDevice(self._device):
            is_done = False
            for block in self._recorded if replay and self._recorded else self._blocks():
                if block.replay is not None:
                    if not is_done:
                        block.launch()
                    is_done = False
                    continue
                if block.chooser is not None:
                    is_done = self._launch_form(block, block.chooser)
                    if is_done:
                        continue
                for segment in block.segments:
                    if segment.eager is not None:
                        segment.eager.function()
                    # On one stream: the first run loads modules, and loading synchronises all streams anyway.
                    for operation in segment.operations:
                        operation.launch()
            if self.captures and replay and not self._recorded:
                # After the whole run, as a kernel that is not loaded yet cannot be recorded: loading is not allowed
                # during capture.
                self._recorded = self._blocks()
                for block in self._recorded:
                    if block.is_graph:
                        self._record(block)
                for block, following in pairwise(self._recorded):
                    eager = block.segments[0].eager
                    if eager is not None and isinstance(eager.part, ChoicePart) and following.is_graph:
                        block.chooser, block.following = eager.part, following.segments

    def run_without_graph(self, stages: Sequence[str]) -> None:
        """Run some stages kernel by kernel, for a call of ``reset()``.

        A fused kernel runs if one of its sections belongs to one of the stages.
        """
        wanted = set(stages)
        with wp.ScopedDevice(self._device):
            for segment in self._segments:
                if segment.eager is not None and segment.stage in wanted:
                    segment.eager.function()
                for operation in segment.operations:
                    if not wanted.isdisjoint(operation.stages):
                        operation.launch()

    def launch(self) -> list[Callable[[], None]]:
        """Launch the kernels of all stages on the current stream, so that a caller can record them in a CUDA graph.

        Returns:
            What the host does after each replay of the caller's graph.

        Raises:
            GraphCaptureError: if an item runs on the host; see :attr:`eager`.
        """
        if self.eager:
            raise GraphCaptureError("stage '{}': {} runs on the host ({})".format(*self.eager[0]))
        with wp.ScopedDevice(self._device):
            return self._launch_segments(self._segments)

    def recapture(self) -> None:
        """Record the graphs again in the next run. Call this after replacing an array that a captured item reads."""
        self._recorded = []

    def _launch_form(self, block: _Block, chooser: ChoicePart) -> bool:
        """Launch one graph of a host function that chooses among forms, and of what follows it.

        Returns:
            False if the function must run instead.
        """
        chosen = chooser.choose()
        if chosen is None:
            return False
        form, stands_for = chosen
        valid, graph = block.forms.get(form, (None, block))
        if valid is not stands_for:
            graph = _Block([*block.segments, *block.following])
            self._record(graph, mixed=True)
            block.forms[form] = stands_for, graph
        graph.launch()
        return True

    def _launch_segments(self, segments: Sequence[_Segment]) -> list[Callable[[], None]]:
        after: list[Callable[[], None]] = []
        for segment in segments:
            if segment.eager is not None and segment.eager.part is not None:
                after += segment.eager.part.launch()
            self._launch(segment.operations)
        return after

    def _launch(self, operations: Sequence[_Operation]) -> None:
        """Launch operations in order; concurrent ones get streams of their own."""
        streams = list[wp.Stream]()
        for operation in operations:
            if operation.concurrent and self._device != "cpu":
                streams.append(self._side_stream(len(streams)))
                with wp.ScopedStream(streams[-1], sync_enter=True):
                    operation.launch()
            else:
                operation.launch()
        for stream in streams:  # all streams of a capture must join the one on which it began before it ends
            wp.get_stream(self._device).wait_stream(stream)

    def _side_stream(self, index: int) -> wp.Stream:
        while len(self._side_streams) <= index:
            self._side_streams.append(wp.Stream(self._device))
        return self._side_streams[index]

    def _record(self, block: _Block, mixed: bool = False) -> None:
        """Record the graph of a block; ``mixed`` if torch launches, too, although a first segment may not say so."""

        def launch() -> None:
            block.after = self._launch_segments(block.segments)

        try:
            if mixed or block.is_mixed:
                block.replay = self.record_mixed(launch)
            else:
                block.replay = partial(wp.capture_launch, capture_graph(self._device, launch))
        except Exception as error:
            raise GraphCaptureError(self._why_not_recorded(block, error)) from error

    def _why_not_recorded(self, block: _Block, error: Exception) -> str:
        """The operation that cannot be recorded, with its error, found by recording each alone."""
        for operation in (o for s in block.segments for o in s.operations):
            try:
                capture_graph(self._device, operation.launch)
            except Exception as own:
                return (
                    f"stage '{' + '.join(operation.stages)}': {operation.name} cannot be captured "
                    f"({_first_line(own)}); it may only launch kernels on arrays that exist: use the torch hook or a "
                    "torch term for what needs the host"
                )
        return f"the step cannot be captured: {_first_line(error)}"

    # -- description

    def rows(self) -> list[tuple[str, str, str]]:
        """Rows of the description, one for each item: stage, item with its terms, and way of running."""
        captured = "graph" if self.captures else "kernel by kernel"
        rows = []
        for stage in self.stages:
            for item in stage.items:
                terms = f"{item.name}: {', '.join(item.terms)}" if item.terms else item.name
                if isinstance(item, Eager):
                    status = item.part.status if item.part is not None else ""
                    rows.append((stage.name, terms, status or f"eager: {item.reason}"))
                elif isinstance(item, Captured):
                    rows.append((stage.name, terms, captured))
                elif item.body:
                    rows.append((stage.name, terms, f"{captured}, fused"))
            if not stage.items:
                rows.append((stage.name, "-", "-"))
        return rows

    def describe(self, kernels: bool = False) -> str:
        """The stages as a table in plain text.

        Args:
            kernels: Also the source code of the fused kernels.
        """
        rows = self.rows()
        first, second = (max(len(row[i]) for row in rows) for i in (0, 2))
        out = [f"{stage:<{first}}  {status:<{second}}  {item}" for stage, item, status in rows]
        graphs, made = self.graph_count, self.kernels
        count = f"{graphs} graph launch{'es' * (graphs != 1)} a step, " if self.captures else ""
        out.append(f"{count}{len(made)} fused kernel{'s' * (len(made) != 1)}")
        if kernels:
            out += ["", *(f"# {k.path}\n{k.source}" for k in made)]
        return "\n".join(out)


class _SegmentBuilder:
    """Splits stages into segments at the host functions, and fuses consecutive sections that can be one kernel."""

    def __init__(self, name: str, scope: Scope, num_envs: int, device: str):
        self._name, self._scope, self._num_envs, self._device = name, scope, num_envs, device
        self._segments = [_Segment()]
        self._pending: list[tuple[str, Section]] = []
        """Sections of the kernel under construction, with their stages."""
        self._deferred: list[_Operation] = []
        """Concurrent launches, to be placed behind that kernel."""

    def build(self, stages: Sequence[Stage]) -> list[_Segment]:
        for stage in stages:
            for item in stage.items:
                if isinstance(item, Section):
                    self._add_section(stage.name, item)
                elif isinstance(item, Captured):
                    self._add_captured(stage.name, item)
                else:
                    self._flush()
                    self._segments += [_Segment(eager=item, stage=stage.name), _Segment()]
        self._flush()
        return [s for s in self._segments if s.operations or s.eager]

    def _add_section(self, stage: str, section: Section) -> None:
        if not section.body:
            return
        if self._pending and not _can_share_kernel(self._pending[-1], (stage, section)):
            self._flush()
        self._pending.append((stage, section))

    def _add_captured(self, stage: str, item: Captured) -> None:
        operation = _Operation((stage,), item.name, item.function, concurrent=item.concurrent)
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
            self._segments[-1].operations.append(_Operation(stages, title, fused.launch, fused))
            self._pending.clear()
        self._segments[-1].operations += self._deferred
        self._deferred.clear()


def _can_share_kernel(before: tuple[str, Section], after: tuple[str, Section]) -> bool:
    """Whether two neighbouring sections may be in one kernel."""
    if before[1].parts and after[1].parts:
        # Parts of one stage do not depend on each other. Parts of the next stage may depend on any part of this one,
        # and the threads of a launch do not wait for each other.
        return before[0] == after[0]
    return not before[1].parts and not after[1].parts


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0] or type(error).__name__
