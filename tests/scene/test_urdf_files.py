# SPDX-License-Identifier: Apache-2.0
"""URDF files: whether a robot floats is said, not guessed; what is not the file itself is named."""

from __future__ import annotations

from pathlib import Path

import newton.examples
import pytest

from stripe_newton.assets import ArticulationCfg
from stripe_newton.assets.articulation import Articulation
from stripe_newton.sim import UrdfFileCfg
from tests.helpers.small_scenes import make_scene

BODY = '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>'
ARM = f"""<link name="base">{BODY}</link><link name="tip">{BODY}</link>
<joint name="elbow" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>"""
HELD = """<link name="world"/>{arm}
<joint name="stand" type="{kind}"><parent link="world"/><child link="base"/></joint>"""


def robot(folder: Path, links: str, fix_base: bool | None) -> Articulation:
    path = folder / "robot.urdf"
    path.write_text(f'<robot name="robot">{links}</robot>')
    spawn = UrdfFileCfg(asset_path=str(path), fix_base=fix_base)
    scene = make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})
    return scene.articulations["robot"]


@pytest.mark.parametrize(
    ("links", "fix_base", "fixed"),
    [(ARM, True, True), (ARM, False, False), (HELD.format(arm=ARM, kind="fixed"), None, True)],
    ids=["set fixed", "set floating", "held by the link world"],
)
def test_the_base_is_as_the_config_or_the_file_says(tmp_path, links, fix_base, fixed):
    assert robot(tmp_path, links, fix_base).is_fixed_base is fixed


@pytest.mark.parametrize(
    ("links", "fix_base", "message"),
    [
        (ARM, None, "does not say whether its root link 'base' floats.*set fix_base=False, or fix_base=True"),
        (f'{ARM}<link name="hat">{BODY}</link>', True, "links 'base', 'hat' are the child of no joint: one must be"),
        (HELD.format(arm=ARM, kind="floating"), None, "joint 'stand' is of type 'floating'.*set fix_base=False"),
    ],
    ids=["nobody says", "two roots", "a floating joint"],
)
def test_what_does_not_say_it_is_refused(tmp_path, links, fix_base, message):
    with pytest.raises(ValueError, match=rf"robot\.urdf.*{message}"):
        robot(tmp_path, links, fix_base)


@pytest.mark.parametrize(("name", "root"), [("quadruped", "base"), ("cartpole", "slider")])
def test_files_of_newton_do_not_say_it(name, root):
    spawn = UrdfFileCfg(asset_path=str(newton.examples.get_asset(f"{name}.urdf")))
    with pytest.raises(ValueError, match=f"whether its root link '{root}' floats"):
        make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})


def test_a_pointer_of_git_lfs_is_named(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 3\n")
    spawn = UrdfFileCfg(asset_path=str(path), fix_base=True)
    with pytest.raises(ValueError, match=r"robot\.urdf' is a pointer of git LFS.*'git lfs pull'"):
        make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, actuators={})})
