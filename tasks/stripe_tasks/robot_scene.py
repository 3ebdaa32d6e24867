# SPDX-License-Identifier: Apache-2.0
"""Ground and lights that the tasks share: as a scene config with a robot, and as a function for direct tasks."""

from __future__ import annotations

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
from stripe_newton.assets.asset_base import AssetInitialStateCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import DistantLightCfg, DomeLightCfg, GroundPlaneCfg, spawn_ground_plane, spawn_light

__all__ = ["RobotSceneCfg", "spawn_scenery"]

SKY = DomeLightCfg(intensity=2000.0, color=(0.75, 0.75, 0.75))
SUN = DistantLightCfg(intensity=2500.0)
FROM_THE_LEFT = (0.29, 0.21, 0.1, 0.93)
"""Orientation of the sun, quaternion (x, y, z, w)."""


@configclass
class RobotSceneCfg(InteractiveSceneCfg):
    """A robot on a ground plane, under a grey sky and a sun from the left."""

    robot: ArticulationCfg = MISSING
    """The robot."""
    ground: AssetBaseCfg | None = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    """The ground; None where a terrain takes its place."""
    sky: AssetBaseCfg = AssetBaseCfg(prim_path="/World/Light", spawn=SKY)
    """Light from everywhere."""
    sun: AssetBaseCfg = AssetBaseCfg(
        prim_path="/World/Sun", spawn=SUN, init_state=AssetInitialStateCfg(rot=FROM_THE_LEFT)
    )
    """Light from one side."""


def spawn_scenery(ground: GroundPlaneCfg | None = None) -> None:
    """Author a ground plane, a grey sky and a sun from the left, in the scene under construction."""
    spawn_ground_plane("/World/ground", ground or GroundPlaneCfg())
    spawn_light("/World/Light", SKY)
    spawn_light("/World/Sun", SUN, orientation=FROM_THE_LEFT)
