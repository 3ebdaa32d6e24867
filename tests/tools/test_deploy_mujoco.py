# SPDX-License-Identifier: Apache-2.0
"""Tool ``deploy_mujoco.py``: observations and motion in plain MuJoCo are those of the environment."""

from __future__ import annotations

import importlib.util
import math
import runpy
import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.managers import RunningNormCfg
from stripe_newton.rl import OnPolicyRunner, RslRlMLPModelCfg, RslRlRNNModelCfg, RslRlVecEnvWrapper, export_policy
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg, CartpoleManagerPPORunnerCfg
from stripe_tasks.velocity.humanoid import HumanoidFlatEnvCfg, HumanoidFlatPPORunnerCfg
from stripe_tasks.velocity.quadruped import QuadrupedFlatEnvCfg, QuadrupedFlatPPORunnerCfg
from tests.helpers.checkout import TOOLS

pytest.importorskip("onnxruntime")
TOOL = TOOLS / "deployment" / "deploy_mujoco.py"


@pytest.fixture(scope="module")
def tool() -> Any:
    spec = importlib.util.spec_from_file_location("deploy_mujoco", TOOL)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def make_runner(env_cfg: Any, agent_cfg: Any, robot: Path) -> OnPolicyRunner:
    """An untrained policy of the robot as it is in the file, on a plane."""
    torch.manual_seed(0)
    env_cfg.seed, env_cfg.sim.device, env_cfg.scene.num_envs, env_cfg.scene.env_spacing = 2, "cpu", 1, 0.0
    env_cfg.sim.solver.save_to_mjcf = str(robot)
    for name in ("payload", "centre_of_mass", "soles"):
        if hasattr(env_cfg.events, name):
            setattr(env_cfg.events, name, None)
    agent_cfg.algorithm.num_mini_batches = 1
    return OnPolicyRunner(RslRlVecEnvWrapper(ManagerBasedRLEnv(env_cfg), agent_cfg.clip_actions), agent_cfg)


def take_over(robot: Any, env: Any) -> np.ndarray:
    """Put the environment's state into the program's robot; returns the command."""
    data, (q, qd) = robot.data, (env.sim.state.joint_q.numpy(), env.sim.state.joint_qd.numpy())
    data.qpos[:3], data.qpos[3:7] = q[:3], q[[6, 3, 4, 5]]
    data.qpos[robot.qpos], data.qvel[robot.qvel] = q[7:], qd[6:]
    mujoco.mj_forward(robot.model, data)
    com = data.xipos[robot.base] - data.xpos[robot.base]
    data.qvel[3:6] = robot.rotation @ qd[3:6]
    data.qvel[:3] = env.scene["robot"].data.root_lin_vel_w[0].numpy() - np.cross(qd[3:6], com)
    mujoco.mj_forward(robot.model, data)
    return env.command_manager.get_command("base_velocity")[0].numpy()


def quadruped() -> tuple[Any, Any]:
    """With all that is done to observations and actions, and a policy with a state."""
    env_cfg, agent_cfg = QuadrupedFlatEnvCfg(), QuadrupedFlatPPORunnerCfg(clip_actions=0.4)
    seen = env_cfg.observations.policy
    seen.base_ang_vel.scale, seen.base_ang_vel.history_length = (0.25, 0.5, 1.0), 3
    seen.joint_vel.scale, seen.joint_vel.clip = 0.05, (-2.0, 2.0)
    seen.enable_corruption = False
    seen.normalization = RunningNormCfg(clip=3.0)
    env_cfg.actions.joint_pos.clip = {".*_calf_joint": (-1.6, -1.4)}
    env_cfg.actions.joint_pos.scale = {".*_hip_joint": 0.1, ".*_(thigh|calf)_joint": 0.3}
    agent_cfg.actor = RslRlRNNModelCfg(
        hidden_dims=(16,), rnn_hidden_dim=8, distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg()
    )
    return env_cfg, agent_cfg


def humanoid() -> tuple[Any, Any]:
    """With joints of several axes."""
    env_cfg, agent_cfg = HumanoidFlatEnvCfg(), HumanoidFlatPPORunnerCfg()
    env_cfg.observations.policy.enable_corruption = False
    return env_cfg, agent_cfg


@pytest.mark.parametrize("make", [quadruped, humanoid])
def test_mujoco_alone_sees_and_moves_as_the_environment(tool, make, tmp_path):
    env_cfg, agent_cfg = make()
    runner = make_runner(env_cfg, agent_cfg, tmp_path / "robot.xml")
    env, actor = runner.env.unwrapped, runner.get_inference_policy()
    with torch.inference_mode():
        with torch.no_grad():
            list(actor.mlp.parameters())[-1].uniform_(-0.5, 0.5)  # or the actions would be near zero
        runner.env.reset(seed=5)
        for _ in range(3):  # the normalisation sees something
            runner.env.step(0.5 * torch.rand(1, runner.env.num_actions))
        if make is quadruped:
            env.context.parameters["observations.policy.normalization.update"] = False
        files = export_policy(runner, tmp_path)
        obs, dones = runner.env.reset(seed=5), None
        actor.reset()
        policy = tool.Policy(str(files.onnx))
        robot = tool.Robot(str(tmp_path / "robot.xml"), policy.metadata)
        observe = tool.Observations(robot, policy.metadata)
        for _ in range(10):  # while it falls and lands
            observe.command = take_over(robot, env)
            seen = observe()
            np.testing.assert_allclose(
                seen["policy"], obs["policy"][0].numpy(), atol=1e-4 if make is quadruped else 2e-5
            )
            actions = actor(obs)
            if make is quadruped:
                actions = actions.clamp(-0.4, 0.4)
            observe.action = policy(seen)
            np.testing.assert_allclose(observe.action, actions[0].numpy(), atol=1e-4)
            robot.step(tool.targets(policy.metadata, observe.action))
            obs, _, dones, _ = runner.env.step(actions)
            np.testing.assert_allclose(robot.data.ctrl, env.processed_actions[0].numpy(), atol=1e-5)
            after = env.sim.state.joint_q.numpy()
            np.testing.assert_allclose(robot.data.qpos[robot.qpos], after[7:], atol=2e-3)
            np.testing.assert_allclose(robot.data.qpos[:3], after[:3], atol=1e-3)
            assert not dones.any()
        assert np.abs(observe.action).max() > 0.3
        if make is quadruped:
            alone(tmp_path)
    runner.env.close()


def alone(folder: Path) -> None:
    """The program needs nothing of this package, nor torch."""
    hidden = ("torch", "newton", "warp", "stripe_newton", "stripe_kernels", "stripe_tasks")
    with pytest.MonkeyPatch.context() as patch:
        for name in hidden:
            patch.setitem(sys.modules, name, None)
        arguments = [str(folder / "policy.onnx"), str(folder / "robot.xml")]
        patch.setattr(sys, "argv", ["deploy_mujoco.py", *arguments, "--episodes", "2", "--seconds", "0.2"])
        results: list[dict[str, float]] = []
        module = runpy.run_path(str(TOOL))
        report = module["report"]
        module["main"].__globals__["report"] = lambda found: results.extend(found) or report(found)
        module["main"]()
    assert [r["seconds"] for r in results] == pytest.approx([0.2, 0.2])
    assert all(r["finished"] for r in results)
    assert all(math.isnan(r["error_lin"]) for r in results)  # too short to follow anything


def test_a_robot_on_a_fixed_base_is_driven_by_efforts(tool, tmp_path):
    """The cart-pole moves as in the environment, pushed to and fro by a policy that was not trained."""
    env_cfg, agent_cfg = CartpoleManagerEnvCfg(), CartpoleManagerPPORunnerCfg()
    runner = make_runner(env_cfg, agent_cfg, tmp_path / "robot.xml")
    env = runner.env.unwrapped
    with torch.inference_mode():
        runner.env.reset(seed=5)
        files = export_policy(runner, tmp_path)
        policy = tool.Policy(str(files.onnx))
        robot = tool.Robot(str(tmp_path / "robot.xml"), policy.metadata)
        robot.reset(env.sim.state.joint_q.numpy())
        for step in range(20):
            action = np.array([0.5 * math.sin(0.4 * step)])
            robot.step(tool.targets(policy.metadata, action), tool.efforts(policy.metadata, action))
            runner.env.step(torch.tensor(action, dtype=torch.float32)[None])
            np.testing.assert_allclose(robot.data.qpos, env.sim.state.joint_q.numpy(), atol=1e-4)
        assert abs(robot.data.qpos).min() > 0.05  # both joints have moved
        results = [tool.episode(robot, policy, np.zeros(0), 1.2, offset=0.1)]
    assert set(results[0]) == {"seconds", "slider_to_cart", "cart_to_pole"}
    assert "cart_to_pole off by" in tool.report(results)
    runner.env.close()


def test_what_the_program_does_not_know(tool, tmp_path):
    """It says so, by name."""
    robot = tmp_path / "robot.xml"
    robot.write_text("<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>")
    asset = {"joint_names": ["knee"], "fixed_base": False, "stiffness": [1], "damping": [1], "effort_limit": [1]}
    metadata: dict[str, Any] = {"assets": {"robot": asset}, "rates": {}, "actions": {"size": 1}}
    with pytest.raises(SystemExit, match="joint 'knee': found none among"):
        tool.Robot(str(robot), metadata)
    term = {"type": "JointVelocityAction", "name": "speed", "first": 0, "size": 1}
    with pytest.raises(SystemExit, match="action 'speed': JointVelocityAction is not known here; there are JointPos"):
        tool.targets({"assets": {"robot": asset}, "actions": {"terms": [term]}}, np.zeros(1))
