# SPDX-License-Identifier: Apache-2.0
"""Collections of rigid objects: their tensors against those of the objects themselves, in a scene and by Isaac Lab's
names."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.assets import RigidObjectCfg, RigidObjectCollection, RigidObjectCollectionCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import CuboidCfg, MassPropertiesCfg, RigidBodyPropertiesCfg, Simulation
from tests.helpers.small_scenes import sim_cfg

PLACES = {"red": (1.0, 0.0, 2.0), "green": (0.0, 1.0, 3.0), "blue": (-1.0, 0.0, 4.0)}
MASSES = {"red": 1.0, "green": 2.0, "blue": 3.0}
NUM_ENVS, DT = 4, 0.005


def box(key: str) -> RigidObjectCfg:
    body, mass = RigidBodyPropertiesCfg(), MassPropertiesCfg(mass=MASSES[key])
    spawn = CuboidCfg(size=(0.1, 0.2, 0.3), mass_props=mass, rigid_props=body)
    return RigidObjectCfg(spawn=spawn, init_state=RigidObjectCfg.InitialStateCfg(pos=PLACES[key]))


@configclass
class BoxesCfg(InteractiveSceneCfg):
    boxes: RigidObjectCollectionCfg = RigidObjectCollectionCfg(rigid_objects={key: box(key) for key in PLACES})


@pytest.fixture
def scene() -> InteractiveScene:
    made = InteractiveScene(BoxesCfg(num_envs=NUM_ENVS, env_spacing=5.0), Simulation(sim_cfg(dt=DT)))
    made.build()
    return made


def test_tensors_are_those_of_the_objects(scene: InteractiveScene) -> None:
    boxes = scene["boxes"]
    assert isinstance(boxes, RigidObjectCollection)
    assert (boxes.num_instances, boxes.num_objects, boxes.object_names) == (NUM_ENVS, 3, list(PLACES))
    assert list(scene.rigid_objects) == [f"boxes_{key}" for key in PLACES]
    assert boxes.data.object_link_pose_w.shape == (NUM_ENVS, 3, 7)
    places = torch.tensor(list(PLACES.values())) + scene.env_origins.unsqueeze(1)
    torch.testing.assert_close(boxes.data.object_pos_w, places)
    assert boxes.data.default_mass.flatten(1).tolist() == [list(MASSES.values())] * NUM_ENVS
    assert boxes.data.default_inertia.shape == (NUM_ENVS, 3, 9)
    assert boxes.data.object_com_pose_b.shape == (NUM_ENVS, 3, 7)
    with pytest.raises(AttributeError, match="object_colour"):
        _ = boxes.data.object_colour


def test_what_is_written_is_read_and_falls(scene: InteractiveScene) -> None:
    boxes, envs, objects = scene["boxes"], torch.tensor([1, 3]), torch.tensor([2, 0])
    generator = torch.Generator().manual_seed(3)
    state = torch.rand(2, 2, 13, generator=generator)
    state[..., 3:7] = torch.from_numpy(Rotation.random(4, random_state=1).as_quat()).view(2, 2, 4).float()
    before = boxes.data.object_state_w
    boxes.write_object_link_state_to_sim(state, envs, objects)
    chosen = envs.unsqueeze(1), objects
    torch.testing.assert_close(boxes.data.object_link_state_w[chosen], state)
    torch.testing.assert_close(boxes.data.object_state_w[:, 1], before[:, 1])
    for _ in range(20):
        scene.sim.step()
    # A body in free fall: symplectic Euler, as MuJoCo integrates.
    fallen = state[..., 2] + 20 * DT * state[..., 9] - 9.81 * DT**2 * 20 * 21 / 2
    torch.testing.assert_close(boxes.data.object_com_pos_w[chosen][..., 2], fallen, atol=2e-4, rtol=0.0)


def test_forces_act_on_the_chosen_objects(scene: InteractiveScene) -> None:
    boxes = scene["boxes"]
    force = torch.tensor([[[0.0, 0.0, 9.81 * MASSES["green"]]]]).expand(NUM_ENVS, 1, 3)
    boxes.set_external_force_and_torque(force, torch.zeros_like(force), object_ids=[1], is_global=True)
    for _ in range(10):
        scene.sim.step()
    speeds = boxes.data.object_lin_vel_w[..., 2]
    np.testing.assert_allclose(speeds[:, 1], 0.0, atol=1e-5)
    np.testing.assert_allclose(speeds[:, [0, 2]], -9.81 * 10 * DT, rtol=1e-4)
    boxes.reset()
    scene.sim.step()
    np.testing.assert_allclose(boxes.data.object_lin_vel_w[:, 1, 2], -9.81 * DT, rtol=1e-3)


def test_objects_are_found_and_reset(scene: InteractiveScene) -> None:
    boxes = scene["boxes"]
    ids, names = boxes.find_objects(["blue", "r.*"], preserve_order=True)
    assert (ids.tolist(), names) == ([2, 0], ["blue", "red"])
    boxes.write_object_velocity_to_sim(torch.ones(NUM_ENVS, 3, 6))
    scene.controller.reset_robots()
    assert boxes.data.object_vel_w.abs().max() == 0.0


def test_wrong_shapes_and_configs_are_errors(scene: InteractiveScene) -> None:
    with pytest.raises(ValueError, match=r"shape \(4, 7\), must be \(4, 3, 7\)"):
        scene["boxes"].write_object_pose_to_sim(torch.zeros(4, 7))
    with pytest.raises(ConfigError, match="rigid_objects: is empty"):
        RigidObjectCollectionCfg(rigid_objects={}).validate()
    cfg = BoxesCfg(num_envs=1, env_spacing=0.0)
    cfg.boxes.rigid_objects["red"] = 1
    with pytest.raises(ConfigError, match="rigid_objects"):
        InteractiveScene(cfg, Simulation(sim_cfg()))
