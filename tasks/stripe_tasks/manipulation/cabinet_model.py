# SPDX-License-Identifier: Apache-2.0
"""Cabinet of two drawers, authored as USD in code: boxes, two slides, a handle of a bar on each drawer.

Its front faces -x. Dimensions are those of kitchen cabinets: 0.6 m wide, 0.5 m deep, with drawers of 0.25 m.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import configclass
from stripe_newton.sim import SpawnerCfg

if TYPE_CHECKING:
    from pxr import Usd

__all__ = ["CABINET_CFG", "DRAWERS", "HANDLE", "CabinetCfg", "spawn_cabinet"]

Vector = tuple[float, float, float]

WIDTH, DEPTH, HEIGHT, BOARD, PLINTH = 0.6, 0.5, 0.6, 0.02, 0.1
TRAVEL = 0.4
"""How far a drawer opens [m]."""
DRAWERS = ("drawer_bottom", "drawer_top")
"""Bodies of the drawers; the joint of each is ``<drawer>_joint``."""
STANDOFF = 0.05
"""Distance of a handle's bar from the front [m]."""
HANDLE: Vector = (-0.5 * DEPTH - 0.5 * BOARD - STANDOFF, 0.0, 0.0)
"""Middle of a handle's bar in the frame of its drawer [m]."""
_WOOD, _FRONT, _METAL = (0.45, 0.3, 0.17), (0.6, 0.43, 0.26), (0.35, 0.36, 0.38)


@dataclass(frozen=True)
class _Box:
    """A box of a body."""

    name: str
    size: Vector
    pos: Vector
    color: Vector
    collides: bool = True


def _shell() -> Iterator[_Box]:
    """Boards of the cabinet about its middle: sides, top, bottom, back. They are never touched but from outside."""
    side = 0.5 * (WIDTH - BOARD)
    for name, y in (("left", side), ("right", -side)):
        yield _Box(name, (DEPTH, BOARD, HEIGHT), (0.0, y, 0.0), _WOOD)
    for name, z in (("top", 0.5 * (HEIGHT - BOARD)), ("bottom", -0.5 * (HEIGHT - BOARD))):
        yield _Box(name, (DEPTH, WIDTH - 2.0 * BOARD, BOARD), (0.0, 0.0, z), _WOOD)
    plinth = (DEPTH - 0.1, WIDTH - 0.1, PLINTH)
    yield _Box("plinth", plinth, (0.05, 0.0, -0.5 * (HEIGHT + PLINTH)), _METAL, collides=False)
    yield _Box("back", (BOARD, WIDTH, HEIGHT), (0.5 * (DEPTH - BOARD), 0.0, 0.0), _WOOD, collides=False)


def _drawer() -> Iterator[_Box]:
    """Parts of a drawer about its middle: front, tray, and the handle with its two posts."""
    tall = 0.5 * HEIGHT - 0.01
    front = -0.5 * (DEPTH + BOARD)
    yield _Box("front", (BOARD, WIDTH - 0.01, tall), (front, 0.0, 0.0), _FRONT)
    tray = (DEPTH - 2.0 * BOARD, WIDTH - 4.0 * BOARD, BOARD)
    yield _Box("tray", tray, (0.0, 0.0, -0.35 * tall), _WOOD, collides=False)
    yield _Box("handle", (0.024, 0.16, 0.024), HANDLE, _METAL)
    for name, y in (("left_post", 0.07), ("right_post", -0.07)):
        post = 0.5 * (HANDLE[0] + front - 0.5 * BOARD)
        yield _Box(name, (STANDOFF, 0.012, 0.012), (post, y, 0.0), _METAL)


def spawn_cabinet(
    prim_path: str,
    cfg: CabinetCfg,
    translation: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Usd.Prim:
    """Author the cabinet: a body that is fixed to the world, and two drawers that slide along -x."""
    # USD loads when a scene is built, not with the configs of a task.
    from pxr import Gf, UsdGeom, UsdPhysics

    from stripe_newton.sim.scene_context import authored_path, current_stage
    from stripe_newton.sim.spawners.spawner_cfg import finish, place

    stage, path = current_stage(), authored_path(prim_path)
    root = UsdGeom.Xform.Define(stage, path).GetPrim()
    UsdPhysics.ArticulationRootAPI.Apply(root)

    def body(name: str, mass: float, pos: Vector, boxes: Iterator[_Box]) -> Usd.Prim:
        xform = UsdGeom.Xform.Define(stage, f"{path}/{name}")
        xform.AddTranslateOp().Set(Gf.Vec3d(*pos))
        UsdPhysics.RigidBodyAPI.Apply(xform.GetPrim())
        UsdPhysics.MassAPI.Apply(xform.GetPrim()).CreateMassAttr(mass)
        for box in boxes:
            cube = UsdGeom.Cube.Define(stage, f"{path}/{name}/{box.name}")
            cube.CreateSizeAttr(1.0)
            cube.AddTranslateOp().Set(Gf.Vec3d(*box.pos))
            cube.AddScaleOp().Set(Gf.Vec3f(*box.size))
            cube.CreateDisplayColorAttr([Gf.Vec3f(*box.color)])
            if box.collides:
                UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
        return xform.GetPrim()

    frame = body("cabinet", 20.0, (0.0, 0.0, 0.0), _shell())
    UsdPhysics.FixedJoint.Define(stage, f"{path}/root_joint").CreateBody1Rel().SetTargets([frame.GetPath()])
    for name, z in zip(DRAWERS, (-0.25 * HEIGHT, 0.25 * HEIGHT), strict=True):
        drawer = body(name, cfg.drawer_mass, (0.0, 0.0, z), _drawer())
        joint = UsdPhysics.PrismaticJoint.Define(stage, f"{path}/{name}_joint")
        joint.CreateBody0Rel().SetTargets([frame.GetPath()])
        joint.CreateBody1Rel().SetTargets([drawer.GetPath()])
        joint.CreateAxisAttr("X")
        # About z by half a turn: the drawer's coordinate grows as it opens towards -x.
        half_turn = Gf.Quatf(0.0, Gf.Vec3f(0.0, 0.0, 1.0))
        joint.CreateLocalPos0Attr(Gf.Vec3f(0.0, 0.0, z))
        joint.CreateLocalRot0Attr(half_turn)
        joint.CreateLocalPos1Attr(Gf.Vec3f(0.0, 0.0, 0.0))
        joint.CreateLocalRot1Attr(half_turn)
        joint.CreateLowerLimitAttr(0.0)
        joint.CreateUpperLimitAttr(TRAVEL)
    place(root, translation, orientation)
    return finish(root, cfg)


@configclass
class CabinetCfg(SpawnerCfg):
    """Cabinet of two drawers."""

    func: Callable[..., Usd.Prim] = spawn_cabinet
    """Function that authors the prim."""
    drawer_mass: float = 3.0
    """Mass of a drawer [kg]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.drawer_mass > 0.0:
            yield "drawer_mass", f"is {self.drawer_mass}, must be a mass [kg]"


CABINET_CFG = ArticulationCfg(
    prim_path="{ENV_REGEX_NS}/Cabinet",
    spawn=CabinetCfg(),
    init_state=ArticulationCfg.InitialStateCfg(pos=(1.05, 0.0, 0.5 * HEIGHT + PLINTH), joint_pos={".*": 0.0}),
    actuators={
        "drawers": ImplicitActuatorCfg(
            joint_names_expr=["drawer_.*_joint"], stiffness=10.0, damping=1.0, effort_limit=87.0
        )
    },
)
"""The cabinet, its drawers closed and held by weak springs, those of Isaac Lab's cabinet.

It is so far from an arm at the origin that a Panda can pull a drawer open by 0.36 m.
"""
