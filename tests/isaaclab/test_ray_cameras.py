# SPDX-License-Identifier: Apache-2.0
"""Ray-caster cameras and ray casters over several meshes, in a script as users of Isaac Lab write it."""

from __future__ import annotations

import runpy
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from stripe_newton import isaaclab as dialect
from stripe_newton.configclass import ConfigError
from stripe_newton.isaaclab import ray_cameras
from stripe_newton.isaaclab.latest_simulation import latest_simulation
from stripe_newton.sensors import GridPatternCfg, PinholeCameraPatternCfg

SCRIPT = """
import torch

import isaaclab.sim as sim_utils
from isaaclab.assets import RigidObject, RigidObjectCfg
from isaaclab.sensors import CameraCfg, Camera, TiledCamera, TiledCameraCfg, patterns
from isaaclab.sensors.ray_caster import (
    MultiMeshRayCaster, MultiMeshRayCasterCfg, MultiMeshRayCasterCamera, MultiMeshRayCasterCameraCfg, RayCasterCamera,
    RayCasterCameraCfg,
)

sim = sim_utils.SimulationContext(sim_utils.SimulationCfg(dt=0.01, device="cpu"))
sim_utils.GroundPlaneCfg().func("/World/ground", sim_utils.GroundPlaneCfg())
solid = dict(
    rigid_props=sim_utils.RigidBodyPropertiesCfg(),
    mass_props=sim_utils.MassPropertiesCfg(mass=1.0),
    collision_props=sim_utils.CollisionPropertiesCfg(),
)
high = RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, 2.0))
sphere, cube = sim_utils.SphereCfg(radius=0.2, **solid), sim_utils.CuboidCfg(size=(0.5, 0.5, 0.5), **solid)
ball = RigidObject(RigidObjectCfg(prim_path="/World/Ball", spawn=sphere, init_state=high))
low = RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, 0.5))
box = RigidObject(RigidObjectCfg(prim_path="/World/Box", spawn=cube, init_state=low))
lens = patterns.PinholeCameraPatternCfg(focal_length=24.0, horizontal_aperture=24.0, width=20, height=10)
down = RayCasterCameraCfg.OffsetCfg(rot=(0.0, 1.0, 0.0, 0.0), convention="ros")  # half a turn about x: looks along -z
shared = dict(
    prim_path="/World/Ball", pattern_cfg=lens, offset=down, data_types=["distance_to_image_plane", "normals"],
    depth_clipping_behavior="max", max_distance=5.0,
)
ground_camera = RayCasterCamera(RayCasterCameraCfg(mesh_prim_paths=["/World/ground"], **shared))
target = MultiMeshRayCasterCameraCfg.RaycastTargetCfg(prim_expr="/World/Box/visuals")
all_camera = MultiMeshRayCasterCamera(MultiMeshRayCasterCameraCfg(mesh_prim_paths=["/World/ground", target], **shared))
grid = patterns.GridPatternCfg(resolution=1.0, size=(2.0, 0.0))
caster = MultiMeshRayCaster(
    MultiMeshRayCasterCfg(prim_path="/World/Ball", mesh_prim_paths=["/World/ground", target], pattern_cfg=grid)
)
wide = sim_utils.PinholeCameraCfg(focal_length=12.0, horizontal_aperture=24.0)
above = CameraCfg.OffsetCfg(pos=(5.0, 0.0, 1.0), rot=(0.0, 1.0, 0.0, 0.0), convention="ros")
size = dict(width=20, height=10, offset=above, data_types=["depth"])
camera = Camera(CameraCfg(prim_path="/World/Ball/eye", spawn=wide, **size))
tiled = TiledCamera(TiledCameraCfg(prim_path="/World/Ball/eye", spawn=None, **size))
sim.reset()
tiled.update(dt=0.01, force_recompute=True)
depth, tiled_matrix = tiled.data.output["depth"][0, ..., 0].clone(), tiled.data.intrinsic_matrices[0].tolist()
for sensor in (ground_camera, all_camera, caster):
    sensor.update(dt=0.01, force_recompute=True)
seen = [c.data.output["distance_to_image_plane"][0, ..., 0].clone() for c in (ground_camera, all_camera)]
normal = ground_camera.data.output["normals"][0, 5, 10].tolist()
heights = caster.data.ray_hits_w[0, :, 2].tolist()
matrix = ground_camera.data.intrinsic_matrices[0].tolist()
"""


@pytest.fixture
def script(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "rays.py"
    path.write_text(SCRIPT)
    dialect.install()
    yield path
    sim = latest_simulation()
    if sim is not None:
        sim.close()
    dialect.uninstall()


def test_rays_meet_the_prims_that_are_named_and_no_others(script):
    found = runpy.run_path(str(script))
    ground, everything = found["seen"]
    torch.testing.assert_close(ground, torch.full((10, 20), 2.0), atol=1e-4, rtol=0.0)  # through ball and box
    # The box fills 0.5 m at a depth of 1.25 m: 20 pixels are as wide as the depth.
    expected = np.full((10, 20), 2.0)
    expected[1:9, 6:14] = 1.25
    torch.testing.assert_close(everything, torch.tensor(expected, dtype=torch.float32), atol=1e-4, rtol=0.0)
    np.testing.assert_allclose(found["normal"], [0.0, 0.0, 1.0], atol=1e-5)
    np.testing.assert_allclose(found["heights"], [0.0, 0.75, 0.0], atol=1e-4)
    np.testing.assert_allclose(found["matrix"], [[20, 0, 10], [0, 20, 5], [0, 0, 1]], atol=1e-5)
    # A camera without a lens of its own has that of the camera at its prim.
    np.testing.assert_allclose(found["tiled_matrix"], [[10, 0, 10], [0, 10, 5], [0, 0, 1]], atol=1e-5)
    torch.testing.assert_close(found["depth"][:, 5:15], torch.full((10, 10), 3.0), atol=1e-4, rtol=0.0)


def test_a_camera_without_a_lens_needs_another_one_there(script):
    script.write_text(SCRIPT.replace('"/World/Ball/eye", spawn=wide', '"/World/Ball/other", spawn=wide'))
    with pytest.raises(ConfigError, match="no camera before it is at '/World/Ball/eye'"):
        runpy.run_path(str(script))


def test_what_these_sensors_have_not_is_refused():
    lens = PinholeCameraPatternCfg(width=4, height=4)
    camera = ray_cameras.RayCasterCameraCfg(
        prim_path="/World/Ball", mesh_prim_paths=["/World/ground"], pattern_cfg=lens
    )
    with pytest.raises(ConfigError, match="data_types: has 'rgb', must be of distance_to_image_plane"):
        camera.replace(data_types=["rgb"]).validate()
    with pytest.raises(ConfigError, match="pattern_cfg"):
        ray_cameras.RayCasterCameraCfg(prim_path="/World/Ball", mesh_prim_paths=["/World/ground"]).validate()
    caster = ray_cameras.MultiMeshRayCasterCfg(
        prim_path="/World/Ball",
        mesh_prim_paths=[ray_cameras.MultiMeshRayCasterCfg.RaycastTargetCfg(prim_expr="/World/(")],
        pattern_cfg=GridPatternCfg(size=(1.0, 1.0), resolution=0.5),
        update_mesh_ids=True,
    )
    with pytest.raises(ConfigError, match=r"(?s)mesh_prim_paths\[0\].*update_mesh_ids: is True"):
        caster.validate()
