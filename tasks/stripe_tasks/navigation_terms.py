# SPDX-License-Identifier: Apache-2.0
"""Navigation terms: observation, rewards, termination and curriculum of a robot that is sent to a place."""

import warp as wp

from stripe_kernels.data import ArticulationData, Pose2dCommandData
from stripe_kernels.mdp import frames
from stripe_kernels.mdp.random import uniform
from stripe_kernels.terrain import TerrainData

__all__ = ["facing_goal", "goal_reached", "goal_vector", "terrain_levels_goal", "velocity_toward_goal"]


@wp.func
def _way(env: int, robot: ArticulationData, command: Pose2dCommandData) -> wp.vec2:
    """Horizontal vector from the root to the place, in the world [m]."""
    way = command.pos[env] - wp.transform_get_translation(robot.root_pose[env])
    return wp.vec2(way[0], way[1])


@wp.func
def goal_vector(
    env: int, command: Pose2dCommandData, robot: ArticulationData, near: float, out: wp.array[float]
) -> None:
    """Direction of the place in the frame of the root's yaw, and how near it is; three numbers.

    Formula: ``Rz(yaw)^T d / |d|`` and ``min(|d| / near, 1)``, ``d`` the horizontal vector to the place and ``near`` a
    distance [m].

    Source: this project.
    """
    way = _way(env, robot, command)
    far = wp.length(way)
    # The direction is undefined at the place itself; there it is 0.
    local = frames.rotate_inverse_yaw(
        wp.transform_get_rotation(robot.root_pose[env]), wp.vec3(way[0], way[1], 0.0) / wp.max(far, 1.0e-6)
    )
    out[0] = local[0]
    out[1] = local[1]
    out[2] = wp.min(far / near, 1.0)


@wp.func
def velocity_toward_goal(env: int, robot: ArticulationData, command: Pose2dCommandData, speed: float) -> float:
    """Horizontal speed of the root toward the place, as a share of the wanted speed.

    Formula: ``clip(v . d / (|d| speed), -1, 1)``, ``v`` the velocity of the root [m/s], ``d`` the horizontal vector to
    the place. Walking around an obstacle costs nothing but time.

    Source: this project.
    """
    way = wp.normalize(_way(env, robot, command))
    velocity = wp.spatial_top(robot.root_vel[env])
    return wp.clamp((velocity[0] * way[0] + velocity[1] * way[1]) / speed, -1.0, 1.0)


@wp.func
def facing_goal(env: int, robot: ArticulationData, command: Pose2dCommandData) -> float:
    """Cosine of the angle between the root's heading and the direction to the place.

    Source: this project.
    """
    way = _way(env, robot, command)
    return wp.cos(wp.atan2(way[1], way[0]) - frames.heading_w(env, robot))


@wp.func
def goal_reached(env: int, robot: ArticulationData, command: Pose2dCommandData, threshold: float) -> bool:
    """Whether the root is within ``threshold`` [m] of the place, horizontally."""
    return wp.length(_way(env, robot, command)) < threshold


@wp.func
def terrain_levels_goal(
    env: int,
    robot: ArticulationData,
    terrain: TerrainData,
    command: Pose2dCommandData,
    rng: wp.array[wp.uint32],
    threshold: float,
) -> float:
    """Curriculum of tiles: a robot at its place goes to a harder tile, one that is still far from it to an easier one.

    Formula: with ``d`` the horizontal distance to the place and ``D`` that from the environment's origin [m]:
    ``level + 1`` if ``d < threshold``, ``level - 1`` if ``d > D / 2``; past the last level any level, with equal
    chance; then ``origin = origins[level, kind]``. Returns the level.

    Source: this project, after ``terrain_levels_vel``.
    """
    levels = terrain.origins.shape[0]
    if levels > 1:
        level = terrain.level[env]
        far = wp.length(_way(env, robot, command))
        whole = command.pos[env] - terrain.env_origin[env]
        if far < threshold:
            level += 1
        elif far > 0.5 * wp.length(wp.vec2(whole[0], whole[1])):
            level = wp.max(level - 1, 0)
        if level >= levels:  # whoever has mastered all tiles keeps seeing all of them
            level = wp.min(int(uniform(env, rng) * float(levels)), levels - 1)
        terrain.level[env] = level
        terrain.env_origin[env] = terrain.origins[level, terrain.kind[env]]
    return float(terrain.level[env])
