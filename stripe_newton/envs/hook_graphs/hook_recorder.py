# SPDX-License-Identifier: Apache-2.0
"""Hook recorder: decides in which steps torch hooks run as they are, are watched, are compared, or are replayed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from contextlib import AbstractContextManager, nullcontext

import torch

from .carried_state import CarriedState, NotSteady
from .reachable import Places
from .recorded_hook import RecordedHook
from .recording_context import HookGraph, HooksEnv, RecordingContext

__all__ = ["HookGraphError", "HookRecorder"]


class HookGraphError(RuntimeError):
    """A hook cannot be recorded, and the config wants it to be."""


class HookRecorder:
    """Records the torch hooks of one environment, each as far as a replay gives the same as the hook.

    The first steps run as they are: kernels load, attributes are made. In the next ones hooks are watched. Those
    without a reason against it are recorded and compared with themselves, then and now and again.
    """

    WARM = 3
    """Steps that run as they are."""
    NEXT_CHECK, LONGEST = 64, 4096
    """Step after which hooks are compared again. The distance doubles, up to the second number."""
    ATTEMPTS = 5
    """How often hooks may be recorded anew, as something was changed from outside, before they stay eager."""
    OFTEN, WINDOW = 16, 256
    """A variant is recorded once it has come so often among so many runs. To record one costs about as much time as
    some tens of replays save, so that recording what comes rarely would make training slower."""
    MAX_VARIANTS = 32
    """Largest number of graphs of a hook with variants."""
    PADDED, PROOFS = 2, 3
    """A variant that stands for many is recorded once it has come so often. It counts once it has stood for another one
    so often with the same results: one comparison may agree by chance, such as by a mean of equal numbers."""

    def __init__(
        self,
        env: HooksEnv,
        skip: Collection[str],
        arrays: Callable[[], Mapping[str, torch.Tensor]],
        record: Callable[[Callable[[], None]], HookGraph],
        waits: Callable[[], object],
        required: bool = False,
        changed: Callable[[], None] = lambda: None,
        fused_envs: int = 0,
    ):
        """Prepare; nothing is recorded yet.

        Args:
            env: The environment.
            skip: Attributes that belong to the framework.
            arrays: Returns the memory of the simulation that hooks may write, by name.
            record: Makes the graph of a function.
            waits: Makes a context within which a wait of the host for the device raises.
            required: Whether a hook that stays eager is an error.
            changed: Called when it has changed which hooks are replayed.
            fused_envs: Number of environments, for chains of operations on their rows to become kernels; 0 for none.
        """
        self.context = RecordingContext(env, skip, arrays, record, waits, fused_envs=fused_envs)
        self.hooks: list[RecordedHook] = []
        self._required, self._changed = required, changed
        self._env, self._skip = env, skip
        self._steps, self._attempts, self._next_check = 0, 0, 0
        self._within_step = self._checks_all = False
        self._joined: list[RecordedHook] = []
        self._has_run = False
        """Whether a hook has run in this step, rather than a graph that it is part of."""
        self._steady: Places | None = None
        """Values that must stay in place for recordings to hold; None after a hook has run, which may move them."""
        self._variants: Counter[int] = Counter()

    def add(
        self,
        name: str,
        function: Callable[[], None],
        method: Callable[..., object],
        joins: bool = True,
        as_variant: Callable[[int], AbstractContextManager[None]] = lambda variant: nullcontext(),
    ) -> RecordedHook:
        """Add a hook, in the order in which a step runs them.

        Args:
            name: Its name.
            function: Runs it with what the framework does around it.
            method: The method of the class, for reasons.
            joins: Whether its launches may be part of a larger graph.
            as_variant: Context in which ``function`` does for a variant what its graph is to do.
        """
        self.hooks.append(RecordedHook(name, function, self.context, method, joins, as_variant))
        return self.hooks[-1]

    # -- a step

    def begin_step(self) -> None:
        """Choose what becomes of the hooks in the step that begins."""
        self._within_step = True
        self._checks_all = False
        if self._stopped:
            return
        self._steps += 1
        # In most steps nothing has been bound anew between steps, and one look says so.
        if (self._steady is None or not self._steady.all_in_place()) and not self._is_as_recorded():
            return
        if self._joined and self._steps >= self._next_check:
            self._checks_all = True
            self._next_check = self._steps + min(max(self._steps, self.NEXT_CHECK), self.LONGEST)

    def _is_as_recorded(self) -> bool:
        """Look for what has been bound anew between steps, and have the hooks watched again that it concerns.

        Returns:
            Whether recordings of the tensors' places go on to hold.
        """
        self._steady = None
        if self._steps > self.WARM and self.context.carried is None and self._all_traced:
            self._make_homes()
        if self.context.carried is None:
            return False
        replaced = self.context.carried.replaced()
        if replaced:
            self.start_again(f"{replaced} is bound to another tensor between steps")
            return False
        try:
            for hook in self.hooks:
                changed = hook.number_that_changed() if hook.traces and not hook.reason else ""
                if changed:
                    hook.start_again(changed, self.ATTEMPTS)
        except NotSteady as error:
            self.start_again(str(error))
            return False
        self._note_joined()
        watched = [place for hook in self.hooks if hook.traces and not hook.reason for place in hook.places]
        self._steady = Places([*self.context.carried.places, *watched])
        return True

    def end_step(self) -> None:
        """Note what the step has shown.

        Raises:
            HookGraphError: if a hook stays eager and the config wants it recorded.
        """
        self._within_step = False
        if not self._has_run:
            return
        self._has_run = False
        reasons = [f"{h.name}: {h.reason}" for h in self.hooks if h.reason]
        if self._required and reasons:
            raise HookGraphError(
                f"hooks_graph is True, but cannot be for {'; '.join(reasons)}. 'auto' runs such hooks as they are"
            )
        if len(reasons) == len(self.hooks) and not self._stopped:
            self._stop()
        self._note_joined()

    def run(self, hook: RecordedHook, variant: int = 0, padded: int | None = None) -> None:
        """Run a hook as it is, watch it, compare it or replay it.

        Args:
            hook: The hook.
            variant: Number of a variant that has a graph of its own. The first variant is watched, for reasons. One
                that comes often is watched, then recorded and compared; all others run as they are.
            padded: Number of a variant that may stand for this one and for others, while that gives the same; 0 if
                there is none for this one, None if there is none for any.
        """
        self._has_run, self._steady = True, None
        try:
            if not self._watches or hook.reason:
                hook.run_eagerly()
            elif not hook.joins:
                self._run_variant(hook, variant, padded)
            elif hook.traces < hook.TRACES:
                hook.trace()
            elif self.context.carried is None:
                hook.run_eagerly()
            elif hook.unchecked or self._checks_all:
                self._check(hook)
            else:
                hook.replay()
        except NotSteady as error:
            self.start_again(f"{hook.location}: {error}")

    def _check(self, hook: RecordedHook, variant: int = 0) -> None:
        difference = hook.check(variant)
        if difference:
            hook.reject(difference)

    def _run_variant(self, hook: RecordedHook, variant: int, padded: int | None) -> None:
        if self.context.carried is None:
            hook.run_eagerly()
        elif padded is not None and not hook.why_not_padded and hook.traces:
            if padded:
                self._run_padded(hook, padded, shows=variant != padded)
            else:
                hook.run_eagerly()
        elif hook.has_graph(variant):
            if self._checks_all:
                self._check(hook, variant)
            else:
                hook.replay(variant)
        elif hook.traces == 0 or (self._comes_often(variant, self.OFTEN) and hook.variants < self.MAX_VARIANTS):
            if hook.has_constants(variant):
                self._check(hook, variant)
            else:
                hook.trace(variant)
        else:
            hook.run_eagerly()

    def _run_padded(self, hook: RecordedHook, variant: int, shows: bool) -> None:
        """Run a hook by the graph of a variant that covers many, or do the next step towards recording one.

        Args:
            hook: The hook.
            variant: Number of the variant.
            shows: Whether this run stands for another one, so that a comparison shows that the variant may.
        """
        difference = ""
        if hook.proofs[variant] >= self.PROOFS and not self._checks_all:
            hook.replay(variant)
        elif hook.has_constants(variant):
            difference = hook.check(variant)
            hook.proofs[variant] += shows and hook.has_graph(variant)
        elif self._comes_often(variant, self.PADDED):
            difference = hook.rehearse(variant)
        else:
            hook.run_eagerly()
        if difference:
            hook.give_up_padding(difference)

    def padded_recording(self, hook: RecordedHook, variant: int) -> HookGraph | None:
        """The graph of a variant that stands for others, if that is what runs in this step; None otherwise."""
        if hook.reason or hook.why_not_padded or not hook.traces or self._checks_all or not self._watches:
            return None
        if self.context.carried is None or hook.proofs[variant] < self.PROOFS:
            return None
        return hook.graph(variant)

    def _comes_often(self, variant: int, often: int) -> bool:
        if self._variants.total() >= self.WINDOW:
            self._variants.clear()
        self._variants[variant] += 1
        return self._variants[variant] >= often

    @property
    def replays(self) -> bool:
        """Whether graphs may be launched in this step: in the first ones, and where hooks are compared, all runs hook
        by hook. Where no hook is recorded for good, the graphs of the kernels between hooks remain."""
        return self._within_step and (self._stopped or (self._steps > self.WARM and not self._checks_all))

    @property
    def checks_all(self) -> bool:
        """Whether this step compares all hooks with themselves."""
        return self._checks_all

    def replayed(self, hook: RecordedHook) -> bool:
        """Whether a hook with variants has been recorded."""
        return self.context.carried is not None and not hook.reason and hook.variants > 0

    @property
    def steps_to_check(self) -> int:
        """Number of steps from the next one on in which hooks are not compared."""
        return max(self._next_check - self._steps - 1, 0)

    def settle(self) -> None:
        """Bring tensors that a hook has bound outside of its turn to their homes."""
        if self.context.carried is not None:
            try:
                self.context.carried.settle()
            except NotSteady as error:
                self.start_again(str(error))

    def joined(self, hook: RecordedHook) -> bool:
        """Whether the launches of a hook may be part of a larger graph now."""
        return hook in self._joined

    @property
    def is_settled(self) -> bool:
        """Whether each hook is either recorded and compared, or eager for good."""
        return self._stopped or all(h.reason or not h.joins or h in self._joined for h in self.hooks)

    # -- beginning and ending

    @property
    def _watches(self) -> bool:
        return self._within_step and not self._stopped and self._steps > self.WARM

    @property
    def _stopped(self) -> bool:
        return not self.hooks or self._attempts > self.ATTEMPTS

    @property
    def _all_traced(self) -> bool:
        return all(h.reason or h.traces >= h.TRACES for h in self.hooks if h.joins)

    def _make_homes(self) -> None:
        moved = set().union(*(h.moved for h in self.hooks))
        try:
            self.context.carried = CarriedState(self._env, self._skip, self.context.arrays().values(), moved)
        except NotSteady as error:
            self.start_again(str(error))
            return
        if not self._next_check:
            self._next_check = self._steps + self.NEXT_CHECK

    def _note_joined(self) -> None:
        """Find out which hooks may be part of larger graphs, and say so if these are other ones than before."""
        ready = self.context.carried is not None
        now = [h for h in self.hooks if ready and h.joins and h.recorded and not h.unchecked]
        if now != self._joined:
            self._joined = now
            self._changed()

    def start_again(self, reason: str) -> None:
        """Drop all recordings, as something has changed that they hold. Hooks run as they are in the next steps.

        Args:
            reason: Reason why hooks stay eager, if this happens too often.
        """
        self._attempts += 1
        self.context.carried = self._steady = None
        for hook in self.hooks:
            hook.discard_recordings()
        if self._stopped:
            for hook in self.hooks:
                hook.reject(reason)
        self._steps = 0
        self._note_joined()

    def _stop(self) -> None:
        """Go on without recordings for good."""
        self._attempts = self.ATTEMPTS + 1
        self.context.carried = None
