# SPDX-License-Identifier: Apache-2.0
"""The scene of the manager-based tasks: a robot and what :mod:`stripe_tasks.scenery` spawns for the direct ones."""

from __future__ import annotations

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
from stripe_newton.assets.asset_base import AssetInitialStateCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import DistantLightCfg, DomeLightCfg, GroundPlaneCfg

__all__ = ["RobotSceneCfg"]

_FROM_THE_LEFT = AssetInitialStateCfg(rot=(0.29, 0.21, 0.1, 0.93))


@configclass
class RobotSceneCfg(InteractiveSceneCfg):
    """A robot on a ground plane, under a grey sky and a sun from the left."""

    robot: ArticulationCfg = MISSING
    """The robot."""
    ground: AssetBaseCfg = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    """The ground."""
    sky: AssetBaseCfg = AssetBaseCfg(
        prim_path="/World/Light", spawn=DomeLightCfg(intensity=2000.0, color=(0.75, 0.75, 0.75))
    )
    """Light from everywhere."""
    sun: AssetBaseCfg = AssetBaseCfg(
        prim_path="/World/Sun", spawn=DistantLightCfg(intensity=2500.0), init_state=_FROM_THE_LEFT
    )
    """Light from one side."""
