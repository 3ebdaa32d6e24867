# SPDX-License-Identifier: Apache-2.0
"""Options of MJCF files: what acts as in MuJoCo, and what has a row."""

import warnings
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from stripe_newton.assets import AssetBaseCfg, file_spawner
from stripe_newton.robot_files import inspect_robot_file
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import MuJoCoSolverCfg, Simulation, SimulationCfg

SOLVER = MuJoCoSolverCfg(fused=False)
"""The fused step is compiled for each model."""
MEDIUM = '<option integrator="implicitfast" density="1000" viscosity="0.5" wind="2 0.3 0"/>'
GEOMS = {
    "sphere": '<geom size="0.1"/>',
    "turned cube": '<geom type="box" size="0.1 0.1 0.1" euler="20 30 40"/>',
    "turned cylinder": '<geom type="cylinder" size="0.1 0.2" euler="20 30 40"/>',
}


def scene_of(path: Path, **options: Any) -> InteractiveScene:
    scene = InteractiveScene(
        InteractiveSceneCfg(num_envs=1, env_spacing=0.0), Simulation(SimulationCfg(solver=SOLVER, **options))
    )
    spawn = file_spawner(path, ignore_names=())
    scene.builder.build_objects({"body": AssetBaseCfg(prim_path="{ENV_REGEX_NS}/Body", spawn=spawn)})
    scene.builder.adopt = True
    scene.build()
    return scene


@pytest.mark.parametrize("geom", GEOMS)
def test_a_medium_acts_along_the_file_s_axes(geom: str, tmp_path: Path) -> None:
    """Of equal moments of inertia the principal axes are any, and MuJoCo's drag of a sphere depends on them."""
    path = tmp_path / "body.xml"
    body = f'<body pos="0 0 1"><freejoint/>{GEOMS[geom]}</body>'
    path.write_text(f"<mujoco>{MEDIUM}<worldbody>{body}</worldbody></mujoco>")
    scene = scene_of(path, dt=0.002)
    scene.sim.step(100)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    for _ in range(100):
        mujoco.mj_step(model, data)
    assert abs(data.qpos[0]) > 0.05
    np.testing.assert_allclose(scene.sim.state.body_q.numpy()[0, :3], data.qpos[:3], atol=1e-4)
    scene.close()


@pytest.mark.parametrize(("option", "size"), [(MEDIUM, ".1 .1 .1"), (MEDIUM, ".1 .2 .3"), ("", ".1 .1 .1")])
def test_moments_set_apart_have_a_row(option: str, size: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    body = f'<body name="box"><freejoint/><geom type="box" size="{size}"/></body>'
    path.write_text(f"<mujoco>{option}<worldbody>{body}</worldbody></mujoco>")
    report = inspect_robot_file(path)
    expected = np.sort(mujoco.MjModel.from_xml_path(str(path)).body_inertia[1])
    changed = not np.allclose(np.sort(report.bodies[0].inertia), expected, rtol=1e-6)
    assert changed == (bool(option) and size == ".1 .1 .1")
    assert [row[0] for row in report.ignored if row[1] == "inertia"] == (["box"] if changed else [])


def test_rows_of_options(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    joint = '<joint type="slide" damping="1e11"/><geom size="0.1"/>'
    option = '<option noslip_iterations="3" density="1000"/>'
    path.write_text(f"<mujoco>{option}<worldbody><body>{joint}</body></worldbody></mujoco>")
    rows = {what.partition(" ")[0]: why for _, what, why in inspect_robot_file(path).ignored}
    assert rows.keys() == {"timestep", "integrator", "noslip_iterations", "inverse", "inertia"}
    assert rows["noslip_iterations"].startswith("not read")


BOX = '<geom name="box" type="box" size=".1 .1 .1" pos="3 0 1"/>'
MARGINS = f"""<mujoco><worldbody><geom type="plane" size="5 5 .1"/>{BOX}
<body name="ball" pos="0 0 .12"><freejoint/><geom size=".1" margin="0.01"/><geom size=".01" margin="0.01"/></body>
</worldbody></mujoco>"""


def test_margins_that_a_box_makes_zero_have_one_row_and_one_warning(tmp_path: Path) -> None:
    path = tmp_path / "margins.xml"
    path.write_text(MARGINS)
    rows = [(where, what) for where, what, _ in inspect_robot_file(path).ignored if "margin" in what]
    assert len(rows) == 1
    assert rows[0][0].endswith("(+1 more)")
    assert rows[0][1] == "contact margin 0.01 m"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene_of(path, dt=0.002).close()
    texts = [str(w.message) for w in caught if "margin" in str(w.message)]
    assert len(texts) == 1
    assert "and 1 more is not heeded" in texts[0]


def test_margins_are_heeded_without_a_box(tmp_path: Path) -> None:
    path = tmp_path / "margins.xml"
    path.write_text(MARGINS.replace(BOX, ""))
    assert not [what for _, what, _ in inspect_robot_file(path).ignored if "margin" in what]
    scene = scene_of(path, dt=0.002)
    scene.sim.step(300)
    assert 0.109 < float(scene.sim.state.body_q.numpy()[0, 2]) < 0.11
    scene.close()
