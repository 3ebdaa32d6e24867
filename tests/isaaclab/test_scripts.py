# SPDX-License-Identifier: Apache-2.0
"""Scripts with their own loop under the Isaac Lab dialect: how they are run, how they end, the picture."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import stripe_newton.isaaclab as dialect
from stripe_newton.isaaclab.__main__ import run_script
from stripe_newton.isaaclab.latest_simulation import latest_simulation
from stripe_newton.isaaclab.rough_plane import rough_heights

SCRIPT = """
import argparse

from isaaclab.app import AppLauncher

parser = argparse.ArgumentParser()
AppLauncher.add_app_launcher_args(parser)
args = parser.parse_args()
simulation_app = AppLauncher(args).app

import isaaclab.sim as sim_utils
from isaaclab.assets import RigidObject, RigidObjectCfg
from isaaclab.sensors import Imu, ImuCfg
from isaacsim.core.utils.prims import create_prim

sim = sim_utils.SimulationContext(sim_utils.SimulationCfg(dt=0.01, device=args.device))
sim.set_camera_view([2.0, 0.0, 1.0], [0.0, 0.0, 0.5])
ground = sim_utils.GroundPlaneCfg()
ground.func("/World/ground", ground)
for i in range(2):
    create_prim(f"/World/Place{i}", "Xform", translation=(0.0, float(i), 0.0))
cube = RigidObject(
    RigidObjectCfg(
        prim_path="/World/Place.*/Cube",
        spawn=sim_utils.CuboidCfg(
            size=(0.4, 0.4, 0.4),
            rigid_props=sim_utils.RigidBodyPropertiesCfg(),
            mass_props=sim_utils.MassPropertiesCfg(mass=1.0),
            collision_props=sim_utils.CollisionPropertiesCfg(),
            visual_material=sim_utils.PreviewSurfaceCfg(diffuse_color=(1.0, 0.0, 0.0)),
        ),
        init_state=RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, 1.0)),
    )
)
imu = Imu(ImuCfg(prim_path="/World/Place.*/Cube"))
sim.reset()
heights = []
while simulation_app.is_running():
    cube.write_data_to_sim()
    sim.step()
    cube.update(sim.get_physics_dt())
    imu.update(dt=sim.get_physics_dt())
    heights.append(cube.data.root_pos_w[:, 2].clone())
assert len(heights) == 10, len(heights)
fallen = 1.0 - heights[-1]
expected = 9.81 * 0.01**2 * 55  # semi-implicit Euler: 1 + 2 + ... + 10
assert cube.num_instances == 2 and (abs(fallen - expected) < 1e-4).all(), fallen
assert (imu.data.lin_vel_b[:, 2] + 9.81 * 0.1).abs().max() < 1e-3, imu.data.lin_vel_b
print("fell", [round(float(f), 3) for f in fallen])
simulation_app.close()
"""

PLACES = """
import torch

import isaaclab.sim as sim_utils
from isaaclab.assets import RigidObject, RigidObjectCfg
from isaacsim.core.utils.prims import create_prim

sim = sim_utils.SimulationContext(sim_utils.SimulationCfg(dt=0.01, device="cpu"))
places = [[-3.0, 0.0, 0.0], [3.0, 1.0, 0.5]]
cubes = []
for i, place in enumerate(places):
    create_prim(f"/World/Place{i}", "Xform", translation=place)
    body = sim_utils.RigidBodyPropertiesCfg()
    mass = sim_utils.MassPropertiesCfg(mass=1.0)
    spawn = sim_utils.CuboidCfg(size=(0.4, 0.4, 0.4), rigid_props=body, mass_props=mass)
    state = RigidObjectCfg.InitialStateCfg(pos=(0.0, 0.0, 1.0), rot=(0.5, 0.5, 0.5, 0.5))
    cubes.append(RigidObject(RigidObjectCfg(prim_path=f"/World/Place{i}/Cube", spawn=spawn, init_state=state)))
sim.reset()
for cube, place in zip(cubes, places):
    state = cube.data.default_root_state.clone()
    expected = torch.tensor([[0.0, 0.0, 1.0, 0.5, 0.5, 0.5, 0.5]])
    assert torch.allclose(state[:, :7], expected), state
    state[:, :3] += torch.tensor(place)
    cube.write_root_pose_to_sim(state[:, :7])
    there = torch.tensor(place) + torch.tensor([0.0, 0.0, 1.0])
    assert torch.allclose(cube.data.root_pos_w, there), cube.data.root_pos_w
    changed = cube.data.default_root_state.clone()
    changed[:, 2] = 2.0
    cube.data.default_root_state = changed
    assert torch.allclose(cube.data.default_root_state, changed)
sim.reset()
assert torch.allclose(cubes[1].data.root_pos_w, torch.tensor([[3.0, 1.0, 2.5]])), cubes[1].data.root_pos_w
"""
"""Assets below prims that have been moved: their default state is that of the config, as Isaac Lab has it."""

ROUGH = """
import numpy as np
import torch

import isaaclab.sim as sim_utils
from isaaclab.assets import RigidObject, RigidObjectCfg
from isaaclab.sensors import RayCaster, RayCasterCfg, patterns
from isaaclab.utils.assets import ISAAC_NUCLEUS_DIR

sim = sim_utils.SimulationContext(sim_utils.SimulationCfg(dt=0.01, device="cpu"))
ground = sim_utils.UsdFileCfg(usd_path=f"{ISAAC_NUCLEUS_DIR}/Environments/Terrains/rough_plane.usd")
ground.func("/World/ground", ground)
spawn = sim_utils.SphereCfg(
    radius=0.2,
    rigid_props=sim_utils.RigidBodyPropertiesCfg(),
    mass_props=sim_utils.MassPropertiesCfg(mass=1.0),
    collision_props=sim_utils.CollisionPropertiesCfg(),
)
state = RigidObjectCfg.InitialStateCfg(pos=np.array([1.0, -2.0, 0.7]))
ball = RigidObject(RigidObjectCfg(prim_path="/World/Ball", spawn=spawn, init_state=state))
pattern = patterns.GridPatternCfg(resolution=0.25, size=(2.0, 2.0))
caster = RayCaster(
    RayCasterCfg(prim_path="/World/Ball", mesh_prim_paths=["/World/ground"], pattern_cfg=pattern, ray_alignment="yaw")
)
sim.reset()
caster.update(dt=0.01, force_recompute=True)
hits = caster.data.ray_hits_w[0].numpy()
for _ in range(100):
    sim.step()
height = float(ball.data.root_pos_w[0, 2])
"""
"""A ball falls on the rough plane, which a ray caster has measured before."""


@pytest.fixture
def script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A script; argument list, search path and the dialect's modules are put back after the test."""
    monkeypatch.setattr(sys, "argv", ["pytest"])
    monkeypatch.setattr(sys, "path", list(sys.path))
    path = tmp_path / "falling.py"
    path.write_text(SCRIPT)
    yield path
    sim = latest_simulation()
    if sim is not None:
        sim.close()
    dialect.uninstall()


def test_a_script_runs_unmodified_and_ends_with_a_picture_of_its_last_state(script, capsys):
    picture = script.with_suffix(".png")
    run_script(str(script), ["--headless", "--device", "cpu", "--stop_after", "10", "--picture", str(picture)])
    assert "fell [0.054, 0.054]" in capsys.readouterr().out
    pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    red = (pixels[..., 0] > 100) & (pixels[..., 1] < 60) & (pixels[..., 2] < 60)
    assert pixels.shape == (540, 960, 3)
    assert 0.005 < red.mean() < 0.5


def test_default_states_are_in_the_frame_of_the_prim_above(script):
    script.write_text(PLACES)
    run_script(str(script), [])


def test_the_rough_plane_has_its_heights(script):
    script.write_text(ROUGH)
    dialect.install()
    found = runpy.run_path(str(script))
    hits, heights = found["hits"], rough_heights()
    columns, rows = (np.rint((hits[:, k] + 10.0) / 0.25).astype(int) for k in (0, 1))
    assert len(hits) == 81
    np.testing.assert_allclose(hits[:, 2], heights[rows, columns], atol=1e-4)
    assert np.ptp(hits[:, 2]) > 0.1
    assert heights.min() < found["height"] < heights.max() + 0.25  # the ball lies on it


def test_a_script_that_is_not_there_is_named():
    with pytest.raises(SystemExit, match=r"no script 'nowhere/falling\.py'"):
        run_script("nowhere/falling.py", [])
