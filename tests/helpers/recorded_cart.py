# SPDX-License-Identifier: Apache-2.0
"""Environments with torch hooks that are recorded on the CPU, by a tape in the place of a CUDA graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch

from stripe_newton.assets import Articulation
from stripe_newton.configclass import configclass
from stripe_newton.envs import DirectRLEnv, hook_parts
from stripe_newton.envs.hook_graphs import HookRecorder
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg
from stripe_newton.scene import InteractiveSceneCfg
from tests.helpers.cart_env import CartCfg
from tests.helpers.tape_graph import TapeGraph

N = 6


@configclass
class RecordedCartCfg(CartCfg):
    scene = InteractiveSceneCfg(num_envs=N, env_spacing=2.0)
    episode_length_s = 0.24
    observation_space = 8
    scale = 10.0


class RecordedCart(DirectRLEnv):
    """A cart whose hooks keep state in the ways that tasks do: new tensors, shifts, in place, log, random numbers."""

    cfg: RecordedCartCfg

    def __init__(self, cfg: RecordedCartCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        self.joints = self.robot.find_joints(".*")[0]
        self.previous = torch.zeros(self.num_envs, 1, device=self.device)
        self.actions = torch.zeros(self.num_envs, 1, device=self.device)
        self.sums = {"height": torch.zeros(self.num_envs, device=self.device)}

    def _setup_scene(self) -> None:
        self.robot = Articulation(self.cfg.robot)
        self.scene.articulations["robot"] = self.robot
        self.scene.clone_environments(copy_from_source=False)

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        self.previous = self.actions
        self.actions = actions.clamp(-1.0, 1.0)

    def _apply_action(self) -> None:
        self.robot.set_joint_effort_target(self.cfg.scale * self.actions, joint_ids=[self.joints[0]])

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        away = self.robot.data.joint_pos[:, 0].abs() > 0.26
        return away, self.episode_length_buf >= self.max_episode_length

    def _get_rewards(self) -> torch.Tensor:
        change = (self.actions - self.previous).square().sum(-1)
        self.sums["height"] += self.robot.data.joint_pos[:, 1].cos()
        self.extras["log"]["change"] = change.mean()
        return 1.0 - change - 0.1 * self.robot.data.joint_vel[:, self.joints].abs().sum(-1)

    def _reset_idx(self, env_ids: Any) -> None:
        super()._reset_idx(env_ids)
        self.extras["log"]["height"] = self.sums["height"][env_ids].mean()
        self.sums["height"][env_ids] = 0.0
        self.actions[env_ids] = 0.0
        start = 0.2 * torch.rand(len(env_ids), 2, device=self.device)
        self.robot.write_joint_state_to_sim(start, torch.zeros_like(start), env_ids=env_ids)
        self.previous = self.previous.clone()

    def _get_observations(self) -> dict[str, torch.Tensor]:
        data = self.robot.data
        noise = 0.01 * torch.randn_like(data.joint_pos)
        return {"policy": torch.cat((data.joint_pos, data.joint_vel, self.previous, self.actions, noise), dim=-1)}


class WarpReset(RecordedCart):
    """Its reset, which does nothing, is in Warp, so that nothing in a step waits."""

    _reset_idx = DirectRLEnv._reset_idx

    def _launch_reset(self, env_mask: Any) -> None:
        pass


def small_agent(iterations: int) -> RslRlOnPolicyRunnerCfg:
    """PPO with small networks and short rollouts."""
    drawn = RslRlMLPModelCfg.GaussianDistributionCfg(init_std=1.0)
    actor = RslRlMLPModelCfg(hidden_dims=(8,), distribution_cfg=drawn)
    critic = RslRlMLPModelCfg(hidden_dims=(8,))
    return RslRlOnPolicyRunnerCfg(num_steps_per_env=4, max_iterations=iterations, actor=actor, critic=critic)


def _tape(self: hook_parts.Recorder, function: Callable[[], None]) -> TapeGraph:
    """Tape of a function, which is recorded as a graph is: without running it."""
    recorder = recorder_of(self.env)
    before = recorder.context.snapshot()
    kept = [(tensor, tensor.clone()) for hook in recorder.hooks for tensor in hook.extras_memory.tensors.values()]
    tape = TapeGraph(function)
    before.restore()
    for tensor, value in kept:
        tensor.copy_(value)
    return tape


def record_on_cpu(patch: pytest.MonkeyPatch) -> None:
    """Let environments record hooks on the CPU, and resets of a number of environments when it comes again."""
    patch.setattr(HookRecorder, "OFTEN", 2)
    patch.setattr(hook_parts, "records_on", lambda device: True)
    patch.setattr(hook_parts.Recorder, "__call__", _tape)


def make(cls: type[RecordedCart] = RecordedCart, **changes: Any) -> RecordedCart:
    env = cls(RecordedCartCfg().replace(**changes))
    env.reset(seed=3)
    return env


def recorder_of(env: RecordedCart) -> HookRecorder:
    assert env._recorder is not None
    return env._recorder


def run(env: RecordedCart, steps: int, first: int = 0) -> list[dict[str, torch.Tensor]]:
    """Results of some steps with actions that depend on the number of the step."""
    found = []
    for k in range(first, first + steps):
        action = torch.sin(torch.arange(env.num_envs).float() * 0.7 + 0.3 * k)[:, None].to(env.device)
        obs, reward, terminated, truncated, extras = env.step(action)
        log = {f"log.{k}": torch.as_tensor(v).float() for k, v in extras["log"].items()}
        found.append({**obs, "reward": reward, "terminated": terminated, "truncated": truncated, **log})
    return found


def first_difference(one: list[dict[str, torch.Tensor]], two: list[dict[str, torch.Tensor]]) -> str:
    """The first step and result that differ in two runs; empty for none."""
    for step, (a, b) in enumerate(zip(one, two, strict=True)):
        if a.keys() != b.keys():
            return f"step {step}: {sorted(a.keys() ^ b.keys())}"
        for name in a:
            if not torch.equal(a[name], b[name]):
                return f"step {step}: {name}"
    return ""
