# SPDX-License-Identifier: Apache-2.0
"""Terrain terms, against references in float64."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_kernels import mdp
from stripe_kernels.data import ArticulationData, EpisodeData, Pose2dCommandData, VelocityCommandData
from stripe_kernels.terrain import TerrainData
from stripe_newton.terrains import Ground
from tests.helpers.term_kernels import import_source
from tests.helpers.term_reference import heading, wrap
from tests.helpers.term_reference_random import Stream
from tests.helpers.terrain_world import ground_data, hills, reference_height

SEED, NUM_ENVS = 11, 64
LEVELS, TYPES, TILE = 4, 3, (4.0, 3.0)

SOURCE = """import warp as wp
from stripe_kernels import mdp
from stripe_kernels.data import ArticulationData, EpisodeData, Pose2dCommandData, VelocityCommandData
from stripe_kernels.terrain import TerrainData


@wp.kernel(enable_backward=False)
def levels(robot: ArticulationData, terrain: TerrainData, command: VelocityCommandData, episode: EpisodeData,
           rng: wp.array[wp.uint32], distance: float, result: wp.array[float]):
    env = wp.tid()
    result[env] = mdp.terrain_levels_vel(env, robot, terrain, command, episode, rng, distance)


@wp.kernel(enable_backward=False)
def lasting(terrain: TerrainData, episode: EpisodeData, rng: wp.array[wp.uint32], result: wp.array[float]):
    env = wp.tid()
    result[env] = mdp.terrain_levels_survival(env, terrain, episode, rng)


@wp.kernel(enable_backward=False)
def bounds(robot: ArticulationData, terrain: TerrainData, distance: float, result: wp.array[wp.bool]):
    env = wp.tid()
    result[env] = mdp.terrain_out_of_bounds(env, robot, terrain, distance)


@wp.kernel(enable_backward=False)
def low(robot: ArticulationData, terrain: TerrainData, height: float, result: wp.array[wp.bool]):
    env = wp.tid()
    result[env] = mdp.root_height_over_ground_below_minimum(env, robot, terrain, height)


@wp.kernel(enable_backward=False)
def from_terrain(robot: ArticulationData, terrain: TerrainData, rng: wp.array[wp.uint32],
                 pose_range: wp.array[wp.vec2], velocity_range: wp.array[wp.vec2], move: wp.bool):
    env = wp.tid()
    mdp.reset_root_state_from_terrain(env, robot, terrain, rng, pose_range, velocity_range, move)


@wp.kernel(enable_backward=False)
def on_terrain(robot: ArticulationData, terrain: TerrainData, rng: wp.array[wp.uint32],
               pose_range: wp.array[wp.vec2], velocity_range: wp.array[wp.vec2], footprint: float):
    env = wp.tid()
    mdp.reset_root_state_uniform_on_terrain(env, robot, terrain, rng, pose_range, velocity_range, footprint)


@wp.kernel(enable_backward=False)
def pose_2d(command: Pose2dCommandData, robot: ArticulationData, terrain: TerrainData, rng: wp.array[wp.uint32],
            heading: wp.vec2, simple: wp.bool, distance: wp.vec2):
    env = wp.tid()
    mdp.resample_terrain_based_pose_2d(env, command, robot, terrain, rng, heading, simple, distance)
"""


@pytest.fixture(scope="module")
def kernels(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return import_source("terrain_term_kernels", SOURCE, Path(tmp_path_factory.mktemp("kernels")))


def terrain_of(ground: Ground, num_envs: int = NUM_ENVS, patches: bool = True) -> tuple[TerrainData, dict[str, Any]]:
    """The struct, and what is in it in float64."""
    rng = np.random.default_rng(2)
    v: dict[str, Any] = {
        "origins": rng.normal(size=(LEVELS, TYPES, 3)).astype(np.float32).astype(float),
        "init_pos": rng.normal(size=(LEVELS, TYPES, 5 if patches else 0, 3)).astype(np.float32).astype(float),
        "target": rng.normal(size=(LEVELS, TYPES, 7 if patches else 0, 3)).astype(np.float32).astype(float),
        "level": rng.integers(0, LEVELS, 4096)[:num_envs],
        "kind": rng.integers(0, TYPES, 4096)[:num_envs],
    }
    v["env_origin"] = v["origins"][v["level"], v["kind"]]
    data = ground_data(ground)
    data.tile = wp.vec2(*TILE)
    for name, kind in (("origins", wp.vec3), ("init_pos", wp.vec3), ("target", wp.vec3), ("env_origin", wp.vec3)):
        value = v[name].astype(np.float32)
        array = wp.array(value, dtype=kind) if value.size else wp.zeros(value.shape[:-1], dtype=kind)
        setattr(data, name, array)
    data.level, data.kind = wp.array(v["level"], dtype=int), wp.array(v["kind"], dtype=int)
    return data, v


def robot_of(num_envs: int = NUM_ENVS) -> tuple[ArticulationData, dict[str, np.ndarray]]:
    def draws(*shape: int, scale: float = 1.0) -> np.ndarray:
        values = np.random.default_rng(3 + len(shape)).normal(size=(4096, *shape)) * scale
        return values[:num_envs].astype(np.float32).astype(float)

    def poses(scale: float, shift: float) -> np.ndarray:
        quat = Rotation.from_quat(draws(4)).as_quat()
        return np.concatenate([draws(3, scale=scale) + shift, quat], axis=1).astype(np.float32).astype(float)

    v = {"root_pose": poses(5.0, 2.0), "root_vel": draws(6), "default_root_pose": poses(1.0, 0.0)}
    v["default_root_vel"] = v["root_vel"][::-1].copy()
    data = ArticulationData()
    for name, value in v.items():
        setattr(
            data, name, wp.array(value.astype(np.float32), dtype=wp.transform if "pose" in name else wp.spatial_vector)
        )
    return data, v


@pytest.mark.parametrize("distance", [0.0, 1.4])
def test_levels_rise_and_fall_by_the_way_walked(kernels, distance):
    terrain, t = terrain_of(hills())
    robot, r = robot_of()
    rng = np.random.default_rng(5)
    way = rng.uniform(0.0, 4.0, NUM_ENVS)
    angle = rng.uniform(-np.pi, np.pi, NUM_ENVS)
    r["root_pose"][:, :2] = t["env_origin"][:, :2] + (way * [np.cos(angle), np.sin(angle)]).T
    robot.root_pose = wp.array(r["root_pose"].astype(np.float32), dtype=wp.transform)
    speed = rng.uniform(0.0, 0.3, (NUM_ENVS, 3))
    command, episode = VelocityCommandData(), EpisodeData()
    command.command = wp.array(speed.astype(np.float32), dtype=float)
    episode.max_length_s = 20.0
    stream, reference = wp.array(Stream(SEED, NUM_ENVS).n, dtype=wp.uint32), Stream(SEED, NUM_ENVS)
    result = wp.zeros(NUM_ENVS, dtype=float)
    inputs = [robot, terrain, command, episode, stream, distance]
    wp.launch(kernels.levels, dim=NUM_ENVS, inputs=inputs, outputs=[result])
    up = way > (distance or TILE[0] / 2)
    down = ~up & (way < 0.5 * np.linalg.norm(speed[:, :2], axis=1) * 20.0)
    level = t["level"] + up - np.where(down, 1, 0)
    drawn = np.minimum(reference.uniform(where=level >= LEVELS) * LEVELS, LEVELS - 1).astype(int)
    assert up.sum() > 5
    assert down.sum() > 5
    assert (level >= LEVELS).sum() > 2
    assert (level < 0).sum() > 0
    level = np.where(level >= LEVELS, drawn, np.maximum(level, 0))
    np.testing.assert_array_equal(terrain.level.numpy(), level)
    np.testing.assert_array_equal(result.numpy(), level)
    np.testing.assert_allclose(terrain.env_origin.numpy(), t["origins"][level, t["kind"]], atol=1e-6)
    np.testing.assert_array_equal(stream.numpy(), reference.n)


def test_low_over_the_ground(kernels):
    ground, (terrain, _), (robot, r) = hills(), terrain_of(hills()), robot_of()
    result = wp.zeros(NUM_ENVS, dtype=wp.bool)
    wp.launch(kernels.low, dim=NUM_ENVS, inputs=[robot, terrain, 1.0], outputs=[result])
    wanted = r["root_pose"][:, 2] - reference_height(ground, *r["root_pose"][:, :2].T) < 1.0
    assert 5 < wanted.sum() < NUM_ENVS - 5
    np.testing.assert_array_equal(result.numpy(), wanted)


def test_levels_rise_where_an_episode_lasted(kernels):
    terrain, t = terrain_of(hills())
    ended = np.random.default_rng(6).random(NUM_ENVS) < 0.4
    episode = EpisodeData()
    episode.terminated = wp.array(ended, dtype=wp.bool)
    stream, reference = wp.array(Stream(SEED, NUM_ENVS).n, dtype=wp.uint32), Stream(SEED, NUM_ENVS)
    result = wp.zeros(NUM_ENVS, dtype=float)
    wp.launch(kernels.lasting, dim=NUM_ENVS, inputs=[terrain, episode, stream], outputs=[result])
    level = np.where(ended, np.maximum(t["level"] - 1, 0), t["level"] + 1)
    drawn = np.minimum(reference.uniform(where=level >= LEVELS) * LEVELS, LEVELS - 1).astype(int)
    assert (level >= LEVELS).sum() > 2
    level = np.where(level >= LEVELS, drawn, level)
    np.testing.assert_array_equal(terrain.level.numpy(), level)
    np.testing.assert_array_equal(result.numpy(), level)
    np.testing.assert_allclose(terrain.env_origin.numpy(), t["origins"][level, t["kind"]], atol=1e-6)


@pytest.mark.parametrize("distance", [0.0, 1.5])
def test_out_of_bounds_near_the_edge_of_the_field(kernels, distance):
    ground, (terrain, _), (robot, r) = hills(), terrain_of(hills()), robot_of()
    result = wp.zeros(NUM_ENVS, dtype=wp.bool)
    wp.launch(kernels.bounds, dim=NUM_ENVS, inputs=[robot, terrain, distance], outputs=[result])
    lower = np.array(ground.lower) + distance
    upper = np.array(ground.lower) + ground.size - distance
    pos = r["root_pose"][:, :2]
    expected = ((pos < lower) | (pos > upper)).any(axis=1)
    assert 5 < expected.sum() < NUM_ENVS - 5
    np.testing.assert_array_equal(result.numpy(), expected)


POSE_RANGE = np.array([[-0.5, 0.5], [-0.3, 0.4], [0.1, 0.2], [-0.1, 0.1], [-0.2, 0.2], [-3.0, 3.0]])
VELOCITY_RANGE = np.array([[-0.5, 0.5], [0.0, 0.0], [0.0, 1.0], [-1.0, 1.0], [0.0, 0.5], [0.2, 0.4]])


def ranges() -> list[wp.array]:
    return [wp.array(x.astype(np.float32), dtype=wp.vec2) for x in (POSE_RANGE, VELOCITY_RANGE)]


def turned(pose: np.ndarray, angles: np.ndarray) -> np.ndarray:
    return (Rotation.from_quat(pose[:, 3:]) * Rotation.from_euler("xyz", angles)).as_quat()


def same_pose(actual: np.ndarray, pos: np.ndarray, quat: np.ndarray) -> None:
    np.testing.assert_allclose(actual[:, :3], pos, atol=5e-6)
    np.testing.assert_allclose(abs((actual[:, 3:] * quat).sum(axis=1)), 1.0, atol=1e-5)


@pytest.mark.parametrize(("patches", "move"), [(True, False), (False, False), (True, True)])
def test_a_root_starts_on_a_level_patch(kernels, patches, move):
    terrain, t = terrain_of(hills(), patches=patches)
    robot, r = robot_of()
    s, stream = Stream(SEED, NUM_ENVS), wp.array(Stream(SEED, NUM_ENVS).n, dtype=wp.uint32)
    wp.launch(kernels.from_terrain, dim=NUM_ENVS, inputs=[robot, terrain, stream, *ranges(), move])
    u = s.uniform()
    place = t["env_origin"]
    if patches:
        place = t["init_pos"][t["level"], t["kind"], (u * 5).astype(int)]
    angles = s.rows(POSE_RANGE[3:])
    pose = r["default_root_pose"]
    same_pose(robot.root_pose.numpy(), pose[:, :3] + place, turned(pose, angles))
    np.testing.assert_allclose(terrain.env_origin.numpy(), place if move else t["env_origin"], atol=1e-6)
    np.testing.assert_allclose(robot.root_vel.numpy(), r["default_root_vel"] + s.rows(VELOCITY_RANGE), atol=2e-6)


@pytest.mark.parametrize("footprint", [0.0, 0.5])
def test_a_root_starts_above_the_ground_below_it(kernels, footprint):
    ground, (terrain, t), (robot, r) = hills(), terrain_of(hills()), robot_of()
    s, stream = Stream(SEED, NUM_ENVS), wp.array(Stream(SEED, NUM_ENVS).n, dtype=wp.uint32)
    wp.launch(kernels.on_terrain, dim=NUM_ENVS, inputs=[robot, terrain, stream, *ranges(), footprint])
    offset, angles = s.rows(POSE_RANGE[:3]), s.rows(POSE_RANGE[3:])
    pose = r["default_root_pose"]
    pos = pose[:, :3] + offset
    pos[:, :2] += t["env_origin"][:, :2]
    if footprint:
        grid = [ground.lower[i] + ground.cell[i] * np.arange(n) for i, n in ((0, 41), (1, 31))]
        for i, (x, y) in enumerate(pos[:, :2]):
            near = []
            for axis, at in ((0, x), (1, y)):
                cell = ground.cell[axis]
                inside = (grid[axis] > at - footprint - cell) & (grid[axis] < at + footprint + cell)
                edge = 0 if at < grid[axis][0] else -1
                near.append(np.flatnonzero(inside) if inside.any() else [np.arange(len(grid[axis]))[edge]])
            pos[i, 2] += ground.heights[np.ix_(near[1], near[0])].max()
    else:
        pos[:, 2] += reference_height(ground, *pos[:, :2].T)
    same_pose(robot.root_pose.numpy(), pos, turned(pose, angles))
    np.testing.assert_allclose(robot.root_vel.numpy(), r["default_root_vel"] + s.rows(VELOCITY_RANGE), atol=2e-6)


@pytest.mark.parametrize("simple", [True, False])
def test_a_place_to_go_to_is_a_level_patch(kernels, simple):
    (terrain, t), (robot, r) = terrain_of(hills()), robot_of()
    command = Pose2dCommandData()
    command.pos = wp.zeros(NUM_ENVS, dtype=wp.vec3)
    command.heading = wp.zeros(NUM_ENVS, dtype=float)
    s, stream = Stream(SEED, NUM_ENVS), wp.array(Stream(SEED, NUM_ENVS).n, dtype=wp.uint32)
    inputs = [command, robot, terrain, stream, wp.vec2(-1.0, 2.0), simple, wp.vec2(0.0, 1.0e6)]
    wp.launch(kernels.pose_2d, dim=NUM_ENVS, inputs=inputs)
    place = t["target"][t["level"], t["kind"], (s.uniform() * 7).astype(int)]
    place = place + np.array([0.0, 0.0, 1.0]) * r["default_root_pose"][:, 2:3]
    target = s.uniform(-1.0, 2.0)
    if simple:
        way = place - r["root_pose"][:, :3]
        target = np.arctan2(way[:, 1], way[:, 0])
        away = abs(wrap(target - heading(r["root_pose"]))) >= 0.5 * np.pi
        assert away.any()
        assert not away.all()
        target = np.where(away, wrap(target + np.pi), target)
    np.testing.assert_allclose(command.pos.numpy(), place, atol=2e-6)
    np.testing.assert_allclose(wrap(command.heading.numpy() - target), 0.0, atol=2e-5)


def test_a_place_to_go_to_lies_as_far_away_as_asked(kernels):
    (terrain, t), (robot, r) = terrain_of(hills()), robot_of()
    command = Pose2dCommandData()
    command.pos, command.heading = wp.zeros(NUM_ENVS, dtype=wp.vec3), wp.zeros(NUM_ENVS, dtype=float)
    stream = wp.array(Stream(SEED, NUM_ENVS).n, dtype=wp.uint32)
    inputs = [command, robot, terrain, stream, wp.vec2(-1.0, 2.0), False, wp.vec2(4.0, 5.0)]
    wp.launch(kernels.pose_2d, dim=NUM_ENVS, inputs=inputs)
    there = t["target"][t["level"], t["kind"]]
    far = np.linalg.norm(there[..., :2] - r["root_pose"][:, None, :2], axis=-1)
    possible = (far > 4.001) & (far < 4.999)
    found = np.linalg.norm((command.pos.numpy() - r["root_pose"][:, :3])[:, :2], axis=-1)
    good = possible.sum(axis=1) >= 2  # 24 draws of 7 patches miss two of them once in 3000
    assert good.sum() > 10
    assert (found[good] >= 4.0 - 1e-5).all()
    assert (found[good] <= 5.0 + 1e-5).all()
    never = ~((far > 3.999) & (far < 5.001)).any(axis=1)
    assert never.sum() > 5
    miss = np.maximum(np.maximum(4.0 - far, far - 5.0), 0.0).min(axis=1)
    assert np.isclose(np.maximum(4.0 - found, found - 5.0)[never], miss[never], atol=1e-5).mean() > 0.8


def test_what_an_environment_draws_does_not_depend_on_how_many_there_are(kernels):
    found = []
    for num_envs in (8, 64):
        terrain, _ = terrain_of(hills(), num_envs)
        robot, _ = robot_of(num_envs)
        robot.default_root_vel = robot.root_vel
        stream = wp.array(Stream(SEED, num_envs).n, dtype=wp.uint32)
        wp.launch(kernels.on_terrain, dim=num_envs, inputs=[robot, terrain, stream, *ranges(), 0.2])
        found.append(robot.root_pose.numpy()[:8])
    np.testing.assert_array_equal(*found)


def test_the_terms_are_exported():
    for name in ("terrain_levels_vel", "terrain_out_of_bounds", "reset_root_state_from_terrain"):
        assert isinstance(getattr(mdp, name), wp.Function)
