# SPDX-License-Identifier: Apache-2.0
"""Scenes of one free body that carries a sensor, over ground and shapes that a test adds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import newton
import numpy as np
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.scene import InteractiveScene
from stripe_newton.sensors import SensorBase, SensorBaseCfg
from stripe_newton.sim import CollisionPropertiesCfg, CuboidCfg, MassPropertiesCfg, RigidBodyPropertiesCfg
from tests.helpers.small_scenes import make_scene

ROWS, COLS, CELL = 21, 31, 0.2
LOWER = np.array([-0.5 * CELL * (COLS - 1), -0.5 * CELL * (ROWS - 1)])
HEIGHTS = np.random.default_rng(5).uniform(-0.2, 0.5, (ROWS, COLS))
"""Heights of the field about the world's origin [m], rows along y."""


class _Scenery(SensorBase):
    """Adds shapes that no spawner makes: ``build(template, static)``."""

    def prepare(self, sim: Any, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        self.cfg.build(template, static)


@configclass
class SceneryCfg(SensorBaseCfg):
    """Shapes added to the builders of one environment and of what all share."""

    class_type: Callable[..., Any] | None = _Scenery
    prim_path: str = "{ENV_REGEX_NS}/Body"
    build: Any = None


def add_field(template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
    field = newton.Heightfield(HEIGHTS.astype(np.float32), ROWS, COLS, hx=-LOWER[0], hy=-LOWER[1])
    static.add_shape_heightfield(heightfield=field, label="/World/ground/field")


def add_mesh(template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
    """The triangles of the field as a mesh."""
    x, y = (LOWER[k] + CELL * np.arange(n) for k, n in enumerate((COLS, ROWS)))
    vertices = np.stack([*np.meshgrid(x, y), HEIGHTS], axis=-1).reshape(-1, 3)
    i = (np.arange(ROWS - 1)[:, None] * COLS + np.arange(COLS - 1)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + COLS], 1), np.stack([i + 1, i + COLS + 1, i + COLS], 1)])
    static.add_shape_mesh(-1, mesh=newton.Mesh(vertices, faces.ravel(), compute_inertia=False), label="/World/ground/m")


def body(name: str = "Body", size: float = 0.1) -> RigidObjectCfg:
    """A free cube."""
    spawn = CuboidCfg(
        size=(size, size, size),
        rigid_props=RigidBodyPropertiesCfg(),
        mass_props=MassPropertiesCfg(mass=1.0),
        collision_props=CollisionPropertiesCfg(),
    )
    return RigidObjectCfg(prim_path=f"{{ENV_REGEX_NS}}/{name}", spawn=spawn)


def ray_scene(
    sensor: Any, build: Any = None, num_envs: int = 3, others: dict[str, Any] | None = None
) -> InteractiveScene:
    """A scene whose environments lie in one place, with ``scene.sensors["rays"]`` on the rigid object ``body``."""

    def author(scene: InteractiveScene) -> None:
        scenery = {} if build is None else {"scenery": SceneryCfg(build=build)}
        scene.builder.build_sensors({**scenery, "rays": sensor})

    return make_scene({"body": body(), **(others or {})}, num_envs=num_envs, spacing=0.0, author=author)


def place(scene: InteractiveScene, poses: np.ndarray, name: str = "body") -> None:
    """Put a rigid object at poses, shape ``(num_envs, 7)``, and let the bodies follow."""
    scene.rigid_objects[name].write_root_pose_to_sim(torch.tensor(poses, dtype=torch.float32))
    scene.sim.forward()


def random_poses(count: int, seed: int = 0, tilt: float = 0.4, reach: float = 1.0) -> np.ndarray:
    """Poses above the ground, float64 of float32 numbers, shape ``(count, 7)``."""
    rng = np.random.default_rng(seed)
    angles = np.column_stack([rng.uniform(-tilt, tilt, (count, 2)), rng.uniform(-3.0, 3.0, count)])
    position = np.column_stack([rng.uniform(-reach, reach, (count, 2)), rng.uniform(1.0, 2.0, count)])
    rotation = Rotation.from_euler("xyz", angles).as_quat()
    return np.concatenate([position, rotation], axis=1).astype(np.float32).astype(np.float64)


def rays_of(poses: np.ndarray, starts: np.ndarray, directions: np.ndarray, alignment: str) -> tuple[np.ndarray, ...]:
    """Starts and directions in the world, float64, shape ``(num_envs, num_rays, 3)``."""
    rotation = Rotation.from_quat(poses[:, 3:])
    if alignment == "world":
        rotation = Rotation.identity(len(poses))
    if alignment == "yaw":
        forward = rotation.apply([1.0, 0.0, 0.0])
        rotation = Rotation.from_euler("z", np.arctan2(forward[:, 1:2], forward[:, :1]))
    turn = rotation.as_matrix()
    return poses[:, None, :3] + starts @ turn.transpose(0, 2, 1), directions @ turn.transpose(0, 2, 1)


def surface_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Height of the field's triangles, float64; infinite beside it."""
    u, v = (x - LOWER[0]) / CELL, (y - LOWER[1]) / CELL
    inside = (u >= 0) & (v >= 0) & (u <= COLS - 1) & (v <= ROWS - 1)
    col, row = (np.clip(np.floor(w), 0, n - 2).astype(int) for w, n in ((u, COLS), (v, ROWS)))
    fx, fy = u - col, v - row
    h = HEIGHTS.astype(np.float32).astype(np.float64)
    a, b, c, d = h[row, col], h[row, col + 1], h[row + 1, col], h[row + 1, col + 1]
    near = a + fx * (b - a) + fy * (c - a)
    far = d + (1 - fx) * (c - d) + (1 - fy) * (b - d)
    return np.where(inside, np.where(fx + fy <= 1.0, near, far), np.inf)
