# SPDX-License-Identifier: Apache-2.0
"""Terrain terms: level curriculums, terminations, resets and commands that use the ground.

``terrain`` is the ground of the scene. If it is no grid of generated tiles (a plane, a file), environments keep their
origins, and a term that draws a patch takes the origin instead.
"""

import warp as wp

from ..data import ArticulationData, EpisodeData, Pose2dCommandData, VelocityCommandData
from ..term_info import needs_terrain, resets
from ..terrain import TerrainData, ground_below, max_ground_below
from . import frames, random

__all__ = [
    "resample_terrain_based_pose_2d",
    "reset_root_state_from_terrain",
    "reset_root_state_uniform_on_terrain",
    "root_height_over_ground_below_minimum",
    "terrain_levels_survival",
    "terrain_levels_vel",
    "terrain_out_of_bounds",
]

_TRIES = wp.constant(24)
"""Number of patches drawn before the best of them is taken."""


@wp.func
def _move_to_level(env: int, terrain: TerrainData, rng: wp.array[wp.uint32], level: int):
    """Move the origin of an environment to a level of its kind of terrain; past the last level to a random one."""
    levels = terrain.origins.shape[0]
    place = level
    # A robot that has mastered the last level goes to a random one, so that it does not forget the easier ones.
    if level >= levels:
        place = wp.min(int(random.uniform(env, rng) * float(levels)), levels - 1)
    terrain.level[env] = place
    terrain.env_origin[env] = terrain.origins[place, terrain.kind[env]]


@needs_terrain(curriculum=True)
@wp.func
def terrain_levels_vel(
    env: int,
    robot: ArticulationData,
    terrain: TerrainData,
    command: VelocityCommandData,
    episode: EpisodeData,
    rng: wp.array[wp.uint32],
    distance: float = 0.0,
) -> float:
    """Terrain curriculum by distance: up a level after a long walk, down after less than half the commanded distance.

    Formula: ``d = |(p - origin).xy|`` [m]; ``level + 1`` if ``d > distance``, else ``level - 1`` if
    ``d < |c.xy| T / 2``, ``T`` the length of an episode [s]; past the last level any level, with equal chance; then
    ``origin = origins[level, kind]``. A ``distance`` of 0 is half a tile, ``tile.x / 2``. Returns the level.

    Source: Isaac Lab, ``mdp.terrain_levels_vel``, there without ``distance``; N. Rudin et al., "Learning to Walk in
    Minutes", 2022.
    """
    # Curriculums run before the reset events of a step, which then reset the robot on its new tile. The distance counts
    # from the origin of the old tile, so that it is computed before the origin changes.
    if terrain.origins.shape[0] > 1:
        level = terrain.level[env]
        way = wp.transform_get_translation(robot.root_pose[env]) - terrain.env_origin[env]
        walked = wp.length(wp.vec2(way[0], way[1]))
        commanded = wp.length(wp.vec2(command.command[env, 0], command.command[env, 1])) * episode.max_length_s
        far = distance
        if distance <= 0.0:
            far = 0.5 * terrain.tile[0]
        if walked > far:
            level += 1
        elif walked < 0.5 * commanded:
            level = wp.max(level - 1, 0)
        _move_to_level(env, terrain, rng, level)
    return float(terrain.level[env])


@wp.func
def terrain_levels_survival(env: int, terrain: TerrainData, episode: EpisodeData, rng: wp.array[wp.uint32]) -> float:
    """Terrain curriculum by survival: up a level after an episode of full length, down after a termination.

    Formula: ``level - 1`` if terminated, else ``level + 1``; past the last level any level, with equal chance; then
    ``origin = origins[level, kind]``. Returns the level.

    Source: this project, after ``terrain_levels_vel``.
    """
    if terrain.origins.shape[0] > 1:
        level = terrain.level[env] + 1
        if episode.terminated[env]:
            level = wp.max(level - 2, 0)
        _move_to_level(env, terrain, rng, level)
    return float(terrain.level[env])


@wp.func
def terrain_out_of_bounds(
    env: int, robot: ArticulationData, terrain: TerrainData, distance_buffer: float = 3.0
) -> bool:
    """Termination if the root is near the edge of the ground or beyond it; a plane has no edge.

    It has left an imported world also where it has fallen below it.

    Formula: ``p.x < x_min + b or p.x > x_max - b``, the same for y, ``b = distance_buffer`` [m]; ``p.z < bottom``.

    Source: Isaac Lab, ``mdp.terrain_out_of_bounds``.
    """
    pos = wp.transform_get_translation(robot.root_pose[env])
    lower = terrain.lower
    upper_x = lower[0] + float(terrain.heights.shape[1] - 1) * terrain.cell[0]
    upper_y = lower[1] + float(terrain.heights.shape[0] - 1) * terrain.cell[1]
    out_x = pos[0] < lower[0] + distance_buffer or pos[0] > upper_x - distance_buffer
    out_y = pos[1] < lower[1] + distance_buffer or pos[1] > upper_y - distance_buffer
    fallen = terrain.mesh != wp.uint64(0) and pos[2] < terrain.bottom
    return out_x or out_y or fallen


@wp.func
def root_height_over_ground_below_minimum(
    env: int, robot: ArticulationData, terrain: TerrainData, minimum_height: float
) -> bool:
    """Termination if the root is less than ``minimum_height`` [m] above the ground below it.

    Formula: ``p.z - ground(p) < minimum_height``. In an imported world it is the ground of the storey of the root.

    Source: this project, after Isaac Lab's ``mdp.root_height_below_minimum``.
    """
    pos = wp.transform_get_translation(robot.root_pose[env])
    return pos[2] - ground_below(terrain, pos) < minimum_height


@wp.func
def _draw_patch(env: int, terrain: TerrainData, patches: wp.array3d[wp.vec3], rng: wp.array[wp.uint32]) -> wp.vec3:
    """Draw a flat patch of the environment's tile, or take its origin if the tile has none [m]; takes one draw."""
    count = patches.shape[2]
    u = random.uniform(env, rng)  # drawn without patches too: the stream does not depend on the terrain
    if count == 0:
        return terrain.env_origin[env]
    index = wp.min(int(u * float(count)), count - 1)
    return patches[terrain.level[env], terrain.kind[env], index]


@needs_terrain(patches="init_pos")
@resets("root")
@wp.func
def reset_root_state_from_terrain(
    env: int,
    robot: ArticulationData,
    terrain: TerrainData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
    move_origin: bool = False,
):
    """Reset the root to a random flat patch ``init_pos`` of its tile; only the angles of ``pose_range`` are used.

    With ``move_origin`` the patch becomes the environment's origin, from which distances are measured.

    Formula: ``p = patch + p_default`` [m], ``q = q_default Rz(U) Ry(U) Rx(U)``, ``v = v_default + U`` [m/s, rad/s].

    Source: Isaac Lab, ``mdp.reset_root_state_from_terrain``, there without ``q_default`` and ``move_origin``.
    """
    pose = robot.default_root_pose[env]
    patch = _draw_patch(env, terrain, terrain.init_pos, rng)
    if move_origin:
        terrain.env_origin[env] = patch
    pos = wp.transform_get_translation(pose) + patch
    angles = random.uniform_vec3(env, rng, pose_range, 3)
    rot = wp.transform_get_rotation(pose) * wp.quat_rpy(angles[0], angles[1], angles[2])
    robot.root_pose[env] = wp.transform(pos, rot)
    robot.root_vel[env] = robot.default_root_vel[env] + random.uniform_twist(env, rng, velocity_range)


@resets("root")
@wp.func
def reset_root_state_uniform_on_terrain(
    env: int,
    robot: ArticulationData,
    terrain: TerrainData,
    rng: wp.array[wp.uint32],
    pose_range: wp.array[wp.vec2],
    velocity_range: wp.array[wp.vec2],
    footprint: float = 0.0,
):
    """Reset the root as ``reset_root_state_uniform``, but with heights above the ground below the root.

    With a ``footprint`` [m] heights are above the highest ground in the square of that half side around the root, so
    that no foot starts inside a step of the terrain. In an imported world it is the ground of the storey on which the
    environment's origin is.

    Formula: ``p.xy = (p_default + origin + U).xy``, ``p.z = max(ground) + (p_default + U).z`` [m],
    ``q = q_default Rz(U) Ry(U) Rx(U)``, ``v = v_default + U`` [m/s, rad/s].

    Source: Isaac Lab, ``mdp.reset_root_state_uniform``, there without the ground.
    """
    pose = robot.default_root_pose[env]
    offset = random.uniform_vec3(env, rng, pose_range, 0)
    angles = random.uniform_vec3(env, rng, pose_range, 3)
    pos = wp.transform_get_translation(pose) + offset
    x, y = pos[0] + terrain.env_origin[env][0], pos[1] + terrain.env_origin[env][1]
    # Looked for from the height of the root, so that no ceiling is taken for the ground.
    above = terrain.env_origin[env][2] + wp.max(pos[2], 0.1)
    z = pos[2] + max_ground_below(terrain, wp.vec3(x, y, above), footprint)
    rot = wp.transform_get_rotation(pose) * wp.quat_rpy(angles[0], angles[1], angles[2])
    robot.root_pose[env] = wp.transform(wp.vec3(x, y, z), rot)
    robot.root_vel[env] = robot.default_root_vel[env] + random.uniform_twist(env, rng, velocity_range)


@needs_terrain(patches="target")
@wp.func
def resample_terrain_based_pose_2d(
    env: int,
    command: Pose2dCommandData,
    robot: ArticulationData,
    terrain: TerrainData,
    rng: wp.array[wp.uint32],
    heading: wp.vec2,
    simple_heading: bool,
    distance: wp.vec2,
):
    """Draw a position command from the flat patches ``target`` of the environment's tile, and a heading.

    Up to 24 patches are drawn until one lies within ``distance`` (least, greatest) [m] of the root; if none does, the
    one that comes closest to these bounds is taken.

    Formula: ``p = patch + (0, 0, p_default.z)`` [m]; heading ``U(heading)`` [rad], or with ``simple_heading`` the
    direction to the position or the opposite one, whichever needs the smaller turn.

    Source: Isaac Lab, ``TerrainBasedPose2dCommand``, there without ``distance``.
    """
    # ``least`` is the smallest miss of the distance bounds so far; 0 ends the search.
    height = wp.transform_get_translation(robot.default_root_pose[env])[2]
    root = wp.transform_get_translation(robot.root_pose[env])
    pos, least = wp.vec3(0.0), wp.float32(1.0e30)
    for _ in range(_TRIES):
        if least > 0.0:  # no further draw once a patch fits
            patch = _draw_patch(env, terrain, terrain.target, rng)
            far = wp.length(wp.vec2(patch[0] - root[0], patch[1] - root[1]))
            miss = wp.max(wp.max(distance[0] - far, far - distance[1]), 0.0)
            if miss < least:
                pos, least = patch + wp.vec3(0.0, 0.0, height), miss
    target = random.uniform_range(env, rng, heading)
    if simple_heading:
        way = pos - wp.transform_get_translation(robot.root_pose[env])
        target = wp.atan2(way[1], way[0])
        if wp.abs(frames.wrap_to_pi(target - frames.heading_w(env, robot))) >= 0.5 * wp.pi:
            target = frames.wrap_to_pi(target + wp.pi)
    command.pos[env] = pos
    command.heading[env] = target
