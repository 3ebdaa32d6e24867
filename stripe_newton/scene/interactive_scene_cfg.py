# SPDX-License-Identifier: Apache-2.0
"""Config of a scene."""

from __future__ import annotations

import math
from collections.abc import Iterator

from stripe_newton.configclass import MISSING, configclass

__all__ = ["InteractiveSceneCfg"]


@configclass
class InteractiveSceneCfg:
    """How many environments, and what is in each.

    Subclass it and add assets as fields, in the order they are to be spawned::

        @configclass
        class SceneCfg(InteractiveSceneCfg):
            ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
            robot: ArticulationCfg = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    """

    num_envs: int = MISSING
    """Number of environments."""
    env_spacing: float = MISSING
    """Distance between neighbouring environments [m]. With 0 all stand at the origin, where float32 is finest."""
    lazy_sensor_update: bool = True
    """Accepted for compatibility."""
    replicate_physics: bool = True
    """Accepted for compatibility: Newton always replicates one environment."""
    filter_collisions: bool = True
    """Accepted for compatibility: Newton's worlds never collide with each other."""
    clone_in_fabric: bool = False
    """Accepted for compatibility."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.num_envs is not MISSING and (not isinstance(self.num_envs, int) or self.num_envs < 1):
            yield "num_envs", f"is {self.num_envs!r}, must be a whole number, 1 or more"
        if self.env_spacing is not MISSING and not (math.isfinite(self.env_spacing) and self.env_spacing >= 0):
            yield "env_spacing", f"is {self.env_spacing!r}, must be a distance, 0 or more [m]"
        if not self.replicate_physics:
            yield "replicate_physics", "is False, but Newton replicates one environment; leave it True"
