# SPDX-License-Identifier: Apache-2.0
"""Frame transformer: poses against those of the bodies, in scripts and in an environment's graph."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_kernels.sensors.frame import FrameTransformerData
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.managers import ObservationGroupCfg, ObservationTermCfg, SceneEntityCfg
from stripe_newton.noise import GaussianNoiseCfg
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sensors import FrameCfg, FrameTransformerCfg, OffsetCfg
from stripe_newton.sim import Simulation
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg
from stripe_tasks.robots import QUADRUPED_CFG
from tests.helpers.small_scenes import DT, numpy, sim_cfg

ROBOT = "{ENV_REGEX_NS}/Robot"
AHEAD = OffsetCfg(pos=(0.3, 0.0, 0.05), rot=(0.0, 0.0, 0.6, 0.8))
TIP = OffsetCfg(pos=(0.0, 0.01, -0.02), rot=(0.5, 0.5, -0.5, 0.5))
FIELDS = ("source_pos_w", "source_quat_w", "target_pos_w", "target_quat_w", "target_pos_source", "target_quat_source")


def frames(**fields: Any) -> FrameTransformerCfg:
    targets = [
        FrameCfg(prim_path=f"{ROBOT}/.*_foot", offset=TIP),
        FrameCfg(prim_path=f"{ROBOT}/base/imu", name="head"),
        FrameCfg(prim_path=f"{ROBOT}/base"),
    ]
    given = {"prim_path": f"{ROBOT}/base", "target_frames": targets, "source_frame_offset": AHEAD} | fields
    return FrameTransformerCfg(**given)


def build(sensors: dict[str, FrameTransformerCfg], num_envs: int = 2) -> InteractiveScene:
    """Quadrupeds that fall and turn."""
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=num_envs, env_spacing=3.0), Simulation(sim_cfg()))
    scene.builder.build_robot("robot", QUADRUPED_CFG.replace(prim_path=ROBOT))
    scene.builder.build_sensors(sensors)
    scene.clone_environments(copy_from_source=False)
    scene.build()
    speed = torch.tensor([[0.5, 0.0, 1.0, 2.0, -1.0, 3.0]]) * torch.linspace(0.5, 1.0, num_envs)[:, None]
    scene["robot"].write_root_velocity_to_sim(speed)
    return scene


def step(scene: InteractiveScene, count: int = 1) -> None:
    for _ in range(count):
        scene.sim.step(1)
        scene.update(DT)


def at(pos: np.ndarray, quat: np.ndarray, offset: OffsetCfg) -> tuple[np.ndarray, Rotation]:
    turn = Rotation.from_quat(quat)
    return pos + turn.apply(offset.pos), turn * Rotation.from_quat(offset.rot)


def same(quat: Any, expected: Rotation) -> bool:
    return bool(((Rotation.from_quat(numpy(quat)) * expected.inv()).magnitude() < 1e-4).all())


def test_poses_are_those_of_the_bodies():
    scene = build({"frames": frames()})
    step(scene, 40)
    sensor, robot = scene.sensors["frames"], scene["robot"]
    data, names = sensor.data, [f"{leg}_foot" for leg in ("FL", "FR", "RL", "RR")]
    assert data.target_frame_names == sensor.body_names == [*names, "head", "base"]
    assert sensor.counts == {"num_frames": 6}
    assert [tuple(getattr(data, n).shape) for n in FIELDS] == [
        (2, 3),
        (2, 4),
        (2, 6, 3),
        (2, 6, 4),
        (2, 6, 3),
        (2, 6, 4),
    ]
    root = numpy(robot.data.root_pos_w), numpy(robot.data.root_quat_w)
    origin, turn = at(*root, AHEAD)
    assert turn.magnitude().max() > 0.2
    np.testing.assert_allclose(numpy(data.source_pos_w), origin, atol=1e-5)
    assert same(data.source_quat_w, turn)
    site = OffsetCfg(pos=(-0.02557, 0.0, 0.04232))  # where the robot's stage has it
    expected = [at(*root, site), at(*root, OffsetCfg())]
    for index, name in enumerate(names):
        body = robot.find_bodies(name)[0][0]
        pose = numpy(robot.data.body_pos_w[:, body]), numpy(robot.data.body_quat_w[:, body])
        expected.insert(index, at(*pose, TIP))
    for index, (pos, rot) in enumerate(expected):
        np.testing.assert_allclose(numpy(data.target_pos_w[:, index]), pos, atol=1e-5)
        assert same(data.target_quat_w[:, index], rot)
        np.testing.assert_allclose(numpy(data.target_pos_source[:, index]), turn.inv().apply(pos - origin), atol=1e-5)
        assert same(data.target_quat_source[:, index], turn.inv() * rot)


def test_period_delay_and_noise():
    noise = {"target_pos_source": GaussianNoiseCfg(std=0.05)}
    scene = build({"true": frames(), "slow": frames(update_period=3 * DT), "late": frames(delay=2, noise=noise)})
    true, slow, late = (scene.sensors[n].data for n in ("true", "slow", "late"))
    past: list[dict[str, torch.Tensor]] = []
    fresh, errors = [], []
    for count in range(30):
        step(scene)
        past.append({n: getattr(true, n).clone() for n in FIELDS})
        fresh.append(bool(torch.equal(slow.target_pos_w, true.target_pos_w)))
        then = past[max(count - 2, 0)]
        for name in FIELDS:
            if name != "target_pos_source":
                assert torch.equal(getattr(late, name), then[name]), name
        errors.append(numpy(late.target_pos_source - then["target_pos_source"]))
    assert fresh == [False, False, True] * 10
    assert np.std(errors[2:]) == pytest.approx(0.05, rel=0.1)
    for name in ("slow", "late"):
        scene.sensors[name].reset([1])
        scene.sensors[name].launch_observed()  # before the observations of the new episode
    assert torch.equal(late.target_pos_w[1], true.target_pos_w[1])
    assert torch.equal(late.target_pos_w[0], past[-3]["target_pos_w"][0])
    step(scene)
    assert not torch.equal(slow.target_pos_w[1], true.target_pos_w[1])


@wp.func
def tip_height(env: int, sensor: FrameTransformerData, body_ids: wp.array[int], out: wp.array[float]):
    for i in range(body_ids.shape[0]):
        out[i] = sensor.target_pos_w[env, body_ids[i]][2]


def test_terms_read_frames_of_this_step_and_of_the_new_episode():
    cfg = CartpoleManagerEnvCfg(seed=1)
    cfg.sim.device, cfg.scene.num_envs = "cpu", 3
    targets = [
        FrameCfg(prim_path=f"{ROBOT}/pole", name="tip", offset=OffsetCfg(pos=(0.0, 0.0, 0.5))),
        FrameCfg(prim_path=f"{ROBOT}/cart"),
    ]

    @configclass
    class Scene(type(cfg.scene)):
        tip = FrameTransformerCfg(prim_path=f"{ROBOT}/cart", target_frames=targets)

    cfg.scene = Scene(**{k: getattr(cfg.scene, k) for k in cfg.scene.__dataclass_fields__})
    params = {"sensor_cfg": SceneEntityCfg("tip", body_names="tip")}
    term = ObservationTermCfg(func=tip_height, params=params, size=1)
    cfg.observations = {"policy": configclass(type("Group", (ObservationGroupCfg,), {"tip": term}))()}
    env = ManagerBasedRLEnv(cfg)
    env.reset(seed=0)
    data = env.scene.sensors["tip"].data
    for count in range(4):
        if count == 2:
            env.scene["robot"].data.joint_pos[1, 0] = 100.0  # off the track: its episode ends
        obs, _, terminated, _, _ = env.step(torch.ones(3, 1))
        assert terminated.tolist() == [False, count == 2, False]
        poses = env.scene["robot"].data
        pole = env.scene["robot"].find_bodies("pole")[0][0]
        turn = Rotation.from_quat(numpy(poses.body_quat_w[:, pole]))
        height = numpy(poses.body_pos_w[:, pole, 2]) + turn.apply([0.0, 0.0, 0.5])[:, 2]
        np.testing.assert_allclose(numpy(obs["policy"])[:, 0], height, atol=1e-5)
        assert data.target_pos_source[:, 1].abs().max() < 1e-5  # the cart, seen from itself
    env.close()


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"prim_path": f"{ROBOT}/.*_calf"}, "FL_calf, FR_calf, RL_calf, RR_calf match, it must name one source frame"),
        ({"prim_path": f"{ROBOT}/tail"}, "no body or site at '.*tail'; below '.*' there is base"),
        ({"target_frames": []}, "target_frames: is empty"),
        (
            {"target_frames": [FrameCfg(prim_path=f"{ROBOT}/.*_foot", name="foot")]},
            r"target_frames\[0\].name: is 'foot'",
        ),
        ({"target_frames": [FrameCfg(prim_path=f"{ROBOT}/base")] * 2}, "base is there twice, give each its name"),
        ({"noise": {"target_quat_w": GaussianNoiseCfg()}}, "noise: has 'target_quat_w', must be of source_pos_w"),
        ({"delay": 0.5}, "delay: is 0.5, must be a whole number of at least 0"),
        ({"history_length": 1}, "history_length: is not kept by a frame transformer"),
    ],
)
def test_a_wrong_config_is_named(fields, message):
    with pytest.raises(ConfigError, match=message):
        build({"frames": frames(**fields)}, num_envs=1)
