# SPDX-License-Identifier: Apache-2.0
"""Assistance manager: a force that lifts robots which do not get up by themselves, and that fades as they learn to.

Each environment has a level from 0 to 1. It rises after an episode at whose end the robot does not stand, and falls
after one at whose end it stands, as levels of terrain do. It begins at 0: the first episode of each environment, which
an evaluation counts, is without help. The pull upwards follows HoST (Huang et al. 2025), which weakens it for all
robots at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_kernels.mdp import frames
from stripe_kernels.term_info import writes
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import Item, SceneEntityCfg
from stripe_newton.managers import CustomManager, CustomManagerCfg, ManagerContext

__all__ = ["AssistanceData", "AssistanceManager", "AssistanceManagerCfg", "assistance_level", "stands_unassisted"]


@wp.struct
class AssistanceData:
    """Assistance of each environment, as terms read it."""

    level: wp.array[float]
    """Share of the largest force, from 0 to 1, shape ``(num_envs,)``."""
    steps: wp.array[int]
    """Steps of the episode so far, shape ``(num_envs,)``."""
    standing: wp.array[int]
    """Whether the robot stood after the last step, shape ``(num_envs,)``."""


@wp.func
def is_standing(env: int, robot: ArticulationData, body: int, least_height: float, largest_tilt: float) -> bool:
    """Whether a body is above a height [m], and the root upright within an angle [rad]."""
    height = wp.transform_get_translation(robot.body_pose[env, body])[2] - robot.env_origin[env][2]
    return height > least_height and -frames.projected_gravity_b(env, robot)[2] > wp.cos(largest_tilt)


@wp.func
def lift(
    env: int, assistance: AssistanceData, robot: ArticulationData, body_ids: wp.array[int], largest_force: float
) -> None:
    """Pull bodies upwards, at their centres of mass.

    Formula: ``f_i = level largest_force e_z`` [N], in the frame that the body has at the start of the step.
    """
    force = wp.vec3(0.0, 0.0, assistance.level[env] * largest_force)
    for i in range(body_ids.shape[0]):
        rot = wp.transform_get_rotation(robot.body_pose[env, body_ids[i]])
        robot.external_wrench[env, body_ids[i]] = wp.spatial_vector(wp.quat_rotate_inv(rot, force), wp.vec3())


@wp.func
def watch(
    env: int,
    assistance: AssistanceData,
    robot: ArticulationData,
    body_ids: wp.array[int],
    least_height: float,
    largest_tilt: float,
) -> None:
    """Count the step, and record whether the robot stands."""
    assistance.steps[env] = assistance.steps[env] + 1
    assistance.standing[env] = wp.where(is_standing(env, robot, body_ids[0], least_height, largest_tilt), 1, 0)


@wp.func
def adapt(env: int, assistance: AssistanceData, least_steps: int, change: float) -> None:
    """Change the level by how the last episode ended; one that was too short to get up in changes nothing.

    Formula: ``level = clamp(level - change, 0, 1)`` if the robot stood at the end, else with ``+ change``.
    """
    if assistance.steps[env] >= least_steps:
        step = wp.where(assistance.standing[env] != 0, -change, change)
        level = wp.clamp(assistance.level[env] + step, 0.0, 1.0)
        # 0.1 has no exact binary form: ten steps up and ten down leave a rest, which would be help.
        assistance.level[env] = wp.where(level < 0.5 * change, 0.0, level)
    assistance.steps[env] = 0
    assistance.standing[env] = 0


@wp.func
def stands_unassisted(
    env: int,
    reached: wp.array[int],
    assistance: AssistanceData,
    robot: ArticulationData,
    body_ids: wp.array[int],
    least_height: float,
    largest_tilt: float,
) -> None:
    """Record whether the robot stands without help: a body above a height, and the root upright within an angle."""
    standing = is_standing(env, robot, body_ids[0], least_height, largest_tilt)
    reached[env] = wp.where(standing and assistance.level[env] == 0.0, 1, 0)


@writes(1)
@wp.func
def assistance_level(env: int, assistance: AssistanceData, out: wp.array[float]) -> None:
    """Observation: share of the largest force that lifts the robot."""
    out[0] = assistance.level[env]


class AssistanceManager(CustomManager):
    """Lifts robots that do not get up by themselves.

    ``Assistance/level`` and ``Assistance/stands`` are logged for episodes that end, the latter with help or without.

    Attributes:
        data: The struct that terms read.
    """

    functions: ClassVar[Sequence[wp.Function]] = (lift, watch, adapt)
    cfg: AssistanceManagerCfg

    def __init__(self, name: str, cfg: AssistanceManagerCfg, context: ManagerContext):
        super().__init__(name, cfg, context)
        self.data = data = AssistanceData()
        data.level = self.array("level", float)
        data.steps, data.standing = self.array("steps", int), self.array("standing", int)
        self.provide(data)

    def action_items(self) -> list[Item]:
        """Set the force."""
        return [self.call(lift, robot=self._body(), largest_force=self.cfg.largest_force)]

    def physics_items(self) -> list[Item]:
        """Watch whether the robot stands."""
        cfg = self.cfg
        bounds = {"least_height": cfg.least_height, "largest_tilt": cfg.largest_tilt}
        return [self.call(watch, robot=self._body(), **bounds)]

    def log_items(self) -> list[Item]:
        """Log the level and whether the robot stands."""
        code, data = self.context.code, self.context.scope.name(self.name, self.data)
        return [
            self.log("Assistance/level", code("{level}[env]", level=data.field("level"))),
            self.log("Assistance/stands", code("float({standing}[env])", standing=data.field("standing"))),
        ]

    def reset_items(self) -> list[Item]:
        """Change the level where an episode begins."""
        least_steps = round(self.cfg.least_seconds / self.context.step_dt)
        return [self.call(adapt, least_steps=least_steps, change=self.cfg.change)]

    def _body(self) -> SceneEntityCfg:
        return SceneEntityCfg(self.cfg.asset_name, body_names=self.cfg.body_name)


@configclass
class AssistanceManagerCfg(CustomManagerCfg):
    """Config of the assistance manager."""

    class_type: type[CustomManager] = AssistanceManager
    asset_name: str = "robot"
    """Robot that is lifted."""
    body_name: str = MISSING
    """Body that is lifted, and whose height decides whether the robot stands."""
    largest_force: float = 200.0
    """Force at level 1 [N]; 0 for no help."""
    change: float = 0.1
    """How much the level changes after an episode."""
    least_seconds: float = 3.0
    """Length of an episode whose end counts [s]."""
    least_height: float = MISSING
    """Height of the body above which the robot stands [m]."""
    largest_tilt: float = MISSING
    """Angle of the root from the vertical within which it stands [rad]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not self.largest_force >= 0.0:
            yield "largest_force", f"is {self.largest_force}, must not be negative [N]"
        if not 0.0 <= self.change <= 1.0:
            yield "change", f"is {self.change}, must be in [0, 1]"
