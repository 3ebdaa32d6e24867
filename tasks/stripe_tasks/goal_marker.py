# SPDX-License-Identifier: Apache-2.0
"""A thing to see where the goal of an environment is: a body without collider, fixed to the world, that moves along."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import torch
import warp as wp

from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.fusion import Captured, Stage
from stripe_newton.sim import SpawnerCfg

if TYPE_CHECKING:
    from pxr import Usd

    from stripe_newton.scene import InteractiveScene

__all__ = ["GoalMarked", "GoalMarkerCfg", "goal_marker", "origin_frames", "spawn_goal_marker"]

SHAPES = ("ball", "disc", "frame")
RED, GREEN, BLUE = (0.85, 0.05, 0.04), (0.06, 0.6, 0.1), (0.05, 0.2, 0.85)


@wp.kernel(enable_backward=False)
def place_markers(
    frames: wp.array[wp.transform],
    goals: wp.array[wp.transform],
    anchors: wp.array[wp.transform],
    bodies: wp.array[wp.transform],
) -> None:
    """Put the marker of each environment at its goal, which is given in a frame; in the model and in the state."""
    env = wp.tid()
    pose = wp.transform_multiply(frames[env], goals[env])
    anchors[env] = pose
    bodies[env] = pose


@wp.kernel(enable_backward=False)
def place_markers_at(
    points: wp.array[wp.vec3], anchors: wp.array[wp.transform], bodies: wp.array[wp.transform]
) -> None:
    """Put the marker of each environment at a point of the world; in the model and in the state."""
    env = wp.tid()
    pose = wp.transform(points[env], wp.quat_identity())
    anchors[env] = pose
    bodies[env] = pose


def spawn_goal_marker(prim_path: str, cfg: GoalMarkerCfg, translation: Any = None, orientation: Any = None) -> Usd.Prim:
    """Author a body that is fixed to the world and touches nothing."""
    from pxr import Gf, UsdGeom, UsdPhysics

    from stripe_newton.sim.scene_context import authored_path, current_stage
    from stripe_newton.sim.spawners.spawner_cfg import finish, place

    stage, path = current_stage(), authored_path(prim_path)
    root = UsdGeom.Xform.Define(stage, path).GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(root)
    UsdPhysics.ArticulationRootAPI.Apply(root)
    mass = UsdPhysics.MassAPI.Apply(root)
    mass.CreateMassAttr(0.01)
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(1.0e-5))
    UsdPhysics.FixedJoint.Define(stage, f"{path}/root_joint").CreateBody1Rel().SetTargets([root.GetPath()])
    for name, kind, size, axis, offset, color in _parts(cfg):
        geometry = getattr(UsdGeom, kind).Define(stage, f"{path}/{name}")
        geometry.CreateRadiusAttr(size[0])
        if kind == "Cylinder":
            geometry.CreateHeightAttr(size[1])
            geometry.CreateAxisAttr(axis)
        geometry.AddTranslateOp().Set(Gf.Vec3d(*offset))
        geometry.CreateDisplayColorAttr([Gf.Vec3f(*color)])
    place(root, translation, orientation)
    return finish(root, cfg)


def _parts(cfg: GoalMarkerCfg) -> list[tuple[str, str, tuple[float, float], str, tuple[float, ...], Any]]:
    size, thin = cfg.size, 0.1 * cfg.size
    if cfg.shape == "disc":
        return [("disc", "Cylinder", (size, 0.02), "Z", (0.0, 0.0, cfg.offset), cfg.color)]
    ball = ("ball", "Sphere", (size if cfg.shape == "ball" else 1.6 * thin, 0.0), "", (0.0, 0.0, cfg.offset), cfg.color)
    if cfg.shape == "ball":
        return [ball]
    arms = []
    for i, (axis, color) in enumerate(zip("XYZ", (RED, GREEN, BLUE), strict=True)):
        offset = tuple(0.5 * size if i == j else 0.0 for j in range(3))
        arms.append((f"axis_{axis.lower()}", "Cylinder", (0.8 * thin, size), axis, offset, color))
    return [ball, *arms]


@configclass
class GoalMarkerCfg(SpawnerCfg):
    """What marks a goal."""

    func: Callable[..., Any] = spawn_goal_marker
    """Function that authors the prim."""
    shape: str = "ball"
    """``"ball"``, ``"disc"``, which lies flat, or ``"frame"``: axes x red, y green, z blue."""
    size: float = 0.05
    """Radius of a ball or disc, length of an axis [m]."""
    color: tuple[float, float, float] = (0.95, 0.3, 0.02)
    """Colour, linear RGB."""
    offset: float = 0.0
    """Height of ball or disc over the goal [m]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.shape not in SHAPES:
            yield "shape", f"is '{self.shape}', must be one of {', '.join(SHAPES)}"
        if not self.size > 0.0:
            yield "size", f"is {self.size}, must be a length [m]"


def goal_marker(shape: str, size: float, **options: Any) -> RigidObjectCfg:
    """Config of a marker for a scene with :class:`GoalMarked`.

    Args:
        shape: ``"ball"``, ``"disc"`` or ``"frame"``.
        size: Radius of a ball or disc, length of an axis [m].
        options: Other fields of :class:`GoalMarkerCfg`.
    """
    return RigidObjectCfg(prim_path="{ENV_REGEX_NS}/Goal", spawn=GoalMarkerCfg(shape=shape, size=size, **options))


def origin_frames(scene: InteractiveScene) -> wp.array:
    """Frames of the environments in the world [m], ``wp.transform``, shape ``(num_envs,)``."""
    origins = scene.env_origins
    rotation = torch.tensor([0.0, 0.0, 0.0, 1.0], device=origins.device).repeat(len(origins), 1)
    return wp.from_torch(torch.cat((origins, rotation), dim=-1), dtype=wp.transform)


class GoalMarked:
    """Beside an environment class: moves the scene's ``"goal"`` to the goals, at the end of each step.

    The solver is not told, as nothing can touch the marker.
    """

    def _goals(self) -> tuple[wp.array, ...]:
        """Frames in the world [m] and goals in them [m], ``wp.transform``, shape ``(num_envs,)`` each; or points of the
        world [m] alone, ``wp.vec3``, shape ``(num_envs,)``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_goals(self)'")

    def _stages(self) -> list[Stage]:
        stages: list[Stage] = super()._stages()  # type: ignore[misc]  # of the environment class
        env: Any = self
        marker = env.scene["goal"]
        anchors = env.sim.per_env(env.sim.model.joint_X_p)[:, marker.layout.joints[0]]
        rows = [wp.from_torch(t, dtype=wp.transform) for t in (anchors, marker.data.root_pose_w)]
        goals = self._goals()
        kernel = place_markers if len(goals) == 2 else place_markers_at

        def place() -> None:
            wp.launch(kernel, dim=env.num_envs, inputs=[*goals], outputs=rows, device=env.device)

        stages[-1] = replace(stages[-1], items=[*stages[-1].items, Captured("goal marker", place)])
        return stages
