# SPDX-License-Identifier: Apache-2.0
"""Round trips: each scene file of the installed packages that loads is exported to a stage that loads the same."""

from __future__ import annotations

from pathlib import Path

import newton
import numpy as np
import pytest
from pxr import Usd, UsdGeom

from stripe_newton.robot_files import file_kind
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import SimulationCfg
from tests.helpers.same_scene import assert_same
from tests.helpers.stage_files import Dressed, dressed, further_files, package_files
from tools.checks.file_trial import SOLVER, file_scene

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]
FILES = dict(package_files())
FURTHER = dict(further_files())
SOFT, EMPTY, UNREAD = "made of particles", "has no bodies", "Newton's importer does"
# What does not load, and a part of the reason given. Everything else must load.
REFUSED = {
    "newton/examples/assets/mpm_sand.usda": SOFT,
    "newton/examples/assets/nv_humanoid.xml": "MuJoCo refuses it",
    "newton/tests/assets/deformables_mixed.usda": SOFT,
    "newton/tests/assets/humanoid.urdf": "moves and has no mass",
    "newton/tests/assets/mpm_material_subsets.usda": SOFT,
    "newton/tests/assets/mpm_two_prims.usda": SOFT,
    "newton/tests/assets/tetmesh_custom_attrs.usda": SOFT,
    "newton/tests/assets/tetmesh_multi.usda": SOFT,
    "newton/tests/assets/tetmesh_simple.usda": SOFT,
    "newton/tests/assets/tetmesh_with_legacy_material.usda": SOFT,
    "newton/tests/assets/tetmesh_with_material.usda": SOFT,
    "mujoco/testdata/msh.xml": EMPTY,
    "mujoco_warp/test_data/collision_sdf/mesh.xml": "contains no triangles",
    "mujoco_warp/test_data/collision_sdf/scene.xml": EMPTY,
    "mujoco_warp/test_data/collision_sdf/torus.xml": "MuJoCo refuses it",
    "mujoco_warp/test_data/convex_collision/box100.xml": UNREAD,
    "mujoco_warp/test_data/flex/floppy.xml": UNREAD,
    "mujoco_warp/test_data/flex/moving_base_strain.xml": UNREAD,
    "mujoco_warp/test_data/flex/multiflex.xml": UNREAD,
    "mujoco_warp/test_data/flex/rope.xml": UNREAD,
    "mujoco_warp/test_data/flex/scene.xml": EMPTY,
    "mujoco_warp/test_data/humanoid/n_humanoid.xml": UNREAD,
    "mujoco_warp/test_data/pendula.xml": "has a ball joint and 1 more",
    "mujoco_warp/test_data/primitives.xml": UNREAD,
    "mujoco_warp/test_data/ray.xml": EMPTY,
    "mujoco_warp/test_data/skybox/checker.xml": EMPTY,
    "mujoco_warp/test_data/skybox/gradient.xml": EMPTY,
}
LOADED = {name: file for name, file in FILES.items() if name not in REFUSED}
STAGES = {name: file for name, file in LOADED.items() if file.suffix.startswith(".usd")}
UNITS = (0.01, 0.0254, 0.1, 1.0)


def assert_comes_back(scene: InteractiveScene, path: Path) -> Usd.Stage:
    """Export a scene, import it, and compare the two; returns the exported stage."""
    scene.export(path)
    stage = Usd.Stage.Open(str(path))
    # A scene chooses who finds its contacts: the second one is to choose for itself.
    again = InteractiveScene.from_usd(stage, sim_cfg=scene.sim.cfg.replace(solver=SOLVER))
    assert_same(scene, again)
    again.close()
    return stage


def test_the_files_are_more_than_a_hundred():
    assert set(REFUSED) <= set(FILES)
    assert len(LOADED) >= 140  # 147 of newton 1.8.0, warp 1.19.0, mujoco 3.17.0, mujoco-warp 3.17.0, gymnasium 1.4.0


@pytest.mark.parametrize("name", FILES)
def test_a_file_comes_back_as_the_same_model(tmp_path, name):
    file = FILES[name]
    if name in REFUSED:
        with pytest.raises(ValueError, match=REFUSED[name]):
            file_scene(str(file), file_kind(file).name)
        return
    scene = file_scene(str(file), file_kind(file).name)
    assert_comes_back(scene, tmp_path / "scene.usda")
    scene.close()


@pytest.mark.parametrize("name", FURTHER)
def test_a_further_file_comes_back_as_the_same_model(tmp_path, name):
    try:
        scene = file_scene(str(FURTHER[name]), file_kind(FURTHER[name]).name)
    except ValueError as error:
        pytest.skip(f"does not load: {error}")
    assert_comes_back(scene, tmp_path / "scene.usda")
    scene.close()


@pytest.mark.parametrize("name", STAGES)
def test_a_stage_in_other_units_with_motion_labels_and_materials_comes_back(tmp_path, name):
    number = list(STAGES).index(name)
    metres, up = UNITS[number % 4], "YZ"[number // 4 % 2]
    stage = dressed(STAGES[name], metres, up, seed=number)
    scene = InteractiveScene.from_usd(stage.stage, sim_cfg=SimulationCfg(gravity=None, device="cpu", solver=SOLVER))
    assert_has(scene, stage)
    exported = assert_comes_back(scene, tmp_path / "scene.usda")
    assert (UsdGeom.GetStageMetersPerUnit(exported), UsdGeom.GetStageUpAxis(exported)) == (1.0, up)
    scene.close()


def assert_has(scene: InteractiveScene, stage: Dressed) -> None:
    """What was authored on a stage is in its scene."""
    model, report = scene.sim.model, scene.builder.reports[0]
    starts, children = model.joint_qd_start.numpy(), model.joint_child.numpy()
    for joint in np.flatnonzero(model.joint_type.numpy() == newton.JointType.FREE):
        speed = model.joint_qd.numpy()[starts[joint] : starts[joint] + 6].reshape(2, 3)
        expected = stage.speeds[model.body_label[children[joint]]]
        np.testing.assert_allclose(np.linalg.norm(speed, axis=1), expected, rtol=1e-4, atol=1e-6)
    bodies = set(model.body_label)
    assert {path: labels["category"] for path, labels in report.semantics.items() if path in bodies} == {
        path: labels for path, labels in stage.labels.items() if path in bodies
    }
    friction = {row.path: row.dynamic_friction for row in report.materials}
    assert {path: friction[path] for path in stage.frictions} == pytest.approx(stage.frictions, rel=1e-6)
