# SPDX-License-Identifier: Apache-2.0
"""Obstacles, and scenes with collider slots."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.scene import Capsules, InteractiveScene, InteractiveSceneCfg, ObstaclesCfg
from stripe_newton.sensors import SensorBase, SensorCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    GroundPlaneCfg,
    MuJoCoSolverCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SimulationCfg,
    SphereCfg,
)
from stripe_tasks.robots import QUADRUPED_CFG

REACH = 1.2


def random_capsules(count: int, seed: int, half: float = 5.0, longest: float = 6.0) -> Capsules:
    """Capsules of all lengths and directions, some longer than many cells."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-half, half, (count, 3)) * [1.0, 1.0, 0.1]
    lengths = rng.uniform(0.0, 1.0, count) ** 3 * longest
    return Capsules(positions, rng.normal(size=(count, 4)), rng.uniform(0.02, 0.3, count), lengths)


def distances(capsules: Capsules, point: np.ndarray) -> np.ndarray:
    """From a point to all surfaces [m], float64."""
    x, y, z, w = capsules.rotations.astype(np.float64).T
    axis = np.column_stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)])
    offset = point - capsules.positions
    half = capsules.half_length.astype(np.float64)
    along = np.clip((offset * axis).sum(axis=1), -half, half)
    return np.linalg.norm(offset - along[:, None] * axis, axis=1) - capsules.radius


class StaticCapsules(SensorBase):
    """The obstacles as ordinary colliders of the world."""

    def prepare(self, sim: Any, template: Any, static: Any) -> None:
        there = self.cfg.obstacles
        for i in range(len(there)):
            pose = wp.transform(wp.vec3(*there.positions[i]), wp.quat(*there.rotations[i]))
            size = {"radius": float(there.radius[i]), "half_height": float(there.half_length[i])}
            static.add_shape_capsule(-1, xform=pose, **size)


@configclass
class StaticCapsulesCfg(SensorCfg):
    """Config of them."""

    class_type: Any = StaticCapsules
    prim_path: str = "/World/obstacles"
    obstacles: Any = None


@configclass
class WalkCfg(InteractiveSceneCfg):
    """A quadruped on a plane, among obstacles."""

    ground: AssetBaseCfg = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    robot: ArticulationCfg = QUADRUPED_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    obstacles: Any = None


@configclass
class BallCfg(InteractiveSceneCfg):
    """A ball, and another one that is not to be touched."""

    ground: AssetBaseCfg = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    robot: RigidObjectCfg = RigidObjectCfg(
        prim_path="{ENV_REGEX_NS}/Ball",
        spawn=SphereCfg(radius=0.1, rigid_props=RigidBodyPropertiesCfg(), collision_props=CollisionPropertiesCfg()),
        init_state=RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, 0.5)),
    )
    obstacles: Any = None
    other: Any = None


def make(cfg: InteractiveSceneCfg, **sim: Any) -> InteractiveScene:
    solver = MuJoCoSolverCfg(njmax=300, nconmax=80)
    options = {"device": "cpu", "dt": 0.005, "solver": solver} | sim
    scene = InteractiveScene(cfg, Simulation(SimulationCfg(**options)))
    scene.build()
    return scene


def slots_cfg(capsules: Capsules, **changes: Any) -> ObstaclesCfg:
    return ObstaclesCfg(source=lambda: capsules, reach=REACH).replace(**changes)


def ball_scene(capsules: Capsules, num_envs: int = 3, other: Any = None, **changes: Any) -> InteractiveScene:
    return make(BallCfg(num_envs=num_envs, env_spacing=2.0, obstacles=slots_cfg(capsules, **changes), other=other))


def move_to(scene: InteractiveScene, points: np.ndarray) -> None:
    pose = scene["robot"].data.root_pose_w.clone()
    pose[:, :3] = torch.from_numpy(np.asarray(points, dtype=np.float32))
    scene["robot"].write_root_pose_to_sim(pose)
