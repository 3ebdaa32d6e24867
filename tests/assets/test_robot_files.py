# SPDX-License-Identifier: Apache-2.0
"""Robot files of other projects, by path and by name: the simulation has what MuJoCo reads from the same file."""

from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path

import mujoco
import newton.examples
import newton.utils
import numpy as np
import pytest
import torch

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg, AssetBaseCfg, file_spawner, find_robot, robot_library
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import GroundPlaneCfg, MjcfFileCfg, MuJoCoSolverCfg, UrdfFileCfg, UsdFileCfg
from tests.helpers.robot_files import ROBOTS, plain_model, robot_file
from tests.helpers.small_scenes import MASS, G, make_scene, numpy, sim_cfg

GROUND = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
AS_THE_FILE_SAYS = ArticulationCfg.InitialStateCfg(pos=None, rot=None, joint_pos=None)


@pytest.mark.filterwarnings("ignore::newton.NewtonWarning")
@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_of_others_is_what_plain_mujoco_reads(name):
    path = robot_file(name)
    urdf = path.suffix == ".urdf"
    spawn = file_spawner(path, **({"fix_base": False} if urdf else {}))
    state = AS_THE_FILE_SAYS.replace(pos=(0.0, 0.0, 0.7)) if urdf else AS_THE_FILE_SAYS
    robot = ArticulationCfg(prim_path="{ENV_REGEX_NS}/Robot", spawn=spawn, init_state=state)
    solver = MuJoCoSolverCfg(njmax=500, nconmax=500)
    scene = make_scene({"ground": GROUND, "robot": robot}, sim=sim_cfg(dt=0.002, solver=solver))
    asset, model = scene["robot"], plain_model(path)

    joints = [j for j in range(model.njnt) if model.jnt_type[j] != mujoco.mjtJoint.mjJNT_FREE]
    assert asset.joint_names == [model.joint(j).name for j in joints]
    limited = model.jnt_limited[joints].astype(bool)
    limits = numpy(asset.data.joint_pos_limits)[0]
    np.testing.assert_allclose(limits[limited], model.jnt_range[joints][limited], atol=1e-5)
    assert (limits[~limited, 1] - limits[~limited, 0] > 4.0 * np.pi - 1e-3).all()

    masses = numpy(asset.data.body_mass)[0]
    assert masses.sum() == pytest.approx(model.body_mass.sum(), rel=1e-4)
    own = dict(zip(asset.body_names, masses, strict=True))
    named = [i for i in range(1, model.nbody) if model.body(i).name]
    assert len(named) > 0.5 * (model.nbody - 1)
    for i in named:
        assert own[model.body(i).name] == pytest.approx(model.body_mass[i], rel=1e-4, abs=1e-6), model.body(i).name

    start = asset.data.root_pos_w - torch.as_tensor(scene.env_origins)
    expected = state.pos or (model.qpos0[:3] if model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE else (0.0, 0.0, 0.0))
    np.testing.assert_allclose(numpy(start)[0], expected, atol=1e-6)
    scene.sim.step(200)
    for values in (asset.data.root_state_w, asset.data.joint_pos, asset.data.joint_vel):
        assert torch.isfinite(values).all()


@pytest.mark.filterwarnings("ignore::newton.NewtonWarning")
@pytest.mark.parametrize("name", ["go1", "g1"])
def test_a_config_of_a_few_lines_makes_a_robot_stand(name):
    """A PD law on all joints holds a robot of others up for a second."""
    feet = {"go1": {".*_thigh_joint": 0.9, ".*_calf_joint": -1.8}, "g1": {}}[name]
    robot = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/Robot",
        spawn=MjcfFileCfg(asset_path=str(robot_file(name))),
        init_state=ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, {"go1": 0.3, "g1": 0.79}[name]), joint_pos=feet),
        actuators={"all": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=100.0, damping=5.0)},
    )
    solver = MuJoCoSolverCfg(njmax=500, nconmax=500)
    scene = make_scene({"ground": GROUND, "robot": robot}, num_envs=1, sim=sim_cfg(dt=0.002, solver=solver))
    scene.sim.step(500)
    assert float(scene["robot"].data.root_pos_w[0, 2]) > {"go1": 0.22, "g1": 0.7}[name]


# -- what MJCF files say of joints


SLIDER = (
    f'<inertial pos="0 0 0" mass="{MASS}" diaginertia=".1 .1 .1"/><joint name="z" type="slide" axis="0 0 1"/></body>'
)


def mjcf(folder: Path, bodies: str, rest: str = "") -> MjcfFileCfg:
    path = folder / "robot.xml"
    base = '<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>'
    path.write_text(f'<mujoco><worldbody><body name="base">{base}{bodies}</body></worldbody>{rest}</mujoco>')
    return MjcfFileCfg(asset_path=str(path), fix_base=True)


def hanging(folder: Path, actuator: str, **group: float) -> InteractiveScene:
    """A body of 2 kg on a vertical slide, driven by the file's actuator, or by a group of the config."""
    spawn = mjcf(folder, f'<body name="b">{SLIDER}', f"<actuator>{actuator}</actuator>")
    groups = {"z": ImplicitActuatorCfg(joint_names_expr=["z"], **group)} if group else {}
    return make_scene(
        {
            "robot": ArticulationCfg(
                prim_path="{ENV_REGEX_NS}/R", spawn=spawn, init_state=AS_THE_FILE_SAYS, actuators=groups
            )
        },
        sim=sim_cfg(dt=0.005),
    )


def test_friction_that_a_file_leaves_out_is_that_of_mujoco(tmp_path):
    geoms = '<geom name="plain" size=".1" mass="1"/><geom name="own" size=".1" friction="0.3" mass="1"/>'
    spawn = mjcf(tmp_path, f'<body name="b"><joint type="slide" axis="0 0 1"/>{geoms}</body>')
    scene = make_scene({"robot": ArticulationCfg(prim_path="{ENV_REGEX_NS}/R", spawn=spawn, actuators={})})
    friction = dict(zip(scene.sim.template.shape_label, scene.sim.template.shape_material_mu, strict=True))
    found = {label.rsplit("/", 1)[-1]: mu for label, mu in friction.items()}
    assert (found["plain"], found["own"]) == (1.0, pytest.approx(0.3))
    assert scene.sim.new_builder().default_shape_cfg.mu == 0.5


SERVOS = {
    "position": '<position joint="z" kp="400" kv="40"/>',
    "general": '<general joint="z" gainprm="400" biastype="affine" biasprm="0 -400 -40"/>',
}


@pytest.mark.parametrize("servo", SERVOS)
def test_a_servo_of_the_file_follows_the_position_target(servo, tmp_path):
    scene = hanging(tmp_path, SERVOS[servo])
    robot = scene["robot"]
    robot.set_joint_position_target(torch.full((2, 1), 0.2))
    scene.sim.step(400)
    assert float(robot.data.joint_pos[0]) == pytest.approx(0.2 - MASS * G / 400.0, abs=1e-3)
    assert float(robot.data.joint_stiffness[0]) == pytest.approx(400.0)


@pytest.mark.parametrize("servo", SERVOS)
def test_a_group_of_the_config_takes_the_place_of_the_servo(servo, tmp_path):
    scene = hanging(tmp_path, SERVOS[servo], stiffness=100.0, damping=20.0)
    scene.sim.step(500)
    assert float(scene["robot"].data.joint_pos[0]) == pytest.approx(-MASS * G / 100.0, abs=1e-3)


@pytest.mark.parametrize(
    "actuator",
    [
        '<motor joint="z" ctrlrange="-0.5 0.5" gear="20"/>',
        '<position joint="z" kp="400" forcerange="-10 10"/>',
        '<general joint="z" gainprm="400" biastype="affine" biasprm="0 -400 -40" forcelimited="true" '
        'forcerange="-10 10"/>',
    ],
    ids=["motor", "position", "general as MuJoCo saves it"],
)
def test_ranges_of_actuators_limit_the_effort_until_the_config_does(actuator, tmp_path):
    strong = {"stiffness": 1000.0, "damping": 5.0}
    limited = hanging(tmp_path, actuator, **strong)
    assert float(limited["robot"].data.joint_effort_limits[0]) == pytest.approx(10.0)
    limited.sim.step(100)  # it is far below its target by now
    before = float(limited["robot"].data.joint_vel[0])
    limited.sim.step(100)  # 0.5 s of fall, less the 10 N
    change = float(limited["robot"].data.joint_vel[0]) - before
    inertia = MASS + 0.005 * 5.0  # see MuJoCoSolverCfg.drive_limits
    assert change == pytest.approx(-0.5 * (MASS * G - 10.0) / inertia, rel=1e-3)
    freed = hanging(tmp_path, actuator, effort_limit=100.0, **strong)
    freed.sim.step(600)
    assert float(freed["robot"].data.joint_pos[0]) == pytest.approx(-MASS * G / 1000.0, abs=1e-3)


def test_a_general_actuator_that_is_no_servo_stays_what_it_is(tmp_path):
    scene = hanging(tmp_path, '<general joint="z" gainprm="3" biastype="affine" biasprm="19.62 0 0"/>')
    scene.sim.step(50)  # its bias carries the weight
    assert float(scene["robot"].data.joint_pos[0]) == pytest.approx(0.0, abs=1e-4)
    assert float(scene["robot"].data.joint_stiffness[0]) == 0.0


SHARED = (
    '<body name="b"><joint name="yaw-1" axis="0 0 1"/><joint name="pitch" axis="0 1 0"/>'
    '<joint name="lift" type="slide" axis="0 0 1"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/></body>'
)


def test_joints_that_share_a_body_keep_their_names(tmp_path):
    robot = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/R",
        spawn=mjcf(tmp_path, SHARED),
        init_state=ArticulationCfg.InitialStateCfg(joint_pos={"pitch": 0.3, "lift": -0.1}),
    )
    asset = make_scene({"robot": robot})["robot"]
    assert asset.joint_names == ["lift", "yaw_1", "pitch"]  # what slides comes first, "-" is no name in USD
    np.testing.assert_allclose(numpy(asset.data.joint_pos)[0], (-0.1, 0.0, 0.3), atol=1e-6)
    assert asset.find_joints("pit.*") == ([2], ["pitch"])


def test_a_keyframe_gives_the_initial_state(tmp_path):
    path = tmp_path / "free.xml"
    path.write_text(
        '<mujoco><worldbody><body name="base" pos="0 0 1"><freejoint/>'
        f'<inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>{SHARED}</body></worldbody>'
        '<keyframe><key name="home" qpos="1 2 3 0.6 0 0.8 0 0.1 0.2 0.3"/><key name="other"/></keyframe></mujoco>'
    )
    robot = ArticulationCfg(
        prim_path="{ENV_REGEX_NS}/R",
        spawn=MjcfFileCfg(asset_path=str(path), keyframe="home"),
        init_state=AS_THE_FILE_SAYS,
    )
    scene = make_scene({"robot": robot})
    data = scene["robot"].data
    expected = np.array([1.0, 2.0, 3.0, 0.0, 0.8, 0.0, 0.6])
    np.testing.assert_allclose(numpy(data.root_state_w)[0, :7], expected, atol=1e-6)
    np.testing.assert_allclose(numpy(data.default_root_state)[0, :7], expected, atol=1e-6)
    np.testing.assert_allclose(numpy(data.joint_pos)[0], (0.3, 0.1, 0.2), atol=1e-6)
    np.testing.assert_allclose(numpy(data.joint_pos_target)[0], (0.3, 0.1, 0.2), atol=1e-6)
    robot.spawn.keyframe = "stand"
    with pytest.raises(ValueError, match="no keyframe 'stand', it has home, other"):
        make_scene({"robot": robot})


# -- by name


def test_the_spawner_of_a_file_goes_by_its_suffix(tmp_path):
    kinds = {"a.usda": UsdFileCfg, "a.USD": UsdFileCfg, "a.urdf": UrdfFileCfg, "a.xml": MjcfFileCfg}
    for name, kind in kinds.items():
        assert type(file_spawner(tmp_path / name)) is kind
    assert file_spawner("a.xml", self_collision=False).self_collision is False
    with pytest.raises(ValueError, match=r"a\.txt.*expected a file"):
        file_spawner("a.txt")


@pytest.fixture
def menagerie(tmp_path, monkeypatch):
    """A package that behaves as ``mujoco_menagerie`` does, with one robot on this machine and one that is not."""
    (tmp_path / "good.xml").write_text("<mujoco/>")

    def xml(entry: str) -> Path:
        if entry == "missing":
            raise LookupError("no entry point 'missing'; available: good, scene")
        return tmp_path / f"{entry}.xml"

    def download(entry: str) -> Path:
        raise OSError("Name or service not known")

    robots = {
        "robot_a1": types.SimpleNamespace(default_model="good", xml=xml),
        "robot_far": types.SimpleNamespace(default_model="far", xml=download),
    }
    module = types.ModuleType("mujoco_menagerie")
    module.__spec__ = importlib.util.spec_from_loader("mujoco_menagerie", None)
    module.names, module.get = lambda: sorted(robots), robots.__getitem__
    monkeypatch.setitem(sys.modules, "mujoco_menagerie", module)
    return tmp_path


def test_a_robot_of_menagerie_is_found_by_name(menagerie):
    assert find_robot("robot_a1") == menagerie / "good.xml"
    with pytest.raises(LookupError, match="entry point 'missing'"):
        find_robot("robot_a1", file="missing")
    with pytest.raises(LookupError, match="did you mean robot_a1"):
        find_robot("robot_al")
    with pytest.raises(LookupError, match="'nobody' of menagerie"):
        find_robot("nobody", source="menagerie")


def test_without_a_network_the_error_says_what_to_do(menagerie, monkeypatch):
    with pytest.raises(ConnectionError, match=r"robot_far.*not known.*run this once with a network.*MENAGERIE_ROOT"):
        find_robot("robot_far")

    def no_network(folder: str) -> Path:
        raise RuntimeError("Git operation failed: could not resolve host")

    git = types.ModuleType("git")
    git.__spec__ = importlib.util.spec_from_loader("git", None)
    monkeypatch.setitem(sys.modules, "git", git)
    monkeypatch.setattr(newton.utils, "download_asset", no_network)
    with pytest.raises(ConnectionError, match=r"unitree_g1.*resolve host.*NEWTON_CACHE_PATH"):
        find_robot("unitree_g1")
    monkeypatch.setattr(newton.utils, "download_asset", lambda folder: menagerie)
    with pytest.raises(FileNotFoundError, match=r"no file '.*g1_isaac\.usd'.*has good\.xml"):
        find_robot("unitree_g1")
    assert find_robot("anything", source="newton", file="good.xml") == menagerie / "good.xml"


def test_without_the_package_the_error_says_what_to_install(monkeypatch):
    def no_network(*arguments: str) -> None:
        raise OSError("could not resolve host")

    monkeypatch.setattr(robot_library, "_git", no_network)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(LookupError, match=r"unitree_goo1.*did you mean unitree_g.*pip install mujoco-menagerie"):
        find_robot("unitree_goo1")
    with pytest.raises(ConnectionError, match=r"resolve host.*pip install mujoco-menagerie.*set MENAGERIE_ROOT"):
        find_robot("unitree_r1", source="menagerie")
    with pytest.raises(ImportError, match="pip install mjlab --no-deps"):
        find_robot("unitree_go1", source="mjlab")
    with pytest.raises(ImportError, match="pip install robot_descriptions"):
        find_robot("go2_mj_description")
    with pytest.raises(ImportError, match="pip install GitPython"):
        find_robot("unitree_g1")
    with pytest.raises(ValueError, match="expected one of mjlab, menagerie, newton, descriptions"):
        find_robot("unitree_go1", source="web")
