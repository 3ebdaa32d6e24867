# SPDX-License-Identifier: Apache-2.0
"""Reference of the terms about objects in float64, in the form of ``term_reference`` and ``term_reference_random``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.helpers.term_reference import Params, Values, rotation
from tests.helpers.term_reference_random import Stream, Written

# -- reading


def positions(v: Values) -> np.ndarray:
    return v["ObjectPoolData"]["pose"][..., :3]


def to_target(v: Values) -> np.ndarray:
    pool = v["ObjectPoolData"]
    return pool["target_pose"][..., :3] + pool["env_origin"][:, None] - positions(v)


def in_root_frame(v: Values, vectors: np.ndarray) -> np.ndarray:
    """Vectors (num_envs, k, 3) of the world in the axes of the root."""
    turns = rotation(v["ArticulationData"]["root_pose"]).inv().as_matrix()
    return np.einsum("nij,nkj->nki", turns, vectors)


def shown(v: Values, vectors: np.ndarray) -> np.ndarray:
    active = v["ObjectPoolData"]["active"]
    return np.where(active[..., None], in_root_frame(v, vectors), 0.0).reshape(len(active), -1)


def from_root(v: Values) -> np.ndarray:
    return positions(v) - v["ArticulationData"]["root_pose"][:, None, :3]


def nearest_b(v: Values, p: Params) -> np.ndarray:
    active = v["ObjectPoolData"]["active"]
    distance = np.where(active, np.linalg.norm(from_root(v), axis=-1), np.inf)
    which = distance.argmin(axis=1)
    found = in_root_frame(v, from_root(v))[np.arange(len(which)), which]
    return np.where(active.any(axis=1)[:, None], found, 0.0)


def least(v: Values, points: np.ndarray) -> np.ndarray:
    """Least distance between points (num_envs, b, 3) and active objects; inf where there is none."""
    distance = np.linalg.norm(positions(v)[:, None] - points[:, :, None], axis=-1)
    return np.where(v["ObjectPoolData"]["active"][:, None], distance, np.inf).min(axis=(1, 2), initial=np.inf)


def bodies(v: Values, p: Params) -> np.ndarray:
    return v["ArticulationData"]["body_pose"][:, p["body_ids"], :3]


def mean_active(v: Values, values: np.ndarray) -> np.ndarray:
    active = v["ObjectPoolData"]["active"]
    return np.where(active, values, 0.0).sum(axis=1) / np.maximum(active.sum(axis=1), 1)


def velocity_toward_goal(v: Values, p: Params) -> np.ndarray:
    way, vel = to_target(v), v["ObjectPoolData"]["vel"][..., :3]
    length = np.linalg.norm(way, axis=-1)
    return mean_active(v, (vel * way).sum(axis=-1) / np.where(length > 0.0, length, np.inf))


def outside(v: Values, p: Params) -> np.ndarray:
    place = positions(v) - v["ObjectPoolData"]["env_origin"][:, None]
    return (place < np.array(p["lower"])).any(axis=-1) | (place > np.array(p["upper"])).any(axis=-1)


def reached(v: Values, p: Params) -> np.ndarray:
    active = v["ObjectPoolData"]["active"]
    near = np.linalg.norm(to_target(v), axis=-1) < p["threshold"]
    return active.any(axis=1) & (near | ~active).all(axis=1)


OBSERVATIONS: dict[str, Callable[[Values, Params], np.ndarray]] = {
    "object_positions_b": lambda v, p: shown(v, from_root(v)),
    "object_target_positions_b": lambda v, p: shown(v, from_root(v) + to_target(v)),
    "object_velocities_b": lambda v, p: shown(v, v["ObjectPoolData"]["vel"][..., :3]),
    "object_active": lambda v, p: v["ObjectPoolData"]["active"].astype(float),
    "nearest_object_pos_b": nearest_b,
}

REWARDS: dict[str, Callable[[Values, Params], np.ndarray]] = {
    "object_distance_tanh": lambda v, p: (
        1.0 - np.tanh(least(v, v["ArticulationData"]["root_pose"][:, None, :3]) / p["std"])
    ),
    "object_ee_distance": lambda v, p: 1.0 - np.tanh(least(v, bodies(v, p)) / p["std"]),
    "reach_object": lambda v, p: 1.0 * (least(v, bodies(v, p)) < p["threshold"]),
    "object_moved_to_goal": lambda v, p: mean_active(
        v, 1.0 - np.tanh(np.linalg.norm(to_target(v), axis=-1) / p["std"])
    ),
    "object_velocity_toward_goal": velocity_toward_goal,
    "object_lifted": lambda v, p: mean_active(
        v, 1.0 * (positions(v)[..., 2] - v["ObjectPoolData"]["env_origin"][:, None, 2] > p["minimal_height"])
    ),
}

TERMINATIONS: dict[str, Callable[[Values, Params], np.ndarray]] = {
    "object_out_of_bounds": lambda v, p: (outside(v, p) & v["ObjectPoolData"]["active"]).any(axis=1),
    "object_reached_goal": reached,
}


# -- events


def _written(pool: dict[str, Any], *fields: str) -> Written:
    return {"ObjectPoolData": {f: pool[f] for f in fields}}


def _retire(pool: dict[str, Any], mask: np.ndarray) -> Written:
    parked = np.broadcast_to(pool["parking_pose"], pool["pose"].shape).copy()
    parked[..., :3] += pool["env_origin"][:, None]
    pool["pose"][mask], pool["vel"][mask] = parked[mask], 0.0
    pool["active"][mask], pool["age"][mask], pool["written"][mask] = False, 0, True
    return _written(pool, "pose", "vel", "active", "age", "written")


def retire_objects(v: Values, p: Params, stream: Stream) -> Written:
    pool = v["ObjectPoolData"]
    return _retire(pool, np.ones_like(pool["active"]))


def retire_objects_out_of_bounds(v: Values, p: Params, stream: Stream) -> Written:
    place = positions(v) - v["ObjectPoolData"]["env_origin"][:, None]
    inside = ((place >= np.array(p["lower"])) & (place <= np.array(p["upper"]))).all(axis=-1)
    return _retire(v["ObjectPoolData"], v["ObjectPoolData"]["active"] & ~inside)


def _turned(home: np.ndarray, angles: list[float]) -> np.ndarray:
    return (Rotation.from_quat(home[3:]) * Rotation.from_euler("xyz", angles)).as_quat()


def _spawn(v: Values, p: Params, stream: Stream, place: Callable[..., Any]) -> Written:
    """``place(env, slot, draw)`` gives pose and velocity of a free place, or None."""
    pool = v["ObjectPoolData"]
    low, high = (int(x) for x in p["num_range"])
    for env, active in enumerate(pool["active"]):

        def draw(bounds: Any, env: int = env) -> float:
            return float(stream.uniform(*bounds, where=stream.env == env)[env])

        number = min(low + int(draw((0.0, 1.0)) * (high - low + 1)), high, int((~active).sum()))
        for _ in range(number):
            retired = np.flatnonzero(~active)
            slot = retired[min(int(draw((0.0, 1.0)) * len(retired)), len(retired) - 1)]
            found = place(env, slot, draw)
            if found is not None:
                pool["pose"][env, slot], pool["vel"][env, slot] = found
                pool["active"][env, slot], pool["age"][env, slot], pool["written"][env, slot] = True, 0, True
    return _written(pool, "pose", "vel", "active", "age", "written")


def spawn_objects_at_home(v: Values, p: Params, stream: Stream) -> Written:
    pool = v["ObjectPoolData"]

    def place(env: int, slot: int, draw: Callable[[Any], float]) -> Any:
        pose = pool["home_pose"][env, slot].copy()
        pose[:3] += pool["env_origin"][env]
        return pose, pool["home_vel"][env, slot]

    return _spawn(v, p, stream, place)


def spawn_objects_in_region(v: Values, p: Params, stream: Stream, keep_off: float = 0.0) -> Written:
    pool, root = v["ObjectPoolData"], v["ArticulationData"]["root_pose"]

    def place(env: int, slot: int, draw: Callable[[Any], float]) -> Any:
        home = pool["home_pose"][env, slot]
        for _ in range(p["max_tries"]):
            offset = np.array([draw(b) for b in p["pose_range"][:3]])
            pos = pool["env_origin"][env] + [0.0, 0.0, home[2]] + offset
            others = pool["pose"][env, pool["active"][env], :3]
            near = np.linalg.norm(others - pos, axis=-1) < p["min_distance"]
            if not near.any() and np.linalg.norm((pos - root[env, :3])[:2]) >= keep_off:
                turned = _turned(home, [draw(b) for b in p["pose_range"][3:]])
                twist = [draw(b) for b in p["velocity_range"]]
                return np.concatenate((pos, turned)), pool["home_vel"][env, slot] + twist
        return None

    return _spawn(v, p, stream, place)


def spawn_objects(v: Values, p: Params, stream: Stream) -> Written:
    return spawn_objects_in_region(v, p, stream, p["min_robot_distance"])


def sample_object_targets(v: Values, p: Params, stream: Stream) -> Written:
    pool = v["ObjectPoolData"]
    for slot in range(pool["home_pose"].shape[1]):
        home = pool["home_pose"][:, slot]
        offset, angles = stream.rows(p["pose_range"][:3]), stream.rows(p["pose_range"][3:])
        pos = np.stack((0.0 * home[:, 0], 0.0 * home[:, 0], home[:, 2]), axis=-1) + offset
        turned = [_turned(h, a) for h, a in zip(home, angles, strict=True)]
        pool["target_pose"][:, slot] = np.concatenate((pos, turned), axis=-1)
    return _written(pool, "target_pose")


def reset_object_targets(v: Values, p: Params, stream: Stream) -> Written:
    v["ObjectPoolData"]["target_pose"] = v["ObjectPoolData"]["home_pose"].copy()
    return _written(v["ObjectPoolData"], "target_pose")


EVENTS: dict[str, Callable[[Values, Params, Stream], Written]] = {
    "retire_objects": retire_objects,
    "retire_objects_out_of_bounds": retire_objects_out_of_bounds,
    "spawn_objects": spawn_objects,
    "spawn_objects_at_home": spawn_objects_at_home,
    "spawn_objects_in_region": spawn_objects_in_region,
    "sample_object_targets": sample_object_targets,
    "reset_object_targets": reset_object_targets,
}
