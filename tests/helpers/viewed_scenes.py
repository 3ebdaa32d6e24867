# SPDX-License-Identifier: Apache-2.0
"""Viewed scenes: the attributes of a simulation that the viewers read, without a simulation."""

from __future__ import annotations

import types

import newton
import numpy as np
import pytest
import warp as wp


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
