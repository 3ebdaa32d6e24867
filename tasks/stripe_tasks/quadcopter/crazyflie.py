# SPDX-License-Identifier: Apache-2.0
"""Crazyflie: Bitcraze's quadcopter as one rigid body, drawn with Newton's packaged stage, which has no physics.

Mass and inertia: J. Förster, "System Identification of the Crazyflie 2.0 Nano Quadrocopter", ETH Zürich, 2015, with
battery and markers. The frame is 92 mm from motor to motor and 29 mm high (Bitcraze's data sheet).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from newton.examples import get_asset

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.sim import SpawnerCfg

if TYPE_CHECKING:
    from pxr import Usd

__all__ = ["CRAZYFLIE_CFG", "CrazyflieFileCfg", "spawn_crazyflie"]

COLORS = {
    "arms": (0.05, 0.05, 0.06),
    "battery": (0.55, 0.57, 0.6),
    "battery_holder": (0.06, 0.06, 0.07),
    "board": (0.03, 0.12, 0.07),
    "motor_mounts": (0.93, 0.93, 0.9),
    "motors": (0.62, 0.62, 0.66),
    "pin_racks": (0.04, 0.04, 0.04),
    "pins": (0.83, 0.68, 0.25),
    "propeller_ccw_back": (0.1, 0.1, 0.11),
    "propeller_ccw_front": (0.95, 0.35, 0.06),
    "propeller_cw_back": (0.1, 0.1, 0.11),
    "propeller_cw_front": (0.95, 0.35, 0.06),
}
"""Colours of the stage's parts, linear RGB; the stage names none. The propellers in front are orange."""


def spawn_crazyflie(
    prim_path: str,
    cfg: CrazyflieFileCfg,
    translation: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Usd.Prim:
    """Author a rigid body with the file and one collider below it; its frame is its centre of mass, x forward, z up."""
    # USD loads when a scene is built, not with the configs of a task.
    from pxr import Gf, Usd, UsdGeom, UsdPhysics

    from stripe_newton.sim.scene_context import authored_path, current_stage
    from stripe_newton.sim.spawners.spawner_cfg import finish, place

    stage, path = current_stage(), authored_path(prim_path)
    body = UsdGeom.Xform.Define(stage, f"{path}/body").GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(body)
    UsdPhysics.ArticulationRootAPI.Apply(body)
    mass = UsdPhysics.MassAPI.Apply(body)
    mass.CreateMassAttr(cfg.mass)
    mass.CreateCenterOfMassAttr(Gf.Vec3f(0.0))
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*cfg.inertia))
    mass.CreatePrincipalAxesAttr(Gf.Quatf(1.0))
    hull = UsdGeom.Cylinder.Define(stage, f"{path}/body/hull")
    hull.CreateRadiusAttr(cfg.hull_radius)
    hull.CreateHeightAttr(cfg.hull_height)
    hull.CreatePurposeAttr(UsdGeom.Tokens.guide)  # collides, but is not drawn
    UsdPhysics.CollisionAPI.Apply(hull.GetPrim())
    visuals = UsdGeom.Xform.Define(stage, f"{path}/body/visuals").GetPrim()
    visuals.GetReferences().AddReference(cfg.usd_path)
    place(visuals, (0.0, 0.0, -cfg.center_height), cfg.turn)
    for mesh in list(Usd.PrimRange(visuals)):
        if mesh.IsA(UsdGeom.Mesh):
            name = mesh.GetName() if mesh.GetName() in COLORS else mesh.GetParent().GetName()
            UsdGeom.Mesh(mesh).CreateDisplayColorAttr([Gf.Vec3f(*COLORS[name])])
    root = stage.GetPrimAtPath(path)
    place(root, translation, orientation)
    return finish(root, cfg)


@configclass
class CrazyflieFileCfg(SpawnerCfg):
    """Spawner of a Crazyflie from a stage without physics."""

    func: Callable[..., Usd.Prim] = spawn_crazyflie
    """Function that authors the prim."""
    usd_path: str = get_asset("crazyflie.usd")
    """The file."""
    mass: float = 0.028
    """Mass [kg]."""
    inertia: tuple[float, float, float] = (1.657171e-5, 1.6655602e-5, 2.9261652e-5)
    """Moments of inertia about x, y and z through the centre of mass [kg m^2]."""
    center_height: float = 0.0157
    """Height of the centre of mass in the file, which stands on z = 0: that of the board [m]."""
    hull_radius: float = 0.046
    """Radius of the collider, a cylinder [m]."""
    hull_height: float = 0.028
    """Height of the collider [m]."""
    turn: tuple[float, float, float, float] = (0.5, 0.5, 0.5, 0.5)
    """Orientation of the file on the body, quaternion (x, y, z, w): its y is up, its z forward."""


CRAZYFLIE_CFG = ArticulationCfg(
    spawn=CrazyflieFileCfg(),
    init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 0.5)),
)
"""A quadcopter of 28 g, without joints: its rotors are a wrench on the body."""
