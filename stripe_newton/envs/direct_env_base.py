# SPDX-License-Identifier: Apache-2.0
"""Direct environment base: what the direct workflows of one agent and of several have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import torch

from stripe_newton.fusion import Captured, Eager, Item, Stage

from .events import EventRunner
from .rl_env import RLEnv
from .rl_env_cfg import RLEnvCfg
from .substeps import Substeps

__all__ = ["DirectEnvBase"]


class DirectCfg(Protocol):
    """Fields that the configs of the direct workflows share."""

    events: object
    apply_action: str
    decimation: int
    compute_final_obs: bool


class DirectEnvBase(RLEnv):
    """An environment whose class fills hooks; those with torch run between graphs."""

    def __init__(self, cfg: RLEnvCfg, render_mode: str | None = None, **kwargs: object):
        super().__init__(cfg, render_mode, **kwargs)
        self._checked = False
        """Whether the first observations were compared with the spaces."""

    def _make_hook_helpers(self, cfg: DirectCfg) -> None:
        """Make what runs events and action hooks, once the spaces are there."""
        self._events = EventRunner(cfg.events, self) if cfg.events is not None else None
        self._substeps = Substeps(cfg.apply_action, cfg.decimation)

    def _run_startup_events(self) -> None:
        if self._events is not None:
            self._events.startup()

    # -- stages that both have

    def _torch_physics(self) -> Eager:
        """The physics with the torch hook ``_apply_action`` before each step of it, or before all."""
        graph = self.device != "cpu" and self.cfg.sim.use_cuda_graph
        how = f"torch hook; the physics is {'one CUDA graph' if graph else 'kernel by kernel'}"
        name = f"_apply_action ({self._substeps.mode}), {self._physics_name}"
        return Eager(name, lambda: self._substeps.run(self), how)

    @property
    def _physics_name(self) -> str:
        return f"{type(self.sim.solver).__name__}, {self.cfg.decimation} physics steps"

    def _measurements_stage(self) -> list[Stage]:
        """Sensors that measure on the state after the physics; no stage where there are none."""
        measured = self._measure("launch_measured")
        return [Stage("measurements", measured)] if measured else []

    def _sensor_items(self) -> list[Item]:
        items: list[Item] = []
        if self.scene.needs_update:
            items.append(Eager("assets", lambda: self.scene.update_assets(self.step_dt), "host update"))
        return [*items, *self._measure("launch_observed")]

    def _log_items(self) -> list[Item]:
        return [Captured("log", self.context.log.finish)] if self.context.log.keys else []

    # -- what torch hooks write, into the memory that kernels read

    def _end_episodes(self, terminated: torch.Tensor, time_outs: torch.Tensor) -> None:
        """Write the reset mask from what a torch hook returned; a world that is not finite has failed."""
        torch.logical_or(terminated, self._safety.nonfinite, out=self.reset_terminated)
        self.reset_time_outs[:] = time_outs
        torch.logical_or(self.reset_terminated, self.reset_time_outs, out=self.reset_buf)
        self.context.torch(self.context.moved)[:] = self.reset_buf

    def _torch_reset(self) -> None:
        """Call ``_reset_idx`` where episodes ended, and let the bodies follow."""
        ids = self.context.reset_mask.indices()
        if len(ids):
            ended = self.reset_buf.clone()  # a hook may clear the buffer
            self._reset_idx(ids)
            self.sim.forward(ended)

    def _apply_action(self) -> None:
        raise NotImplementedError

    def _reset_idx(self, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        raise NotImplementedError

    def _env_indices(self, env_ids: Sequence[int] | torch.Tensor | None) -> torch.Tensor:
        """``env_ids`` as an int64 tensor on the device; all environments for None."""
        every = range(self.num_envs) if env_ids is None else env_ids
        return torch.as_tensor(every, device=self.device)

    def _is_final(self) -> bool:
        """Whether episodes end in a step, so that their last observations are wanted."""
        return bool(self._stepping[0]) and len(self.context.reset_mask.indices()) > 0
