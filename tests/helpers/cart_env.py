# SPDX-License-Identifier: Apache-2.0
"""Cart with a pole whose environment records the calls of its hooks."""

from __future__ import annotations

import torch

from stripe_newton.assets import Articulation
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_tasks.robots import CARTPOLE_CFG

N = 4


@configclass
class CartCfg(DirectRLEnvCfg):
    sim = SimulationCfg(device="cpu", dt=0.01, solver=MuJoCoSolverCfg(disable_contacts=True))
    scene = InteractiveSceneCfg(num_envs=N, env_spacing=2.0)
    decimation = 2
    episode_length_s = 0.2
    observation_space = 4
    action_space = 1
    robot = CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")
    start = 0.3
    limit = 100.0


class CartEnv(DirectRLEnv):
    """Records the calls of its hooks; the first environment may be made to fail."""

    cfg: CartCfg

    def __init__(self, cfg, render_mode=None, **kwargs):
        self.calls: list[str] = []
        super().__init__(cfg, render_mode, **kwargs)
        self.joint_pos, self.joint_vel = self.robot.data.joint_pos, self.robot.data.joint_vel
        self.buffer = torch.zeros(self.num_envs, 4)
        self.fail = torch.zeros(self.num_envs, dtype=torch.bool)
        self.logged = torch.zeros(())

    def _setup_scene(self):
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        self.scene.clone_environments(copy_from_source=False)

    def _pre_physics_step(self, actions):
        self.calls.append("pre")
        self.actions = actions

    def _apply_action(self):
        self.calls.append("apply")
        self.robot.set_joint_effort_target(10.0 * self.actions, joint_ids=[0])

    def _get_dones(self):
        self.calls.append("dones")
        fail = self.fail | (self.joint_pos[:, 0].abs() > self.cfg.limit) | ~torch.isfinite(self.joint_pos).all(-1)
        return fail, self.episode_length_buf >= self.max_episode_length

    def _get_rewards(self):
        self.calls.append("rewards")
        self.logged += 1.0
        self.extras["log"]["count"] = self.logged
        return self.joint_pos[:, 0].clone()

    def _reset_idx(self, env_ids):
        self.calls.append("reset")
        super()._reset_idx(env_ids)
        ids = self.robot.env_indices(env_ids)
        start = torch.full((len(ids), 2), self.cfg.start) + 0.1 * torch.rand(len(ids), 2)
        self.robot.write_joint_state_to_sim(start, torch.zeros(len(ids), 2), env_ids=ids)

    def _get_observations(self):
        self.calls.append("observations")
        self.buffer[:, :2], self.buffer[:, 2:] = self.joint_pos, self.joint_vel
        return {"policy": self.buffer}


def make(cls=CartEnv, **changes) -> CartEnv:
    return cls(CartCfg().replace(**changes))


def zeros(env) -> torch.Tensor:
    return torch.zeros(env.num_envs, 1)


def rollout(env, steps: int = 14) -> torch.Tensor:
    out = [env.step(torch.sin(torch.arange(N).float() + k)[:, None])[0]["policy"] for k in range(steps)]
    return torch.stack(out)
