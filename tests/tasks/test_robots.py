# SPDX-License-Identifier: Apache-2.0
"""Robots of this package: published numbers, standing, and the program that authors them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from pxr import Sdf, Usd
from scipy.spatial.transform import Rotation

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
from stripe_newton.cli import main
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import ArticulationRootPropertiesCfg, GroundPlaneCfg, MuJoCoSolverCfg
from stripe_newton.usd import inspect_stage
from stripe_tasks.robots import HUMANOID_POSITION_CFG, QUADRUPED_CFG
from tests.helpers.checkout import ROOT, TOOLS
from tests.helpers.small_scenes import make_scene, numpy, sim_cfg
from tests.helpers.solver_contacts import touching_geoms, watch_contacts

STAGE = Path(QUADRUPED_CFG.spawn.usd_path)
GROUND = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
LEGS = ("FL", "FR", "RL", "RR")
LINKS = ("hip", "thigh", "calf")

PUBLISHED_MASS = {"base": 6.921, "hip": 0.678, "thigh": 1.152, "calf": 0.154, "foot": 0.04}
"""Unitree's go2_description.urdf [kg]."""
PUBLISHED_INERTIA = {
    "base": (0.02448, 0.098077, 0.107, 0.00012166, 0.0014849, -3.12e-05),
    "FL_hip": (0.00048, 0.000884, 0.000596, -3.01e-06, 1.11e-06, -1.42e-06),
    "FR_hip": (0.00048, 0.000884, 0.000596, 3.01e-06, 1.11e-06, 1.42e-06),
    "RL_hip": (0.00048, 0.000884, 0.000596, 3.01e-06, -1.11e-06, -1.42e-06),
    "FL_thigh": (0.00584, 0.0058, 0.00103, 8.72e-05, -0.000289, 0.000808),
    "FR_thigh": (0.00584, 0.0058, 0.00103, -8.72e-05, -0.000289, -0.000808),
    "FR_calf": (0.00108, 0.0011, 3.29e-05, -3.4e-07, 1.72e-05, -8.28e-06),
}
"""The same file's tensors about the centres of mass: xx, yy, zz, xy, xz, yz [kg m^2]."""
PUBLISHED_COM = {
    "base": (0.021112, 0.0, -0.005366),
    "FR_hip": (-0.0054, -0.00194, -0.000105),
    "RL_hip": (0.0054, 0.00194, -0.000105),
    "RR_thigh": (-0.00374, 0.0223, -0.0327),
    "RL_calf": (0.00548, -0.000975, -0.115),
}
PUBLISHED_LIMITS = {
    "hip": (-1.0472, 1.0472),
    "F_thigh": (-1.5708, 3.4907),
    "R_thigh": (-0.5236, 4.5379),
    "calf": (-2.7227, -0.83776),
}


def on_ground(robot: ArticulationCfg, num_envs: int = 1, **solver) -> InteractiveScene:
    options = {"njmax": 300, "nconmax": 100, "cone": "elliptic", "impratio": 10.0, **solver}
    return make_scene(
        {"ground": GROUND, "robot": robot.replace(prim_path="{ENV_REGEX_NS}/Robot")},
        num_envs=num_envs,
        sim=sim_cfg(dt=0.005, solver=MuJoCoSolverCfg(**options)),
    )


@pytest.fixture(scope="module")
def quadruped():
    return on_ground(QUADRUPED_CFG, num_envs=2)


def test_the_file_lies_in_the_package():
    assert STAGE.is_relative_to(ROOT / "tasks" / "stripe_tasks")
    assert STAGE.stat().st_size < 1_000_000


def test_the_tool_writes_the_file_and_always_the_same(tmp_path):
    files = [tmp_path / "one.usda", tmp_path / "two.usda"]
    tool = TOOLS / "authoring" / "author_quadruped.py"
    for file in files:
        subprocess.run([sys.executable, tool, file], check=True, capture_output=True)
    assert files[0].read_bytes() == files[1].read_bytes()
    own, packaged = (Sdf.Layer.FindOrOpen(str(f)).ExportToString() for f in (files[0], STAGE))
    assert own == packaged, "python tools/authoring/author_quadruped.py writes the file anew"


def test_joints_and_bodies_have_the_names_and_the_order_of_the_field(quadruped):
    robot = quadruped["robot"]
    assert robot.joint_names == [f"{leg}_{link}_joint" for leg in LEGS for link in LINKS]
    assert robot.body_names == ["base", *(f"{leg}_{part}" for leg in LEGS for part in (*LINKS, "foot"))]
    assert not robot.is_fixed_base


def test_masses_and_inertias_are_the_published_ones(quadruped):
    robot = quadruped["robot"]
    masses = dict(zip(robot.body_names, numpy(robot.data.body_mass)[0], strict=True))
    for name, mass in masses.items():
        assert mass == pytest.approx(PUBLISHED_MASS[name.rpartition("_")[2]], rel=1e-5), name
    assert sum(masses.values()) == pytest.approx(15.019, abs=0.005)  # the published file has two markers of 1 g more
    tensors = dict(zip(robot.body_names, numpy(robot.data.body_inertia)[0], strict=True))
    for name, (xx, yy, zz, xy, xz, yz) in PUBLISHED_INERTIA.items():
        expected = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        np.testing.assert_allclose(tensors[name], expected, atol=2e-5 * np.trace(expected), err_msg=name)


def test_mujoco_gets_the_same_robot(quadruped):
    model = quadruped.sim.solver.mj_model
    names = [model.body(i).name.rpartition("/")[2] for i in range(model.nbody)]
    assert model.body_mass.sum() == pytest.approx(15.017, abs=1e-3)
    for name, com in PUBLISHED_COM.items():
        body = next(i for i, n in enumerate(names) if n.endswith(name))
        np.testing.assert_allclose(model.body_ipos[body], com, atol=1e-6, err_msg=name)
    name, (xx, yy, zz, xy, xz, yz) = "FL_thigh", PUBLISHED_INERTIA["FL_thigh"]
    body = next(i for i, n in enumerate(names) if n.endswith(name))
    axes = Rotation.from_quat(np.roll(model.body_iquat[body], -1)).as_matrix()
    tensor = axes @ np.diag(model.body_inertia[body]) @ axes.T
    np.testing.assert_allclose(tensor, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], atol=1e-7)
    sites = [model.site(i).name for i in range(model.nsite)]
    assert len(sites) == 1
    assert "/base/imu" in sites[0]
    np.testing.assert_allclose(model.site_pos[0], (-0.02557, 0.0, 0.04232), atol=1e-6)


def test_limits_are_the_published_ones(quadruped):
    data = quadruped["robot"].data
    limits, names = numpy(data.joint_pos_limits)[0], quadruped["robot"].joint_names
    for row, name in zip(limits, names, strict=True):
        leg, link, _ = name.split("_")
        key = f"{leg[0]}_thigh" if link == "thigh" else link
        np.testing.assert_allclose(row, PUBLISHED_LIMITS[key], atol=2e-5, err_msg=name)
    np.testing.assert_allclose(numpy(data.joint_effort_limits)[0].reshape(4, 3), [[23.7, 23.7, 45.43]] * 4, rtol=1e-5)
    np.testing.assert_allclose(numpy(data.joint_vel_limits)[0].reshape(4, 3), [[30.1, 30.1, 15.7]] * 4, rtol=1e-3)


def test_the_file_alone_says_what_the_config_says(quadruped):
    """Drives, limits and armature stand in the USD file too, for those who load it without the config."""
    report = inspect_stage(STAGE)
    assert report.ignored == []
    configured = {joint.path.rpartition("/")[2]: joint for joint in quadruped.builder.reports[0].joints}
    revolute = [joint for joint in report.joints if joint.type == "revolute"]
    assert len(revolute) == 12
    default = quadruped["robot"].data.default_joint_pos[0]
    for index, joint in enumerate(revolute):
        same = configured[joint.path.rpartition("/")[2]]
        for field in ("lower", "upper", "stiffness", "damping", "max_force", "velocity_limit", "armature"):
            assert getattr(joint, field) == pytest.approx(getattr(same, field), rel=2e-3), (joint.path, field)
        assert joint.position == pytest.approx(float(default[index]), abs=1e-5)


def test_inspect_draws_it(tmp_path, capsys):
    assert main(["inspect", str(STAGE), "--out", str(tmp_path)]) == 0
    assert "17 bodies, 18 degrees of freedom" in capsys.readouterr().out
    assert (tmp_path / "quadruped.png").stat().st_size > 20_000


def test_colliders_are_few_primitives_and_feet_are_bodies_of_their_own(quadruped):
    model = quadruped.sim.solver.mj_model
    kinds = [mujoco.mjtGeom(kind).name for kind in model.geom_type]
    assert sorted(set(kinds)) == ["mjGEOM_BOX", "mjGEOM_CAPSULE", "mjGEOM_PLANE", "mjGEOM_SPHERE"]
    assert len(kinds) == 1 + 2 + 4 * 4  # ground, trunk and head, four a leg
    for leg in LEGS:
        foot = next(i for i in range(model.nbody) if model.body(i).name.endswith(f"{leg}_foot"))
        geoms = [i for i in range(model.ngeom) if model.geom_bodyid[i] == foot]
        assert [model.geom_size[i][0] for i in geoms] == [pytest.approx(0.022)]


def test_it_stands_on_its_default_pose(quadruped):
    """With position targets at the default pose: it sinks into its springs within a second, then stays."""
    scene, data = quadruped, quadruped["robot"].data
    scene.sim.step(200)
    settled, joints = numpy(data.root_state_w)[0], numpy(data.joint_pos)[0]
    assert 0.26 < settled[2] < 0.34
    scene.sim.step(800)
    after = numpy(data.root_state_w)[0]
    assert np.abs(after[:2] - settled[:2]).max() < 0.01
    assert abs(after[2] - settled[2]) < 0.01
    assert Rotation.from_quat(after[3:7]).magnitude() < np.radians(2.0)
    assert np.abs(numpy(data.joint_pos)[0] - joints).max() < 0.05
    assert np.abs(after[7:]).max() < 0.02


def test_only_the_feet_touch_the_ground(quadruped):
    """Run after it stood: what MuJoCo reports of its contacts."""
    solver = quadruped.sim.solver
    model = solver.mj_model
    watch_contacts(solver)
    quadruped.sim.step()
    geoms = touching_geoms(solver)[1]
    bodies = {model.body(model.geom_bodyid[g]).name.rpartition("/")[2] for pair in geoms for g in pair}
    assert {b.rpartition("_")[2] for b in bodies} - {"world"} == {"foot"}
    assert len(bodies - {"world"}) == 4


def test_links_do_not_collide_near_the_default_pose():
    """With collisions between its own links switched on."""
    robot = QUADRUPED_CFG.copy()
    robot.spawn.articulation_props = ArticulationRootPropertiesCfg(enabled_self_collisions=True)
    model = on_ground(robot).sim.solver.mj_model
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    middle = np.array([0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5])
    for offset in [np.zeros(12), *rng.uniform(-0.4, 0.4, size=(50, 12))]:
        data.qpos[:7] = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0)
        data.qpos[7:] = middle + offset
        mujoco.mj_forward(model, data)
        touching = [tuple(c.geom) for c in data.contact[: data.ncon] if c.dist < 0.0]
        assert not touching, [[model.geom(int(g)).name for g in pair] for pair in touching]


def test_legs_that_cross_do_collide():
    """The switch of the test before does something."""
    robot = QUADRUPED_CFG.copy()
    robot.spawn.articulation_props = ArticulationRootPropertiesCfg(enabled_self_collisions=True)
    model = on_ground(robot).sim.solver.mj_model
    data = mujoco.MjData(model)
    data.qpos[:7] = (0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    data.qpos[7:] = (-0.6, 0.8, -1.5, 0.6, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5)
    mujoco.mj_forward(model, data)
    assert any(c.dist < 0.0 for c in data.contact[: data.ncon])


def test_every_visible_surface_has_a_material_and_faces_outward():
    stage = Usd.Stage.Open(str(STAGE))
    meshes = [p for p in stage.Traverse() if p.GetTypeName() == "Mesh"]
    assert len(meshes) > 40
    for prim in meshes:
        points = np.array(prim.GetAttribute("points").Get())
        normals = np.array(prim.GetAttribute("normals").Get())
        counts = np.array(prim.GetAttribute("faceVertexCounts").Get())
        indices = np.array(prim.GetAttribute("faceVertexIndices").Get())
        assert prim.GetRelationship("material:binding").GetTargets(), prim.GetPath()
        assert counts.sum() == len(indices)
        assert indices.max() < len(points) == len(normals)
        start = np.concatenate([[0], np.cumsum(counts)[:-1]])
        corners = points[np.stack([indices[start], indices[start + 1], indices[start + 2]], axis=1)]
        faces = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        large = np.linalg.norm(faces, axis=1) > 1e-7
        corner_normals = sum(normals[indices[start + k]] for k in range(3))
        agree = (faces * corner_normals).sum(axis=1)[large]
        assert (agree > 0.0).mean() > 0.98, prim.GetPath()


def test_the_humanoid_stands_on_its_default_pose():
    scene = on_ground(HUMANOID_POSITION_CFG)
    data = scene["robot"].data
    assert scene["robot"].num_joints == 21
    limits = data.joint_effort_limits[0]
    for _ in range(3):
        scene.sim.step(200)
        assert (data.applied_torque[0].abs() < limits).all()
    state = numpy(data.root_state_w)[0]
    assert np.abs(state[:2]).max() < 0.06
    assert state[2] == pytest.approx(1.25, abs=0.02)
    assert Rotation.from_quat(state[3:7]).magnitude() < np.radians(5.0)
    assert torch.isfinite(data.joint_pos).all()
    assert (data.joint_pos - data.default_joint_pos).abs().max() < 0.12
