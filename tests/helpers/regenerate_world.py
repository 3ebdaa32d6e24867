# SPDX-License-Identifier: Apache-2.0
"""Hills with posts that differ by seed, and environments on them."""

from __future__ import annotations

import numpy as np
import torch
import warp as wp

from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.scene import ObstaclesCfg
from stripe_newton.sensors import ContactSensorCfg, GridPatternCfg, LidarPatternCfg, RayCasterCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_newton.specifications import AssetSpec, CylinderMesh, Places, SceneSpec, TerrainInstance, TrainingSpec
from stripe_newton.terrains import Ground
from stripe_tasks.robots import ANT_CFG

SIZE, N = (16.0, 16.0), 4


class Posts(AssetSpec):
    """Posts anywhere, one more or less with each seed."""

    def __init__(self, name="posts", mesh=None, count=40, spread=10):
        super().__init__(name)
        self.mesh, self.count, self.spread = mesh or CylinderMesh("post", (0.15, 1.0)), count, spread

    def generate(self, terrain, rng):
        count = self.count + int(rng.integers(0, self.spread + 1))
        places = rng.uniform(-0.48, 0.48, (count, 2)) * terrain.size
        heights = terrain.ground.height_at(*places.T)
        for index, (place, height) in enumerate(zip(places, heights, strict=True)):
            yield self.create_instance(f"a{index}", self.mesh, (*place, height), scale=rng.uniform(0.8, 1.2))


class Hills(SceneSpec):
    """Hills whose height, friction and colour depend on the seed."""

    def __init__(self, size=SIZE, palette=None, places=True, grows=0, **options):
        self.grows = grows
        wanted = {"init_pos": Places(16, margin=1.0), "target": Places(8, margin=1.0)} if places else None
        super().__init__(size, [Posts()] if palette is None else palette, places=wanted, **options)

    def generate(self, rng):
        count = [round(2.0 * s) + 1 + self.grows * int(rng.integers(1, 5)) for s in self.size]
        x, y = np.meshgrid(*(np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(self.size, count, strict=True)))
        relief = rng.uniform(0.2, 0.8)
        heights = relief * np.sin(0.5 * x + rng.uniform(0.0, 6.0)) * np.cos(0.4 * y) + rng.uniform(-1.0, 1.0)
        lower, cell = (-0.5 * self.size[0], -0.5 * self.size[1]), tuple(s / (n - 1) for s, n in zip(self.size, count))
        return TerrainInstance(
            Ground(heights + rng.normal(0.0, 0.01, x.shape), lower, cell), dynamic_friction=float(rng.uniform(0.5, 1.0))
        )


def small_hills():
    """Made in less time than those of 16 m."""
    return Hills((8.0, 8.0), [Posts(count=5, spread=3)])


@configclass
class PolicyCfg(ObservationGroupCfg):
    height: ObservationTermCfg = ObservationTermCfg(func=mdp.base_pos_z)
    joints: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos)
    scan: ObservationTermCfg = ObservationTermCfg(
        func=mdp.height_scan, params={"sensor": SceneEntityCfg("scanner"), "offset": 0.5}
    )


@configclass
class EventsCfg:
    start: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_from_terrain,
        mode="reset",
        params={"pose_range": {}, "velocity_range": {}, "move_origin": True},
    )


def scanner(pattern=None, **options):
    return RayCasterCfg(
        prim_path="{ENV_REGEX_NS}/Robot/torso",
        offset=RayCasterCfg.OffsetCfg(pos=(0.0, 0.0, 1.0)),
        pattern_cfg=pattern or GridPatternCfg(resolution=0.5, size=(1.0, 1.0)),
        mesh_prim_paths=["/World/ground"],
        **options,
    )


def lidar():
    return LidarPatternCfg(
        channels=3, vertical_fov_range=(-40.0, 0.0), horizontal_fov_range=(0.0, 360.0), horizontal_res=30.0
    )


def training(scene=None, device="cpu", **changes):
    fields = {
        "observations": {"policy": PolicyCfg()},
        "actions": {"efforts": mdp.JointEffortActionCfg(joint_names=[".*"], scale=5.0)},
        "rewards": {"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)},
        "terminations": {"time_out": TerminationTermCfg(func=mdp.time_out, time_out=True)},
        "events": EventsCfg(),
        "obstacles": ObstaclesCfg(slots=6, reach=1.2),
        "sensors": {
            "contacts": ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*"),
            "scanner": scanner(),
            "lidar": scanner(lidar()),
        },
        "sim": SimulationCfg(device=device, dt=1 / 120, solver=MuJoCoSolverCfg(njmax=400, nconmax=80)),
        "num_envs": N,
        "env_spacing": 1.0,
        **changes,
    }
    return TrainingSpec(scene=scene or Hills(), robot=ANT_CFG, **fields)


def make(seed, spec=None):
    cfg = (spec or training()).to_env_cfg(decimation=2, episode_length_s=2.0, seed=seed)
    cfg.seed = 0
    env = ManagerBasedRLEnv(cfg)
    env.reset()
    return env


def arrays(holder):
    """Arrays by name; those of structs are left out."""
    found = {k: v for k, v in vars(holder).items() if isinstance(v, wp.array) and v.size}
    return {k: v for k, v in found.items() if not isinstance(v.dtype, wp._src.codegen.Struct)}


def ground_geom(sim):
    shape = list(sim.model.shape_label).index("/World/ground/terrain")
    return int(np.flatnonzero(sim.solver.mjc_geom_to_newton_shape.numpy()[0] == shape)[0])


def copy_state(pair):
    """Both in the first one's state, which stays."""
    fresh, moved = pair
    moved.set_state({**fresh.get_state(), "scenery_seed": 7})


def random_actions(steps):
    return 0.4 * torch.rand(steps, N, 8, generator=torch.Generator().manual_seed(0)) - 0.2


def put_beside_posts(env):
    """Each robot falls onto a post's side."""
    posts, ground = env.scene["obstacles"].capsules, env.scene.terrain.ground
    at = posts.positions[np.abs(posts.positions[:, :2]).max(axis=1) < 6.0][:N, :2] + [0.3, 0.2]
    pose = env.scene["robot"].data.root_state_w[:, :7].clone()
    place = np.column_stack([at, ground.height_at(*at.T) + 0.6])
    pose[:, :3] = torch.tensor(place, dtype=torch.float32, device=pose.device)
    env.scene["robot"].write_root_pose_to_sim(pose)
    env.sim.forward()
