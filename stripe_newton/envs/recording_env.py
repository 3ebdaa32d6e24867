# SPDX-License-Identifier: Apache-2.0
"""Recording environment: the part of a direct environment that has its torch hooks recorded in the step's graphs."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import torch

from stripe_newton.configclass import MISSING, ConfigError
from stripe_newton.fusion import HostFunction, Item, KernelLaunches

from .direct_env_base import DirectEnvBase
from .hook_graphs import HookRecorder, Launched
from .hook_parts import HookPart, PhysicsPart, ResetPart, rehearse
from .hook_results import ObservationGroup
from .hooks import DirectHooks
from .rl_env import Extras, Observations, ResetOptions
from .spaces import to_space

if TYPE_CHECKING:
    from .direct_rl_env import DirectRLEnvCfg

__all__ = ["RecordingEnv"]


class RecordingEnv(DirectEnvBase):
    """Base of environments whose torch hooks are recorded where a replay gives what the hook gives.

    Without a recorder, as on the CPU, hooks run between the graphs of the kernels.
    """

    cfg: DirectRLEnvCfg
    _hooks: DirectHooks
    _recorder: HookRecorder | None = None
    """Records the hooks; None where nothing is recorded."""
    _apply_part: PhysicsPart | None = None
    """The physics with a torch hook that may be recorded."""
    _observation_buffers: dict[str, ObservationGroup]
    """Memory by group that torch hooks write their observations to."""

    # -- items of a step

    def _torch_item(
        self, name: str, function: Callable[[], None], method: str, before: Callable[[], None] | None = None
    ) -> HostFunction:
        """A torch hook as an item of a step.

        Args:
            name: Its name in the description.
            function: Runs the hook with what belongs to it.
            method: Name of the method.
            before: The host's part before it, in each step.
        """
        if self._recorder is not None:
            hook = self._recorder.add(name, function, getattr(type(self), method))
            return HookPart(self._recorder, hook, before).item(name)

        def run() -> None:
            if before is not None:
                before()
            function()

        return HostFunction(name, run, "torch hook")

    def _torch_physics(self) -> HostFunction:
        physics = super()._torch_physics()
        if self._recorder is None:
            return physics
        hook = self._recorder.add("_apply_action", super().run_apply_action, type(self)._apply_action)
        self._apply_part = PhysicsPart(self, self._recorder, hook)
        return HostFunction(physics.name, self._run_physics, physics.reason, part=self._apply_part)

    def _run_physics(self) -> None:
        """Run the physics hook by hook, for a step that watches or compares."""
        each = self._substeps.each
        self._substeps.run(self)
        if each != self._substeps.each:
            self.plan.recapture()

    def run_apply_action(self) -> None:
        if self._recorder is None or self._apply_part is None:
            super().run_apply_action()
        else:
            self._recorder.run(self._apply_part.hook)

    def _torch_reset_item(self, name: str) -> HostFunction:
        """``_reset_idx`` as an item of a step."""
        if self._recorder is None:
            return HostFunction(name, self._torch_reset, "torch hook")
        part = self._reset_part = ResetPart(self, self._recorder)
        method = type(self)._reset_idx
        part.hook = self._recorder.add(name, self._reset_listed, method, joins=False, as_variant=part.as_variant)
        return HostFunction(name, self._torch_reset, "torch hook", part=part)

    def _list_items(self) -> list[Item]:
        """Kernels that list the environments of the reset mask, where graphs of torch resets read the list."""
        if self._recorder is None or self._hooks.reset.is_warp:
            return []
        return [KernelLaunches("list of resets", self.context.reset_mask.launch_list, fields=frozenset())]

    def _torch_reset(self) -> None:
        if self._recorder is None:
            super()._torch_reset()
            return
        self.outputs.prepare()  # before the host waits for the number, as the device has work
        self._reset_part.run()

    def _reset_listed(self) -> None:
        # A copy, as the hook may keep it.
        self._reset_envs(self._reset_part.env_ids.clone())

    def observation_buffers(self) -> dict[str, ObservationGroup]:
        """Memory by group that torch hooks write their observations to, where they may be recorded."""
        return self._observation_buffers

    # -- the step

    def reset(self, *, seed: int | None = None, options: ResetOptions | None = None) -> tuple[Observations, Extras]:
        with self._explains_spaces():
            return super().reset(seed=seed, options=options)

    def step(self, action: torch.Tensor) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
        if self.common_step_counter:
            return super().step(action)
        with self._explains_spaces():
            return super().step(action)

    @contextlib.contextmanager
    def _explains_spaces(self) -> Iterator[None]:
        """Name the space of the actions in errors of torch, where the config has another one than its class.

        Hooks take the number of actions for granted: the first one that cannot says something about its tensors.
        """
        try:
            yield
        except (IndexError, RuntimeError) as error:
            own = next((f.default for f in dataclasses.fields(self.cfg) if f.name == "action_space"), MISSING)
            if own is MISSING or to_space(own) == self.single_action_space:
                raise
            first = str(error).strip().partition("\n")[0]
            given = f"is {self.cfg.action_space!r}, must be {own!r} for {type(self).__name__}"
            raise ConfigError([f"action_space: {given}: its hooks fail otherwise ({first})"]) from error

    def _record_mixed(self, function: Callable[[], None]) -> Callable[[], None]:
        assert self._recorder is not None  # without one no hook joins a graph
        return self._recorder.context.record(function).replay

    def _replays(self) -> bool:
        # A watched step takes its physics steps one by one, with or without recorded hooks: in one go they may round
        # otherwise, and the results should not depend on what is recorded. Only torch actions are watched.
        watches = self._apply_part is not None and self._substeps.watches
        return self._recorder is None or (self._recorder.replays and not watches)

    def begin_step(self) -> None:
        recaptures = self._recaptures
        super().begin_step()
        if self._recorder is not None:
            if self._recaptures != recaptures:
                self._recorder.start_again("an array of the simulation is replaced again and again")
            self._recorder.begin_step()

    def finish_step(self) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
        results = super().finish_step()
        if self._recorder is not None:
            self._recorder.end_step()
        return results

    def settle_hooks(self) -> None:
        # A torch reset waits for the device, so that the step can be no part of a larger graph anyway.
        if self._recorder is not None and self._hooks.reset.is_warp and not self._recorder.is_settled:
            rehearse(self, self._recorder)

    def hook_log_keys(self) -> list[str]:
        return [k for h in self._recorder.hooks for k in h.log_keys()] if self._recorder is not None else []

    def hook_log(self, launched: Sequence[Callable[[], None]]) -> dict[str, torch.Tensor]:
        return {k: v for part in launched if isinstance(part, Launched) for k, v in part.log_tensors().items()}
