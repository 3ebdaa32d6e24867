# SPDX-License-Identifier: Apache-2.0
"""Viewed boxes: a small environment for tests of viewers, boxes on a plane that slide without a solver."""

from __future__ import annotations

import newton
import numpy as np
import torch
import warp as wp


class BoxSim:
    """What viewers read of a simulation: boxes that fall onto nothing, each beside its neighbour."""

    device = "cpu"

    def __init__(self, num_envs: int = 4, spacing: float = 3.0):
        self.num_envs = num_envs
        self.markers, self.body_choices, self.lights, self.env_origin = [], [], [], None
        self.template, self.static = newton.ModelBuilder(), newton.ModelBuilder()
        self.static.add_ground_plane()
        body = self.template.add_body(xform=wp.transform((0.0, 0.0, 0.5), wp.quat_identity()), label="/World/Box/base")
        self.template.add_shape_box(body, hx=0.2, hy=0.1, hz=0.1, color=(0.9, 0.05, 0.05))
        self.env_origins = np.array([[spacing * i, 0.0, 0.0] for i in range(num_envs)], dtype=np.float32)
        builder = newton.ModelBuilder()
        builder.add_builder(self.static)
        for origin in self.env_origins:
            builder.add_world(self.template, xform=wp.transform(wp.vec3(*map(float, origin)), wp.quat_identity()))
        self.model = builder.finalize(device="cpu")
        self.state = self.model.state()
        newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, self.state)


class BoxEnv:
    """An environment in which every box moves 1 cm along x in a step."""

    max_episode_length = 100
    step_dt = 0.02

    def __init__(self, num_envs: int = 4):
        self.sim = BoxSim(num_envs)
        self.num_envs, self.common_step_counter, self.resets = num_envs, 0, 0
        self.reward_buf = torch.arange(num_envs, dtype=torch.float32)
        self.reset_buf = torch.zeros(num_envs, dtype=torch.bool)
        self.episode_length_buf = torch.zeros(num_envs, dtype=torch.int64)
        self.obs_buf, self.extras = {"policy": torch.zeros(num_envs, 3)}, {"log": {}}
        self._start = self.sim.state.body_q.numpy().copy()

    @property
    def box_positions(self) -> np.ndarray:
        """Positions of the boxes [m], shape ``(num_envs, 3)``."""
        return self.sim.state.body_q.numpy()[:, :3]

    def step(self, action: torch.Tensor | None = None) -> None:
        """Move all boxes."""
        poses = self.sim.state.body_q.numpy().copy()
        poses[:, 0] += 0.01
        self.sim.state.body_q.assign(poses)
        self.common_step_counter += 1
        self.episode_length_buf += 1
        self.reset_buf = self.episode_length_buf >= self.max_episode_length

    def reset(self) -> None:
        """Put all boxes back."""
        self.sim.state.body_q.assign(self._start)
        self.episode_length_buf.zero_()
        self.resets += 1
