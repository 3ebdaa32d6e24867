# SPDX-License-Identifier: Apache-2.0
"""Randomisation in manager-based environments: modes, saved state, encoders, custom terms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.model_data import BodyModelData
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import EventTermCfg, ObservationTermCfg, SceneEntityCfg
from stripe_newton.sensors import CameraCfg
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg
from stripe_tasks.robot_scene import RobotSceneCfg
from stripe_tasks.velocity.quadruped import QuadrupedFlatEnvCfg

ROBOT = SceneEntityCfg("robot")
TORSO = SceneEntityCfg("robot", body_names="base")


@wp.func
def make_heavier(env: int, model: BodyModelData, body_ids: wp.array[int], factor: float):
    for i in range(body_ids.shape[0]):
        model.mass[env, body_ids[i]] = factor * model.default_mass[env, body_ids[i]]


def event(func: Any, mode: str, **params: Any) -> EventTermCfg:
    bounds = {"interval_range_s": (0.04, 0.08)} if mode == "interval" else {}
    return EventTermCfg(func=func, mode=mode, params=params, **bounds)


CARTPOLE_EVENTS = {
    "reset_joints": event(mdp.reset_joints_by_offset, "reset", position_range=(-0.2, 0.2), velocity_range=(0.0, 0.0)),
    "gains": event(mdp.randomize_actuator_gains, "startup", asset_cfg=ROBOT,
                   damping_distribution_params=(0.5, 2.0), operation="scale"),
    "mass": event(mdp.randomize_rigid_body_mass, "reset", asset_cfg=ROBOT, mass_distribution_params=(0.5, 2.0),
                  operation="scale"),
    "armature": event(mdp.randomize_joint_parameters, "interval", asset_cfg=ROBOT,
                      armature_distribution_params=(0.0, 0.1), operation="abs"),
    "bias": event(mdp.randomize_encoder_bias, "reset", asset_cfg=ROBOT, bias_range=(-0.1, 0.1)),
    "gravity": event(mdp.randomize_physics_scene_gravity, "step", operation="scale",
                     gravity_distribution_params=([1.0, 1.0, 0.9], [1.0, 1.0, 1.1])),
}  # fmt: skip


def make(cfg: ManagerBasedRLEnvCfg, events: dict[str, Any], num_envs: int = 3, **fields: Any) -> ManagerBasedRLEnv:
    cfg = cfg.replace(seed=4, events=events, **fields)
    cfg.sim.device, cfg.scene.num_envs = "cpu", num_envs
    return ManagerBasedRLEnv(cfg)


def cartpole() -> ManagerBasedRLEnv:
    cfg = CartpoleManagerEnvCfg(episode_length_s=0.2)
    cfg.observations.policy.pole_pos = ObservationTermCfg(func=mdp.joint_pos_rel_biased)
    env = make(cfg, CARTPOLE_EVENTS)
    env.reset(seed=1)
    return env


def walk(env: ManagerBasedRLEnv, steps: int) -> torch.Tensor:
    shape = env.action_space.shape
    seen = [env.step(0.3 * torch.sin(torch.arange(shape[0] * shape[1]).reshape(shape) + k))[0] for k in range(steps)]
    return torch.stack([o["policy"] for o in seen])


def model(env: ManagerBasedRLEnv, name: str) -> tuple[np.ndarray, np.ndarray]:
    now, default = env.scene.controller.field(name)
    return now.numpy().copy(), default.numpy().copy()


@pytest.fixture(scope="module")
def cart() -> ManagerBasedRLEnv:
    return cartpole()


def test_each_mode_changes_what_it_should_when_it_should(cart: ManagerBasedRLEnv):
    cart.reset(seed=1)
    gains, _ = model(cart, "joint_target_kd")
    mass, default = model(cart, "body_mass")
    assert len(np.unique(gains[:, 0])) == 3
    walk(cart, 5)
    assert np.array_equal(model(cart, "body_mass")[0], mass)
    gravity, _ = model(cart, "gravity")
    assert len(np.unique(gravity[..., 2])) == 3
    armature, _ = model(cart, "joint_armature")
    for _ in range(20):
        walk(cart, 13)
        ratio = model(cart, "body_mass")[0] / default
        assert ((ratio > 0.5) & (ratio < 2.0)).all()
        assert (np.abs(model(cart, "gravity")[0][..., 2] / -9.81 - 1.0) < 0.1001).all()
        assert not np.array_equal(model(cart, "body_mass")[0], mass)
    assert np.array_equal(model(cart, "joint_target_kd")[0], gains)
    assert not np.array_equal(model(cart, "joint_armature")[0], armature)
    solver = cart.sim.solver.mjw_model
    assert np.array_equal(solver.body_mass.numpy()[:, 1:], model(cart, "body_mass")[0])
    assert np.array_equal(solver.opt.gravity.numpy(), model(cart, "gravity")[0][:, 0])
    assert np.array_equal(solver.dof_armature.numpy(), model(cart, "joint_armature")[0])


def test_the_policy_sees_what_the_encoders_show(cart: ManagerBasedRLEnv):
    seen = cart.reset(seed=5)[0]["policy"]
    data = cart.scene["robot"].data
    bias = wp.to_torch(cart.context.arrays["encoder.robot.bias"])
    assert (bias.abs() > 1e-4).all()
    shown = data.joint_pos - data.default_joint_pos + bias
    assert any(torch.allclose(seen[:, k : k + 2], shown) for k in range(seen.shape[1] - 1))


def test_a_saved_state_goes_on_bit_by_bit(cart: ManagerBasedRLEnv):
    cart.reset(seed=2)
    walk(cart, 7)
    state = cart.get_state()
    wanted = walk(cart, 30)
    cart.set_state(state)
    assert torch.equal(walk(cart, 30), wanted)
    other = cartpole()
    walk(other, 3)
    other.set_state(state)
    assert torch.equal(walk(other, 30), wanted)


def test_a_quadruped_with_all_of_it_walks_on():
    events = dict(vars(QuadrupedFlatEnvCfg().events)) | {
        "material": event(mdp.randomize_rigid_body_material, "startup", asset_cfg=ROBOT,
                          static_friction_range=(0.4, 1.2)),
        "mass": event(mdp.randomize_rigid_body_mass, "startup", asset_cfg=TORSO, mass_distribution_params=(-1.0, 3.0),
                      operation="add"),
        "own": event(make_heavier, "reset", asset_cfg=SceneEntityCfg("robot", body_names=".*_hip"), factor=1.5),
        "com": event(mdp.randomize_rigid_body_com, "reset", asset_cfg=TORSO, com_range={"x": (-0.05, 0.05)}),
        "pos": event(mdp.randomize_joint_default_pos, "reset", asset_cfg=ROBOT, ranges=(-0.05, 0.05)),
        "bias": event(mdp.randomize_encoder_bias, "startup", asset_cfg=ROBOT, bias_range=(-0.02, 0.02)),
    }  # fmt: skip
    cfg = QuadrupedFlatEnvCfg()
    cfg.actions.joint_pos.apply = mdp.apply_joint_position_biased
    env = make(cfg, events, num_envs=2)
    env.reset(seed=1)
    assert torch.isfinite(walk(env, 4)).all()
    mass, default = model(env, "body_mass")
    robot = env.scene["robot"]
    hips, base = robot.find_bodies(".*_hip")[0], robot.find_bodies("base")[0]
    np.testing.assert_allclose(mass[:, hips], 1.5 * default[:, hips], rtol=1e-6)
    assert (mass[:, base] != default[:, base]).all()
    assert np.array_equal(env.sim.solver.mjw_model.body_mass.numpy()[:, 1:], mass)
    bias = wp.to_torch(env.context.arrays["encoder.robot.bias"])
    offset = robot.data.joint_pos_target - (env.processed_actions - bias)
    assert offset.abs().max() < 1e-6
    drift = (robot.data.default_joint_pos - torch.tensor([0.0])).abs()
    assert len(torch.unique(drift)) == drift.numel()
    assert "solver told of body_com" in env.describe()


@configclass
class SeenCfg(RobotSceneCfg):
    camera: CameraCfg = CameraCfg(
        prim_path="{ENV_REGEX_NS}/Camera",
        width=32,
        height=32,
        offset=CameraCfg.OffsetCfg(pos=(-1.5, 0.0, 2.2), convention="world"),
    )


def test_cameras_see_the_colours():
    paint = {"r": (0.9, 1.0), "g": (0.0, 0.1), "b": (0.0, 0.1)}
    cfg = CartpoleManagerEnvCfg(scene=SeenCfg(num_envs=2, env_spacing=4.0, robot=CartpoleManagerEnvCfg().scene.robot))
    env = make(cfg, {"color": event(mdp.randomize_visual_color, "reset", asset_cfg=ROBOT, colors=paint)}, num_envs=2)
    env.reset(seed=1)
    env.step(torch.zeros(env.action_space.shape))
    picture = env.scene["camera"].data.output["rgb"].float()
    red = (picture[..., 0] > 2.0 * picture[..., 1]) & (picture[..., 0] > 2.0 * picture[..., 2])
    assert (red.flatten(1).sum(dim=1) > 8).all()
    array = env.context.arrays["events.color.colors"]
    array.assign(array.numpy()[[1, 0, 2]])
    env.reset(options={"reset_mask": [True, False]})
    env.step(torch.zeros(env.action_space.shape))
    picture = env.scene["camera"].data.output["rgb"].float()
    green = (picture[..., 1] > 2.0 * picture[..., 0]).flatten(1).sum(dim=1)
    assert green[0] > 8
    assert green[1] == 0
