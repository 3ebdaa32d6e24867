# SPDX-License-Identifier: Apache-2.0
"""Angles and rotations of stripe_kernels.mdp.frames against SciPy."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import warp as wp
from scipy.spatial.transform import Rotation

from tests.helpers import term_kernels as tk
from tests.helpers import term_reference as reference

FRAMES = """import warp as wp
from stripe_kernels.mdp import frames


@wp.kernel(enable_backward=False)
def angles(x: wp.array[float], wrapped: wp.array[float]):
    i = wp.tid()
    wrapped[i] = frames.wrap_to_pi(x[i])


@wp.kernel(enable_backward=False)
def rotations(
    p: wp.array[wp.quat], q: wp.array[wp.quat], u: wp.array[wp.vec3], euler: wp.array[wp.vec3],
    error: wp.array[wp.vec3], magnitude: wp.array[float], yaw: wp.array[wp.quat], level: wp.array[wp.vec3],
    unique: wp.array[wp.quat],
):
    i = wp.tid()
    euler[i] = frames.euler_xyz(q[i])
    error[i] = frames.quat_error(p[i], q[i])
    magnitude[i] = frames.quat_error_magnitude(p[i], q[i])
    yaw[i] = frames.yaw_quat(q[i])
    level[i] = frames.rotate_inverse_yaw(q[i], u[i])
    unique[i] = frames.quat_unique(q[i])
"""


@cache
def frame_kernels() -> Any:
    return tk.import_source("term_kernels_frames", FRAMES, Path(mkdtemp()))


def test_wrap_to_pi(device):
    inside = np.array([0.0, 1.0, -1.0, 3.14159, -3.14159, 3.1415925, -3.1415925], dtype=np.float32)
    x = np.concatenate((inside, np.linspace(-40.0, 40.0, 801, dtype=np.float32)))
    out = wp.empty(len(x), dtype=float, device=device)
    wp.launch(frame_kernels().angles, dim=len(x), inputs=[wp.array(x, device=device), out], device=device)
    wrapped = out.numpy()
    np.testing.assert_array_equal(wrapped[: len(inside)], inside)
    assert (np.abs(wrapped) <= np.float32(np.pi)).all()
    turns = (x.astype(float) - wrapped) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=2e-6)


def test_rotations(device):
    rng = np.random.default_rng(1)
    special = tk.special_quats()
    q = np.concatenate((special, tk.random_quats(rng, 200))).astype(np.float32)
    p = np.concatenate((tk.random_quats(rng, len(special)), q[len(special) : -5], q[-5:])).astype(np.float32)
    p[len(special) : -5] = tk.random_quats(rng, len(q) - len(special) - 5)
    p[-5:] = -p[-5:]  # the same rotations
    u = rng.normal(size=(len(q), 3)).astype(np.float32)
    n = len(q)
    types = (wp.vec3, wp.vec3, wp.float32, wp.quat, wp.vec3, wp.quat)
    outs = [wp.empty(n, dtype=t, device=device) for t in types]
    ins = [wp.array(a, dtype=t, device=device) for a, t in ((p, wp.quat), (q, wp.quat), (u, wp.vec3))]
    wp.launch(frame_kernels().rotations, dim=n, inputs=[*ins, *outs], device=device)
    euler, error, magnitude, yaw, level, unique = (o.numpy() for o in outs)
    rp, rq = Rotation.from_quat(p), Rotation.from_quat(q)

    back = Rotation.from_euler("xyz", euler)
    assert (back * rq.inv()).magnitude().max() < 2e-6
    assert np.abs(euler[:, 1]).max() <= np.float32(np.pi / 2) + 1e-6
    assert np.abs(euler).max() <= np.float32(np.pi)
    # a rotation vector of half a turn has two signs
    assert (Rotation.from_rotvec(error) * rp * rq.inv()).magnitude().max() < 3e-6
    np.testing.assert_allclose(magnitude, (rq * rp.inv()).magnitude(), atol=2e-6)
    heading = reference.heading(q.astype(float))
    level_x = rq.apply([1.0, 0.0, 0.0])
    defined = np.hypot(level_x[:, 0], level_x[:, 1]) > 1e-3
    expected = Rotation.from_euler("z", heading[:, None])
    assert (Rotation.from_quat(yaw) * expected.inv()).magnitude()[defined].max() < 2e-4
    np.testing.assert_allclose(level[defined], expected.inv().apply(u)[defined], atol=2e-4)
    np.testing.assert_array_equal(unique, np.where(q[:, 3:] < 0.0, -q, q))
