# SPDX-License-Identifier: Apache-2.0
"""Quadruped on generated tiles with a curriculum: starts on the ground, levels by the distance covered."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.data import Pose2dCommandData
from stripe_newton.assets import Articulation, ArticulationCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg, ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    CurriculumTermCfg,
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_newton.terrains import (
    FlatPatchSamplingCfg,
    HfRandomUniformTerrainCfg,
    MeshInvertedPyramidStairsTerrainCfg,
    MeshPyramidStairsTerrainCfg,
    TerrainGeneratorCfg,
    TerrainImporterCfg,
)
from stripe_tasks.robots import QUADRUPED_CFG

NUM_ENVS, STEPS = 6, 4
PATCHES = {"target": FlatPatchSamplingCfg(num_patches=6, patch_radius=0.3, max_height_diff=0.05)}
TILES = TerrainGeneratorCfg(
    size=(4.0, 4.0),
    border_width=2.0,
    num_rows=4,
    num_cols=3,
    curriculum=True,
    sub_terrains={
        "up": MeshPyramidStairsTerrainCfg(
            step_height_range=(0.05, 0.15), step_width=0.4, platform_width=1.2, flat_patch_sampling=PATCHES
        ),
        "down": MeshInvertedPyramidStairsTerrainCfg(
            step_height_range=(0.05, 0.15), step_width=0.4, platform_width=1.2, flat_patch_sampling=PATCHES
        ),
        "rough": HfRandomUniformTerrainCfg(
            noise_range=(0.0, 0.04), noise_step=0.01, downsampled_scale=0.2, flat_patch_sampling=PATCHES
        ),
    },
)


@configclass
class SceneCfg(InteractiveSceneCfg):
    """Tiles and a quadruped."""

    terrain: TerrainImporterCfg = TerrainImporterCfg(prim_path="/World/ground", terrain_generator=TILES)
    robot: ArticulationCfg = QUADRUPED_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")


@configclass
class PolicyCfg(ObservationGroupCfg):
    """Observations of the policy."""

    command: ObservationTermCfg = ObservationTermCfg(func=mdp.generated_commands, params={"command_name": "velocity"})


@configclass
class EnvCfg(ManagerBasedRLEnvCfg):
    """Episodes of a few steps."""

    decimation: int = 2
    episode_length_s: float = 0.01 * STEPS
    seed: int | None = 3
    sim: SimulationCfg = SimulationCfg(device="cpu", dt=0.005, solver=MuJoCoSolverCfg(njmax=200, nconmax=60))
    scene: SceneCfg = SceneCfg(num_envs=NUM_ENVS, env_spacing=2.5)
    observations: Any = {"policy": PolicyCfg()}
    actions: Any = {"joint_pos": mdp.JointPositionActionCfg(asset_name="robot", joint_names=[".*"], scale=0.25)}
    commands: Any = {
        "velocity": mdp.UniformVelocityCommandCfg(
            resampling_time_range=(10.0, 10.0),
            heading_command=False,
            rel_standing_envs=0.0,
            ranges=mdp.UniformVelocityCommandCfg.Ranges(
                lin_vel_x=(0.5, 1.0), lin_vel_y=(0.0, 0.0), ang_vel_z=(0.0, 0.0)
            ),
        ),
        "place": mdp.TerrainBasedPose2dCommandCfg(resampling_time_range=(10.0, 10.0), simple_heading=False),
    }
    rewards: Any = {"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)}
    terminations: Any = {
        "time_out": TerminationTermCfg(func=mdp.time_out, time_out=True),
        "gone": TerminationTermCfg(func=mdp.terrain_out_of_bounds, params={"distance_buffer": 0.5}),
    }
    events: Any = {
        "base": EventTermCfg(
            func=mdp.reset_root_state_uniform_on_terrain,
            mode="reset",
            params={
                "pose_range": {"x": (-0.25, 0.25), "y": (-0.25, 0.25), "yaw": (-math.pi, math.pi)},
                "velocity_range": {},
                "footprint": 0.3,
            },
        )
    }
    curriculum: Any = {"levels": CurriculumTermCfg(func=mdp.terrain_levels_vel, params={"command_name": "velocity"})}


@pytest.fixture(scope="module")
def env() -> Iterator[ManagerBasedRLEnv]:
    made = ManagerBasedRLEnv(EnvCfg())
    yield made
    made.close()


def feet_above_ground(env: Any) -> np.ndarray:
    """Distance of the lowest point of each foot sphere from the ground below it [m], shape ``(num_envs, feet)``."""
    model, state = env.sim.model, env.sim.state
    labels = model.shape_label
    feet = [i for i, label in enumerate(labels) if "foot" in label.lower() and model.shape_flags.numpy()[i] & 2]
    assert len(feet) == 4 * env.num_envs, labels[:40]
    poses = torch.tensor(state.body_q.numpy())
    gaps = []
    for i in feet:
        body, local = int(model.shape_body.numpy()[i]), model.shape_transform.numpy()[i]
        centre = wp.transform_point(wp.transform(*poses[body].tolist()), wp.vec3(*map(float, local[:3])))
        radius = float(model.shape_scale.numpy()[i][0])
        ground = env.scene.terrain.ground.height_at(np.array([centre[0]]), np.array([centre[1]]))[0]
        gaps.append(centre[2] - radius - ground)
    return np.array(gaps).reshape(env.num_envs, 4)


def test_episodes_start_on_the_ground(env):
    for _ in range(3):
        env.reset()
        lowest = feet_above_ground(env).min(axis=1)
        assert lowest.min() > -0.02
        assert lowest.max() < 0.05


def test_on_stairs_no_foot_starts_in_a_step(env):
    name = next(k for k in env.context.arrays if k.endswith("base.pose_range"))
    before = env.context.arrays[name].numpy().copy()
    wide = before.copy()
    wide[:2] = (-1.6, 1.6)
    env.context.arrays[name].assign(wide)
    env.reset()
    root = env.scene["robot"].data.root_pos_w
    away = (root - env.scene.env_origins)[:, :2].abs().max(dim=1).values
    assert away.max() > 0.8  # some are beyond the platform
    assert feet_above_ground(env).min() > -0.02
    env.context.arrays[name].assign(before)


def test_levels_follow_how_far_the_robots_got(env):
    terrain, robot = env.scene.terrain, env.scene["robot"]
    env.reset()
    far = torch.tensor([True, True, False, False, True, False])
    seen = set()
    for _ in range(4):
        levels, start = terrain.terrain_levels.clone(), terrain.env_origins.clone()
        for _ in range(STEPS - 1):
            env.step(torch.zeros(NUM_ENVS, 12))
        pose = robot.data.root_state_w[:, :7].clone()
        pose[:, :2] = start[:, :2] + far[:, None] * torch.tensor([2.2, 0.0])
        pose[:, 2] = 1.0 + terrain.height_at(pose)
        robot.write_root_pose_to_sim(pose)
        robot.write_root_velocity_to_sim(torch.zeros(NUM_ENVS, 6))
        _, _, _, truncated, extras = env.step(torch.zeros(NUM_ENVS, 12))
        assert truncated.all()
        wanted = torch.where(far, levels + 1, (levels - 1).clip(min=0))
        past = wanted >= 4
        seen |= {("past" if p else "up" if f else "down") for p, f in zip(past.tolist(), far.tolist(), strict=True)}
        torch.testing.assert_close(terrain.terrain_levels[~past], wanted[~past])
        assert ((terrain.terrain_levels >= 0) & (terrain.terrain_levels < 4)).all()
        origins = terrain.terrain_origins[terrain.terrain_levels.long(), terrain.terrain_types.long()]
        torch.testing.assert_close(terrain.env_origins, origins)
        away = (robot.data.root_pos_w - origins).abs()
        assert away[:, :2].max() < 0.26  # the new episode starts on the new tile
        assert feet_above_ground(env).min() > -0.02
        mean = float(extras["log"]["Curriculum/levels"])
        assert mean == pytest.approx(float(terrain.terrain_levels.float().mean()), abs=1e-5)
    assert seen == {"up", "down", "past"}


def test_a_world_that_is_no_longer_finite_is_not_judged(env):
    """It ends at the pose that the model was built with, which may be many tiles away."""
    env.reset()
    terrain = env.scene.terrain
    everyone = torch.ones(NUM_ENVS, dtype=torch.bool)
    terrain.update_env_origins(torch.arange(NUM_ENVS), everyone, ~everyone)
    env.reset()
    before = terrain.terrain_levels.clone()
    env.scene["robot"].data.joint_pos[2] = math.nan
    _, _, terminated, _, extras = env.step(torch.zeros(NUM_ENVS, 12))
    assert terminated.tolist() == [False, False, True, False, False, False]
    assert terrain.terrain_levels.equal(before)
    assert float(extras["log"]["Episode_Termination/non_finite"]) > 0.0


def test_places_to_go_to_are_level_patches_of_the_tile(env):
    env.reset()
    terrain = env.scene.terrain
    command = env.context.structs.provided[Pose2dCommandData]["place"]
    where = command.pos.numpy()
    patches = terrain.flat_patches["target"][terrain.terrain_levels.long(), terrain.terrain_types.long()].numpy()
    gaps = np.linalg.norm(patches + [0.0, 0.0, 0.34] - where[:, None], axis=2)
    assert gaps.min(axis=1).max() < 1e-4


def test_levels_are_part_of_the_state_that_is_kept(env):
    env.reset()
    terrain = env.scene.terrain
    state = env.get_state()
    levels, origins = terrain.terrain_levels.clone(), terrain.env_origins.clone()
    everyone = torch.ones(NUM_ENVS, dtype=torch.bool)
    terrain.update_env_origins(torch.arange(NUM_ENVS), everyone, ~everyone)
    assert not terrain.env_origins.equal(origins)
    env.set_state(state)
    assert terrain.terrain_levels.equal(levels)
    assert terrain.env_origins.equal(origins)


def test_a_robot_that_leaves_the_ground_is_taken_back(env):
    env.reset()
    robot = env.scene["robot"]
    pose = robot.data.root_state_w[:, :7].clone()
    pose[2, 0] = 40.0
    robot.write_root_pose_to_sim(pose)
    _, _, terminated, _, _ = env.step(torch.zeros(NUM_ENVS, 12))
    assert terminated.tolist() == [i == 2 for i in range(NUM_ENVS)]
    assert (robot.data.root_pos_w - env.scene.env_origins)[2, :2].abs().max() < 0.26


def test_a_place_to_go_to_needs_level_patches():
    tiles = TILES.copy()
    for sub in tiles.sub_terrains.values():
        sub.flat_patch_sampling = None
    cfg = EnvCfg()
    cfg.scene.terrain.terrain_generator = tiles
    with pytest.raises(ConfigError, match="has no flat patches named 'target'"):
        ManagerBasedRLEnv(cfg)


@configclass
class WalkCfg(DirectRLEnvCfg):
    """A direct environment in the style of Isaac Lab's ``anymal_c``."""

    decimation: int = 2
    episode_length_s: float = 1.0
    observation_space: Any = 3
    action_space: Any = 12
    sim: SimulationCfg = SimulationCfg(device="cpu", dt=0.005, solver=MuJoCoSolverCfg(njmax=200, nconmax=60))
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=NUM_ENVS, env_spacing=2.5)
    terrain: TerrainImporterCfg = TerrainImporterCfg(prim_path="/World/ground", terrain_generator=TILES)
    robot: ArticulationCfg = QUADRUPED_CFG.replace(prim_path="/World/envs/env_.*/Robot")


class WalkEnv(DirectRLEnv):
    """Robots start on the tiles' origins."""

    cfg: WalkCfg

    def _setup_scene(self) -> None:
        self._robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self._robot
        self.cfg.terrain.num_envs = self.scene.cfg.num_envs
        self.cfg.terrain.env_spacing = self.scene.cfg.env_spacing
        self._terrain = self.cfg.terrain.class_type(self.cfg.terrain)
        self.scene.clone_environments(copy_from_source=False)
        self.scene.filter_collisions(global_prim_paths=[self.cfg.terrain.prim_path])

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        self._target = self._robot.data.default_joint_pos + 0.1 * actions

    def _apply_action(self) -> None:
        self._robot.set_joint_position_target(self._target)

    def _get_observations(self) -> dict[str, torch.Tensor]:
        return {"policy": self._robot.data.root_lin_vel_b}

    def _get_rewards(self) -> torch.Tensor:
        return torch.zeros(self.num_envs)

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        late = self.episode_length_buf >= self.max_episode_length - 1
        return torch.zeros_like(late), late

    def _reset_idx(self, env_ids: Any) -> None:
        super()._reset_idx(env_ids)
        state = self._robot.data.default_root_state[env_ids]
        state[:, :3] += self._terrain.env_origins[env_ids]
        self._robot.write_root_state_to_sim(state, env_ids)


def test_a_direct_environment_moves_its_robots_to_other_levels():
    env = WalkEnv(WalkCfg())
    env.reset()
    assert env.scene.terrain is env._terrain
    ids, everyone = torch.arange(NUM_ENVS), torch.ones(NUM_ENVS, dtype=torch.bool)
    env._terrain.terrain_levels[:] = 1
    env._terrain.update_env_origins(ids, everyone, ~everyone)
    assert env._terrain.terrain_levels.eq(2).all()
    env.reset()
    offset = env._robot.data.root_pos_w - env._terrain.terrain_origins[2, env._terrain.terrain_types.long()]
    torch.testing.assert_close(offset, torch.tensor([0.0, 0.0, 0.34]).expand(NUM_ENVS, 3), atol=1e-5, rtol=0)
    env.step(torch.zeros(NUM_ENVS, 12))
    env.close()


def test_levels_that_do_not_get_harder_are_no_curriculum():
    cfg = EnvCfg()
    cfg.scene.terrain.terrain_generator = TILES.replace(curriculum=False)
    with pytest.raises(ConfigError, match=r"curriculum\.levels: .*curriculum=True"):
        ManagerBasedRLEnv(cfg)


def test_a_reset_to_patches_needs_them():
    cfg = EnvCfg()
    params = {"pose_range": {}, "velocity_range": {}}
    cfg.events = {"base": EventTermCfg(func=mdp.reset_root_state_from_terrain, mode="reset", params=params)}
    with pytest.raises(ConfigError, match=r"events\.base: .*no flat patches named 'init_pos'"):
        ManagerBasedRLEnv(cfg)
