# SPDX-License-Identifier: Apache-2.0
"""Robots by short names: files from the first source that has them, a pose and drives that hold them."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest
import torch

from stripe_newton.assets import ROBOT_SOURCES, ROBOTS, AssetBaseCfg, find_robot, robot_cfg, robot_library
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import GroundPlaneCfg, MjcfFileCfg, MuJoCoSolverCfg, UrdfFileCfg
from tests.helpers.robot_files import plain_model
from tests.helpers.small_scenes import make_scene, numpy, sim_cfg
from tools.documentation import robot_page

LEGS = ["go1", "go2", "a1", "b2", "spot", "anymal_b", "anymal_c", "anymal_d", "g1", "h1", "t1", "cassie"]


@pytest.fixture(autouse=True)
def no_download(monkeypatch):
    """Nothing is cloned, which takes seconds to fail without a network: a file is on this machine, or a test skips."""

    def git(*arguments: str) -> None:
        raise OSError("git is switched off in this test")

    def newton_asset(name: str, file: str | None) -> str:
        raise ConnectionError("Newton's asset repository is switched off in this test")

    monkeypatch.setattr(robot_library, "_git", git)
    if "NEWTON_CACHE_PATH" not in os.environ:
        monkeypatch.setattr(robot_library, "_newton", newton_asset)


def scene_of(name: str) -> tuple[InteractiveScene, Path]:
    """The robot on a plane. Without its file the test is skipped."""
    try:
        path = find_robot(name)
    except LookupError as error:
        pytest.skip(str(error).replace("\n", " "))
    robot = robot_cfg(name).replace(prim_path="{ENV_REGEX_NS}/Robot")
    ground = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
    solver = MuJoCoSolverCfg(njmax=600, nconmax=400)
    return make_scene({"ground": ground, "robot": robot}, num_envs=1, sim=sim_cfg(dt=0.002, solver=solver)), path


@pytest.mark.filterwarnings("ignore::newton.NewtonWarning")
@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_stands_or_holds_its_pose_for_five_seconds(name):
    scene, path = scene_of(name)
    robot = scene["robot"]
    if path.suffix == ".xml":
        model = plain_model(path)
        free = int((model.jnt_type == mujoco.mjtJoint.mjJNT_FREE).sum())
        assert (len(robot.body_names), robot.num_joints) == (model.nbody - 1, model.nv - 6 * free)
        assert float(robot.data.body_mass[0].sum()) == pytest.approx(model.body_mass.sum(), rel=1e-4)
        assert free == int(not ROBOTS[name].fixed_base)
    assert robot.is_fixed_base is ROBOTS[name].fixed_base
    start, height = numpy(robot.data.joint_pos)[0], float(robot.data.root_pos_w[0, 2])
    limits = numpy(robot.data.joint_pos_limits)[0]
    if len(start) == len(limits):  # no ball joints
        assert ((limits[:, 0] - 1e-4 <= start) & (start <= limits[:, 1] + 1e-4)).all(), (
            "it begins outside of its limits"
        )
    scene.sim.step(2500)
    data = robot.data
    assert torch.isfinite(data.root_state_w).all()
    assert torch.isfinite(data.joint_pos).all()
    if name == "cassie":
        return  # its springs give way, in MuJoCo as here: it needs a controller to stand
    if name in LEGS:
        assert float(data.root_pos_w[0, 2]) > 0.8 * height
        assert float(data.projected_gravity_b[0, 2]) < -0.99
        assert float(data.root_lin_vel_w[0].norm()) < 0.03
    if len(start):
        assert float((data.joint_pos[0].cpu() - torch.tensor(start)).abs().max()) < 0.15
        assert float(data.joint_vel.abs().max()) < 0.05


def test_every_entry_says_where_its_file_is_published():
    assert len(ROBOTS) >= 20
    for name, entry in ROBOTS.items():
        assert entry.sources or entry.get, name
        assert {source for source, _, _ in entry.sources} <= set(ROBOT_SOURCES)
        assert not (entry.keyframe and entry.joint_pos), name


def test_the_page_has_the_table():
    page = robot_page.PAGE.read_text()
    assert page == robot_page.with_table(page), "python tools/documentation/robot_page.py writes the table anew"


def test_a_robot_without_a_file_says_how_to_get_it(monkeypatch):
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    monkeypatch.setattr(robot_library, "_installed", lambda module: False)
    with pytest.raises(LookupError, match=r"(?s)robot 'spot'.*menagerie:.*MENAGERIE_ROOT.*pip install robot_descript"):
        robot_cfg("spot")
    with pytest.raises(LookupError, match=r"'digit'.*Agility Robotics gives it to owners"):
        robot_cfg("digit")
    with pytest.raises(LookupError, match=r"robot 'go3' is not in the table; did you mean .*go2 or go1"):
        robot_cfg("go3")


def test_a_checkout_of_menagerie_is_used_without_its_package(tmp_path, monkeypatch):
    (tmp_path / "boston_dynamics_spot").mkdir()
    file = tmp_path / "boston_dynamics_spot/spot.xml"
    file.write_text("<mujoco/>")
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    assert find_robot("spot") == file
    assert find_robot("boston_dynamics_spot", source="menagerie", file="spot.xml") == file
    cfg = robot_cfg("spot")
    assert isinstance(cfg.spawn, MjcfFileCfg)
    assert cfg.actuators["legs"].stiffness == 500.0


def test_furniture_of_isaac_gym_comes_from_a_checkout(tmp_path, monkeypatch):
    monkeypatch.delenv("ISAACGYMENVS_ROOT", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(
        LookupError, match=r"'sektion_cabinet'.*(?s:.*)IsaacGymEnvs cannot be reached.*ISAACGYMENVS_ROOT"
    ):
        find_robot("sektion_cabinet")
    file = tmp_path / "assets/urdf/sektion_cabinet_model/urdf/sektion_cabinet_2.urdf"
    file.parent.mkdir(parents=True)
    file.write_text("<robot/>")
    monkeypatch.setenv("ISAACGYMENVS_ROOT", str(tmp_path))
    assert find_robot("sektion_cabinet") == file


def test_files_of_a_wheel_that_is_not_imported(tmp_path, monkeypatch):
    source, folder, file = ROBOTS["ur10"].sources[0]
    with monkeypatch.context() as patched:
        patched.setattr(sys, "path", [])
        with pytest.raises(ImportError, match="pip install example-robot-data --no-deps"):
            find_robot(folder, source, file)
    (tmp_path / "example_robot_data-6.0.dist-info").mkdir()
    (tmp_path / "example_robot_data-6.0.dist-info/METADATA").write_text("Name: example-robot-data\nVersion: 6.0\n")
    path = tmp_path / "cmeel.prefix/share/example-robot-data/robots" / folder / file
    path.parent.mkdir(parents=True)
    path.write_text("<robot/>")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert find_robot("ur10") == path


def test_the_config_is_made_for_a_file_of_any_kind(tmp_path):
    arm = robot_cfg("panda", path=tmp_path / "panda.urdf").spawn
    assert isinstance(arm, UrdfFileCfg)
    assert arm.fix_base is True
    assert robot_cfg("go2", path=tmp_path / "go2.urdf").spawn.fix_base is False
    assert robot_cfg("anymal_c", path=tmp_path / "c.usda").spawn.articulation_props.fix_root_link is False


def test_a_folder_of_menagerie_is_cloned_once_and_kept(tmp_path, monkeypatch):
    """A repository on this machine stands for that of Menagerie; the second robot is added to the same clone."""
    origin = tmp_path / "origin"
    for folder, file in (("robot_one", "one.xml"), ("robot_two", "two.xml")):
        (origin / folder).mkdir(parents=True)
        (origin / folder / file).write_text("<mujoco/>")

    def git(*arguments: str) -> None:
        who = ["-c", "user.name=a", "-c", "user.email=a@b.c"]
        subprocess.run(["git", *who, *arguments], check=True, capture_output=True)

    git("-C", str(origin), "init", "--quiet")
    git("-C", str(origin), "config", "uploadpack.allowFilter", "true")
    git("-C", str(origin), "add", ".")
    git("-C", str(origin), "commit", "--quiet", "-m", "robots")
    here = dataclasses.replace(robot_library._MENAGERIE, url=f"file://{origin}")
    monkeypatch.setattr(robot_library, "_MENAGERIE", here)
    monkeypatch.setattr(robot_library, "_installed", lambda module: False)
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def newton_asset(name: str, file: str | None) -> str:
        raise ConnectionError("Newton's asset repository is switched off in this test")

    monkeypatch.setattr(robot_library, "_git", git)
    if "NEWTON_CACHE_PATH" not in os.environ:
        monkeypatch.setattr(robot_library, "_newton", newton_asset)
    first = find_robot("robot_one", source="menagerie", file="one.xml")
    assert first == tmp_path / "cache/stripe-newton/mujoco_menagerie/robot_one/one.xml"
    assert not (first.parents[1] / "robot_two").exists()  # only what was asked for
    assert find_robot("robot_two", source="menagerie", file="two").is_file()
    with pytest.raises(LookupError, match="'robot_six' of menagerie: its repository has no such folder"):
        find_robot("robot_six", source="menagerie", file="six.xml")
    monkeypatch.setattr(robot_library, "_git", lambda *arguments: pytest.fail("it was fetched before"))
    assert find_robot("robot_one", source="menagerie", file="one.xml") == first
