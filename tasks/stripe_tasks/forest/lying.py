# SPDX-License-Identifier: Apache-2.0
"""Lying wood seen from above: whether fallen trunks and branches overlap discs, paths or each other.

Each has a middle [m], a heading [rad], a length and a radius [m].
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from stripe_newton.specifications import AssetMesh, TerrainInstance

from .darts import sample_map

__all__ = ["along", "clashes", "crossed", "floating", "on_path"]


def crossed(
    at: np.ndarray, yaw: np.ndarray, length: np.ndarray, radius: np.ndarray, discs: np.ndarray, room: np.ndarray
) -> np.ndarray:
    """Mask of the logs that touch discs of radius ``room`` [m]."""
    if not len(discs) or not len(at):
        return np.zeros(len(at), dtype=bool)
    tree = cKDTree(discs)
    near = tree.query_ball_point(at, 0.5 * length + room.max() + radius)
    log = np.repeat(np.arange(len(at)), [len(n) for n in near])
    disc = np.concatenate([np.asarray(n, dtype=int) for n in near]) if len(log) else np.zeros(0, dtype=int)
    heading = np.column_stack([np.cos(yaw), np.sin(yaw)])[log]
    way = discs[disc] - at[log]
    nearest = np.clip((way * heading).sum(axis=1), -0.5 * length[log], 0.5 * length[log])
    hit = np.linalg.norm(way - nearest[:, None] * heading, axis=1) < room[disc] + radius[log]
    return np.bincount(log[hit], minlength=len(at)) > 0


def along(at: np.ndarray, yaw: np.ndarray, length: np.ndarray, points: int) -> np.ndarray:
    """Points from end to end of each log, ``(N, points, 2)``."""
    heading = np.column_stack([np.cos(yaw), np.sin(yaw)])
    return np.asarray(at[:, None] + np.linspace(-0.5, 0.5, points)[:, None] * (length[:, None] * heading)[:, None])


def on_path(terrain: TerrainInstance, at: np.ndarray, yaw: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Mask of the logs that lie on trodden ground."""
    if "trodden" not in terrain.maps:
        return np.zeros(len(at), dtype=bool)
    points = along(at, yaw, length, 33)
    return np.asarray((sample_map(terrain.maps["trodden"], terrain.size, points) > 0.0).any(axis=1))


def clashes(at: np.ndarray, yaw: np.ndarray, length: np.ndarray, radius: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Pairs of logs that touch, at least one of them ``fresh``, the lower index first, ``(K, 2)``."""
    pairs = cKDTree(at).query_pairs(float((length + 2.0 * radius).max()), output_type="ndarray")
    pairs = pairs[fresh[pairs].any(axis=1)]
    one, other = pairs.T
    way = along(at[other], yaw[other], length[other], 65) - at[one, None]
    heading = np.column_stack([np.cos(yaw), np.sin(yaw)])[one, None]
    half = 0.5 * length[one, None]
    nearest = np.clip((way * heading).sum(axis=-1), -half, half)
    apart = np.linalg.norm(way - nearest[..., None] * heading, axis=-1).min(axis=1)
    touch = apart < radius[one] + radius[other] + length[other] / 128.0  # half of the spacing of the points
    return np.sort(pairs[touch], axis=1)


def floating(terrain: TerrainInstance, mesh: AssetMesh, place: np.ndarray, turn: np.ndarray, scale: float) -> float:
    """Least height of a log's colliders, which are capsules, over the ground [m]; negative where one is in it."""
    gaps = []
    for collider in mesh.colliders():
        radius, half = collider.size[0], collider.size[1] if len(collider.size) > 1 else 0.0
        axis = Rotation.from_quat(collider.rot).apply([0.0, 0.0, half])
        line = np.array(collider.pos) + np.linspace(-1.0, 1.0, 17)[:, None] * axis
        x, y, z = (place + scale * Rotation.from_quat(turn).apply(line)).T
        gaps.append((z - terrain.ground.height_at(x, y)).min() - scale * radius)
    return float(min(gaps))
