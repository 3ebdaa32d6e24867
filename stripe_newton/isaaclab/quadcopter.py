# SPDX-License-Identifier: Apache-2.0
"""Crazyflie of the Isaac Lab dialect: a body with four rotors on hinges, as NVIDIA's file has it.

Mass and inertia of the body: J. Förster, "System Identification of the Crazyflie 2.0 Nano Quadrocopter", ETH Zürich,
2015. The frame is 92 mm from motor to motor (Bitcraze's data sheet), a rotor 46 mm wide and 0.3 g.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from newton.examples import get_asset
from pxr import Gf, Usd, UsdGeom, UsdPhysics

from stripe_newton.configclass import configclass
from stripe_newton.sim import SpawnerCfg
from stripe_newton.sim.scene_context import authored_path, current_stage
from stripe_newton.sim.spawners.spawner_cfg import finish, place

__all__ = ["CrazyflieCfg", "spawn_crazyflie"]

_ARM = 0.046
_ROTOR_MASS = 3.0e-4
_BODY_MASS = 0.028 - 4.0 * _ROTOR_MASS
_INERTIA = (1.657171e-5, 1.6655602e-5, 2.9261652e-5)
_CENTER_HEIGHT = 0.0157
"""Height of the centre of mass in the file that is drawn, which stands on z = 0 [m]."""


def spawn_crazyflie(
    prim_path: str,
    cfg: CrazyflieCfg,
    translation: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Usd.Prim:
    """Author the quadcopter: ``body``, and ``m1_prop`` to ``m4_prop`` on ``m1_joint`` to ``m4_joint``."""
    stage, path = current_stage(), authored_path(prim_path)
    root = UsdGeom.Xform.Define(stage, path).GetPrim()
    body = _body(stage, f"{path}/body", _BODY_MASS, _body_inertia())
    UsdPhysics.ArticulationRootAPI.Apply(body)
    hull = UsdGeom.Cylinder.Define(stage, f"{path}/body/hull")
    hull.CreateRadiusAttr(_ARM)
    hull.CreateHeightAttr(0.028)
    hull.CreatePurposeAttr(UsdGeom.Tokens.guide)  # collides, but is not drawn
    UsdPhysics.CollisionAPI.Apply(hull.GetPrim())
    drawn = UsdGeom.Xform.Define(stage, f"{path}/body/visuals").GetPrim()
    drawn.GetReferences().AddReference(get_asset("crazyflie.usd"))
    place(drawn, (0.0, 0.0, -_CENTER_HEIGHT), (0.5, 0.5, 0.5, 0.5))  # the file has y up and z forward
    for number, (x, y) in enumerate(_places(), start=1):
        prop = _body(stage, f"{path}/m{number}_prop", _ROTOR_MASS, _rotor_inertia())
        place(prop, (x, y, 0.0), None)
        joint = UsdPhysics.RevoluteJoint.Define(stage, f"{path}/joints/m{number}_joint")
        joint.CreateAxisAttr("Z")
        joint.CreateBody0Rel().SetTargets([body.GetPath()])
        joint.CreateBody1Rel().SetTargets([prop.GetPath()])
        joint.CreateLocalPos0Attr(Gf.Vec3f(x, y, 0.0))
    place(root, translation, orientation)
    return finish(root, cfg)


def _places() -> list[tuple[float, float]]:
    """Places of the rotors, from the front right one clockwise [m]."""
    side = _ARM / 2.0**0.5
    return [(side, -side), (-side, -side), (-side, side), (side, side)]


def _rotor_inertia() -> tuple[float, float, float]:
    """Moments of inertia of a rotor: a thin bar that turns, so a disc about its axis [kg m^2]."""
    about = _ROTOR_MASS * 0.046**2 / 12.0
    return 0.5 * about, 0.5 * about, about


def _body_inertia() -> tuple[float, float, float]:
    """Moments of inertia of the body, so that those of the whole are the published ones [kg m^2]."""
    side = 4.0 * _ROTOR_MASS * _ARM**2 / 2.0
    own = _rotor_inertia()
    moved = (side, side, 2.0 * side)
    return tuple(whole - 4.0 * o - m for whole, o, m in zip(_INERTIA, own, moved, strict=True))  # type: ignore[return-value]


def _body(stage: Usd.Stage, path: str, mass: float, inertia: tuple[float, float, float]) -> Usd.Prim:
    prim = UsdGeom.Xform.Define(stage, path).GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(prim)
    physics = UsdPhysics.MassAPI.Apply(prim)
    physics.CreateMassAttr(mass)
    physics.CreateCenterOfMassAttr(Gf.Vec3f(0.0))
    physics.CreateDiagonalInertiaAttr(Gf.Vec3f(*inertia))
    physics.CreatePrincipalAxesAttr(Gf.Quatf(1.0))
    return prim


@configclass
class CrazyflieCfg(SpawnerCfg):
    """Spawner of the quadcopter."""

    func: Callable[..., Usd.Prim] = spawn_crazyflie
    """Function that authors the prims."""
