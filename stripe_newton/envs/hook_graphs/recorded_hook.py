# SPDX-License-Identifier: Apache-2.0
"""Recorded hook: one torch hook of an environment, traced, recorded as a graph, replayed, and compared with itself."""

from __future__ import annotations

import contextlib
import inspect
import random
from collections import Counter
from collections.abc import Callable
from contextlib import AbstractContextManager

import numpy as np
import torch

from .carried_state import NotSteady, moved_paths
from .extras import ExtrasMemory, added_extras, copy_extras, tensors_of
from .fused import HookFusion, NotFusible
from .host_values import (
    ExecutedCode,
    HostCalls,
    NotRecordable,
    NumbersOnDevice,
    error_location,
    executed_code,
    short_location,
)
from .reachable import Path, scan
from .read_numbers import ReadNumbers
from .recording_context import HookGraph, Launched, RecordingContext, set_flags
from .snapshot import Results, as_close_as_repeats, first_difference

__all__ = ["RecordedHook"]


class RecordedHook:
    """One hook; a number distinguishes variants that need graphs of their own, such as for numbers of resets.

    Attributes:
        name: Name of the hook.
        location: File and line of the hook's definition, or its name where that has none.
        reason: Reason why it stays eager; empty while it is recorded or may be.
        traces: Number of runs that were watched.
        unchecked: Number of replays that are still to be compared before it counts as recorded.
        moved: Paths that it binds anew.
        joins: Whether its launches may be part of a larger graph.
        why_not_padded: Reason why no variant may stand for others; empty while one may.
        proofs: How often a variant has stood for another one and has been compared.
        extras_memory: Memory of the tensors that it adds to the extras when it is replayed.
        fusion: Whether its recordings hold its operations in few kernels.
    """

    TRACES = 2
    """Runs that are watched before the first recording."""
    CHECKS = 2
    """First replays that are compared."""

    def __init__(
        self,
        name: str,
        function: Callable[[], None],
        context: RecordingContext,
        method: Callable[..., object] | None = None,
        joins: bool = True,
        as_variant: Callable[[int], AbstractContextManager[None]] = lambda variant: contextlib.nullcontext(),
    ):
        """Note what it runs.

        Args:
            name: Its name.
            function: Runs it with what the framework does around it.
            context: What it shares with the other hooks.
            method: The method of the class, for reasons.
            joins: Whether its launches may be part of a larger graph.
            as_variant: Context in which ``function`` does for a variant what its graph is to do.
        """
        self.name, self.joins = name, joins
        self._as_variant = as_variant
        self.reason = self.why_not_padded = ""
        self.traces, self.unchecked = 0, self.CHECKS
        self.moved: set[Path] = set()
        self.proofs: Counter[int] = Counter()
        self.location = _location_of(method) or name
        self._code = ExecutedCode()
        self._numbers = ReadNumbers(self._code, self.location)
        self._attempts = 0
        self._function, self._context = function, context
        self._constants: dict[int, list[tuple[str, torch.Tensor]]] = {}
        self._graphs: dict[int, tuple[HookGraph, Launched]] = {}
        self.extras_memory = ExtrasMemory(lambda value: context.log_memory(value))
        self.fusion = HookFusion(context.env.device, context.fused_envs)
        self._unsteady = 0

    # -- running

    def run_eagerly(self) -> None:
        """Run the hook as it is; its new tensors go to their homes.

        Raises:
            NotSteady: if they cannot.
        """
        # A hook of variants runs as it is in most steps. Those should wait no more often than the others.
        with contextlib.nullcontext() if self.joins else NumbersOnDevice():
            self._function()
        if self._context.carried is not None:
            self._context.carried.settle()

    def launch(self, variant: int = 0) -> Launched:
        """Launch what the hook launches, on memory that stays where it is, within a recording.

        Returns:
            The host's part, for after each replay of the recording.

        Raises:
            NotRecordable: if the hook does what a graph cannot hold.
            NotFusible: if its fused form cannot be recorded; from then on it is not fused.
        """
        context, env = self._context, self._context.env
        assert context.carried is not None
        original, flags = env.extras, context.flag_values()
        given = env.extras = copy_extras(original)
        before, dicts = copy_extras(given), {k: v for k, v in given.items() if isinstance(v, dict)}
        bound = scan(env, context.skip)
        try:
            calls = HostCalls(torch.device(env.device), self._constants[variant], first=False)
            with self.fusion.recording(variant):
                with self._as_variant(variant), calls:
                    self._function()
                context.carried.settle()
                # Tensors in homes or in the simulation stay as they are, as a later hook may write them in place.
                extras = self.extras_memory.keep(added_extras(before, dicts, env.extras), context.carried.holds)
            changed = [(o, n, getattr(o, n)) for o, n, old in flags if getattr(o, n) != old]
            return Launched(env, extras, changed)
        except Exception as error:
            if self.fusion.fuses(variant):
                self.fusion.give_up(f"{self.location}: {error}")
                raise NotFusible(str(error)) from error
            if isinstance(error, NotSteady):
                raise NotRecordable(f"{self.location}: {error}") from error
            raise
        finally:
            bound.restore()  # for an error in the middle: what has been recorded does not exist yet
            env.extras = original
            set_flags(flags)

    def replay(self, variant: int = 0) -> None:
        """Replay the hook's own graph, which is recorded first where there is none, and do the host's part of it."""
        if variant not in self._graphs:
            launched: list[Launched] = []
            graph = self._context.record(lambda: launched.append(self.launch(variant)))
            self._graphs[variant] = graph, launched[-1]
        graph, after = self._graphs[variant]
        graph.replay()
        after()

    def log_keys(self) -> list[str]:
        """Keys of the numbers that the recorded hook adds to the episode log."""
        return list(self._graphs[0][1].log_tensors()) if 0 in self._graphs else []

    def has_constants(self, variant: int) -> bool:
        """Whether a variant has been traced, so that it can be recorded."""
        return variant in self._constants

    def has_graph(self, variant: int) -> bool:
        """Whether a variant has been recorded."""
        return variant in self._graphs

    def graph(self, variant: int) -> HookGraph | None:
        """The graph of a variant; None if it has not been recorded."""
        return self._graphs[variant][0] if variant in self._graphs else None

    def discard_recordings(self) -> None:
        """Drop recordings and traces: the hook is watched again before it is recorded again."""
        self.traces, self.unchecked, self._unsteady = 0, self.CHECKS, 0
        self._numbers.clear()
        self._drop_graphs()

    def _drop_graphs(self) -> None:
        self._constants.clear()
        self._graphs.clear()
        self.proofs.clear()
        self.fusion.forget()

    def give_up_padding(self, reason: str) -> None:
        """Drop the recordings of variants that cover many: from now on each variant is recorded on its own."""
        self.why_not_padded = reason
        self._drop_graphs()

    def reject(self, reason: str) -> None:
        """Keep the hook eager; the first reason is kept."""
        self.reason = self.reason or reason
        self._graphs.clear()

    def start_again(self, reason: str, attempts: int) -> None:
        """Watch and record the hook again, as something has changed that recordings hold; at most so many times."""
        self._attempts += 1
        self.discard_recordings()
        if self._attempts > attempts:
            self.reject(reason)

    @property
    def recorded(self) -> bool:
        """Whether it is replayed."""
        return not self.reason and self.traces >= self.TRACES

    @property
    def variants(self) -> int:
        """Number of variants that have been recorded."""
        return len(self._graphs)

    @property
    def recorded_variants(self) -> list[int]:
        """Numbers of the variants that have been recorded, ascending."""
        return sorted(self._graphs)

    # -- watching a run

    def trace(self, variant: int = 0) -> None:
        """Run the hook as it is and watch what a graph could not hold.

        If there is such a thing the hook runs again from the same state, unwatched, and is rejected.

        Raises:
            NotSteady: if tensors have homes already and cannot go there.
        """
        context, env = self._context, self._context.env
        saved, extras, flags = context.snapshot(), copy_extras(env.extras), context.flag_values()
        dicts = {k: v for k, v in env.extras.items() if isinstance(v, dict)}
        before, hosts = scan(env, context.skip), _host_generators(env.device)
        calls = HostCalls(torch.device(env.device))
        try:
            with executed_code(self._code), context.waits(), calls:
                self._function()
        except RuntimeError as error:
            reason = _reason_of(error)
            if not reason:
                raise
            saved.restore()
            env.extras = extras
            set_flags(flags)
            self.reject(reason)
            self._function()
        if _host_generators(env.device) != hosts:
            self.reject(f"{self.location}: it draws random numbers on the host")
        self._remember_constants(calls, variant)
        self.extras_memory.reserve(added_extras(extras, dicts, env.extras))
        after = scan(env, context.skip)
        for reason in self._numbers.changes_within(before, after):
            self.reject(reason)
        changed = self.number_that_changed()
        if changed:
            self.reject(changed)
        self._numbers.watch(after)
        self.traces += 1
        try:
            self.moved |= moved_paths(before, after)
        except NotSteady as error:
            if context.carried is None:
                self.moved |= {p for p in after.tensors if after.tensors[p] is not before.tensors.get(p)}
                self._unsteady += 1
                self.traces -= self._unsteady <= self.TRACES
                if self._unsteady > self.TRACES:
                    self.reject(f"{self.location}: {error}")
        if context.carried is not None:
            context.carried.settle()

    @property
    def places(self) -> list[tuple[object, str | int, object]]:
        """Container, key and value of each number that the hook may read."""
        return self._numbers.places

    def number_that_changed(self) -> str:
        """Reason, with its place, if a number that the hook may read is not what it was when the hook was watched.

        Raises:
            NotSteady: if it is a tensor now, which has no home yet.
        """
        return self._numbers.change_since()

    def _remember_constants(self, calls: HostCalls, variant: int) -> None:
        """Keep tensors that were made of numbers, and compare them with those of the run before."""
        for (where, old), (there, new) in zip(self._constants.get(variant, []), calls.constants, strict=False):
            if where != there or not torch.equal(old, new):
                self.reject(f"{there}: a tensor is made of numbers that change")
        self._constants[variant] = calls.constants

    # -- comparing a replay with the hook itself

    def check(self, variant: int = 0) -> str:
        """Replay the hook and run it as it is, from the same state; the latter counts.

        Returns:
            Why the replay cannot take the place of the hook; empty if it can.
        """
        if self.fusion.is_untried(variant):
            self._try_fusion(variant)
            return ""
        self.unchecked = max(self.unchecked - 1, 0)
        is_fused = self.fusion.fuses(variant)
        difference = self._compare(lambda: self.replay(variant))
        if difference and is_fused:
            self._give_up_fusion(difference)
            return ""
        return difference

    def _try_fusion(self, variant: int) -> None:
        """Compile the chains of the hook, run it by their kernels and as it is, from the same state; the latter counts.

        The next check records the hook, fused or not.
        """
        context = self._context
        saved, extras, flags = context.snapshot(), context.env.extras, context.flag_values()

        def fused() -> None:
            given = copy_extras(extras)
            with self.fusion.tracing(variant):
                self.launch(variant)
            saved.restore()
            context.env.extras = given
            set_flags(flags)
            self.launch(variant)()

        difference = self._compare(fused)
        if difference:
            self._give_up_fusion(difference)

    def _give_up_fusion(self, reason: str) -> None:
        """Record the hook with the kernels of torch, which must be compared from the beginning."""
        self.fusion.give_up(reason)
        self._graphs.clear()
        self.proofs.clear()
        self.unchecked = self.CHECKS

    def rehearse(self, variant: int) -> str:
        """Run a variant as its graph will do it, watched, and then the hook as it is, from the same state.

        Returns:
            Why it cannot be recorded in this form; empty if it can.
        """
        context, env = self._context, self._context.env
        calls = HostCalls(torch.device(env.device))

        def watched() -> None:
            before, dicts = copy_extras(env.extras), {k: v for k, v in env.extras.items() if isinstance(v, dict)}
            with self._as_variant(variant), context.waits(), calls:
                self._function()
            self.extras_memory.reserve(added_extras(before, dicts, env.extras))
            if context.carried is not None:
                context.carried.settle()

        difference = self._compare(watched)
        if not difference:
            self._constants[variant] = calls.constants
        return difference

    def _compare(self, other: Callable[[], None]) -> str:
        """Run something else and then the hook, from the same state; the hook counts.

        Results must be the same bit for bit, unless the hook itself, run twice from the same state, does not repeat its
        own bits: sums by atomics do not.

        Returns:
            Why the results are not the same; empty if they are.
        """
        context = self._context
        given, saved = copy_extras(context.env.extras), context.snapshot()
        flags = context.flag_values()

        def outcome(run: Callable[[], None]) -> Results:
            context.env.extras = copy_extras(given)
            set_flags(flags)
            run()
            extras = {f"extras: {k}": v for k, v in tensors_of(context.env.extras).items()}
            return saved.results() | extras

        try:
            replayed = outcome(other)
        except Exception as error:  # of the tracer, or what CUDA says of a capture that it cannot hold
            saved.restore()
            said = str(error).strip().partition("\n")[0] or type(error).__name__
            outcome(self.run_eagerly)
            return said if isinstance(error, NotRecordable) else f"{error_location(error) or self.location}: {said}"
        saved.restore()
        eager = outcome(self.run_eagerly)
        name = first_difference(replayed, eager)
        if not name:
            return ""
        saved.restore()
        again = outcome(self.run_eagerly)
        # Code that compiles itself in its first runs settles on other bits: those of the replay are then the newer.
        if not first_difference(replayed, again):
            return ""
        if as_close_as_repeats(saved, replayed, eager, again):
            return ""
        return f"{self.location}: gives another '{_shown(name)}' when it is replayed from the same state"


def _location_of(method: Callable[..., object] | None) -> str:
    """File and line of a method's definition; empty for what has none."""
    method = inspect.unwrap(method) if method is not None else None
    code = getattr(getattr(method, "__func__", method), "__code__", None)
    return short_location(code.co_filename, code.co_firstlineno) if code is not None else ""


def _reason_of(error: RuntimeError) -> str:
    """Reason of an error that says that a hook cannot be recorded; empty for any other error."""
    if isinstance(error, NotRecordable):
        return str(error)
    if "synchronizing CUDA" in str(error):
        return f"{error_location(error)}: it waits for the device"
    return ""


def _shown(name: str) -> str:
    return name.removeprefix("extras: ")


def _host_generators(device: str) -> tuple[object, ...]:
    """States of the random generators of the host, for comparison."""
    numpy = np.random.get_state(legacy=False)  # noqa: NPY002  (what users' hooks draw from)
    states: tuple[object, ...] = random.getstate(), repr(numpy)
    return states if device == "cpu" else (*states, torch.get_rng_state().numpy().tobytes())
