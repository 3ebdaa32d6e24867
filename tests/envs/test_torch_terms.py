# SPDX-License-Identifier: Apache-2.0
"""Torch terms of a manager-based environment, against the same terms in Warp."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
import warp as wp

from stripe_kernels.data import ArticulationData
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import (
    CurriculumTermCfg,
    EventTermCfg,
    MetricTermCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_tasks.cartpole.manager_based import (
    CART,
    POLE,
)
from tests.helpers.cartpole_manager_env import (
    N,
    actions_of,
    config,
    fields,
    rollout,
)


def joints(env: ManagerBasedRLEnv) -> Any:
    return env.scene["robot"].data


def torch_pole(env: ManagerBasedRLEnv) -> torch.Tensor:
    return joints(env).joint_pos[:, 1:2]


def torch_angle(env: ManagerBasedRLEnv, target: float) -> torch.Tensor:
    return (joints(env).joint_pos[:, 1] - target) ** 2


def torch_fallen(env: ManagerBasedRLEnv, limit: float) -> torch.Tensor:
    return joints(env).joint_pos[:, 1].abs() > limit


def torch_start(env: ManagerBasedRLEnv, env_ids: torch.Tensor, angle: float) -> None:
    joints(env).joint_pos[env_ids] = torch.tensor([0.0, angle])
    joints(env).joint_vel[env_ids] = 0.0


def torch_stop(env: ManagerBasedRLEnv, env_ids: torch.Tensor) -> None:
    joints(env).joint_vel[env_ids] = 0.0


def torch_level(env: ManagerBasedRLEnv, env_ids: torch.Tensor) -> dict[str, float]:
    return {"ended": float(len(env_ids))}


@wp.func
def warp_start(env: int, robot: ArticulationData, angle: float):
    robot.joint_pos[env, 0] = 0.0
    robot.joint_pos[env, 1] = angle
    robot.joint_vel[env, 0] = 0.0
    robot.joint_vel[env, 1] = 0.0


@wp.func
def warp_stop(env: int, robot: ArticulationData):
    robot.joint_vel[env, 0] = 0.0
    robot.joint_vel[env, 1] = 0.0


def mixed(use_torch: bool) -> ManagerBasedRLEnv:
    cfg = config(steps=37)
    observations, rewards = fields(cfg.observations.policy), fields(cfg.rewards)
    policy, ends = cfg.observations.policy, fields(cfg.terminations)
    assert "pole_pos" in observations
    start, stop = (torch_start, torch_stop) if use_torch else (warp_start, warp_stop)
    if use_torch:
        policy.pole_pos = ObservationTermCfg(torch_pole, size=1, scale=2.0)
        rewards["pole_pos"] = RewardTermCfg(torch_angle, {"target": 0.0}, weight=-1.0)
        ends["pole_fallen"] = TerminationTermCfg(torch_fallen, {"limit": 0.5 * math.pi})
        cfg.curriculum = {"level": CurriculumTermCfg(torch_level)}
    else:
        policy.pole_pos = policy.pole_pos.replace(scale=2.0)
    angle = torch_angle if use_torch else mdp.joint_pos_target_l2
    params = {"target": 0.1} if use_torch else {**POLE, "target": 0.1}
    cfg.metrics = {"angle": MetricTermCfg(angle, params)}
    cfg.events = {
        "start": EventTermCfg(start, {"angle": 0.2}, mode="reset"),
        "stop": EventTermCfg(stop, mode="interval", interval_range_s=(0.2, 0.4)),
    }
    cfg.rewards, cfg.terminations = rewards, ends
    return ManagerBasedRLEnv(cfg)


def test_torch_terms_give_the_same_numbers():
    env, other = mixed(use_torch=True), mixed(use_torch=False)
    assert torch.equal(*(e.reset(seed=6)[0]["policy"] for e in (env, other)))
    ended = 0
    for k in range(80):
        one, two = (e.step(actions_of(k)) for e in (env, other))
        torch.testing.assert_close(one[0]["policy"], two[0]["policy"], rtol=1e-5, atol=1e-5)
        torch.testing.assert_close(one[1], two[1], rtol=1e-5, atol=1e-5)
        assert torch.equal(one[2], two[2])
        assert torch.equal(one[3], two[3])
        assert {k for k in one[4]["log"] if not k.startswith("Curriculum")} == two[4]["log"].keys()
        for key, value in two[4]["log"].items():
            torch.testing.assert_close(one[4]["log"][key], value, rtol=1e-4, atol=1e-5, msg=key)
        now = int((one[2] | one[3]).sum())
        ended += now
        if now:
            assert float(one[4]["log"]["Curriculum/level/ended"]) == now
    assert ended > N
    text = env.describe()
    for name in ("pole_pos", "pole_fallen", "angle", "start", "stop", "level"):
        assert f"torch term '{name}'" in text, name
    assert "torch term" not in other.describe()


def test_masked_reset_leaves_the_others_alone_beside_torch_terms():
    env, twin = mixed(use_torch=True), mixed(use_torch=True)
    for e in (env, twin):
        e.reset(seed=6)
        rollout(e, 8)
    seen, others = env.obs_buf["policy"].clone(), [0, 2]
    obs, _ = env.reset(options={"reset_mask": torch.tensor([False, True, False, True])})
    assert torch.equal(obs["policy"][others], seen[others])
    assert obs["policy"][1, 0] == pytest.approx(2.0 * 0.2)
    for k in range(8, 40):
        one, two = env.step(actions_of(k)), twin.step(actions_of(k))
        assert torch.equal(one[0]["policy"][others], two[0]["policy"][others]), k
        assert torch.equal(one[1][others], two[1][others]), k


def asked_joints(env: ManagerBasedRLEnv, asset_cfg: SceneEntityCfg) -> torch.Tensor:
    return env.scene[asset_cfg.name].data.joint_pos[:, asset_cfg.joint_ids]


def test_torch_terms_get_joints_by_index():
    """A term written for torch reads ``asset_cfg.joint_ids``."""
    cfg = config()
    policy = cfg.observations.policy
    policy.cart_pos = ObservationTermCfg(asked_joints, CART, size=1)
    every = {"asset_cfg": SceneEntityCfg("robot")}
    policy.cart_vel = ObservationTermCfg(asked_joints, every, size=2)
    env = ManagerBasedRLEnv(cfg)
    env.reset()
    obs = env.step(torch.ones(N, 1))[0]["policy"]
    place = joints(env).joint_pos
    assert torch.equal(obs[:, 2:3], place[:, :1])
    assert torch.equal(obs[:, 3:], place)
