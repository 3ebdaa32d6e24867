# SPDX-License-Identifier: Apache-2.0
"""Overflow of contacts and constraints: an error names the size to set, nothing is lost silently."""

from __future__ import annotations

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


def _box(name: str, x: float) -> RigidObjectCfg:
    cube = CuboidCfg(
        size=(0.2, 0.2, 0.2), rigid_props=RigidBodyPropertiesCfg(), collision_props=CollisionPropertiesCfg()
    )
    state = RigidObjectCfg.InitialStateCfg(pos=(x, 0.0, 0.3))
    return RigidObjectCfg(prim_path=f"{{ENV_REGEX_NS}}/{name}", spawn=cube, init_state=state)


@configclass
class _SceneCfg(InteractiveSceneCfg):
    ground: AssetBaseCfg = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    one: RigidObjectCfg = _box("One", 0.0)
    two: RigidObjectCfg = _box("Two", 1.0)


def _fall(solver: MuJoCoSolverCfg, on_overflow: str = "raise") -> InteractiveScene:
    """Two boxes in each of two environments fall onto the ground: eight contacts, 32 constraints, an environment."""
    cfg = SimulationCfg(device="cpu", dt=1.0 / 120.0, solver=solver, on_overflow=on_overflow)
    scene = InteractiveScene(_SceneCfg(num_envs=2, env_spacing=3.0), Simulation(cfg))
    scene.build()
    for _ in range(40):
        scene.sim.launch(1)  # as step() does, without looking
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
