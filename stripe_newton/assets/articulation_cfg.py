# SPDX-License-Identifier: Apache-2.0
"""Config of an articulation."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

from stripe_newton.actuators import ActuatorCfg
from stripe_newton.configclass import configclass

from .asset_base import AssetBaseCfg, AssetInitialStateCfg
from .rigid_object import RigidObjectCfg

__all__ = ["ArticulationCfg"]


def _articulation(cfg: ArticulationCfg) -> Any:
    from .articulation import Articulation

    return Articulation(cfg)


@configclass
class ArticulationCfg(AssetBaseCfg):
    """A robot, or anything else with joints."""

    @configclass
    class InitialStateCfg(RigidObjectCfg.InitialStateCfg):
        """State at the start of an episode."""

        joint_pos: dict[str, float] | None = {".*": 0.0}
        """Joint positions by name expression [m or rad]; ``None`` keeps the file's."""
        joint_vel: dict[str, float] = {".*": 0.0}
        """Joint velocities by name expression [m/s or rad/s]."""

        def problems(self) -> Iterator[tuple[str, str]]:
            yield from AssetInitialStateCfg.problems(self)
            for name in ("joint_pos", "joint_vel"):
                for key, value in (getattr(self, name) or {}).items():
                    if not math.isfinite(value):
                        yield f"{name}[{key!r}]", f"is {value}, must be finite"

    class_type: Callable[..., Any] | None = _articulation
    """Class that the scene makes of this config."""
    init_state: InitialStateCfg = InitialStateCfg()
    """State at the start of an episode."""
    articulation_root_prim_path: str | None = None
    """Path of the articulation root below ``prim_path``, with a leading slash; needed where the asset has several."""
    soft_joint_pos_limit_factor: float = 1.0
    """Share of the range between the joint limits that the soft limits cover."""
    actuators: dict[str, ActuatorCfg] = {}
    """Actuators by name of the group; joints in no group keep the drives of the file."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not 0.0 < self.soft_joint_pos_limit_factor <= 1.0:
            yield "soft_joint_pos_limit_factor", f"is {self.soft_joint_pos_limit_factor}, must be in (0, 1]"
