# SPDX-License-Identifier: Apache-2.0
"""The fused step on a GPU: the same physics as on the CPU, and the same bits in every run."""

from __future__ import annotations

import mujoco_warp
import newton
import numpy as np
import pytest
import torch
import warp as wp

import stripe_tasks  # noqa: F401 - registers the tasks
from stripe_newton.cli.tasks import load_cfg, make_env
from stripe_newton.envs import RLEnv
from stripe_newton.solvers import SolverFused
from tests.helpers.robot_files import robot_file

FLAT, ROUGH = "Stripe-Velocity-Flat-Quadruped-v0", "Stripe-Velocity-Rough-Quadruped-v0"
LIFT, LEGS = "Stripe-Lift-Cube-Panda-v0", "Stripe-Velocity-Rough-AnymalC-v0"
BIPED = "Stripe-Velocity-Flat-G1-v0"
ROBOTS = {LIFT: "panda", LEGS: "anymal_c", BIPED: "g1"}
"""Robots whose file a task needs: with hulls on a cube and the ground, with cylinders on rough ground, and with more
degrees of freedom than lanes, whose rows have no Jacobians."""
WALKS = [(FLAT, True), (FLAT, False), (ROUGH, True), (ROUGH, False), (LIFT, False), (LEGS, False), (BIPED, False)]
"""Tasks, and whether they take the form for a hub with limbs."""


def states(task: str, limbs: bool, num_envs: int, device: str, steps: int) -> torch.Tensor:
    """Joints and rewards of a task under random actions, shape ``(steps, num_envs, n)``, on the CPU."""
    if task in ROBOTS:
        robot_file(ROBOTS[task])
    cfg = load_cfg(task, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = num_envs, device, 3
    cfg.sim.solver.fused_limbs = limbs
    env = make_env(task, cfg).unwrapped
    assert isinstance(env, RLEnv)
    assert env.sim.describe_solver().endswith("all physics steps of a step in one launch")
    generator, rows = torch.Generator().manual_seed(0), []
    try:
        env.reset(seed=3)
        for _ in range(steps):
            action = 2.0 * torch.rand((num_envs, *env.single_action_space.shape), generator=generator) - 1.0
            reward = env.step(action.to(env.device))[1]
            joints = (env.sim.per_env(a) for a in (env.sim.state.joint_q, env.sim.state.joint_qd))
            rows.append(torch.cat([*joints, reward.unsqueeze(1)], dim=1).cpu())
    finally:
        env.close()
    return torch.stack(rows)


@pytest.mark.gpu
@pytest.mark.parametrize(("task", "limbs"), WALKS)
def test_equal_seeds_give_equal_bits(task, limbs):
    """With contacts and resets, in as many worlds as fill the GPU several times over."""
    one, two = (states(task, limbs, 4096, "cuda", 40) for _ in range(2))
    assert torch.isfinite(one).all()
    assert torch.equal(one, two)


@pytest.mark.gpu
@pytest.mark.parametrize(("task", "limbs"), WALKS)
def test_it_is_the_physics_of_the_cpu(task, limbs):
    gpu, cpu = (states(task, limbs, 16, device, 6) for device in ("cuda", "cpu"))
    torch.testing.assert_close(gpu, cpu, atol=2e-3, rtol=1e-3)


def test_inverse_weights_are_added_up_in_order(monkeypatch):
    """By MuJoCo Warp, which derives them from masses: three limbs of a body share an address that atomics add to."""
    builder = newton.ModelBuilder()
    newton.solvers.SolverMuJoCo.register_custom_attributes(builder)
    link = builder.add_link(mass=1.0, inertia=wp.mat33(*np.eye(3).flatten()))
    builder.add_articulation([builder.add_joint_revolute(-1, link)])
    solver, orders = SolverFused(builder.finalize(device="cpu"), kinematic_switchable_roots=False), []
    ordered = int(mujoco_warp.DeterminismType.ATOMICS)
    monkeypatch.setattr(mujoco_warp, "set_const_0", lambda m, d: orders.append(m.opt.deterministic & ordered))
    solver.notify_model_changed(newton.ModelFlags.BODY_INERTIAL_PROPERTIES)
    assert orders == [ordered]
    assert not solver.mjw_model.opt.deterministic & ordered


def test_equal_seeds_give_equal_bits_on_the_cpu():
    one, two = (states(FLAT, True, 4, "cpu", 10) for _ in range(2))
    assert torch.equal(one, two)
