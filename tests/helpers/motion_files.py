# SPDX-License-Identifier: Apache-2.0
"""Motions to read: smooth random ones, as files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

__all__ = ["smooth_motion", "write_motion"]


def smooth_motion(times: np.ndarray, stance: Sequence[float], seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Root positions [m], quaternions (x, y, z, w) and joints [rad] at some times: slow sines about a stance."""
    num_joints = len(stance)
    rng = np.random.default_rng(seed)
    rates, phases = rng.uniform(1.0, 4.0, 6 + num_joints), rng.uniform(0.0, 6.0, 6 + num_joints)
    waves = np.sin(times[:, None] * rates + phases)
    pos = np.array([0.3, 0.3, 0.1]) * waves[:, :3] + [0.0, 0.0, 0.8]
    quat = Rotation.from_rotvec(np.array([0.3, 0.3, 1.0]) * waves[:, 3:6]).as_quat()
    return pos, quat, np.array(stance) + 0.25 * waves[:, 6:]


def write_motion(path: Path, stance: Sequence[float], seconds: float, fps: float, seed: int) -> None:
    """Write a smooth motion as CSV."""
    times = np.arange(round(seconds * fps) + 1) / fps
    np.savetxt(path, np.concatenate(smooth_motion(times, stance, seed), axis=1), delimiter=",", fmt="%.9f")
