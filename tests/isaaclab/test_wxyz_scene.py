# SPDX-License-Identifier: Apache-2.0
"""Quaternions (w, x, y, z) at the boundary of assets, sensors, spawners and scenes, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import yaml
from scipy.spatial.transform import Rotation

from stripe_newton import assets as native_assets
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.isaaclab import assets, scene, sensors, spawners
from stripe_newton.isaaclab.scene_entity import SceneEntityCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import MassPropertiesCfg, RigidBodyPropertiesCfg, Simulation
from tests.helpers.small_scenes import numpy, sim_cfg

START = Rotation.from_euler("xyz", [0.4, -0.7, 1.3])
OFFSET = Rotation.from_euler("xyz", [-0.2, 0.9, 0.5])
FLOOR = Rotation.from_euler("z", 0.6)
WRITTEN = Rotation.from_euler("xyz", [[1.0, 0.2, -0.3], [-2.0, 0.1, 0.8]])
ROOT = "{ENV_REGEX_NS}/Box"
UPRIGHT = (1.0, 0.0, 0.0, 0.0)


def wxyz(turn: Rotation) -> np.ndarray:
    return turn.as_quat(scalar_first=True)


def xyzw(turn: Rotation) -> np.ndarray:
    return turn.as_quat()


def box(path: str, turn: Rotation, cfg: type = assets.RigidObjectCfg) -> native_assets.RigidObjectCfg:
    """A box that turns at its place; the config says how its quaternion is written."""
    quat = xyzw(turn) if cfg is native_assets.RigidObjectCfg else wxyz(turn)
    spawn = spawners.CuboidCfg(
        size=(0.1, 0.2, 0.3), mass_props=MassPropertiesCfg(mass=1.0), rigid_props=RigidBodyPropertiesCfg()
    )
    state = cfg.InitialStateCfg(pos=(0.0, 0.0, 1.0), rot=tuple(map(float, quat)))
    return cfg(prim_path=path, spawn=spawn, init_state=state)


@pytest.fixture(scope="module")
def built() -> scene.InteractiveScene:
    made = scene.InteractiveScene(
        InteractiveSceneCfg(num_envs=2, env_spacing=3.0), Simulation(sim_cfg(observables=("body_qdd",)))
    )
    native = box("{ENV_REGEX_NS}/Native", START, native_assets.RigidObjectCfg)
    offset = sensors.OffsetCfg(rot=tuple(map(float, wxyz(OFFSET))))
    target = sensors.FrameTransformerCfg.FrameCfg(prim_path=ROOT, offset=offset)
    either = box("{ENV_REGEX_NS}/Either", START)
    either.spawn = spawners.MultiAssetSpawnerCfg(
        assets_cfg=[either.spawn, spawners.SphereCfg(radius=0.2, rigid_props=RigidBodyPropertiesCfg())],
        mass_props=MassPropertiesCfg(mass=2.0),
        random_choice=False,
    )
    made.builder.build_objects({
        "either": either,
        "box": box(ROOT, START),
        "lamp": assets.AssetBaseCfg(prim_path="/World/lamp", spawn=spawners.DomeLightCfg(intensity=700.0)),
        "native": native,
        "upright": assets.RigidObjectCfg(prim_path="{ENV_REGEX_NS}/Up", spawn=box(ROOT, START).spawn),
    })  # fmt: skip
    with made.construction():
        floor = spawners.GroundPlaneCfg()
        floor.func("/World/floor", floor, orientation=tuple(wxyz(FLOOR)))
        made.rigid_objects["mixed"] = assets.RigidObject(
            box("{ENV_REGEX_NS}/Mixed", START, native_assets.RigidObjectCfg)
        )
    members = {key: box(f"{{ENV_REGEX_NS}}/{key}", turn) for key, turn in (("Start", START), ("Floor", FLOOR))}
    made.builder.build_collection("pair", assets.RigidObjectCollectionCfg(rigid_objects=members))
    made.builder.build_sensors({
        "imu": sensors.ImuCfg(prim_path=ROOT, offset=offset),
        "frames": sensors.FrameTransformerCfg(prim_path=ROOT, target_frames=[target]),
        "camera": sensors.CameraCfg(
            prim_path=f"{ROOT}/camera", width=4, height=4, data_types=("depth",),
            offset=sensors.CameraCfg.OffsetCfg(rot=tuple(map(float, wxyz(OFFSET))), convention="world"),
        ),
    })  # fmt: skip
    made.clone_environments()
    made.build()
    return made


def same(found: torch.Tensor, expected: np.ndarray) -> None:
    """Compare rotations, whose quaternions may have either sign."""
    values = numpy(found).reshape(-1, 4)
    expected = np.broadcast_to(expected, values.shape)
    np.testing.assert_allclose(np.abs(np.sum(values * expected, axis=1)), 1.0, atol=1e-5)


def test_environments_with_different_objects_start_alike(built):
    assert built["either"].asset_index.tolist() == [0, 1]
    same(built["either"].data.default_root_state[:, 3:7], wxyz(START))


def test_what_a_config_sets_is_what_the_simulation_has(built):
    same(built["box"].native_data.root_quat_w, xyzw(START))
    same(built["box"].data.root_quat_w, wxyz(START))
    same(built["mixed"].native_data.root_quat_w, xyzw(START))  # a config of the package in an asset of the dialect
    same(built["mixed"].data.root_quat_w, wxyz(START))
    same(built["native"].data.root_quat_w, xyzw(START))  # an asset of the package stays as it is
    np.testing.assert_array_equal(numpy(built["upright"].data.root_quat_w), [UPRIGHT] * 2)


def test_every_tensor_with_an_orientation_is_converted(built):
    data, below = built["box"].data, built["box"].native_data
    for name in [n for n in dir(type(below)) if isinstance(getattr(type(below), n), property)]:
        if name.startswith("_") or name in ("struct", "unavailable"):
            continue
        found, value = getattr(data, name), getattr(below, name)
        expected = numpy(value)
        if value.shape[-1] == 4:
            expected = expected[..., [3, 0, 1, 2]]
        elif value.shape[-1] in (7, 13):
            expected = expected[..., [0, 1, 2, 6, 3, 4, 5, *range(7, value.shape[-1])]]
        np.testing.assert_array_equal(numpy(found), expected, err_msg=name)
    assert data.body_names == below.body_names
    state = numpy(data.default_root_state)
    np.testing.assert_allclose(np.abs(state[:, 3:7] @ wxyz(START)), 1.0, atol=1e-6)


def test_collections_speak_the_same_order(built):
    pair = built["pair"]
    for index, turn in enumerate((START, FLOOR)):
        same(pair.data.object_link_quat_w[:, index], wxyz(turn))
        same(pair.data.default_object_state[:, index, 3:7], wxyz(turn))
    pose = pair.data.object_link_pose_w.clone()
    pose[:, 1, 3:7] = torch.tensor(wxyz(WRITTEN))
    pair.write_object_link_pose_to_sim(pose[:, [1]], object_ids=torch.tensor([1]))
    same(pair.objects["Floor"].native_data.root_quat_w[0], xyzw(WRITTEN[0]))
    same(pair.objects["Floor"].native_data.root_quat_w[1], xyzw(WRITTEN[1]))
    same(pair.objects["Start"].native_data.root_quat_w, xyzw(START))
    with pytest.raises(RuntimeError, match="converted copy"):
        pair.data.object_pose_w[:, 0] = 0.0
    entity = SceneEntityCfg("pair", object_collection_names="F.*")
    entity.resolve(built)
    assert entity.object_collection_ids == [1]


def test_data_that_is_a_copy_refuses_to_be_written(built):
    with pytest.raises(RuntimeError, match="converted copy"):
        built["box"].data.default_root_state[:, 3] = 1.0
    kept = built["box"].data.default_root_state
    changed = kept.clone()
    changed[:, 3:7] = torch.tensor(UPRIGHT)
    built["box"].data.default_root_state = changed
    np.testing.assert_array_equal(numpy(built["box"].native_data.default_root_state)[:, 3:7], [(0, 0, 0, 1)] * 2)
    built["box"].data.default_root_state = kept
    same(built["box"].native_data.default_root_state[:, 3:7], xyzw(START))


@pytest.mark.parametrize("name", ["root_pose", "root_link_pose", "root_com_pose"])
@pytest.mark.parametrize("kind", ["pose", "state"])
def test_what_is_written_is_converted_once(built, name, kind):
    asset = built["box"]
    pose = np.hstack([[[0.1, 0.2, 1.0], [3.0, 0.1, 0.9]], wxyz(WRITTEN)])
    values = pose if kind == "pose" else np.hstack([pose, np.arange(12.0).reshape(2, 6)])
    getattr(asset, f"write_{name.replace('pose', kind)}_to_sim")(torch.tensor(values, dtype=torch.float32))
    same(asset.native_data.root_quat_w[:1], xyzw(WRITTEN)[:1])
    same(asset.native_data.root_quat_w[1:], xyzw(WRITTEN)[1:])
    np.testing.assert_allclose(numpy(asset.data.root_pose_w), pose, atol=1e-6)


def test_sensors_take_and_hand_out_wxyz(built):
    built["box"].write_root_pose_to_sim(torch.tensor([[0.0, 0.0, 1.0, *wxyz(START)]] * 2, dtype=torch.float32))
    built.sim.forward()
    built.reset()
    built.update(built.physics_dt)
    turned = wxyz(START * OFFSET)
    same(built["imu"].data.quat_w, turned)
    same(built["frames"].data.target_quat_w, turned)
    same(built["frames"].data.target_quat_source, wxyz(OFFSET))
    same(built["frames"].data.source_quat_w, wxyz(START))
    same(built["camera"].data.quat_w_world, turned)
    assert built["frames"].data.target_frame_names == ["Box"]


def test_a_spawner_takes_wxyz(built):
    from pxr import Gf, UsdGeom

    prim = UsdGeom.Xformable(built.stage.GetPrimAtPath("/World/floor"))
    turn = Gf.Transform(prim.GetLocalTransformation()).GetRotation().GetQuat()
    same(torch.tensor([turn.GetReal(), *turn.GetImaginary()]), wxyz(FLOOR))


def test_a_spawner_of_the_user_is_called_with_wxyz():
    given = []
    cfg = spawners.SpawnerCfg(func=lambda path, own, translation, orientation: given.append((path, orientation)))
    cfg.spawn("/World/thing", None, tuple(xyzw(START)))
    assert given[0][0] == "/World/thing"
    np.testing.assert_allclose(given[0][1], wxyz(START))


def test_states_of_a_scene_are_wxyz_and_come_back(built):
    pose = np.hstack([[[0.5, 0.2, 1.0], [2.5, 0.1, 0.9]], wxyz(WRITTEN)])
    built["box"].write_root_pose_to_sim(torch.tensor(pose, dtype=torch.float32))
    state = built.get_state()
    np.testing.assert_allclose(numpy(state["rigid_object"]["box"]["root_pose"]), pose, atol=1e-6)
    built.controller.reset_robots()  # by the package, to the default state
    same(built["box"].native_data.root_quat_w, xyzw(START))
    built.reset_to(state)
    np.testing.assert_allclose(numpy(built["box"].data.root_pose_w), pose, atol=1e-6)


def test_configs_keep_what_was_written_through_copies_and_files():
    quat = tuple(map(float, wxyz(START)))

    @configclass
    class MyCfg(assets.ArticulationCfg):
        @configclass
        class InitialStateCfg(assets.ArticulationCfg.InitialStateCfg):
            speed: float = 1.0

        init_state: InitialStateCfg = InitialStateCfg(rot=quat)

    read = MyCfg()
    read.init_state.rot = UPRIGHT
    read.from_dict(yaml.safe_load(yaml.safe_dump({"init_state": MyCfg().init_state.to_dict()})))
    for cfg in (MyCfg(), MyCfg().copy(), MyCfg().replace(prim_path="/World/x"), read):
        assert cfg.init_state.rot == quat
        np.testing.assert_allclose(cfg.init_state.rot_xyzw, xyzw(START))


@pytest.mark.parametrize(
    "cfg",
    [assets.AssetBaseCfg.InitialStateCfg, assets.RigidObjectCfg.InitialStateCfg,
     assets.ArticulationCfg.InitialStateCfg, sensors.OffsetCfg, sensors.CameraCfg.OffsetCfg,
     sensors.RayCasterCfg.OffsetCfg, sensors.ImuCfg.OffsetCfg, sensors.FrameTransformerCfg.OffsetCfg],
)  # fmt: skip
def test_the_default_is_upright_and_errors_name_the_order(cfg):
    assert cfg().rot == UPRIGHT
    assert cfg().rot_xyzw == (0.0, 0.0, 0.0, 1.0)
    with pytest.raises(ConfigError, match=r"order \(w, x, y, z\)"):
        cfg(rot=(0.0, 0.0, 0.0, 0.0)).validate()


def test_a_quaternion_of_another_length_is_scaled():
    cfg = assets.ArticulationCfg.InitialStateCfg(rot=(0.1, 0.0, 0.0, 0.1))
    cfg.validate()
    np.testing.assert_allclose(cfg.rot_xyzw, (0.0, 0.0, 0.5**0.5, 0.5**0.5))


def test_static_assets_have_their_prims(built):
    assert [prim.GetPath().pathString for prim in built["lamp"].prims] == built["lamp"].prim_paths == ["/World/lamp"]
    assert built["lamp"].prims[0].GetAttribute("inputs:intensity").Get() == 700.0
