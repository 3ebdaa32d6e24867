# SPDX-License-Identifier: Apache-2.0
"""Overflow of contacts and constraints: an error names the size to set, nothing is lost silently."""

from __future__ import annotations

import newton
import pytest

from stripe_newton.assets import AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import configclass
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    CuboidCfg,
    GroundPlaneCfg,
    MuJoCoSolverCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SimulationCfg,
)
from stripe_newton.sim.contact_capacity import contact_capacity


def _box(name: str, x: float, z: float = 0.3) -> RigidObjectCfg:
    cube = CuboidCfg(
        size=(0.2, 0.2, 0.2), rigid_props=RigidBodyPropertiesCfg(), collision_props=CollisionPropertiesCfg()
    )
    state = RigidObjectCfg.InitialStateCfg(pos=(x, 0.0, z))
    return RigidObjectCfg(prim_path=f"{{ENV_REGEX_NS}}/{name}", spawn=cube, init_state=state)


@configclass
class _SceneCfg(InteractiveSceneCfg):
    ground: AssetBaseCfg = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    one: RigidObjectCfg = _box("One", 0.0)
    two: RigidObjectCfg = _box("Two", 1.0)


def _fall(solver: MuJoCoSolverCfg, on_overflow: str = "raise") -> InteractiveScene:
    """Two boxes in each of two environments fall onto the ground: eight contacts, 32 constraints, an environment."""
    scene = _scene(solver, on_overflow)
    for _ in range(40):
        scene.sim.launch(1)  # as step() does, without looking
    return scene


def _scene(solver: MuJoCoSolverCfg, on_overflow: str = "raise") -> InteractiveScene:
    """The boxes before they fall."""
    cfg = SimulationCfg(device="cpu", dt=1.0 / 120.0, solver=solver, on_overflow=on_overflow)
    scene = InteractiveScene(_SceneCfg(num_envs=2, env_spacing=3.0), Simulation(cfg))
    scene.build()
    return scene


def test_buffers_that_are_large_enough_are_silent():
    scene = _fall(MuJoCoSolverCfg(njmax=64, nconmax=16))
    scene.sim.check_overflow()
    assert scene["one"].data.root_pos_w[:, 2].tolist() == pytest.approx([0.1, 0.1], abs=2e-3)


def test_too_few_contacts_and_constraints_name_the_size():
    scene = _fall(MuJoCoSolverCfg(njmax=8, nconmax=3))
    with pytest.raises(RuntimeError, match=r"njmax is 8, set MuJoCoSolverCfg\(njmax=16\).*nconmax is 3.*nconmax=6"):
        scene.sim.check_overflow()
    scene.sim.check_overflow()  # told once, until it happens again


def test_a_step_raises_right_after_the_overflow():
    scene = _fall(MuJoCoSolverCfg(njmax=8, nconmax=3))
    with pytest.raises(RuntimeError, match="nconmax is 3"):
        scene.sim.step()


def test_a_warning_on_request():
    scene = _fall(MuJoCoSolverCfg(njmax=8, nconmax=16), on_overflow="warn")
    with pytest.warns(UserWarning, match="dropped constraints"):
        scene.sim.check_overflow()


def test_on_the_cpu_the_step_that_drops_contacts_tells():
    looked, first = _scene(MuJoCoSolverCfg(njmax=64, nconmax=16)), None
    for index in range(40):
        looked.sim.launch(1)
        if first is None and int(looked.sim.solver.mjw_data.nefc.numpy().max()) > 8:
            first = index
    scene = _scene(MuJoCoSolverCfg(njmax=8, nconmax=16))
    assert first is not None
    for _ in range(first):
        scene.sim.step()
    with pytest.raises(RuntimeError, match="njmax is 8"):
        scene.sim.step()


def test_a_pile_fits_into_the_default_buffers():
    # Of ten boxes on each other 40 contacts and 160 rows, where MuJoCo Warp's default is 64 rows.
    boxes = {f"box{i}": _box(f"Box{i}", 0.0, 0.1 + 0.2 * i) for i in range(10)}
    cfg = SimulationCfg(device="cpu", dt=1.0 / 240.0)
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=2, env_spacing=3.0), Simulation(cfg))
    scene.builder.build_objects({"ground": AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg()), **boxes})
    scene.build()
    for _ in range(20):
        scene.sim.step()
    assert int(scene.sim.solver.mjw_data.nefc.numpy().min()) >= 150
    assert scene["box9"].data.root_pos_w[:, 2].tolist() == pytest.approx([1.9, 1.9], abs=0.02)


def test_room_is_counted_by_what_can_touch():
    builder = newton.ModelBuilder()
    builder.add_ground_plane()
    ball, block = builder.add_body(mass=1.0), builder.add_body(mass=1.0)
    builder.add_shape_sphere(ball, radius=0.1)
    for _ in range(3):
        builder.add_shape_box(block, hx=0.1, hy=0.1, hz=0.1)
    contacts, rows = contact_capacity(builder.finalize(device="cpu"))
    assert contacts == 1 + 8  # no body needs more than eight
    assert rows == 4 * 9 + 2 * 12
    two = newton.ModelBuilder()
    two.replicate(builder, 2)
    assert contact_capacity(two.finalize(device="cpu")) == (contacts, rows)
