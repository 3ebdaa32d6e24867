# SPDX-License-Identifier: Apache-2.0
"""A direct environment written for Isaac Lab 2.3, with its imports and its quaternions (w, x, y, z)."""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import stripe_newton.isaaclab as dialect
from tests.helpers.small_scenes import numpy

START = Rotation.from_euler("xyz", [0.3, 0.0, 1.1])
TURN_BY_ACTION = Rotation.from_euler("z", 0.5)

FILE = """
import torch

import isaaclab.sim as sim_utils
from isaaclab.assets import RigidObject, RigidObjectCfg
from isaaclab.envs import DirectRLEnv, DirectRLEnvCfg
from isaaclab.scene import InteractiveSceneCfg
from isaaclab.sim import PhysxCfg, SimulationCfg
from isaaclab.utils import configclass


@configclass
class BoxEnvCfg(DirectRLEnvCfg):
    decimation = 2
    episode_length_s = 0.2
    action_space = 4
    observation_space = 7
    state_space = 0
    sim: SimulationCfg = SimulationCfg(dt=1 / 100, device="cpu", gravity=(0.0, 0.0, 0.0), physx=PhysxCfg())
    scene: InteractiveSceneCfg = InteractiveSceneCfg(num_envs=3, env_spacing=2.0)
    box: RigidObjectCfg = RigidObjectCfg(
        prim_path="/World/envs/env_.*/Box",
        spawn=sim_utils.CuboidCfg(
            size=(0.1, 0.2, 0.3),
            rigid_props=sim_utils.RigidBodyPropertiesCfg(),
            mass_props=sim_utils.MassPropertiesCfg(mass=1.0),
        ),
        init_state=RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, 1.0), rot=START),
    )


class BoxEnv(DirectRLEnv):
    cfg: BoxEnvCfg

    def _setup_scene(self):
        self.box = RigidObject(self.cfg.box)
        self.scene.clone_environments(copy_from_source=False)
        self.scene.rigid_objects["box"] = self.box

    def _pre_physics_step(self, actions):
        self.actions = actions.clone()
        pose = self.box.data.root_pose_w.clone()
        pose[:, 3:7] = self.actions
        self.box.write_root_pose_to_sim(pose)

    def _apply_action(self):
        pass

    def _get_observations(self):
        return {"policy": self.box.data.root_link_pose_w - torch.nn.functional.pad(self.scene.env_origins, (0, 4))}

    def _get_rewards(self):
        return (self.box.data.root_quat_w * self.actions).sum(dim=-1).abs()

    def _get_dones(self):
        time_out = self.episode_length_buf >= self.max_episode_length - 1
        return torch.zeros_like(time_out), time_out

    def _reset_idx(self, env_ids):
        super()._reset_idx(env_ids)
        state = self.box.data.default_root_state[env_ids]
        state[:, :3] += self.scene.env_origins[env_ids]
        self.box.write_root_pose_to_sim(state[:, :7], env_ids)
        self.box.write_root_velocity_to_sim(state[:, 7:], env_ids)
"""


@pytest.fixture(scope="module")
def env(tmp_path_factory: pytest.TempPathFactory) -> Iterator[object]:
    folder: Path = tmp_path_factory.mktemp("task")
    start = tuple(map(float, START.as_quat(scalar_first=True)))
    (folder / "box_env_of_isaac_lab.py").write_text(FILE.replace("rot=START", f"rot={start}"))
    sys.path.insert(0, str(folder))
    dialect.install()
    try:
        import box_env_of_isaac_lab as task  # type: ignore[import-not-found]

        made = task.BoxEnv(task.BoxEnvCfg())
        yield made
        made.close()
    finally:
        dialect.uninstall()
        sys.path.remove(str(folder))
        sys.modules.pop("box_env_of_isaac_lab", None)


def test_an_episode_in_wxyz(env):
    start, turned = START.as_quat(scalar_first=True), TURN_BY_ACTION.as_quat(scalar_first=True)
    obs, _ = env.reset()
    np.testing.assert_allclose(numpy(obs["policy"]), [[0, 0, 1, *start]] * 3, atol=1e-5)
    actions = torch.tensor(turned, dtype=torch.float32).repeat(3, 1)
    for step in range(1, env.max_episode_length):
        obs, reward, terminated, time_out, _ = env.step(actions)
        np.testing.assert_allclose(numpy(reward), 1.0, atol=1e-5)
        last = step == env.max_episode_length - 1
        native = (START if last else TURN_BY_ACTION).as_quat()
        np.testing.assert_allclose(numpy(env.box.native_data.root_quat_w), [native] * 3, atol=1e-5)
        assert time_out.all() == last
        assert not terminated.any()
        # After the last step the observation is of the new episode.
        expected = start if last else turned
        np.testing.assert_allclose(numpy(obs["policy"])[:, 3:], [expected] * 3, atol=1e-5)


def test_the_scene_hands_out_wxyz(env):
    env.reset()
    start = START.as_quat(scalar_first=True)
    np.testing.assert_allclose(numpy(env.scene["box"].data.root_quat_w), [start] * 3, atol=1e-5)
    state = env.scene.get_state(is_relative=True)["rigid_object"]["box"]["root_pose"]
    np.testing.assert_allclose(numpy(state), [[0, 0, 1, *start]] * 3, atol=1e-5)
