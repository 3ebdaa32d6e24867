# SPDX-License-Identifier: Apache-2.0
"""The program that runs a policy in plain MuJoCo sees and does what the environment does."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_tasks.velocity_humanoid import HumanoidFlatEnvCfg
from stripe_tasks.velocity_quadruped import QuadrupedFlatEnvCfg

TOOL = Path(__file__).parents[1] / "tools" / "sim_to_sim.py"


@pytest.fixture(scope="module")
def tool() -> Any:
    spec = importlib.util.spec_from_file_location("sim_to_sim", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("name", "cfg_type"), [("Quadruped", QuadrupedFlatEnvCfg), ("Humanoid", HumanoidFlatEnvCfg)])
def test_mujoco_alone_sees_and_moves_as_the_environment(tool, name, cfg_type):
    robot = tool.Robot(f"Stripe-Velocity-Flat-{name}-v0")
    cfg = cfg_type(seed=2)
    cfg.sim.device, cfg.scene.num_envs, cfg.scene.env_spacing = "cpu", 1, 0.0
    cfg.observations.policy.enable_corruption = False
    for name in ("payload", "centre_of_mass", "soles"):  # the robot as it is in the file
        setattr(cfg.events, name, None)
    env = ManagerBasedRLEnv(cfg)
    obs, _ = env.reset(seed=5)
    generator = torch.Generator().manual_seed(1)
    data = mujoco.MjData(robot.model)
    for _ in range(10):  # while it falls and lands
        action = torch.rand(1, len(robot.drives), generator=generator) - 0.5
        state = env.sim.state.joint_q.numpy(), env.sim.state.joint_qd.numpy()
        data.qpos[:3], data.qpos[3:7] = state[0][:3], state[0][[6, 3, 4, 5]]
        data.qpos[robot.qpos], data.qvel[robot.qvel] = state[0][7:], state[1][6:]
        mujoco.mj_forward(robot.model, data)
        com = data.xipos[robot.base] - data.xpos[robot.base]
        turn = data.xmat[robot.base].reshape(3, 3)
        data.qvel[3:6] = turn.T @ state[1][3:6]
        data.qvel[:3] = env.scene["robot"].data.root_lin_vel_w[0].numpy() - np.cross(state[1][3:6], com)
        mujoco.mj_forward(robot.model, data)
        command = obs["policy"][0, 9:12].numpy()
        seen = np.concatenate([f(data, command, env.actions[0].numpy()) for f in tool.functions_of(robot)])
        np.testing.assert_allclose(seen, obs["policy"][0].numpy(), atol=2e-5)

        data.ctrl[robot.drives] = robot.scale * action[0].numpy() + robot.offset
        mujoco.mj_step(robot.model, data, robot.decimation)
        obs, *_ = env.step(action)
        after = env.sim.state.joint_q.numpy()
        np.testing.assert_allclose(data.qpos[robot.qpos], after[7:], atol=2e-3)
        np.testing.assert_allclose(data.qpos[:3], after[:3], atol=1e-3)
    env.close()
