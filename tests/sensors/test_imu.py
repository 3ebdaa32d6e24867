# SPDX-License-Identifier: Apache-2.0
"""IMU: against finite differences of poses and Newton's own sensor; noise and delay."""

from __future__ import annotations

from typing import Any

import newton
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import ConfigError
from stripe_newton.noise import (
    ConstantNoiseCfg,
    GaussianNoiseCfg,
    NoiseModelWithAdditiveBiasCfg,
    UniformNoiseCfg,
)
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sensors import ImuCfg, OffsetCfg
from stripe_newton.sim import Simulation
from tests.helpers.small_scenes import ARM, DT, LOPSIDED, G, mjcf_robot, numpy, sim_cfg

BLOCK, HAND = "{ENV_REGEX_NS}/Robot/block", "{ENV_REGEX_NS}/Robot/hand"
MOUNT = OffsetCfg(pos=(0.3, -0.1, 0.2), rot=(0.5, -0.5, 0.1, 0.7))
SPIN = torch.tensor([0.4, -0.3, 2.0, 3.0, -2.0, 4.0])
STATE = ArticulationCfg.InitialStateCfg(pos=(0.0, 0.0, 1.0))


def build(
    robot: ArticulationCfg, sensors: dict[str, ImuCfg], num_envs: int = 2, decimation: int = 1, **sim: Any
) -> InteractiveScene:
    made = Simulation(sim_cfg(**sim))
    made.decimation = decimation
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=num_envs, env_spacing=3.0), made)
    scene.builder.build_robot("robot", robot)
    scene.builder.build_sensors(sensors)
    scene.clone_environments(copy_from_source=False)
    scene.build()
    return scene


def thrown(tmp_path: Any, sensors: dict[str, ImuCfg], **options: Any) -> InteractiveScene:
    """A block that tumbles: its centre of mass is off its origin, the IMU off both."""
    scene = build(mjcf_robot(tmp_path, LOPSIDED, fix_base=False, init_state=STATE), sensors, **options)
    robot = scene["robot"]
    robot.write_root_velocity_to_sim(SPIN.repeat(scene.num_envs, 1))
    return scene


def step(scene: InteractiveScene, count: int = 1) -> None:
    for _ in range(count):
        scene.sim.step(scene.sim.decimation)
        scene.update(DT * scene.sim.decimation)


def mount_of(scene: InteractiveScene) -> tuple[np.ndarray, Rotation]:
    """Position and orientation of the mount, from the pose of the block."""
    data = scene["robot"].data
    turn = Rotation.from_quat(numpy(data.root_quat_w))
    rot = np.array(MOUNT.rot) / np.linalg.norm(MOUNT.rot)
    return numpy(data.root_pos_w) + turn.apply(MOUNT.pos), turn * Rotation.from_quat(rot)


def test_it_measures_what_the_poses_say(tmp_path):
    scene = thrown(tmp_path, {"imu": ImuCfg(prim_path=BLOCK, offset=MOUNT)}, dt=DT)
    data = scene.sensors["imu"].data
    step(scene, 20)
    poses, seen = [], []
    for _ in range(3):
        step(scene)
        poses.append(mount_of(scene))
        seen.append({n: numpy(getattr(data, n)).copy() for n in data.warp._cls.vars})
    (p0, _), (p1, q1), (p2, q2) = poses
    np.testing.assert_allclose(seen[1]["pos_w"], p1, atol=1e-5)
    assert ((Rotation.from_quat(seen[1]["quat_w"]) * q1.inv()).magnitude() < 1e-5).all()
    inverse = q1.inv()
    np.testing.assert_allclose(seen[1]["lin_vel_b"], inverse.apply((p2 - p0) / (2 * DT)), atol=0.02)
    rate = (q2 * q1.inv()).as_rotvec() / DT
    np.testing.assert_allclose(seen[2]["ang_vel_b"], q2.inv().apply(rate), atol=0.05)
    acceleration = (p2 - 2 * p1 + p0) / DT**2 + [0.0, 0.0, G]
    assert np.linalg.norm(acceleration, axis=1).min() > 5.0  # it swings around
    np.testing.assert_allclose(seen[2]["lin_acc_b"], q2.inv().apply(acceleration), atol=0.7)
    spun = [q.apply(s["ang_vel_b"]) for (_, q), s in zip(poses, seen, strict=True)]
    alpha = (spun[2] - spun[1]) / DT
    np.testing.assert_allclose(q2.apply(seen[2]["ang_acc_b"]), alpha, atol=5e-3)
    down = np.array([0.0, 0.0, -1.0])
    np.testing.assert_allclose(seen[1]["projected_gravity_b"], inverse.apply(down), atol=1e-5)


def test_errors_shrink_with_the_time_step(tmp_path):
    """Accelerations are differences over a physics step: at half the step they are half as far off."""
    errors = []
    for dt in (0.004, 0.002, 0.001):
        scene = thrown(tmp_path, {"imu": ImuCfg(prim_path=BLOCK, offset=MOUNT)}, num_envs=1, dt=dt)
        for _ in range(round(0.04 / dt)):
            scene.sim.step(1)
            scene.update(dt)
        model, data = scene.sim.model, scene.sensors["imu"].data
        com, inertia = model.body_com.numpy()[0], model.body_inertia.numpy()[0].astype(float)
        turn = Rotation.from_quat(numpy(scene["robot"].data.root_quat_w)[0])
        spin = turn.inv().apply(numpy(scene.sim.per_env(scene.sim.state.body_qd))[0, 0, 3:])
        alpha = np.linalg.solve(inertia, -np.cross(spin, inertia @ spin))  # Euler, no torque
        arm = np.array(MOUNT.pos) - com
        exact = np.cross(alpha, arm) + np.cross(spin, np.cross(spin, arm))
        rot = Rotation.from_quat(np.array(MOUNT.rot) / np.linalg.norm(MOUNT.rot))
        errors.append(np.linalg.norm(numpy(data.lin_acc_b)[0] - rot.inv().apply(exact)))
    assert errors[0] < 0.3
    assert errors[2] < 0.6 * errors[1] < 0.36 * errors[0] + 0.02


def test_an_accelerometer_at_rest_reads_the_reaction_to_gravity(tmp_path):
    sensors = {"felt": ImuCfg(prim_path=BLOCK, offset=MOUNT), "moved": ImuCfg(prim_path=BLOCK, gravity_bias=(0, 0, 0))}
    scene = build(mjcf_robot(tmp_path, LOPSIDED, init_state=STATE), sensors)  # fixed in the world
    step(scene, 5)
    felt, moved = scene.sensors["felt"].data, scene.sensors["moved"].data
    expected = mount_of(scene)[1].inv().apply([0.0, 0.0, G])
    np.testing.assert_allclose(numpy(felt.lin_acc_b), expected, atol=1e-4)
    np.testing.assert_allclose(numpy(felt.projected_gravity_b), -expected / G, atol=1e-5)
    assert not moved.lin_acc_b.abs().max() > 1e-5
    assert not felt.ang_vel_b.abs().max() > 1e-6


def test_it_agrees_with_newtons_sensor(tmp_path):
    """On the hand of an arm that falls; Newton's reads the accelerations of the solver at the start of the step."""
    sensors = {"imu": ImuCfg(prim_path=HAND, offset=OffsetCfg(pos=(0.05, 0.0, -0.1)))}
    scene = build(mjcf_robot(tmp_path, ARM), sensors, num_envs=1, observables=("body_qdd",))
    sim, imu = scene.sim, scene.sensors["imu"]
    body = next(i for i, label in enumerate(sim.model.body_label) if label.endswith("hand"))
    step(scene, 100)
    assert imu.data.ang_vel_b.abs().max() > 0.3
    model = newton.ModelBuilder()
    link = model.add_link(mass=1.0, inertia=np.eye(3).tolist())
    site = model.add_site(link, xform=[0.05, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0], label="imu")
    joint = model.add_joint_free(child=link)
    model.add_articulation([joint])
    other = model.finalize(device="cpu")
    own = newton.sensors.SensorIMU(other, sites=[site], request_state_attributes=False)
    state = other.state()
    state.body_q.assign(sim.state.body_q.numpy()[body : body + 1])
    state.body_qd.assign(sim.state.body_qd.numpy()[body : body + 1])
    other.body_com.assign(sim.model.body_com.numpy()[body : body + 1])
    solver = newton.solvers.SolverMuJoCo(other)
    seen = solver.observables(kinds=own.solver_observable_kinds)
    seen.body_qdd.assign(sim.observables.body_qdd.numpy()[body : body + 1])
    own.update(state, observables=seen)
    np.testing.assert_allclose(numpy(imu.data.ang_vel_b), own.gyroscope.numpy(), atol=1e-5)
    np.testing.assert_allclose(numpy(imu.data.lin_acc_b), own.accelerometer.numpy(), atol=0.15)


def test_without_substeps_accelerations_are_means_over_the_step(tmp_path):
    sensors = {"each": ImuCfg(prim_path=BLOCK), "mean": ImuCfg(prim_path=BLOCK, substeps=False)}
    scene = thrown(tmp_path, sensors, decimation=4)
    assert scene.sensors["each"].every_substep
    assert not scene.sensors["mean"].every_substep
    step(scene, 3)
    vel = numpy(scene.sim.per_env(scene.sim.state.body_qd))[:, 0, 3:]
    step(scene)
    after = numpy(scene.sim.per_env(scene.sim.state.body_qd))[:, 0, 3:]
    turn = Rotation.from_quat(numpy(scene["robot"].data.root_quat_w))
    mean, each = scene.sensors["mean"].data, scene.sensors["each"].data
    np.testing.assert_allclose(numpy(mean.ang_acc_b), turn.inv().apply((after - vel) / (4 * DT)), atol=5e-3)
    assert not np.allclose(numpy(each.ang_acc_b), numpy(mean.ang_acc_b), atol=5e-3)


def test_noise_bias_and_delay(tmp_path):
    bias = NoiseModelWithAdditiveBiasCfg(
        noise_cfg=ConstantNoiseCfg(bias=0.5), bias_noise_cfg=UniformNoiseCfg(n_min=-2.0, n_max=2.0)
    )
    sensors = {
        "true": ImuCfg(prim_path=BLOCK),
        "late": ImuCfg(prim_path=BLOCK, delay=2),
        "noisy": ImuCfg(prim_path=BLOCK, noise={"ang_vel_b": GaussianNoiseCfg(std=0.2), "lin_acc_b": bias}),
    }
    scene = thrown(tmp_path, sensors, num_envs=4)
    true, late, noisy = (scene.sensors[n].data for n in sensors)
    history: list[dict[str, torch.Tensor]] = []
    spins, offsets = [], []
    for count in range(60):
        step(scene)
        history.append({n: getattr(true, n).clone() for n in ("pos_w", "quat_w", "lin_acc_b")})
        then = history[max(count - 2, 0)]  # the first stands for those before it
        assert all(torch.equal(getattr(late, n), then[n]) for n in then)
        spins.append(numpy(noisy.ang_vel_b - true.ang_vel_b))
        offsets.append(numpy(noisy.lin_acc_b - true.lin_acc_b))
        assert torch.equal(noisy.pos_w, true.pos_w)
    assert np.std(spins) == pytest.approx(0.2, rel=0.1)
    assert abs(np.mean(spins)) < 0.03
    assert len(np.unique(np.array(spins))) > 700  # drawn anew for each number
    np.testing.assert_allclose(offsets, np.broadcast_to(offsets[0], np.shape(offsets)), atol=1e-4)
    assert np.unique(np.round(offsets[0], 4)).size == 12  # a bias for each environment and component
    assert np.abs(offsets[0] - 0.5).max() < 2.0

    scene.sensors["noisy"].reset([1])
    scene.sensors["late"].reset([1])
    step(scene)
    now = numpy(noisy.lin_acc_b - true.lin_acc_b)
    np.testing.assert_allclose(np.delete(now, 1, axis=0), np.delete(offsets[0], 1, axis=0), atol=1e-4)
    assert np.abs(now[1] - offsets[0][1]).min() > 1e-3  # a new bias
    assert torch.equal(late.pos_w[1], true.pos_w[1])  # what was before is forgotten
    assert torch.equal(late.pos_w[0], history[-2]["pos_w"][0])


def test_operations_and_a_bias_that_components_share(tmp_path):
    shared = NoiseModelWithAdditiveBiasCfg(
        noise_cfg=ConstantNoiseCfg(bias=0.0),
        bias_noise_cfg=UniformNoiseCfg(n_min=1.0, n_max=2.0),
        sample_bias_per_component=False,
    )
    noise = {
        "ang_vel_b": ConstantNoiseCfg(bias=2.0, operation="scale"),
        "lin_acc_b": UniformNoiseCfg(n_min=(0.0, 1.0, 2.0), n_max=(1.0, 2.0, 3.0), operation="abs"),
        "pos_w": shared,
    }
    scene = thrown(tmp_path, {"true": ImuCfg(prim_path=BLOCK), "noisy": ImuCfg(prim_path=BLOCK, noise=noise)})
    step(scene, 3)
    true, noisy = (scene.sensors[n].data for n in ("true", "noisy"))
    assert torch.equal(noisy.ang_vel_b, 2.0 * true.ang_vel_b)
    assert torch.equal(noisy.lin_acc_b.floor(), torch.tensor([[0.0, 1.0, 2.0]] * 2))
    bias = numpy(noisy.pos_w - true.pos_w)
    np.testing.assert_allclose(bias, bias[:, :1].repeat(3, axis=1), atol=1e-5)
    assert bias.min() > 1.0 > bias.max() - 1.0
    assert abs(bias[0, 0] - bias[1, 0]) > 1e-3


def test_noise_does_not_depend_on_the_number_of_environments(tmp_path):
    seen = []
    for num_envs in (2, 5):
        sensor = ImuCfg(prim_path=BLOCK, noise={"ang_vel_b": GaussianNoiseCfg(std=0.2)})
        scene = thrown(tmp_path, {"imu": sensor}, num_envs=num_envs)
        step(scene, 3)
        seen.append(numpy(scene.sensors["imu"].data.ang_vel_b)[:2])
    np.testing.assert_array_equal(*seen)


def test_a_period_skips_steps_and_a_reset_measures_at_once(tmp_path):
    scene = thrown(tmp_path, {"imu": ImuCfg(prim_path=BLOCK, update_period=3 * DT)})
    imu, robot = scene.sensors["imu"], scene["robot"]
    seen = []
    for _ in range(7):
        step(scene)
        seen.append((imu.data.pos_w.clone(), robot.data.root_pos_w.clone()))
    fresh = [bool(torch.allclose(a, b, atol=1e-6)) for a, b in seen]
    assert fresh == [False, False, True, False, False, True, False]
    imu.reset([1])
    imu.launch_observed()  # before the observations of the new episode
    assert torch.equal(imu.data.pos_w[0], seen[5][0][0])
    assert torch.allclose(imu.data.pos_w[1], robot.data.root_pos_w[1])
    assert imu.data.ang_acc_b[1].abs().max() == 0.0  # there was no step before


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"prim_path": "{ENV_REGEX_NS}/Robot/nose"}, r"no body or site at '.*nose'; below '.*' there is .*hand"),
        ({"prim_path": "{ENV_REGEX_NS}/Robot/(upper|lower)"}, "upper, lower match, it must name one"),
        ({"noise": {"quat_w": GaussianNoiseCfg()}}, "noise: has 'quat_w', must be of pos_w"),
        ({"noise": {"ang_vel_b": GaussianNoiseCfg(std=(0.1, 0.2))}}, "noise.std: has 2 numbers, must have 1 or 3"),
        ({"delay": -1}, "delay: is -1, must be a whole number of at least 0"),
        ({"history_length": 2}, "history_length: is not kept by an IMU"),
        ({"offset": OffsetCfg(rot=(0.0, 0.0, 0.0, 2.0))}, "must be a unit quaternion"),
        ({"update_period": 0.5 * DT, "prim_path": "{ENV_REGEX_NS}/Robot/.*"}, "match, it must name one"),
    ],
)
def test_a_wrong_config_is_named(tmp_path, fields, message):
    with pytest.raises(ConfigError, match=message):
        build(mjcf_robot(tmp_path, ARM), {"imu": ImuCfg(**({"prim_path": HAND} | fields))}, num_envs=1)
