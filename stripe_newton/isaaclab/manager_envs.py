# SPDX-License-Identifier: Apache-2.0
"""Manager-based environments of the Isaac Lab dialect: on the dialect's scene, with its terms."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch

from stripe_newton import envs as native
from stripe_newton.configclass import configclass
from stripe_newton.envs.rl_env import Extras, Observations, ResetOptions
from stripe_newton.sim import SimulationCfg as NativeSimulationCfg
from stripe_newton.viewers import ViewerCfg as NativeViewerCfg

from .absent_joints import leave_out_absent_joints
from .env_base import DialectEnv
from .force_sensors import add_force_sensors
from .mdp.warp_term import use_warp_functions
from .simulation_cfg import SimulationCfg, ViewerCfg

__all__ = ["ManagerBasedEnv", "ManagerBasedEnvCfg", "ManagerBasedRLEnv", "ManagerBasedRLEnvCfg"]

_NO_WINDOW = "there is no window of Isaac Sim"
_IGNORED = {
    **dict.fromkeys(("ui_window_class_type", "xr", "teleop_devices"), _NO_WINDOW),
    **dict.fromkeys(("num_rerenders_on_reset", "wait_for_textures"), "render() always draws the current state"),
    "export_io_descriptors": "an exported policy has these facts",
    "log_dir": "the run has its own folder",
}


@configclass
class _IsaacLabFields:
    """Isaac Lab's other fields of a manager-based environment; before the package's config in a list of bases."""

    sim: NativeSimulationCfg = SimulationCfg()
    viewer: NativeViewerCfg = ViewerCfg()
    ui_window_class_type: object = None
    num_rerenders_on_reset: int = 0
    wait_for_textures: bool = True
    xr: object = None
    teleop_devices: object = None
    export_io_descriptors: bool = False
    log_dir: str | None = None
    IGNORED: ClassVar[dict[str, str]] = _IGNORED


@configclass
class ManagerBasedEnvCfg(_IsaacLabFields, native.ManagerBasedEnvCfg):
    """:class:`stripe_newton.envs.ManagerBasedEnvCfg` with Isaac Lab's other fields."""

    def complete(self) -> None:
        """Let terms be the package's, leave out joints that a stand-in does not have, add sensors of actions."""
        _translate(self)
        super().complete()


@configclass
class ManagerBasedRLEnvCfg(_IsaacLabFields, native.ManagerBasedRLEnvCfg):
    """:class:`stripe_newton.envs.ManagerBasedRLEnvCfg` with Isaac Lab's other fields."""

    def complete(self) -> None:
        """As :meth:`ManagerBasedEnvCfg.complete`."""
        _translate(self)
        super().complete()


def _translate(cfg: ManagerBasedEnvCfg | ManagerBasedRLEnvCfg) -> None:
    """Let terms be the package's, leave out joints that a stand-in does not have, add sensors of actions."""
    use_warp_functions(cfg)
    leave_out_absent_joints(cfg, cfg.scene)
    add_force_sensors(cfg.actions, cfg.scene)


class _IsaacLabReset:
    """Isaac Lab's ``reset``, which takes indices of environments."""

    def reset(
        self,
        seed: int | None = None,
        env_ids: Sequence[int] | torch.Tensor | None = None,
        options: ResetOptions | None = None,
    ) -> tuple[Observations, Extras]:
        """Begin new episodes in the environments ``env_ids``; None means all of them."""
        if env_ids is not None:
            mask = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)  # type: ignore[attr-defined]  # of the environment
            mask[env_ids] = True
            options = {**(options or {}), "reset_mask": mask}
        return super().reset(seed=seed, options=options)  # type: ignore[misc]  # of the environment


class ManagerBasedEnv(_IsaacLabReset, DialectEnv, native.ManagerBasedEnv):
    """:class:`stripe_newton.envs.ManagerBasedEnv` with quaternions (w, x, y, z) in its scene."""


class ManagerBasedRLEnv(_IsaacLabReset, DialectEnv, native.ManagerBasedRLEnv):
    """:class:`stripe_newton.envs.ManagerBasedRLEnv` with quaternions (w, x, y, z) in its scene."""
