# SPDX-License-Identifier: Apache-2.0
"""``root_physx_view``, composers of wrenches and saved images, on a walker in a file of Isaac Lab's style."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from stripe_newton.isaaclab.sensors import save_images_to_file
from tests.helpers.isaaclab_walker import walker_task
from tests.helpers.small_scenes import numpy


@pytest.fixture(scope="module")
def env(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with walker_task(tmp_path_factory.mktemp("walker")) as task:
        made = task.ManagerBasedRLEnv(task.WalkerEnvCfg())
        made.reset(seed=4)
        yield made
        made.close()


@pytest.fixture
def robot(env: Any) -> Any:
    return env.scene["robot"]


def test_jacobians_and_mass_matrices_give_velocities_and_energy(env, robot):
    view = robot.root_physx_view
    robot.write_root_velocity_to_sim(torch.tensor([[0.3, -0.2, 0.1, 0.5, 0.4, -0.6]]).repeat(env.num_envs, 1))
    robot.write_joint_velocity_to_sim(torch.tensor([[0.7, -0.4, 0.2, 0.9]]).repeat(env.num_envs, 1))
    env.sim.forward()
    speeds = torch.cat((view.get_root_velocities(), view.get_dof_velocities()), dim=-1)
    jacobians, matrices = view.get_jacobians(), view.get_generalized_mass_matrices()
    assert jacobians.shape == (env.num_envs, view.max_links, 6, 6 + view.max_dofs)
    bodies = view.get_link_velocities()
    np.testing.assert_allclose(torch.einsum("nbic,nc->nbi", jacobians, speeds), numpy(bodies), atol=1e-5)
    # Kinetic energy of the bodies; the walker's inertias are those of spheres, so that their frames do not matter.
    inertia = view.get_inertias()[..., 0]
    own = 0.5 * (view.get_masses() * bodies[..., :3].square().sum(-1) + inertia * bodies[..., 3:].square().sum(-1))
    energy = 0.5 * torch.einsum("nc,ncd,nd->n", speeds, matrices, speeds)
    np.testing.assert_allclose(numpy(energy), numpy(own.sum(dim=1)), rtol=1e-4)
    np.testing.assert_allclose(view.get_gravity_compensation_forces()[:, 2], 9.81 * view.get_masses().sum(1), rtol=1e-4)


def test_properties_are_set_for_some_environments(env, robot):
    view, every = robot.root_physx_view, torch.arange(env.num_envs)
    cases = {
        "masses": 1.5,
        "dof_stiffnesses": 2.0,
        "dof_dampings": 0.5,
        "dof_armatures": 2.0,
        "dof_max_forces": 0.5,
        "material_properties": 0.7,
    }
    for name, factor in cases.items():
        before = getattr(view, f"get_{name}")()
        assert before.device.type == "cpu"
        getattr(view, f"set_{name}")(factor * before, every[1:3])
        after = getattr(view, f"get_{name}")()
        np.testing.assert_allclose(after[1:3], factor * before[1:3], rtol=1e-6, err_msg=name)
        np.testing.assert_array_equal(after[[0, 3]], before[[0, 3]], err_msg=name)
        getattr(view, f"set_{name}")(before, every)
    assert view.shared_metatype.dof_names == robot.joint_names
    assert view.prim_paths[2] == "/World/envs/env_2/Robot"
    assert view.get_root_transforms()[:, 6].shape == (env.num_envs,)  # (x, y, z, w), as PhysX has it
    np.testing.assert_array_equal(numpy(view.get_root_transforms()[:, 6]), numpy(robot.data.root_quat_w[:, 0]))
    with pytest.raises(AttributeError, match=r"root_physx_view has no 'get_warmth'; it has .*get_masses"):
        view.get_warmth()


def test_a_permanent_wrench_acts_until_the_environment_is_reset(env, robot):
    state = robot.data.default_root_state.clone()
    state[:, 2] = 5.0
    state[:, 7:] = 0.0
    weight = 9.81 * robot.root_physx_view.get_masses().sum(dim=1)
    force = torch.zeros(env.num_envs, 1, 3)
    force[:, 0, 2] = 2.0 * weight  # twice what holds it: it rises as fast as it would fall

    def speed() -> np.ndarray:
        robot.write_root_state_to_sim(state)
        robot.write_joint_velocity_to_sim(torch.zeros(env.num_envs, robot.num_joints))
        for _ in range(5):
            robot.write_data_to_sim()
            env.sim.step(1)
        masses = robot.root_physx_view.get_masses()[..., None]
        velocity = robot.root_physx_view.get_link_velocities()[..., :3]
        return numpy((masses * velocity).sum(dim=1) / masses.sum(dim=1))[:, 2]

    fallen = -9.81 * 5 * env.physics_dt
    np.testing.assert_allclose(speed(), fallen, rtol=1e-3)
    composer = robot.permanent_wrench_composer
    base, _ = robot.find_bodies("base")
    composer.set_forces_and_torques(forces=force, body_ids=base, is_global=True)
    np.testing.assert_allclose(speed(), -fallen, rtol=0.02)  # the force turns with the base
    robot.reset(torch.tensor([0, 2]))
    rises = np.isin(np.arange(env.num_envs), [0, 2], invert=True)
    np.testing.assert_allclose(speed(), np.where(rises, -fallen, fallen), rtol=0.02)
    robot.reset()


def test_images_are_saved_in_a_grid(tmp_path):
    images = torch.zeros(2, 3, 4, 3)
    images[1, ..., 0] = 1.0
    save_images_to_file(images, str(tmp_path / "two.png"))
    pixels = np.asarray(Image.open(tmp_path / "two.png").convert("RGB"))
    reds = np.argwhere(pixels[..., 0] > 200)
    assert pixels.shape == (2 * 3 + 3 * 2, 4 + 2 * 2, 3)  # one below the other, 2 pixels apart
    np.testing.assert_array_equal([reds.min(axis=0), reds.max(axis=0)], [[7, 2], [9, 5]])
