# SPDX-License-Identifier: Apache-2.0
"""Terrain importer: origins of environments, levels, files, and export."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import torch
from pxr import Usd, UsdGeom, UsdPhysics

from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import GroundPlaneCfg, PreviewSurfaceCfg, RigidBodyMaterialCfg, Simulation, SimulationCfg
from stripe_newton.terrains import (
    MeshPyramidStairsTerrainCfg,
    TerrainGeneratorCfg,
    TerrainImporter,
    TerrainImporterCfg,
)
from stripe_newton.terrains.spiral_grid import spiral_grid
from stripe_newton.viewers import SceneRenderer, ViewerCfg
from tests.helpers.terrain_world import TINY, YardCfg, yard


def test_environments_start_on_the_tile_of_their_level_and_type():
    scene = yard(build=True)
    terrain = scene.terrain
    assert isinstance(terrain, TerrainImporter)
    assert scene["terrain"] is terrain
    assert terrain.terrain_origins.shape == (3, 2, 3)
    np.testing.assert_array_equal(terrain.terrain_types, np.arange(8) % 2)
    assert set(terrain.terrain_levels.tolist()) == {0, 1, 2}
    expected = terrain.terrain_origins[terrain.terrain_levels.long(), terrain.terrain_types.long()]
    torch.testing.assert_close(terrain.env_origins, expected)
    assert terrain.env_origins is scene.env_origins
    ground = terrain.ground.height_at(*expected[:, :2].numpy().T)
    np.testing.assert_allclose(expected[:, 2], ground, atol=1e-6)
    root = scene["robot"].data.root_pos_w - scene["robot"].data.default_root_state[:, :3]
    torch.testing.assert_close(root, expected, atol=1e-5, rtol=0)


def test_origins_are_one_memory_for_scene_terrain_and_assets():
    scene = yard(build=True)
    pointers = {
        scene.env_origins.data_ptr(),
        scene.terrain.struct.env_origin.ptr,
        scene["robot"].data.struct.env_origin.ptr,
        scene.sim.env_origin.ptr,
    }
    assert len(pointers) == 1
    built = scene.sim.env_origins.copy()
    scene.env_origins[0] += 1.0
    np.testing.assert_array_equal(scene.sim.env_origins, built)  # where it was built stays known
    levels, data = scene.terrain.terrain_levels, scene.terrain.struct
    assert data.level.ptr == levels.data_ptr()
    np.testing.assert_array_equal(data.heights.numpy(), scene.terrain.ground.heights)


def test_where_an_environment_starts_does_not_depend_on_how_many_there_are():
    few, many = yard(8).terrain, yard(64).terrain
    torch.testing.assert_close(few.env_origins, many.env_origins[:8])
    assert yard(64, max_init_terrain_level=1).terrain.terrain_levels.max() == 1
    assert yard(64, max_init_terrain_level=0).terrain.terrain_levels.max() == 0
    other = yard(64, terrain_generator=TINY.replace(seed=5)).terrain
    assert (other.terrain_levels != many.terrain_levels).any()


def test_promotion_and_demotion():
    terrain = yard(64).terrain
    rng = np.random.default_rng(0)
    ids = rng.permutation(64)[:40]
    up, down = rng.random(40) < 0.5, rng.random(40) < 0.4
    before = terrain.terrain_levels.numpy().copy()
    terrain.update_env_origins(torch.tensor(ids), torch.tensor(up), torch.tensor(down))
    wanted = before[ids] + up - down
    after = terrain.terrain_levels.numpy()
    held = wanted <= 2
    assert (~held).any()
    assert (wanted < 0).any()
    np.testing.assert_array_equal(after[ids][held], np.maximum(wanted[held], 0))
    assert ((after >= 0) & (after <= 2)).all()
    others = np.setdiff1d(np.arange(64), ids)
    np.testing.assert_array_equal(after[others], before[others])
    expected = terrain.terrain_origins[after, terrain.terrain_types.long()]
    torch.testing.assert_close(terrain.env_origins, expected)


def test_the_field_is_one_shape_that_all_worlds_share():
    material = RigidBodyMaterialCfg(dynamic_friction=0.9, restitution=0.1)
    scene = yard(build=True, physics_material=material)
    model = scene.sim.model
    shapes = np.flatnonzero(model.shape_type.numpy() == int(newton.GeoType.HFIELD))
    assert len(shapes) == 1
    assert model.shape_world.numpy()[shapes[0]] == -1
    assert model.shape_material_mu.numpy()[shapes[0]] == pytest.approx(0.9)
    assert model.shape_material_restitution.numpy()[shapes[0]] == pytest.approx(0.1)
    plain = yard(build=True, physics_material=None).sim
    assert plain.model.shape_material_mu.numpy()[shapes[0]] == pytest.approx(
        plain.cfg.physics_material.dynamic_friction
    )


def test_a_plane_keeps_the_grid_and_has_no_edge():
    scene = yard(terrain_type="plane", terrain_generator=None, env_spacing=3.0, build=True)
    np.testing.assert_array_equal(scene.env_origins, spiral_grid(8, 3.0))
    assert (scene.sim.model.shape_type.numpy() == int(newton.GeoType.PLANE)).sum() == 1
    assert scene.terrain.terrain_origins is None
    everyone = torch.ones(8, dtype=torch.bool)
    scene.terrain.update_env_origins(torch.arange(8), everyone, ~everyone)
    np.testing.assert_array_equal(scene.env_origins, spiral_grid(8, 3.0))
    assert scene.terrain.height_at(torch.rand(5, 3)).eq(0.0).all()
    assert yard(terrain_type="plane").env_origins[:, 0].max() == 2.0  # the scene's own spacing


def test_the_grid_may_be_used_on_tiles_too():
    scene = yard(use_terrain_origins=False, env_spacing=1.0)
    origins = spiral_grid(8, 1.0)
    np.testing.assert_allclose(scene.env_origins[:, :2], origins[:, :2], atol=1e-6)
    ground = scene.terrain.ground.height_at(*origins[:, :2].T)
    np.testing.assert_allclose(scene.env_origins[:, 2], ground, atol=1e-6)
    assert scene.terrain.struct.origins.shape[0] == 0  # no levels to go to
    with pytest.raises(ValueError, match=r"env_spacing is 50.0 m: 8 environments reach 50.0 m"):
        yard(use_terrain_origins=False, env_spacing=50.0)


def test_a_second_ground_is_refused():
    scene = yard()
    cfg = TerrainImporterCfg(prim_path="/World/other", terrain_type="plane")
    with scene.construction(), pytest.raises(RuntimeError, match="has a terrain at '/World/ground' already"):
        cfg.class_type(cfg)


def test_a_plane_in_the_place_of_the_tiles_is_refused():
    scene = yard()
    with scene.construction():
        plane = GroundPlaneCfg()
        plane.func("/World/ground", plane)
    with pytest.raises(ValueError, match=r"'/World/ground/.*' beside the terrain, .* by ground=None"):
        scene.build()


def test_as_users_of_isaac_lab_write_it():
    """In ``_setup_scene``, without a field of the scene's config."""
    cfg = TerrainImporterCfg(prim_path="/World/ground", terrain_generator=TINY, collision_group=-1)
    scene = InteractiveScene(YardCfg(num_envs=4, env_spacing=2.0), Simulation(SimulationCfg(device="cpu")))
    with scene.construction():
        cfg.num_envs, cfg.env_spacing = scene.cfg.num_envs, scene.cfg.env_spacing
        terrain = cfg.class_type(cfg)
        scene.clone_environments(copy_from_source=False)
        scene.filter_collisions(global_prim_paths=[cfg.prim_path])
    scene.build()
    assert scene.terrain is terrain
    assert (scene.sim.model.shape_type.numpy() == int(newton.GeoType.HFIELD)).sum() == 1


# -- export


def test_an_exported_scene_has_the_same_ground(tmp_path):
    scene = yard(
        build=True,
        physics_material=RigidBodyMaterialCfg(dynamic_friction=0.7),
        visual_material=PreviewSurfaceCfg(diffuse_color=(0.5, 0.25, 0.125)),
        max_init_terrain_level=1,
    )
    path = tmp_path / "yard.usda"
    scene.export(path)
    again = InteractiveScene.from_usd(path, num_envs=8, sim_cfg=SimulationCfg(device="cpu"))
    old, new = scene.terrain, again.terrain
    np.testing.assert_array_equal(new.ground.heights, old.ground.heights)
    np.testing.assert_array_equal(new.ground.origins, old.ground.origins)
    np.testing.assert_array_equal(new.ground.patches["target"], old.ground.patches["target"])
    assert (new.ground.lower, new.ground.cell, new.ground.tile) == (old.ground.lower, old.ground.cell, old.ground.tile)
    torch.testing.assert_close(again.env_origins, scene.env_origins, atol=0, rtol=0)
    a, b = scene.sim.model, again.sim.model
    np.testing.assert_array_equal(a.shape_type.numpy(), b.shape_type.numpy())
    np.testing.assert_allclose(a.shape_material_mu.numpy(), b.shape_material_mu.numpy())
    np.testing.assert_allclose(a.shape_transform.numpy(), b.shape_transform.numpy(), atol=1e-6)
    for _ in range(2):
        scene.sim.step(5)
        again.sim.step(5)
    np.testing.assert_array_equal(scene.sim.state.joint_q.numpy(), again.sim.state.joint_q.numpy())
    # as a terrain file of another scene, it is taken as it is
    other = yard(terrain_type="usd", terrain_generator=None, usd_path=str(path))
    np.testing.assert_array_equal(other.terrain.ground.heights, old.ground.heights)
    # for another program it is a mesh collider with the triangles of the contacts
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/World/ground/terrain"))
    assert mesh.GetPrim().HasAPI(UsdPhysics.CollisionAPI)
    points = np.array(mesh.GetPointsAttr().Get())
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    middles = points[faces].mean(axis=1)
    np.testing.assert_allclose(old.ground.height_at(*middles[:, :2].T), middles[:, 2], atol=1e-5)
    normals = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    assert (normals[:, 2] > 0.0).all()


def test_a_picture_shows_the_ground():
    pictures = []
    for height in (0.0, 0.8):
        tile = MeshPyramidStairsTerrainCfg(step_height_range=(height, height), step_width=0.5)
        cfg = TerrainGeneratorCfg(size=(4.0, 4.0), sub_terrains={"stairs": tile})
        scene = yard(1, terrain_generator=cfg, build=True)
        view = ViewerCfg(resolution=(64, 48), fog=0.0, floor=False, eye=(6.0, 6.0, 8.0), lookat=(0.5, 0.5, 0.0))
        renderer = SceneRenderer(scene.sim, view)
        assert renderer.eye[2] == pytest.approx(8.0 + float(scene.env_origins[0, 2]))  # measured from the tile's origin
        renderer.look((1.5, 1.5, 9.0), (1.5, 1.4, 0.0))  # a corner from above: all of the picture is ground
        pictures.append(renderer.render().astype(int))
        renderer.look((1.5, 1.5, 9.0), (1.5, 9.0, 9.5))
        sky = renderer.render().astype(int).reshape(-1, 3).mean(axis=0)
        assert abs(pictures[-1][20:28, 28:36].reshape(-1, 3).mean(axis=0) - sky).max() > 10
        renderer.close()
    assert abs(pictures[1] - pictures[0]).max() > 20  # the steps are seen
