# SPDX-License-Identifier: Apache-2.0
"""Navigation terms, against references in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import warp as wp

from stripe_kernels.data import ArticulationData, Pose2dCommandData
from stripe_kernels.terrain import TerrainData
from stripe_tasks import navigation_terms
from tests.helpers.term_kernels import build_struct, random_values
from tests.helpers.term_reference import heading, in_yaw_frame
from tests.helpers.term_reference_random import Stream

N, SEED = 512, 7
NEAR, SPEED, THRESHOLD = 1.5, 0.8, 0.6
LEVELS, TYPES = 4, 3


@wp.kernel(enable_backward=False)
def measure(
    robot: ArticulationData,
    command: Pose2dCommandData,
    near: float,
    speed: float,
    threshold: float,
    vector: wp.array2d[float],
    toward: wp.array[float],
    facing: wp.array[float],
    reached: wp.array[wp.bool],
) -> None:
    env = wp.tid()
    navigation_terms.goal_vector(env, command, robot, near, vector[env])
    toward[env] = navigation_terms.velocity_toward_goal(env, robot, command, speed)
    facing[env] = navigation_terms.facing_goal(env, robot, command)
    reached[env] = navigation_terms.goal_reached(env, robot, command, threshold)


@wp.kernel(enable_backward=False)
def levels(
    robot: ArticulationData,
    terrain: TerrainData,
    command: Pose2dCommandData,
    rng: wp.array[wp.uint32],
    threshold: float,
    result: wp.array[float],
) -> None:
    env = wp.tid()
    result[env] = navigation_terms.terrain_levels_goal(env, robot, terrain, command, rng, threshold)


def states(num_envs: int = N) -> tuple[Any, Any, dict[str, Any]]:
    """Robot and command, and their values; the goals of the last three are at, right above and near the root."""
    values = random_values(4096 if num_envs < N else num_envs, SEED)
    v = {name: values[name] for name in ("ArticulationData", "Pose2dCommandData")}
    root, goal = v["ArticulationData"]["root_pose"], v["Pose2dCommandData"]["pos"]
    goal[-3:] = root[-3:, :3]
    goal[-2, 2] += 2.0
    goal[-1, :2] += [0.3, -0.4]
    for part in v.values():
        for key, value in part.items():
            if isinstance(value, np.ndarray) and value.dtype.kind == "f":
                part[key] = value.astype(np.float32).astype(float)
    return *(build_struct(name, part, "cpu") for name, part in v.items()), v


@pytest.fixture(scope="module")
def measured():
    robot, command, v = states()
    out = [wp.zeros((N, 3), dtype=float, device="cpu"), *(wp.zeros(N, dtype=float, device="cpu") for _ in range(2))]
    out.append(wp.zeros(N, dtype=wp.bool, device="cpu"))
    wp.launch(measure, dim=N, inputs=[robot, command, NEAR, SPEED, THRESHOLD], outputs=out, device="cpu")
    way = (v["Pose2dCommandData"]["pos"] - v["ArticulationData"]["root_pose"][:, :3]) * [1.0, 1.0, 0.0]
    return [o.numpy() for o in out], way, np.linalg.norm(way, axis=1), v["ArticulationData"]


def test_goal_vector(measured):
    (vector, *_), way, far, robot = measured
    there = far > 1e-6
    expected = in_yaw_frame(robot["root_pose"], way / np.maximum(far, 1e-6)[:, None])
    np.testing.assert_allclose(vector[there, :2], expected[there, :2], atol=2e-5)
    np.testing.assert_allclose(np.linalg.norm(vector[there, :2], axis=1), 1.0, atol=2e-5)
    np.testing.assert_array_equal(vector[~there, :2], 0.0)
    np.testing.assert_allclose(vector[:, 2], np.minimum(far / NEAR, 1.0), atol=1e-6)
    assert 20 < (far < NEAR).sum() < N - 20


def test_velocity_toward_goal(measured):
    (_, toward, *_), way, far, robot = measured
    speed = (robot["root_vel"][:, :3] * way).sum(axis=1) / np.maximum(far, 1e-9)
    np.testing.assert_allclose(toward, np.clip(speed / SPEED, -1.0, 1.0), atol=1e-5)
    assert (toward[-3:-1] == 0.0).all()
    assert {-1.0, 1.0} <= set(toward.tolist())
    assert (np.abs(toward) < 0.99).sum() > 100


def test_facing_goal(measured):
    (*_, facing, _), way, far, robot = measured
    ahead = heading(robot["root_pose"])
    cosine = (way[:, 0] * np.cos(ahead) + way[:, 1] * np.sin(ahead)) / np.maximum(far, 1e-9)
    there = far > 1e-6
    np.testing.assert_allclose(facing[there], cosine[there], atol=2e-5)
    assert np.isfinite(facing).all()
    assert facing.min() < -0.9
    assert facing.max() > 0.9


def test_goal_reached(measured):
    (*_, reached), _, far, _ = measured
    np.testing.assert_array_equal(reached, far < THRESHOLD)
    assert reached[-3:].all()  # height does not count
    assert 5 < reached.sum() < N - 5


# -- levels


def world(num_envs: int, count: int = LEVELS) -> tuple[list[Any], dict[str, np.ndarray]]:
    """Robots that start on any tile, and are sent 3 m away; some arrive, some get near, some do not."""
    rng = np.random.default_rng(1)
    robot, command, _ = states(num_envs)
    total = 4096
    level, kind = rng.integers(0, count, total), rng.integers(0, TYPES, total)
    origins = rng.normal(size=(count, TYPES, 3)) * 20.0
    start = origins[level, kind] + rng.normal(size=(total, 3))  # as ``move_origin`` leaves it
    angle = rng.uniform(-np.pi, np.pi, (2, total))
    goal = start + np.stack([3.0 * np.cos(angle[0]), 3.0 * np.sin(angle[0]), rng.normal(size=total)], axis=1)
    far = rng.choice([0.2, 0.59, 0.61, 1.0, 1.49, 1.51, 2.0, 3.5], total)
    pos = goal + np.stack([far * np.cos(angle[1]), far * np.sin(angle[1]), rng.normal(size=total)], axis=1)
    pose = np.concatenate([pos, np.tile([0.0, 0.0, 0.0, 1.0], (total, 1))], axis=1)
    terrain = TerrainData()
    v = {"level": level, "kind": kind, "origins": origins, "far": far, "start": start}
    v = {k: x if k == "origins" else x[:num_envs] for k, x in v.items()}
    robot.root_pose = wp.array(pose[:num_envs].astype(np.float32), dtype=wp.transform, device="cpu")
    command.pos = wp.array(goal[:num_envs].astype(np.float32), dtype=wp.vec3, device="cpu")
    terrain.level = wp.array(v["level"], dtype=int, device="cpu")
    terrain.kind = wp.array(v["kind"], dtype=int, device="cpu")
    terrain.origins = wp.array(origins.astype(np.float32), dtype=wp.vec3, device="cpu")
    terrain.env_origin = wp.array(v["start"].astype(np.float32), dtype=wp.vec3, device="cpu")
    stream = wp.array(Stream(SEED, num_envs).n, dtype=wp.uint32, device="cpu")
    return [robot, terrain, command, stream, THRESHOLD], v


def moved(num_envs: int = N, count: int = LEVELS):
    inputs, v = world(num_envs, count)
    result = wp.zeros(num_envs, dtype=float, device="cpu")
    wp.launch(levels, dim=num_envs, inputs=inputs, outputs=[result], device="cpu")
    return inputs, v, result.numpy()


def test_levels_rise_at_the_goal_and_fall_far_from_it():
    (_, terrain, _, stream, _), v, result = moved()
    reference = Stream(SEED, N)
    up, down = v["far"] < THRESHOLD, v["far"] > 0.5 * 3.0
    level = v["level"] + up - down
    past = level >= LEVELS
    drawn = np.minimum(reference.uniform(where=past) * LEVELS, LEVELS - 1).astype(int)
    for branch in (up & ~past, past, down & (level >= 0), level < 0, ~up & ~down):
        assert branch.sum() > 10
    assert len(set(drawn[past])) == LEVELS
    level = np.where(past, drawn, np.maximum(level, 0))
    np.testing.assert_array_equal(terrain.level.numpy(), level)
    np.testing.assert_array_equal(result, level)
    np.testing.assert_allclose(terrain.env_origin.numpy(), v["origins"][level, v["kind"]], atol=1e-5)
    np.testing.assert_array_equal(stream.numpy(), reference.n)


def test_on_one_level_nothing_moves():
    (_, terrain, _, stream, _), v, result = moved(count=1)
    assert (result == 0.0).all()
    np.testing.assert_array_equal(terrain.level.numpy(), 0)
    np.testing.assert_allclose(terrain.env_origin.numpy(), v["start"], rtol=1e-6)
    np.testing.assert_array_equal(stream.numpy(), Stream(SEED, N).n)


def test_levels_do_not_depend_on_the_number_of_environments():
    np.testing.assert_array_equal(moved(16)[2], moved(N)[2][:16])


def test_all_terms_are_exported():
    for name in navigation_terms.__all__:
        assert isinstance(getattr(navigation_terms, name), wp.Function)
