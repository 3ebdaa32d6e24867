# SPDX-License-Identifier: Apache-2.0
"""Plan: runs the stages of a step, on a GPU as CUDA graphs.

>>> import warp as wp
>>> from stripe_newton.fusion import KernelLaunches, Plan, Scope, Section, Stage, code
>>> scope = Scope()
>>> x = scope.name("x", wp.zeros(2, dtype=float, device="cpu"))
>>> count = Section("count", [code("{x}[env] = {x}[env] + 1.0", x=x)], terms=["steps"])
>>> physics = KernelLaunches("solver", lambda: None)
>>> stages = [Stage("actions", [count]), Stage("physics", [physics])]
>>> print(Plan("step", stages, scope, 2, "cpu", use_graph=False).describe())
actions  kernel by kernel, fused  count: steps
physics  kernel by kernel         solver
1 fused kernel
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise

import warp as wp

from stripe_newton.sim.capture import capture_graph

from .fused_kernel import FusedKernel
from .graph_block import GraphBlock, blocks_of
from .host_function import ChoicePart
from .plan_table import plan_rows, plan_table
from .scope import Scope
from .segment_launcher import SegmentLauncher
from .segments import segments_of
from .stage import Stage

__all__ = ["GraphCaptureError", "Plan"]


class GraphCaptureError(RuntimeError):
    """A part of a step that must be captured in a CUDA graph cannot be."""


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
        self._segments = segments_of(name, stages, scope, num_envs, device)
        self._launcher = SegmentLauncher(device)
        self._recorded: list[GraphBlock] = []

    @property
    def kernels(self) -> list[FusedKernel]:
        """The kernels made from sections, in order."""
        return [o.fused for s in self._segments for o in s.operations if o.fused is not None]

    @property
    def graph_count(self) -> int:
        """Number of graph launches in a run, without those of host functions of their own."""
        return sum(b.is_graph for b in blocks_of(self._segments)) if self.captures else 0

    @property
    def host_functions(self) -> list[tuple[str, str, str]]:
        """Stage, name and reason of each host function that is in no graph."""
        alone = [(s.stage, s.host) for s in self._segments if s.host is not None and not s.is_capturable]
        return [(stage, h.name, (h.part.status if h.part else "") or h.reason) for stage, h in alone]

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
            blocks = self._recorded if replay and self._recorded else blocks_of(self._segments)
            is_done = False  # the graph of the block before held this block, too
            for block in blocks:
                is_done = not is_done and self._run_block(block)
            if self.captures and replay and not self._recorded:
                # After the whole run, as a kernel that is not loaded yet cannot be recorded: loading is not allowed
                # during capture.
                self._record_all()

    def run_without_graph(self, stages: Sequence[str]) -> None:
        """Run some stages kernel by kernel, for a call of ``reset()``.

        A fused kernel runs if one of its sections belongs to one of the stages.
        """
        wanted = set(stages)
        with wp.ScopedDevice(self._device):
            for segment in self._segments:
                if segment.host is not None and segment.stage in wanted:
                    segment.host.function()
                for operation in segment.operations:
                    if not wanted.isdisjoint(operation.stages):
                        operation.launch()

    def launch(self) -> list[Callable[[], None]]:
        """Launch the kernels of all stages on the current stream, so that a caller can record them in a CUDA graph.

        Returns:
            What the host does after each replay of the caller's graph.

        Raises:
            GraphCaptureError: if an item runs on the host; see :attr:`host_functions`.
        """
        if self.host_functions:
            raise GraphCaptureError("stage '{}': {} runs on the host ({})".format(*self.host_functions[0]))
        with wp.ScopedDevice(self._device):
            return self._launcher.launch(self._segments)

    def recapture(self) -> None:
        """Record the graphs again in the next run. Call this after replacing an array that a captured item reads."""
        self._recorded = []

    def _run_block(self, block: GraphBlock) -> bool:
        """Run a block, as a graph if it is recorded.

        Returns:
            Whether the block after it was part of the same graph, and is done.
        """
        if block.replay is not None:
            block.launch()
            return False
        if block.chooser is not None and self._launch_form(block, block.chooser):
            return True
        for segment in block.segments:
            if segment.host is not None:
                segment.host.function()
            # On one stream: the first run loads modules, and loading synchronises all streams anyway.
            for operation in segment.operations:
                operation.launch()
        return False

    def _launch_form(self, block: GraphBlock, chooser: ChoicePart) -> bool:
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
            graph = GraphBlock([*block.segments, *block.following])
            self._record(graph, mixed=True)
            block.forms[form] = stands_for, graph
        graph.launch()
        return True

    # -- recording

    def _record_all(self) -> None:
        """Record the graph of each block, and tell functions that choose among forms what follows them."""
        self._recorded = blocks_of(self._segments)
        for block in self._recorded:
            if block.is_graph:
                self._record(block)
        for block, following in pairwise(self._recorded):
            host = block.segments[0].host
            if host is not None and isinstance(host.part, ChoicePart) and following.is_graph:
                block.chooser, block.following = host.part, following.segments

    def _record(self, block: GraphBlock, mixed: bool = False) -> None:
        """Record the graph of a block; ``mixed`` if torch launches, too, although a first segment may not say so."""

        def launch() -> None:
            block.after = self._launcher.launch(block.segments)

        try:
            if mixed or block.is_mixed:
                block.replay = self.record_mixed(launch)
            else:
                block.replay = partial(wp.capture_launch, capture_graph(self._device, launch))
        except Exception as error:
            raise GraphCaptureError(self._why_not_recorded(block, error)) from error

    def _why_not_recorded(self, block: GraphBlock, error: Exception) -> str:
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
        return plan_rows(self.stages, self.captures)

    def describe(self, kernels: bool = False) -> str:
        """The stages as a table in plain text.

        Args:
            kernels: Also the source code of the fused kernels.
        """
        graphs, made = self.graph_count, self.kernels
        count = f"{graphs} graph launch{'es' * (graphs != 1)} a step, " if self.captures else ""
        lines = [*plan_table(self.rows()), f"{count}{len(made)} fused kernel{'s' * (len(made) != 1)}"]
        if kernels:
            lines += ["", *(f"# {k.path}\n{k.source}" for k in made)]
        return "\n".join(lines)


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0] or type(error).__name__
