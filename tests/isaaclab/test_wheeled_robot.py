# SPDX-License-Identifier: Apache-2.0
"""A direct task of a robot with two wheels, as in Isaac Lab's walkthrough: JetBot by its path, arrows as markers."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest
import torch

import stripe_newton.isaaclab as dialect
from tests.helpers.small_scenes import numpy

RADIUS, BASE = 0.03, 0.1125

FILE = """
import torch

import isaaclab.sim as sim_utils
import isaaclab.utils.math as math_utils
from isaaclab.actuators import ImplicitActuatorCfg
from isaaclab.assets import Articulation, ArticulationCfg
from isaaclab.envs import DirectRLEnv, DirectRLEnvCfg
from isaaclab.markers import VisualizationMarkers, VisualizationMarkersCfg
from isaaclab.scene import InteractiveSceneCfg
from isaaclab.sim import SimulationCfg
from isaaclab.sim.spawners.from_files import GroundPlaneCfg, spawn_ground_plane
from isaaclab.utils import configclass
from isaaclab.utils.assets import ISAAC_NUCLEUS_DIR

ROVER_CFG = ArticulationCfg(
    spawn=sim_utils.UsdFileCfg(usd_path=f"{ISAAC_NUCLEUS_DIR}/Robots/NVIDIA/Jetbot/jetbot.usd"),
    actuators={"wheels": ImplicitActuatorCfg(joint_names_expr=[".*"], damping=None, stiffness=None)},
)


@configclass
class RoverEnvCfg(DirectRLEnvCfg):
    decimation = 2
    episode_length_s = 5.0
    action_space = 2
    observation_space = 3
    state_space = 0
    sim: SimulationCfg = SimulationCfg(dt=1 / 120, render_interval=decimation, device="cpu")
    robot_cfg: ArticulationCfg = ROVER_CFG.replace(prim_path="/World/envs/env_.*/Robot")
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=3, env_spacing=4.0, replicate_physics=True)
    dof_names = ["left_wheel_joint", "right_wheel_joint"]


class RoverEnv(DirectRLEnv):
    cfg: RoverEnvCfg

    def __init__(self, cfg, render_mode=None, **kwargs):
        super().__init__(cfg, render_mode, **kwargs)
        self.dof_idx, _ = self.robot.find_joints(self.cfg.dof_names)

    def _setup_scene(self):
        self.robot = Articulation(self.cfg.robot_cfg)
        spawn_ground_plane(prim_path="/World/ground", cfg=GroundPlaneCfg())
        self.scene.clone_environments(copy_from_source=False)
        self.scene.articulations["robot"] = self.robot
        self.markers = VisualizationMarkers(
            VisualizationMarkersCfg(
                prim_path="/Visuals/arrows",
                markers={
                    "forward": sim_utils.UsdFileCfg(
                        usd_path=f"{ISAAC_NUCLEUS_DIR}/Props/UIElements/arrow_x.usd",
                        scale=(0.25, 0.25, 0.5),
                        visual_material=sim_utils.PreviewSurfaceCfg(diffuse_color=(0.0, 1.0, 1.0)),
                    ),
                },
            )
        )
        self.up = torch.tensor([0.0, 0.0, 1.0], device=self.device)
        self.yaws = torch.full((self.num_envs, 1), 0.5, device=self.device)

    def _pre_physics_step(self, actions):
        self.actions = actions.clone()
        orientations = math_utils.quat_from_angle_axis(self.yaws, self.up).squeeze()
        self.markers.visualize(self.robot.data.root_pos_w, orientations, marker_indices=torch.zeros(self.num_envs))

    def _apply_action(self):
        self.robot.set_joint_velocity_target(self.actions, joint_ids=self.dof_idx)

    def _get_observations(self):
        forward = math_utils.quat_apply(self.robot.data.root_link_quat_w, self.robot.data.FORWARD_VEC_B)
        dot = torch.sum(forward[:, :2] * torch.cat([self.yaws.cos(), self.yaws.sin()], dim=-1), dim=-1, keepdim=True)
        speed = self.robot.data.root_com_lin_vel_b[:, 0].reshape(-1, 1)
        return {"policy": torch.hstack((dot, self.robot.data.root_com_vel_w[:, 5:6], speed))}

    def _get_rewards(self):
        return torch.linalg.norm(self.robot.data.root_com_lin_vel_b, dim=-1, keepdim=True)

    def _get_dones(self):
        return False, self.episode_length_buf >= self.max_episode_length - 1

    def _reset_idx(self, env_ids):
        if env_ids is None:
            env_ids = self.robot._ALL_INDICES
        super()._reset_idx(env_ids)
        state = self.robot.data.default_root_state[env_ids]
        state[:, :3] += self.scene.env_origins[env_ids]
        self.robot.write_root_state_to_sim(state, env_ids)
"""


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ModuleType]:
    folder = tmp_path_factory.mktemp("rover")
    (folder / "rover_of_isaac_lab.py").write_text(FILE)
    sys.path.insert(0, str(folder))
    dialect.install()
    try:
        import rover_of_isaac_lab as module  # type: ignore[import-not-found]

        yield module
    finally:
        dialect.uninstall()
        sys.path.remove(str(folder))
        sys.modules.pop("rover_of_isaac_lab", None)


def test_two_wheels_drive_and_turn_as_their_radius_and_distance_say(task):
    env = task.RoverEnv(task.RoverEnvCfg())
    env.reset(seed=0)
    wheels = np.array([[6.0, 6.0], [-2.0, 2.0], [3.0, 5.0]])  # left and right [rad/s]: straight, on the spot, a curve
    for _ in range(60):
        obs, reward, *_ = env.step(torch.tensor(wheels, dtype=torch.float32))
    facing, turning, speed = numpy(obs["policy"]).T
    np.testing.assert_allclose(turning, RADIUS * (wheels[:, 1] - wheels[:, 0]) / BASE, rtol=0.1, atol=0.02)
    # The velocity is that of the centre of mass, behind the axle; along x it is the axle's.
    np.testing.assert_allclose(speed, RADIUS * wheels.mean(axis=1), rtol=0.05, atol=0.005)
    np.testing.assert_allclose(facing[0], np.cos(0.5), atol=0.02)
    assert reward.shape == (3,)
    np.testing.assert_allclose(numpy(env.robot.data.root_pos_w)[:, 2], 0.0, atol=0.002)
    env.close()
