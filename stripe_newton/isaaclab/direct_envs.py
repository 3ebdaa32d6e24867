# SPDX-License-Identifier: Apache-2.0
"""Direct environments of the Isaac Lab dialect: on the dialect's scene."""

from __future__ import annotations

from typing import ClassVar

from stripe_newton import envs as native
from stripe_newton.configclass import configclass
from stripe_newton.sim import SimulationCfg as NativeSimulationCfg
from stripe_newton.viewers import ViewerCfg as NativeViewerCfg

from .env_base import DialectEnv
from .simulation_cfg import SimulationCfg, ViewerCfg

__all__ = ["DirectMARLEnv", "DirectMARLEnvCfg", "DirectRLEnv", "DirectRLEnvCfg"]

_NO_WINDOW = "there is no window of Isaac Sim"


@configclass
class DirectRLEnvCfg(native.DirectRLEnvCfg):
    """:class:`stripe_newton.envs.DirectRLEnvCfg` with Isaac Lab's other fields."""

    sim: NativeSimulationCfg = SimulationCfg()
    viewer: NativeViewerCfg = ViewerCfg()
    ui_window_class_type: object = None
    num_rerenders_on_reset: int = 0
    wait_for_textures: bool = True
    xr: object = None
    log_dir: str | None = None

    IGNORED: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("ui_window_class_type", "xr"), _NO_WINDOW),
        **dict.fromkeys(("num_rerenders_on_reset", "wait_for_textures"), "render() always draws the current state"),
        "log_dir": "the run has its own folder",
    }


@configclass
class DirectMARLEnvCfg(native.DirectMARLEnvCfg):
    """:class:`stripe_newton.envs.DirectMARLEnvCfg` with Isaac Lab's other fields."""

    sim: NativeSimulationCfg = SimulationCfg()
    viewer: NativeViewerCfg = ViewerCfg()
    ui_window_class_type: object = None
    xr: object = None
    log_dir: str | None = None

    IGNORED: ClassVar[dict[str, str]] = {
        **dict.fromkeys(("ui_window_class_type", "xr"), _NO_WINDOW),
        "log_dir": "the run has its own folder",
    }


class DirectRLEnv(DialectEnv, native.DirectRLEnv):
    """:class:`stripe_newton.envs.DirectRLEnv` with quaternions (w, x, y, z) in its scene."""


class DirectMARLEnv(DialectEnv, native.DirectMARLEnv):
    """:class:`stripe_newton.envs.DirectMARLEnv` with quaternions (w, x, y, z) in its scene."""
