# SPDX-License-Identifier: Apache-2.0
"""Options of MJCF files: what acts as in MuJoCo, and what has a row."""

import warnings
from pathlib import Path
from typing import Any

import mujoco
import newton
import numpy as np
import pytest
from newton.solvers import SolverMuJoCo

from stripe_newton.assets import AssetBaseCfg, file_spawner
from stripe_newton.robot_files import import_robot_file, inspect_robot_file
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


@pytest.mark.parametrize(
    ("option", "box", "share"),
    [
        (MEDIUM, 'size=".1 .1 .1" euler="20 30 40"', 2e-4),
        (MEDIUM, 'size=".1 .1 .1"', 4e-6),
        (MEDIUM, 'size=".1 .2 .3"', 0.0),
        ("", 'size=".1 .1 .1"', 0.0),
    ],
)
def test_equal_moments_are_set_apart_no_more_than_needed(option: str, box: str, share: float, tmp_path: Path) -> None:
    """Where that is more than rounding, with a row."""
    path = tmp_path / "robot.xml"
    body = f'<body name="box"><freejoint/><geom type="box" {box}/></body>'
    path.write_text(f"<mujoco>{option}<worldbody>{body}</worldbody></mujoco>")
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    report = import_robot_file(builder, "mjcf", path, {"ignore_names": ()})
    moments = np.linalg.eigvalsh(np.array(builder.body_inertia[0], dtype=float).reshape(3, 3))
    expected = np.sort(mujoco.MjModel.from_xml_path(str(path)).body_inertia[1])
    np.testing.assert_allclose((moments / expected).max() - 1.0, share, atol=1e-6)
    assert [row[0] for row in report.ignored if row[1] == "inertia"] == (["box"] if share > 1e-5 else [])


@pytest.mark.parametrize("option", [MEDIUM, ""])
def test_a_fluid_shape_has_a_row_in_a_medium(option: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    shape = '<geom name="wing" type="box" size=".1 .2 .3" fluidshape="ellipsoid"/>'
    path.write_text(f"<mujoco>{option}<worldbody><body><freejoint/>{shape}</body></worldbody></mujoco>")
    rows = [row[0] for row in inspect_robot_file(path).ignored if row[1] == "fluidshape"]
    assert rows == (["wing"] if option else [])


def test_rows_of_options(tmp_path: Path) -> None:
    path = tmp_path / "robot.xml"
    joint = '<joint type="slide" damping="1e11"/><geom size="0.1"/>'
    option = '<option noslip_iterations="3" density="1000"/>'
    path.write_text(f"<mujoco>{option}<worldbody><body>{joint}</body></worldbody></mujoco>")
    rows = {what.partition(" ")[0]: why for _, what, why in inspect_robot_file(path).ignored}
    assert rows.keys() == {"timestep", "integrator", "noslip_iterations", "inverse"}
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
