# SPDX-License-Identifier: Apache-2.0
"""Contact sensor: weights, filters, histories and times, on planes, height fields and with several solvers."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import newton
import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.sensors.contact import ContactSensorData
from stripe_kernels.sensors.contact_mujoco import CONTACT_FIELDS, add_mujoco_contacts
from stripe_newton.assets import AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.noise import ConstantNoiseCfg, GaussianNoiseCfg, NoiseModelWithAdditiveBiasCfg
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sensors import ContactSensorCfg, SensorBase, SensorBaseCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    CuboidCfg,
    FeatherstoneSolverCfg,
    GroundPlaneCfg,
    MassPropertiesCfg,
    MuJoCoSolverCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SphereCfg,
    XPBDSolverCfg,
)
from stripe_tasks.robots import QUADRUPED_CFG
from tests.helpers.small_scenes import G, numpy, sim_cfg

DT, RADIUS, MASS = 0.005, 0.1, 2.0
GROUND = AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())
FEET = "{ENV_REGEX_NS}/Robot/.*_foot"
SOLVER = {"njmax": 120, "nconmax": 30}
TIMES = ("current_air_time", "last_air_time", "current_contact_time", "last_contact_time")


def body(name: str, shape: Any, pos: tuple[float, float, float], mass: float = MASS) -> RigidObjectCfg:
    spawn = shape.replace(
        rigid_props=RigidBodyPropertiesCfg(),
        collision_props=CollisionPropertiesCfg(),
        mass_props=MassPropertiesCfg(mass=mass),
    )
    state = RigidObjectCfg.InitialStateCfg(pos=pos)
    return RigidObjectCfg(prim_path=f"{{ENV_REGEX_NS}}/{name}", spawn=spawn, init_state=state)


def ball(height: float = RADIUS, **changes: Any) -> RigidObjectCfg:
    return body("Ball", SphereCfg(radius=RADIUS), (0.0, 0.0, height), **changes)


BALL = "{ENV_REGEX_NS}/Ball"


def build(
    sensors: dict[str, Any],
    objects: dict[str, Any] | None = None,
    num_envs: int = 2,
    solver: Any = None,
    decimation: int = 1,
    robot: bool = False,
) -> InteractiveScene:
    sim = Simulation(sim_cfg(dt=DT, solver=solver or MuJoCoSolverCfg(**SOLVER)))
    sim.decimation = decimation
    scene = InteractiveScene(InteractiveSceneCfg(num_envs=num_envs, env_spacing=3.0), sim)
    if robot:
        scene.builder.build_robot("robot", QUADRUPED_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot"))
    scene.builder.build_objects(objects or {})
    scene.builder.build_sensors(sensors)
    scene.clone_environments(copy_from_source=False)
    scene.build()
    return scene


def run(scene: InteractiveScene, steps: int) -> None:
    for _ in range(steps):
        scene.sim.step(scene.sim.decimation)
        scene.update(DT * scene.sim.decimation)


@pytest.fixture(scope="module")
def standing() -> InteractiveScene:
    """Two quadrupeds that have stood still for a while."""
    sensors = {
        "feet": ContactSensorCfg(
            prim_path=FEET, history_length=3, track_air_time=True, filter_prim_paths_expr=["/World/ground"]
        ),
        "all": ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*", track_pose=True),
    }
    solver = MuJoCoSolverCfg(**SOLVER, iterations=10, ls_iterations=20)
    scene = build(sensors, {"ground": GROUND}, robot=True, decimation=4, solver=solver)
    run(scene, 90)
    return scene


def test_feet_carry_the_weight(standing):
    data, robot = standing.sensors["feet"].data, standing["robot"].data
    weight = numpy(robot.body_mass).sum(axis=1) * G
    np.testing.assert_allclose(numpy(data.net_forces_w)[..., 2].sum(axis=1), weight, rtol=0.02)
    np.testing.assert_allclose(numpy(data.net_forces_w)[..., :2].sum(axis=1), 0.0, atol=0.02 * weight[0])
    assert (data.net_forces_w[..., 2] > 0.1 * weight[0]).all()  # each of them
    assert torch.equal(data.force_matrix_w[:, :, 0], data.net_forces_w)  # the ground is all there is
    assert data.net_forces_w_history.shape == (2, 3, 4, 3)
    np.testing.assert_allclose(numpy(data.net_forces_w_history[:, 2]), numpy(data.net_forces_w), rtol=0.02, atol=0.1)


def test_bodies_are_those_that_the_path_names(standing):
    feet, every = standing.sensors["feet"], standing.sensors["all"]
    assert feet.body_names == ["FL_foot", "FR_foot", "RL_foot", "RR_foot"]
    assert every.body_names == standing["robot"].body_names
    assert feet.num_bodies == 4
    assert feet.filter_names == ["ground"]
    assert feet.find_bodies("R._foot") == ([2, 3], ["RL_foot", "RR_foot"])
    with pytest.raises(ValueError, match="tail"):
        feet.find_bodies("tail")
    ids, _ = every.find_bodies(".*_foot")
    np.testing.assert_allclose(numpy(every.data.net_forces_w[:, ids]), numpy(feet.data.net_forces_w), atol=1e-4)
    others = [i for i in range(every.num_bodies) if i not in ids]
    assert not every.data.net_forces_w[:, others].any()
    assert torch.equal(every.data.pos_w, standing["robot"].data.body_pos_w)
    assert torch.equal(every.data.quat_w, standing["robot"].data.body_quat_w)


def test_what_was_not_asked_for_is_none(standing):
    data = standing.sensors["all"].data
    assert all(getattr(data, name) is None for name in TIMES)
    assert data.force_matrix_w is None
    assert standing.sensors["feet"].data.pos_w is None
    with pytest.raises(RuntimeError, match="track_air_time=True"):
        standing.sensors["all"].compute_first_contact(0.02)
    with pytest.raises(AttributeError, match=r"no 'forces'.*net_forces_w"):
        _ = data.forces


def landing(height: float) -> int:
    """Physics steps until the one with the first contact force: the ball lies below the ground where it begins."""
    n = 0
    while height - G * DT**2 * n * (n + 1) / 2 >= RADIUS:
        n += 1
    return n + 1


@pytest.mark.parametrize(("decimation", "substeps"), [(1, None), (4, True), (4, False)])
def test_a_fall_is_timed_to_the_physics_step(decimation, substeps):
    height = 0.403
    sensor = ContactSensorCfg(prim_path=BALL, track_air_time=True, substeps=substeps)
    scene = build({"touch": sensor}, {"ground": GROUND, "ball": ball(height)}, decimation=decimation)
    touch, first = scene.sensors["touch"], landing(height)
    tick = 1 if substeps else decimation
    if substeps is False:  # nothing but the ends of steps is seen
        first = -(-first // decimation) * decimation
    step = decimation * DT
    for count in range(-(-first // decimation)):
        run(scene, 1)
        done = (count + 1) * decimation
        air, contact = (numpy(getattr(touch.data, f"current_{n}_time")) for n in ("air", "contact"))
        if done < first:
            np.testing.assert_allclose(air, done * DT, rtol=1e-5)
            assert not contact.any()
            assert bool(touch.compute_first_air(step).all()) == (count == 0)
            assert not touch.compute_first_contact(step).any()
    assert not air.any()
    np.testing.assert_allclose(numpy(touch.data.last_air_time), first * DT, rtol=1e-5)
    np.testing.assert_allclose(contact, (done - first + tick) * DT, rtol=1e-5)
    assert touch.compute_first_contact(step).all()
    run(scene, 1)
    assert not touch.compute_first_contact(step).any()
    assert touch.compute_first_contact(2 * step).all()


def test_times_follow_from_the_forces_of_all_physics_steps():
    """A ball that bounces: what the history shows gives the same times."""
    solver = MuJoCoSolverCfg(**SOLVER)
    sensor = ContactSensorCfg(prim_path=BALL, history_length=4, track_air_time=True, force_threshold=30.0)
    scene = build({"touch": sensor}, {"ground": GROUND, "ball": ball(0.3)}, solver=solver, decimation=4)
    data = scene.sensors["touch"].data
    expected = dict.fromkeys(TIMES, np.zeros((2, 1)))
    switches = 0
    for _ in range(60):
        run(scene, 1)
        for k in (3, 2, 1, 0):  # the oldest first
            touching = np.linalg.norm(numpy(data.net_forces_w_history[:, k]), axis=-1) > 30.0
            for here, there, now in (("contact", "air", touching), ("air", "contact", ~touching)):
                began = now & (expected[f"current_{there}_time"] > 0.0)
                switches += int(began.sum())
                last = expected[f"current_{there}_time"] + DT
                expected[f"last_{there}_time"] = np.where(began, last, expected[f"last_{there}_time"])
                expected[f"current_{there}_time"] = np.where(now, 0.0, expected[f"current_{there}_time"])
                expected[f"current_{here}_time"] = expected[f"current_{here}_time"] + np.where(now, DT, 0.0)
        for name in TIMES:
            np.testing.assert_allclose(numpy(getattr(data, name)), expected[name], rtol=1e-5, atol=1e-6, err_msg=name)
    assert switches >= 4  # it left the ground again, in both environments


def test_forces_come_from_what_is_touched():
    """A ball of 2 kg on a box of 3 kg: the filters tell them apart, action is reaction."""
    stack = {
        "ground": GROUND,
        "box": body("Box", CuboidCfg(size=(0.4, 0.4, 0.2)), (0.0, 0.0, 0.1), mass=3.0),
        "ball": ball(0.2 + RADIUS),
    }
    filters = ["/World/ground", BALL]
    box = ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Box", filter_prim_paths_expr=filters)
    scene = build({"box": box, "ball": ContactSensorCfg(prim_path=BALL)}, stack)
    assert scene.sensors["box"].filter_names == ["ground", "Ball"]
    assert scene.sensors["box"].counts == {"num_filters": 2}
    run(scene, 200)
    of_ball, of_box = scene.sensors["ball"].data, scene.sensors["box"].data
    np.testing.assert_allclose(numpy(of_ball.net_forces_w)[:, 0], [[0, 0, MASS * G]] * 2, atol=0.02 * MASS * G)
    np.testing.assert_allclose(numpy(of_box.net_forces_w)[:, 0, 2], 3.0 * G, rtol=0.02)
    matrix = numpy(of_box.force_matrix_w)[:, 0]
    np.testing.assert_allclose(matrix[:, 0, 2], 5.0 * G, rtol=0.02)
    np.testing.assert_allclose(matrix[:, 1], -numpy(of_ball.net_forces_w)[:, 0], atol=1e-4)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_forces_of_the_fused_step_are_those_of_its_constraints(cone):
    """Of contacts that slide and turn; MuJoCo Warp's function computes them from the rows of the constraints."""
    stack = {
        "ground": GROUND,
        "box": body("Box", CuboidCfg(size=(0.4, 0.4, 0.2)), (0.0, 0.0, 0.1), mass=3.0),
        "ball": ball(0.2 + RADIUS),
    }
    sensor = ContactSensorCfg(
        prim_path="{ENV_REGEX_NS}/B.*", filter_prim_paths_expr=["/World/ground", BALL], history_length=2, substeps=False
    )
    scene = build({"touch": sensor}, stack, num_envs=3, solver=MuJoCoSolverCfg(**SOLVER, cone=cone), decimation=4)
    sim, touch = scene.sim, scene.sensors["touch"]
    sim.solver.fill_contacts()
    speeds = torch.tensor([[1.0, 0.3, 0.0, 0.2, 0.5, 2.0]]) * torch.arange(1, 4).unsqueeze(1)
    scene["box"].write_root_velocity_to_sim(speeds)
    for _ in range(5):
        run(scene, 1)
        expected = ContactSensorData()
        expected.net_forces_w = wp.zeros((3, 2), dtype=wp.vec3, device="cpu")
        expected.force_matrix_w = wp.zeros((3, 2, 2), dtype=wp.vec3, device="cpu")
        data, rows = sim.solver.mjw_data, [touch._clock.due, touch._rows, touch._filters, sim.solver.mjw_model.opt.cone]
        fields = [getattr(data.contact, name) for name in CONTACT_FIELDS]
        inputs = [*rows, *fields, data.efc.force, data.njmax, data.nacon]
        wp.launch(add_mujoco_contacts, data.naconmax, inputs, [expected], device="cpu")
        forces = expected.net_forces_w.numpy()
        assert np.abs(forces[:, :, :2]).max() > 1.0  # friction
        np.testing.assert_allclose(numpy(touch.data.net_forces_w), forces, atol=1e-5 * np.abs(forces).max())
        matrix = expected.force_matrix_w.numpy()
        np.testing.assert_allclose(numpy(touch.data.force_matrix_w), matrix, atol=1e-5 * np.abs(forces).max())


@pytest.mark.parametrize(
    "solver",
    [
        MuJoCoSolverCfg(**SOLVER, cone="elliptic"),
        MuJoCoSolverCfg(**SOLVER, use_mujoco_contacts=False),
        MuJoCoSolverCfg(**SOLVER, separate_worlds=False),
        XPBDSolverCfg(iterations=10),
    ],
    ids=["elliptic", "newton_contacts", "one_world", "xpbd"],
)
def test_weights_with_other_solvers(solver):
    num_envs = 1 if getattr(solver, "separate_worlds", None) is False else 2
    sensor = ContactSensorCfg(prim_path=BALL, filter_prim_paths_expr=["/World/ground"])
    scene = build({"touch": sensor}, {"ground": GROUND, "ball": ball()}, num_envs=num_envs, solver=solver)
    run(scene, 100)
    data = scene.sensors["touch"].data
    np.testing.assert_allclose(numpy(data.net_forces_w)[:, 0], [[0, 0, MASS * G]] * num_envs, atol=0.02 * MASS * G)
    assert torch.equal(data.force_matrix_w[:, :, 0], data.net_forces_w)


def test_a_solver_without_contact_forces_is_refused():
    with pytest.raises(ConfigError, match="SolverFeatherstone does not report contact forces, use MuJoCoSolverCfg"):
        build({"touch": ContactSensorCfg(prim_path=BALL)}, {"ball": ball()}, solver=FeatherstoneSolverCfg())
    with pytest.raises(ConfigError, match="the solver computes no contacts, set disable_contacts=False"):
        build(
            {"touch": ContactSensorCfg(prim_path=BALL)}, {"ball": ball()}, solver=MuJoCoSolverCfg(disable_contacts=True)
        )


class Field(SensorBase):
    """Not a sensor: puts a height field below the environments."""

    def prepare(self, sim, template, static):
        heights = np.zeros((21, 21), dtype=np.float32)
        heights[0, 0] = -0.01  # a field without any relief has no scale
        made = newton.Heightfield(data=heights, nrow=21, ncol=21, hx=5.0, hy=5.0)
        static.add_shape_heightfield(heightfield=made, label="/World/field")


@configclass
class FieldCfg(SensorBaseCfg):
    prim_path = "{ENV_REGEX_NS}/Ball"
    class_type = Field


def test_contacts_with_a_height_field_count_too():
    sensor = ContactSensorCfg(prim_path=BALL, filter_prim_paths_expr=["/World/field"])
    scene = build({"field": FieldCfg(), "touch": sensor}, {"ball": ball()})
    assert scene.sim.solver.triangles
    run(scene, 100)
    data = scene.sensors["touch"].data
    np.testing.assert_allclose(numpy(data.net_forces_w)[:, 0], [[0, 0, MASS * G]] * 2, atol=0.02 * MASS * G)
    assert torch.equal(data.force_matrix_w[:, :, 0], data.net_forces_w)


def test_a_period_skips_steps_and_a_reset_forgets():
    sensor = ContactSensorCfg(prim_path=BALL, update_period=3 * DT, history_length=2, track_air_time=True)
    scene = build({"touch": sensor}, {"ground": GROUND, "ball": ball()})
    touch = scene.sensors["touch"]
    seen = []
    for _ in range(9):
        run(scene, 1)
        seen.append(touch.data.net_forces_w[:, 0, 2].clone())
    same = [bool((a == b).all()) for a, b in pairwise(seen)]
    assert same == [True, False, True, True, False, True, True, False]
    np.testing.assert_allclose(numpy(touch.data.current_contact_time), 9 * DT, rtol=1e-5)
    assert torch.equal(touch.data.net_forces_w_history[:, 1, 0, 2], seen[5])

    with pytest.raises(ValueError, match=r"dt: is 0.005 s, but .* measures every 0.015 s"):
        touch.compute_first_contact(DT)
    assert not touch.compute_first_contact(3 * DT).any()

    touch.reset([1])
    assert not touch.data.net_forces_w_history[1].any()
    assert touch.data.net_forces_w_history[0].any()
    assert touch.data.current_contact_time[:, 0].tolist() == pytest.approx([9 * DT, 0.0])
    run(scene, 2)
    assert not touch.data.net_forces_w[1].any()  # its period began anew
    run(scene, 1)
    assert touch.data.net_forces_w[1].any()
    assert touch.data.current_contact_time[:, 0].tolist() == pytest.approx([12 * DT, 3 * DT])


def test_when_it_measures():
    cases = {
        "plain": ({}, False),
        "times": ({"track_air_time": True}, False),
        "history": ({"history_length": 3}, True),
        "period_of_physics": ({"update_period": DT}, True),
        "long_period": ({"update_period": 8 * DT, "history_length": 3}, False),
        "asked": ({"track_air_time": True, "substeps": True}, True),
        "not_asked": ({"history_length": 3, "substeps": False}, False),
    }
    sensors = {name: ContactSensorCfg(prim_path=BALL, **fields) for name, (fields, _) in cases.items()}
    scene = build(sensors, {"ground": GROUND, "ball": ball()}, decimation=4)
    assert {n: s.every_substep for n, s in scene.sensors.items()} == {n: each for n, (_, each) in cases.items()}
    run(scene, 2)
    forces = [numpy(s.data.net_forces_w) for s in scene.sensors.values()]
    assert all(np.array_equal(f, forces[0]) for f in forces)


def test_noise_and_delay_are_on_the_net_forces():
    bias = NoiseModelWithAdditiveBiasCfg(noise_cfg=GaussianNoiseCfg(std=2.0), bias_noise_cfg=ConstantNoiseCfg(bias=5.0))
    plain = {"prim_path": BALL, "history_length": 3, "track_air_time": True}
    sensors = {
        "true": ContactSensorCfg(**plain),
        "late": ContactSensorCfg(**plain, delay=2),
        "noisy": ContactSensorCfg(**plain, noise=bias),
    }
    scene = build(sensors, {"ground": GROUND, "ball": ball(0.15)})
    true, late, noisy = (s.data for s in scene.sensors.values())
    past, errors = [], []
    for count in range(100):
        run(scene, 1)
        past.append(true.net_forces_w.clone())
        for k in range(3):
            expected = past[max(count - 2 - k, 0)] if count >= k else torch.zeros(2, 1, 3)
            assert torch.equal(late.net_forces_w_history[:, k], expected)
        errors.append(numpy(noisy.net_forces_w - true.net_forces_w))
        if count:
            np.testing.assert_allclose(numpy(noisy.net_forces_w_history[:, 1] - past[-2]), errors[-2], atol=1e-4)
        assert all(torch.equal(getattr(data, name), getattr(true, name)) for data in (late, noisy) for name in TIMES)
    assert true.current_contact_time.all()
    assert np.mean(errors) == pytest.approx(5.0, abs=0.3)
    assert np.std(errors) == pytest.approx(2.0, rel=0.15)
    scene.sensors["late"].reset([1])
    run(scene, 1)
    assert torch.equal(late.net_forces_w[1], true.net_forces_w[1])
    assert torch.equal(late.net_forces_w[0], past[-2][0])


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"prim_path": "{ENV_REGEX_NS}/Bell"}, r"no body at '.*Bell'; below '.*' there is Ball"),
        ({"filter_prim_paths_expr": ["/World/sea"]}, "no collider at '/World/sea'; there is"),
        ({"filter_prim_paths_expr": ["/World/ground", "/World/gro.*"]}, "name each once"),
        ({"filter_prim_paths_expr": "/World/ground"}, "must be a sequence of texts"),
        ({"force_threshold": -1.0}, "force_threshold: is -1.0, must be a number of at least 0"),
        ({"update_period": 2.5 * DT}, "must be a multiple of the step of 0.005 s, such as 0.01"),
        ({"history_length": -1}, "history_length: is -1"),
    ],
)
def test_a_wrong_config_is_named(fields, message):
    with pytest.raises(ConfigError, match=message):
        build({"touch": ContactSensorCfg(**({"prim_path": BALL} | fields))}, {"ground": GROUND, "ball": ball()})
