# SPDX-License-Identifier: Apache-2.0
"""Warp terms called from torch code: values beside the managers' own, and events in chosen environments."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from stripe_newton.configclass import ConfigError
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import SceneEntityCfg
from tests.helpers.cartpole_manager_env import N, make, put, rich

POLE = SceneEntityCfg("robot", joint_names="cart_to_pole")


@pytest.fixture(scope="module")
def env() -> Iterator[ManagerBasedRLEnv]:
    made = ManagerBasedRLEnv(rich())
    made.reset(seed=0)
    yield made
    made.close()


def test_observations_rewards_and_terminations(env):
    put(env, [0.1, -0.2, 0.3, -0.4], [0.0, 1.0, 2.0, 3.0])
    data = env.scene["robot"].data
    both = env.evaluate(mdp.joint_pos_rel)
    np.testing.assert_allclose(both, data.joint_pos - data.default_joint_pos, atol=1e-7)
    pole = env.evaluate(mdp.joint_pos, asset_cfg=POLE)
    assert pole.shape == (N, 1)
    np.testing.assert_allclose(pole[:, 0], data.joint_pos[:, 1])
    for target in (0.0, 0.25):
        value = env.evaluate(mdp.joint_pos_target_l2, asset_cfg=POLE, target=target)
        np.testing.assert_allclose(value, (data.joint_pos[:, 1] - target) ** 2, atol=1e-7)
    for bounds in ((-0.25, 0.25), (-0.15, 0.35)):
        out = env.evaluate(mdp.joint_pos_out_of_manual_limit, asset_cfg=POLE, bounds=bounds)
        assert out.dtype == torch.bool
        assert out.tolist() == [not bounds[0] <= x <= bounds[1] for x in data.joint_pos[:, 1].tolist()]
    command = env.evaluate(mdp.generated_commands, command_name="place")
    np.testing.assert_array_equal(command, env.command_manager.get_command("place"))
    # Results are the caller's own, and a function is compiled once for all numbers.
    put(env, [0.0] * N)
    assert float(pole[3]) == pytest.approx(-0.4)
    assert len([k for k in env._evaluation._known.values() for _ in k]) == 5


def test_an_event_runs_where_it_is_asked_to(env):
    put(env, [0.0] * N)
    data = env.scene["robot"].data
    state = wp_rng(env)
    env.apply_event(
        mdp.reset_joints_by_offset, [1, 3], asset_cfg=POLE, position_range=(0.2, 0.3), velocity_range=(0.0, 0.0)
    )
    moved = data.joint_pos[:, 1]
    assert moved[[0, 2]].tolist() == [0.0, 0.0]
    assert ((moved[[1, 3]] >= 0.2) & (moved[[1, 3]] <= 0.3)).all()
    assert (wp_rng(env) != state).tolist() == [False, True, False, True]
    tilt = 2.0 * torch.asin(data.body_quat_w[:, -1, :3].norm(dim=-1))  # bodies follow the joints
    np.testing.assert_allclose(tilt, moved, atol=1e-3)


def wp_rng(env: ManagerBasedRLEnv) -> torch.Tensor:
    return env.context.torch(env.context.rng).to(torch.int64).clone()


def test_an_event_on_the_model_reaches_the_solver():
    env = make()
    env.reset(seed=0)
    mass = torch.tensor(env.sim.model.body_mass.numpy()).view(N, -1).clone()
    ids = torch.tensor([0, 2])
    params = {"asset_cfg": SceneEntityCfg("robot", body_names="pole"), "operation": "scale"}
    env.apply_event(mdp.randomize_rigid_body_mass, ids, mass_distribution_params=(2.0, 2.0), **params)
    now = torch.tensor(env.sim.model.body_mass.numpy()).view(N, -1)
    ratio = (now / mass)[:, env.scene["robot"].body_names.index("pole")]
    assert ratio.tolist() == pytest.approx([2.0, 1.0, 2.0, 1.0])
    theirs = torch.tensor(env.sim.solver.mjw_model.body_mass.numpy())
    np.testing.assert_allclose(theirs.sum(dim=1), now.sum(dim=1), rtol=1e-6)
    env.apply_event(mdp.randomize_rigid_body_mass, ids, mass_distribution_params=(3.0, 3.0), **params)
    again = torch.tensor(env.sim.model.body_mass.numpy()).view(N, -1)
    assert float((again / mass).max()) == pytest.approx(3.0)
    env.close()


def test_parameters_that_do_not_fit_are_named(env):
    with pytest.raises(ConfigError, match=r"'joint_pos_target_l2'\.params\.target: is missing"):
        env.evaluate(mdp.joint_pos_target_l2, asset_cfg=POLE)
    with pytest.raises(ConfigError, match="'joint_pos' has no such argument"):
        env.evaluate(mdp.joint_pos, asset_cfg=POLE, offset=1.0)
    with pytest.raises(TypeError, match="'kick' is no observation, reward or termination"):
        env.evaluate(env.cfg.events["kick"].func, speed=1.0)
    assert not env.context.problems
