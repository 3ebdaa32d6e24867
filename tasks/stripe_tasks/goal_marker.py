# SPDX-License-Identifier: Apache-2.0
"""Goal marker: a visible body without collider that shows where the goal of an environment is."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
import warp as wp

from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.fusion import KernelLaunches, Stage
from stripe_newton.sim import SpawnerCfg

if TYPE_CHECKING:
    from pxr import Usd

    from stripe_newton.envs import RLEnv
    from stripe_newton.scene import InteractiveScene
else:
    RLEnv = object  # a mixin: the environment class beside it is the base

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
    # The body is fixed to the world: forward kinematics would put it back to its anchor, viewers read its pose.
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


def spawn_goal_marker(
    prim_path: str,
    cfg: GoalMarkerCfg,
    translation: Sequence[float] | None = None,
    orientation: Sequence[float] | None = None,
) -> Usd.Prim:
    """Author a body that is fixed to the world and touches nothing."""
    # USD loads when a scene is built, not with the configs of a task.
    from pxr import Gf, UsdGeom, UsdPhysics

    from stripe_newton.sim.scene_context import authored_path, current_stage
    from stripe_newton.sim.spawners.spawner_cfg import finish, place

    stage, path = current_stage(), authored_path(prim_path)
    root = UsdGeom.Xform.Define(stage, path).GetPrim()
    UsdPhysics.RigidBodyAPI.Apply(root)
    UsdPhysics.ArticulationRootAPI.Apply(root)
    mass = UsdPhysics.MassAPI.Apply(root)
    # a body needs a mass, even where a fixed joint holds it
    mass.CreateMassAttr(0.01)
    mass.CreateDiagonalInertiaAttr(Gf.Vec3f(1.0e-5))
    UsdPhysics.FixedJoint.Define(stage, f"{path}/root_joint").CreateBody1Rel().SetTargets([root.GetPath()])
    for part in _parts(cfg):
        kind = UsdGeom.Cylinder if part.height else UsdGeom.Sphere
        geometry = kind.Define(stage, f"{path}/{part.name}")
        geometry.CreateRadiusAttr(part.radius)
        if part.height:
            geometry.CreateHeightAttr(part.height)
            geometry.CreateAxisAttr(part.axis)
        geometry.AddTranslateOp().Set(Gf.Vec3d(*part.offset))
        geometry.CreateDisplayColorAttr([Gf.Vec3f(*part.color)])
    place(root, translation, orientation)
    return finish(root, cfg)


class _Part(NamedTuple):
    """A geometry of a marker: a cylinder if it has a height, else a ball."""

    name: str
    radius: float
    offset: tuple[float, ...]
    color: tuple[float, float, float]
    height: float = 0.0
    axis: str = "Z"


def _parts(cfg: GoalMarkerCfg) -> list[_Part]:
    """Geometries of a marker."""
    size, thin, above = cfg.size, 0.1 * cfg.size, (0.0, 0.0, cfg.offset)
    if cfg.shape == "disc":
        return [_Part("disc", size, above, cfg.color, height=0.02)]
    if cfg.shape == "ball":
        return [_Part("ball", size, above, cfg.color)]
    parts = [_Part("ball", 1.6 * thin, above, cfg.color)]
    for i, (axis, color) in enumerate(zip("XYZ", (RED, GREEN, BLUE), strict=True)):
        middle = tuple(0.5 * size if i == j else 0.0 for j in range(3))
        parts.append(_Part(f"axis_{axis.lower()}", 0.8 * thin, middle, color, height=size, axis=axis))
    return parts


@configclass
class GoalMarkerCfg(SpawnerCfg):
    """Marker of a goal: its form, size and colour."""

    func: Callable[..., Usd.Prim] = spawn_goal_marker
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


class GoalMarked(RLEnv):
    """Mixin of an environment class that moves the scene's ``"goal"`` to the goals at the end of each step.

    Example: ``class ReachEnv(GoalMarked, ManagerBasedRLEnv)``.
    """

    def _goals(self) -> tuple[wp.array, ...]:
        """Frames in the world [m] and goals in them [m], ``wp.transform``, shape ``(num_envs,)`` each; or points of the
        world [m] alone, ``wp.vec3``, shape ``(num_envs,)``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_goals(self)'")

    def _stages(self) -> list[Stage]:
        stages = super()._stages()
        marker = self.scene["goal"]
        # The joint's parent frame places the body in the model. The solver need not be told that it moved: nothing can
        # touch the marker.
        anchors = self.sim.per_env(self.sim.model.joint_X_p)[:, marker.layout.joints[0]]
        rows = [wp.from_torch(t, dtype=wp.transform) for t in (anchors, marker.data.root_pose_w)]
        goals = self._goals()
        kernel = place_markers if len(goals) == 2 else place_markers_at

        def place() -> None:
            wp.launch(kernel, dim=self.num_envs, inputs=[*goals], outputs=rows, device=self.device)

        # last of all: goals may be drawn at a reset or by a command of this very step
        stages[-1] = replace(stages[-1], items=[*stages[-1].items, KernelLaunches("goal marker", place)])
        return stages
