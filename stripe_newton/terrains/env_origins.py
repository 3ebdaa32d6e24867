# SPDX-License-Identifier: Apache-2.0
"""Environment origins: where environments start on the ground, by tile or on a square grid."""

from __future__ import annotations

import numpy as np

from .ground import Ground
from .spiral_grid import spiral_grid

__all__ = ["grid_origins", "tile_of"]


def tile_of(num_envs: int, shape: tuple[int, int], max_level: int | None, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Level and type of each environment; both depend only on its index, not on ``num_envs``.

    Args:
        num_envs: Number of environments.
        shape: Number of levels and of types.
        max_level: Highest level to start on. None: any.
        seed: Seed of the levels.

    Returns:
        Levels, uniformly random, and types in turn, int32, shape ``(num_envs,)`` each.
    """
    levels, types = shape
    count = levels if max_level is None else min(max_level + 1, levels)
    # Generator.random fills from one stream: environment i gets the i-th number however many follow.
    draws = np.random.default_rng([seed, 1]).random(num_envs)
    return (draws * count).astype(np.int32), (np.arange(num_envs) % types).astype(np.int32)


def grid_origins(num_envs: int, spacing: float, ground: Ground | None) -> np.ndarray:
    """Origins on the square grid of the scene, at the height of the ground, shape ``(num_envs, 3)``.

    Raises:
        ValueError: if the grid reaches beyond the ground.
    """
    origins = spiral_grid(num_envs, spacing)
    if ground is None:
        return origins
    origins[:, :2] += np.array(ground.middle, dtype=np.float32)
    reach = np.abs(origins[:, :2] - np.array(ground.middle, dtype=np.float32)).max(initial=0.0)
    if reach > 0.5 * min(ground.size):
        raise ValueError(
            f"env_spacing is {spacing} m: {num_envs} environments reach {reach:.1f} m from the middle of the terrain, "
            f"which is {ground.size[0]:.1f} m by {ground.size[1]:.1f} m; set a smaller env_spacing (0 puts all of "
            "them in its middle)"
        )
    origins[:, 2] = ground.height_at(origins[:, 0], origins[:, 1])
    return origins
