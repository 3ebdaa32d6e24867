# SPDX-License-Identifier: Apache-2.0
"""Viewed scenes: the attributes of a simulation that the viewers read, without a simulation."""

from __future__ import annotations

import types

import newton
import numpy as np
import pytest
import warp as wp

SMALL = (96, 64)
"""Size of a picture [px]."""


def light(kind, color=(1.0, 1.0, 1.0), intensity=3000.0, direction=(0.3, 0.4, -0.87)):
    return types.SimpleNamespace(kind=kind, color=color, intensity=intensity, direction=direction)


def sim_of(template, num_envs=1, spacing=3.0, ground=True, device="cpu", lights=()):
    """The attributes of a simulation that the viewers read."""
    if device != "cpu" and not wp.is_cuda_available():
        pytest.skip("no NVIDIA GPU")
    static = newton.ModelBuilder()
    if ground:
        static.add_ground_plane()
    origins = np.array([[i * spacing, 0.0, 0.0] for i in range(num_envs)], dtype=np.float32)
    builder = newton.ModelBuilder()
    builder.add_builder(static)
    for origin in origins:
        builder.add_world(template, xform=wp.transform(wp.vec3(*map(float, origin)), wp.quat_identity()))
    model = builder.finalize(device=device)
    state = model.state()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    return types.SimpleNamespace(
        markers=[], body_choices=[],
        device=device, template=template, static=static, env_origins=origins, model=model, state=state,
        num_envs=num_envs, lights=list(lights), env_origin=None,
    )  # fmt: skip


def box(color=(0.9, 0.05, 0.05), position=(0.0, 0.0, 0.5), half=0.15):
    template = newton.ModelBuilder()
    body = template.add_body(xform=wp.transform(wp.vec3(*position), wp.quat_identity()), label="/World/Crate/base")
    template.add_shape_box(body, hx=half, hy=half, hz=half, color=color)
    return template


def move(sim, env, offset):
    count = sim.template.body_count
    poses = sim.state.body_q.numpy()
    poses[env * count : (env + 1) * count, :3] += offset
    sim.state.body_q.assign(poses)


def red_pixels(frame):
    """Row and column of the pixels that are clearly red, shape (n, 2)."""
    r, g, b = (frame[..., i].astype(int) for i in range(3))
    return np.argwhere((r > 90) & (r > 2 * g) & (r > 2 * b))
