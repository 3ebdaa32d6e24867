# SPDX-License-Identifier: Apache-2.0
"""Direct environment base: stages, events and resets that direct environments of one and of several agents share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import torch

from stripe_newton.fusion import HostFunction, Item, KernelLaunches, Stage

from .events import EventRunner
from .hook_results import value_per_env
from .rl_env import RLEnv
from .rl_env_cfg import RLEnvCfg
from .stage_items import launch_scenery_reset, sensor_items
from .substeps import Substeps

__all__ = ["DirectEnvBase"]


class DirectCfg(Protocol):
    """Fields that the configs of the direct workflows share."""

    events: object
    apply_action: str
    decimation: int
    compute_final_obs: bool


class DirectEnvBase(RLEnv):
    """Base of environments whose class fills hooks. Hooks in torch run between CUDA graphs."""

    def __init__(self, cfg: RLEnvCfg, render_mode: str | None = None, **kwargs: object):
        super().__init__(cfg, render_mode, **kwargs)
        self._checked = False
        """Whether the first observations have been compared with the spaces."""

    def _make_hook_helpers(self, cfg: DirectCfg) -> None:
        """Make the runners of events and action hooks. Events may ask for spaces, so this comes after them."""
        self._events = EventRunner(cfg.events, self) if cfg.events is not None else None
        self._substeps = Substeps(cfg.apply_action, cfg.decimation)

    def _run_startup_events(self) -> None:
        if self._events is not None:
            self._events.startup()

    # -- stages that both have

    def _torch_physics(self) -> HostFunction:
        """The physics with the torch hook ``_apply_action``, before each physics step or once before all of them."""
        graph = self.device != "cpu" and self.cfg.sim.use_cuda_graph
        how = f"torch hook; the physics is {'one CUDA graph' if graph else 'kernel by kernel'}"
        name = f"_apply_action ({self._substeps.mode}), {self._physics_name}"
        return HostFunction(name, lambda: self._substeps.run(self), how)

    def run_apply_action(self) -> None:
        """Run ``_apply_action`` and hand over what assets have pending."""
        self._apply_action()
        self.scene.write_data_to_sim()

    def count_physics(self) -> None:
        """Count a step whose physics was part of a recording."""
        self._substeps.count_step()

    @property
    def applies_each_substep(self) -> bool:
        """Whether ``_apply_action`` runs before every physics step of every step."""
        return self._substeps.each

    @property
    def _physics_name(self) -> str:
        return f"{type(self.sim.solver).__name__}, {self.cfg.decimation} physics steps"

    def _measurements_stage(self) -> list[Stage]:
        """Sensors that measure on the state after the physics; no stage where there are none."""
        measured = sensor_items(self.scene, self.context, "launch_measured")
        return [Stage("measurements", measured)] if measured else []

    def _sensor_items(self) -> list[Item]:
        items: list[Item] = []
        if self.scene.needs_update:
            items.append(HostFunction("assets", lambda: self.scene.update_assets(self.step_dt), "host update"))
        return [*items, *sensor_items(self.scene, self.context, "launch_observed")]

    def _log_items(self) -> list[Item]:
        return [KernelLaunches("log", self.context.log.finish)] if self.context.log.keys else []

    # -- results of torch hooks, written into the memory that kernels read

    def _end_episodes(self, terminated: object, time_outs: object) -> None:
        """Write the reset mask from the two results of ``_get_dones``. A world that is not finite has failed."""
        failed = self._per_env(terminated, "_get_dones, first result")
        late = self._per_env(time_outs, "_get_dones, second result")
        torch.logical_or(failed, self._safety.nonfinite, out=self.reset_terminated)
        self.reset_time_outs[:] = late
        torch.logical_or(self.reset_terminated, self.reset_time_outs, out=self.reset_buf)
        self.context.torch(self.context.moved)[:] = self.reset_buf

    def _per_env(self, value: object, hook: str) -> torch.Tensor:
        return value_per_env(value, self.num_envs, self.device, f"{type(self).__name__}.{hook}")

    def _torch_reset(self) -> None:
        """Call ``_reset_idx`` for the environments whose episodes ended, then forward kinematics for them."""
        ids = self.context.reset_mask.indices()
        if len(ids):
            self._reset_envs(ids)

    def _reset_envs(self, env_ids: torch.Tensor) -> None:
        """Call ``_reset_idx`` for the environments of the reset mask, whose indices are given."""
        ended = self.reset_buf.clone()  # a hook may clear the buffer
        launch_scenery_reset(self.scene, self.context)
        self._reset_idx(env_ids)
        # At once, as the observations that follow may be a torch hook, whose reads nobody can look up beforehand.
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
        """Whether an episode ends in this step, so that its last observations are kept. False within ``reset()``."""
        return bool(self._stepping[0]) and len(self.context.reset_mask.indices()) > 0
