# SPDX-License-Identifier: Apache-2.0
"""Rolling ball: a sphere that rolling friction slows down, without which a push would never end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from stripe_newton.configclass import configclass
from stripe_newton.sim import RigidBodyMaterialCfg, SphereCfg
from stripe_newton.sim.spawners.shapes import spawn_shape

if TYPE_CHECKING:
    from pxr import Usd

__all__ = ["RollingBallCfg", "spawn_rolling_ball"]


def spawn_rolling_ball(
    prim_path: str,
    cfg: RollingBallCfg,
    translation: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Usd.Prim:
    """Author a sphere whose contacts also resist rolling: MuJoCo's contacts of six dimensions."""
    from pxr import Sdf  # loads when a scene is built, not with the configs of a task

    prim = spawn_shape(prim_path, cfg, translation, orientation)
    stage, path = prim.GetStage(), prim.GetPath()
    stage.GetPrimAtPath(f"{path}/geometry/mesh").CreateAttribute("mjc:condim", Sdf.ValueTypeNames.Int).Set(6)
    material = stage.GetPrimAtPath(f"{path}/{cfg.physics_material_path}")
    material.CreateAttribute("newton:rollingFriction", Sdf.ValueTypeNames.Float).Set(cfg.rolling_friction)
    return prim


@configclass
class RollingBallCfg(SphereCfg):
    """Sphere with rolling friction."""

    func: Callable[..., Usd.Prim] = spawn_rolling_ball
    """Function that authors the prim."""
    physics_material: RigidBodyMaterialCfg | None = RigidBodyMaterialCfg(static_friction=0.8, dynamic_friction=0.8)
    """Friction of its surface."""
    rolling_friction: float = 0.02
    """Moment that resists rolling, divided by the normal force [m]. On the ground a solid ball of radius ``r`` slows by
    ``g rolling_friction / (1.4 r)`` [m/s^2]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from SphereCfg.problems(self)
        if not self.rolling_friction >= 0.0:
            yield "rolling_friction", f"is {self.rolling_friction}, must be zero or more [m]"
        if self.physics_material is None:
            yield "physics_material", "is None, must be a RigidBodyMaterialCfg: it carries the rolling friction"
