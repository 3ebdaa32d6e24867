# SPDX-License-Identifier: Apache-2.0
"""Manager-based cart-pole: plain, and with noise, history, delay, commands, events, a curriculum and metrics."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp

from stripe_kernels.data import ArticulationData, CommandData
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import (
    CommandTermCfg,
    CurriculumTermCfg,
    EventTermCfg,
    MetricTermCfg,
    RewardTermCfg,
)
from stripe_newton.noise import NoiseModelWithAdditiveBiasCfg, UniformNoiseCfg
from stripe_tasks.cartpole.manager_based import (
    CartpoleManagerEnvCfg,
)

N = 4
DT = 1.0 / 60.0


def fields(cfg: Any) -> dict[str, Any]:
    return {k: getattr(cfg, k) for k in cfg.__dataclass_fields__}


def config(num_envs: int = N, steps: int = 300, **changes: Any) -> CartpoleManagerEnvCfg:
    """The cartpole on the CPU, with episodes of ``steps`` steps."""
    cfg = CartpoleManagerEnvCfg(episode_length_s=steps * DT, seed=3)
    cfg.sim.device, cfg.scene.num_envs = "cpu", num_envs
    return cfg.replace(**changes)


def make(num_envs: int = N, steps: int = 300, **changes: Any) -> ManagerBasedRLEnv:
    return ManagerBasedRLEnv(config(num_envs, steps, **changes))


def actions_of(step: int, num_envs: int = N) -> torch.Tensor:
    """The same for an environment whatever their number."""
    return 0.5 * torch.sin(1.7 * step + torch.arange(num_envs, dtype=torch.float32))[:, None]


def put(env: ManagerBasedRLEnv, pole: list[float], cart: list[float] | float = 0.0) -> None:
    data = env.scene["robot"].data
    data.joint_pos[:, 1], data.joint_pos[:, 0] = torch.tensor(pole), torch.as_tensor(cart)
    data.joint_vel.zero_()
    env.sim.forward()


@wp.func
def kick(env: int, robot: ArticulationData, rng: wp.array[wp.uint32], speed: float):
    robot.joint_vel[env, 0] = robot.joint_vel[env, 0] + mdp.random.uniform_range(env, rng, wp.vec2(-speed, speed))


@wp.func
def draw_place(env: int, command: CommandData, rng: wp.array[wp.uint32]):
    command.command[env, 0] = mdp.random.uniform_range(env, rng, wp.vec2(-1.0, 1.0))


@wp.func
def off_place(env: int, command: CommandData, robot: ArticulationData) -> float:
    return wp.abs(command.command[env, 0] - robot.joint_pos[env, 0])


def rich(num_envs: int = N, **changes: Any) -> CartpoleManagerEnvCfg:
    """With noise, bias, history, delay, commands, events, a curriculum and metrics."""
    cfg = config(num_envs, 37, **changes)
    noise = UniformNoiseCfg(n_min=-0.01, n_max=0.01)
    policy = cfg.observations.policy
    policy.enable_corruption = True
    policy.pole_pos = policy.pole_pos.replace(noise=noise, history_length=3)
    policy.pole_vel = policy.pole_vel.replace(
        noise=NoiseModelWithAdditiveBiasCfg(noise_cfg=noise, bias_noise_cfg=UniformNoiseCfg(n_min=-0.2, n_max=0.2))
    )
    policy.cart_pos = policy.cart_pos.replace(delay_max_lag=3)
    cfg.observations = {"policy": policy}
    cfg.actions.joint_effort = cfg.actions.joint_effort.replace(noise=noise, delay_max_lag=2)
    cfg.commands = {"place": CommandTermCfg(resampling_time_range=(0.1, 0.4), resample=draw_place, size=1)}
    cfg.rewards = {**fields(cfg.rewards), "off": RewardTermCfg(off_place, weight=-0.3)}
    kicks = EventTermCfg(kick, {"speed": 0.5}, mode="interval", interval_range_s=(0.1, 0.5))
    cfg.events = {**fields(cfg.events), "kick": kicks}
    weight = {"term_name": "alive", "weight": 3.0, "num_steps": 20}
    cfg.curriculum = {"alive": CurriculumTermCfg(mdp.modify_reward_weight, weight)}
    cfg.metrics = {"off": MetricTermCfg(off_place)}
    return cfg


def rollout(env: ManagerBasedRLEnv, steps: int, first: int = 0, count: int | None = None) -> list[tuple[Any, ...]]:
    """Outputs of each step, of the first ``count`` environments."""
    out, ends = [], 0
    for k in range(first, first + steps):
        obs, reward, terminated, truncated, _ = env.step(actions_of(k, env.num_envs))
        values = obs["policy"], reward, terminated, truncated, wp.to_torch(env.context.rng)
        out.append(tuple(v[:count].clone() for v in values))
        ends += int((terminated | truncated).sum())
    assert ends > 0 or steps < 37
    return out
