# SPDX-License-Identifier: Apache-2.0
"""Ground and light that the tasks share."""

from __future__ import annotations

from stripe_newton.sim import DistantLightCfg, DomeLightCfg, GroundPlaneCfg, spawn_ground_plane, spawn_light

__all__ = ["spawn_scenery"]


def spawn_scenery(ground: GroundPlaneCfg | None = None) -> None:
    """Author a ground plane, a grey sky and a sun from the left, in the scene under construction."""
    spawn_ground_plane("/World/ground", ground or GroundPlaneCfg())
    spawn_light("/World/Light", DomeLightCfg(intensity=2000.0, color=(0.75, 0.75, 0.75)))
    spawn_light("/World/Sun", DistantLightCfg(intensity=2500.0), orientation=(0.29, 0.21, 0.1, 0.93))
