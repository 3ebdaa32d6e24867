# SPDX-License-Identifier: Apache-2.0
"""Viewed boxes: a small environment for tests of viewers, boxes on a plane that slide without a solver."""

from __future__ import annotations

import math
from types import SimpleNamespace

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
        self.external_wrench, self.wrench_in_world = None, None
        newton.eval_fk(self.model, self.model.joint_q, self.model.joint_qd, self.state)

    def enable_external_wrench(self) -> None:
        """Make room for wrenches, as a simulation does."""
        if self.external_wrench is None:
            self.external_wrench = wp.zeros(self.model.body_count, dtype=wp.spatial_vector, device="cpu")
            self.wrench_in_world = wp.zeros(self.model.body_count, dtype=wp.bool, device="cpu")


class VelocityTerm:
    """A velocity command as a command manager has it."""

    def __init__(self, num_envs: int):
        ranges = SimpleNamespace(lin_vel_x=(-1.0, 2.0), lin_vel_y=(0.0, 0.0), ang_vel_z=(-1.5, 1.5))
        self.cfg = SimpleNamespace(ranges=ranges)
        self.vel_command_b = self.command = 0.25 * torch.ones(num_envs, 3)
        self.is_heading_env = torch.ones(num_envs, dtype=torch.bool)
        self.is_standing_env = torch.ones(num_envs, dtype=torch.bool)
        self.time_left = 3.0 * torch.ones(num_envs)


class PoseTerm:
    """A pose command as a command manager has it."""

    def __init__(self, num_envs: int):
        axes = ("pos_x", "pos_y", "pos_z", "roll", "pitch", "yaw")
        self.cfg = SimpleNamespace(ranges=SimpleNamespace(**dict.fromkeys(axes, (-1.0, 1.0))), update=None)
        self.pose_command_b = self.command = torch.zeros(num_envs, 7)
        self.command[:, 6] = 1.0
        self.time_left = 3.0 * torch.ones(num_envs)


class Commands:
    """A command manager of the two."""

    active_terms = ("velocity", "pose", "nothing")

    def __init__(self, num_envs: int):
        self.terms = {"velocity": VelocityTerm(num_envs), "pose": PoseTerm(num_envs)}

    def get_term(self, name: str) -> VelocityTerm | PoseTerm:
        """A term."""
        return self.terms[name]

    def get_command(self, name: str) -> torch.Tensor:
        """The numbers of a term."""
        return self.terms[name].command


def box_sensors(num_envs: int) -> dict[str, SimpleNamespace]:
    """A grid of rays, a lidar, contacts, frames and a camera, as a scene has them."""
    hits = torch.arange(num_envs * 12, dtype=torch.float32).reshape(num_envs, 4, 3)
    hits[:, 3] = math.inf
    identity = torch.tensor([0.0, 0.0, 0.0, 1.0])
    pose = {"pos_w": torch.ones(num_envs, 3), "quat_w": identity.repeat(num_envs, 1)}
    grid = SimpleNamespace(pattern_cfg=SimpleNamespace(size=(1.0, 1.0)))
    lidar = SimpleNamespace(pattern_cfg=SimpleNamespace(channels=2), offset=SimpleNamespace(pos=(0.0, 0.0, 0.5)))
    camera = SimpleNamespace(
        output={
            "rgb": torch.full((num_envs, 4, 6, 3), 128, dtype=torch.uint8),
            "depth": torch.arange(num_envs * 24, dtype=torch.float32).reshape(num_envs, 4, 6, 1),
        },
        pos_w=torch.full((num_envs, 3), 2.0),
        quat_w_world=identity.repeat(num_envs, 1),
        intrinsic_matrices=torch.tensor([[2.0, 0, 3], [0, 2.0, 2], [0, 0, 1]]).repeat(num_envs, 1, 1),
        image_shape=(4, 6),
    )
    return {
        "scan": SimpleNamespace(data=SimpleNamespace(ray_hits_w=hits, **pose), cfg=grid),
        "lidar": SimpleNamespace(data=SimpleNamespace(ray_hits_w=hits, **pose), cfg=lidar),
        "feet": SimpleNamespace(
            data=SimpleNamespace(net_forces_w=torch.tensor([[[0.0, 0.0, 50.0]]]).repeat(num_envs, 1, 1)),
            body_names=["base"],
            parent_path="/World/Box",
        ),
        "frames": SimpleNamespace(
            data=SimpleNamespace(target_pos_w=torch.ones(num_envs, 2, 3), target_quat_w=identity.repeat(num_envs, 2, 1))
        ),
        "camera": SimpleNamespace(data=camera),
    }


class BoxEnv:
    """An environment in which every box moves 1 cm along x in a step, and as wrenches push it."""

    max_episode_length = 100
    step_dt = 0.02

    def __init__(self, num_envs: int = 4):
        self.sim = BoxSim(num_envs)
        self.num_envs, self.common_step_counter, self.resets = num_envs, 0, 0
        self.reward_buf = torch.arange(num_envs, dtype=torch.float32)
        self.reset_buf = torch.zeros(num_envs, dtype=torch.bool)
        self.episode_length_buf = torch.zeros(num_envs, dtype=torch.int64)
        self.obs_buf, self.extras = {"policy": torch.zeros(num_envs, 3)}, {"log": {}}
        self.command_manager = Commands(num_envs)
        self.scene = SimpleNamespace(sensors=box_sensors(num_envs), articulations={})
        self._start = self.sim.state.body_q.numpy().copy()

    @property
    def box_positions(self) -> np.ndarray:
        """Positions of the boxes [m], shape ``(num_envs, 3)``."""
        return self.sim.state.body_q.numpy()[:, :3]

    def step(self, action: torch.Tensor | None = None) -> None:
        """Move all boxes."""
        poses = self.sim.state.body_q.numpy().copy()
        poses[:, 0] += 0.01
        if self.sim.external_wrench is not None:
            speeds = self.sim.state.body_qd.numpy().copy()
            forces = self.sim.external_wrench.numpy()[:, :3]
            speeds[:, :3] += self.step_dt * forces / self.sim.model.body_mass.numpy()[:, None]
            poses[:, :3] += self.step_dt * speeds[:, :3]
            self.sim.state.body_qd.assign(speeds)
        self.sim.state.body_q.assign(poses)
        self.common_step_counter += 1
        self.episode_length_buf += 1
        self.reset_buf = self.episode_length_buf >= self.max_episode_length

    def update_debug_vis(self) -> None:
        """It draws no markers of its own."""

    def reset(self) -> None:
        """Put all boxes back."""
        self.sim.state.body_q.assign(self._start)
        self.episode_length_buf.zero_()
        self.resets += 1


def take(viewer, env, count):
    """Take so many steps as the page lets."""
    for _ in viewer.steps(count):
        env.step()
