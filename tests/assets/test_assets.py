# SPDX-License-Identifier: Apache-2.0
"""Articulations and rigid objects: data and writes, against closed-form physics and finite differences."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg, RigidObjectCfg
from stripe_newton.configclass import ConfigError
from stripe_newton.sim import (
    CuboidCfg,
    MassPropertiesCfg,
    MjcfFileCfg,
    RigidBodyPropertiesCfg,
)
from tests.helpers.small_scenes import ARM, COM, DT, INERTIA, LOPSIDED, G, make_scene, mjcf_robot, numpy, sim_cfg

PASSIVE = {"all": ImplicitActuatorCfg(joint_names_expr=[".*"], stiffness=0.0, damping=0.0)}
QUAT = np.array([0.2, -0.4, 0.1, 0.88]) / np.linalg.norm([0.2, -0.4, 0.1, 0.88])
TWIST = np.array([0.3, -0.5, 0.8, 1.5, -2.0, 1.0])
"""Velocity of the centre of mass and angular velocity, world frame."""


@pytest.fixture(scope="module")
def lopsided(tmp_path_factory):
    robot = mjcf_robot(tmp_path_factory.mktemp("lopsided"), LOPSIDED, fix_base=None)
    return make_scene({"robot": robot}, num_envs=3, sim=sim_cfg(gravity=(0.0, 0.0, 0.0)))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """Three joints on a fixed base, in three environments."""
    state = ArticulationCfg.InitialStateCfg(
        pos=(0.1, 0.2, 1.0), joint_pos={"shoulder": 0.2, "elbow": -0.3, "grip": 0.1}
    )
    robot = mjcf_robot(
        tmp_path_factory.mktemp("arm"), ARM, init_state=state, actuators=PASSIVE, soft_joint_pos_limit_factor=0.5
    )
    return make_scene({"robot": robot}, num_envs=3)


@pytest.fixture(scope="module")
def floating_arm(tmp_path_factory):
    robot = mjcf_robot(tmp_path_factory.mktemp("floating"), ARM, fix_base=False, actuators=PASSIVE)
    return make_scene({"robot": robot}, num_envs=3)


def write(asset, pos=(0.0, 0.0, 2.0), quat=QUAT, twist=TWIST) -> None:
    """The same state in every environment, relative to its origin."""
    state = torch.tensor(np.concatenate((pos, quat, twist)), dtype=torch.float32).repeat(asset.num_instances, 1)
    state[:, :3] += torch.from_numpy(asset._sim.env_origins)
    asset.write_root_state_to_sim(state)
    asset._sim.forward()


# -- velocities and frames of a body whose centre of mass is off its origin


def test_velocities_are_derivatives_of_positions(lopsided):
    """root_lin_vel_w moves the centre of mass, root_link_lin_vel_w the origin, root_ang_vel_w the orientation."""
    asset, sim = lopsided.articulations["robot"], lopsided.sim
    write(asset)
    data = asset.data
    np.testing.assert_allclose(numpy(data.root_com_offset_b), [COM] * 3, atol=1e-6)
    for _ in range(5):
        before = {
            k: numpy(getattr(data, k)) for k in ("root_com_pos_w", "root_pos_w", "root_quat_w", "root_link_lin_vel_w")
        }
        sim.step(1)
        after = {k: numpy(getattr(data, k)) for k in before}
        moved_com = (after["root_com_pos_w"] - before["root_com_pos_w"]) / DT
        np.testing.assert_allclose(moved_com, numpy(data.root_lin_vel_w), atol=2e-3)
        moved = (after["root_pos_w"] - before["root_pos_w"]) / DT
        middle = 0.5 * (before["root_link_lin_vel_w"] + after["root_link_lin_vel_w"])
        np.testing.assert_allclose(moved, middle, atol=4e-3)
        turned = (
            Rotation.from_quat(after["root_quat_w"]) * Rotation.from_quat(before["root_quat_w"]).inv()
        ).as_rotvec()
        np.testing.assert_allclose(turned / DT, numpy(data.root_ang_vel_w), atol=1e-2)
    apart = numpy(data.root_lin_vel_w - data.root_link_lin_vel_w)
    assert np.abs(apart).max() > 0.3  # the two points do move differently


def test_momentum_is_conserved_in_free_flight(lopsided):
    asset, sim = lopsided.articulations["robot"], lopsided.sim
    write(asset)

    def momenta() -> np.ndarray:
        data = asset.data
        rotation = Rotation.from_quat(numpy(data.root_quat_w)).as_matrix()
        inertia = rotation @ np.diag(INERTIA) @ rotation.transpose(0, 2, 1)
        spin = np.einsum("eij,ej->ei", inertia, numpy(data.root_ang_vel_w))
        return np.concatenate((numpy(data.root_lin_vel_w), spin), axis=1)

    before = momenta()
    sim.step(100)
    np.testing.assert_allclose(momenta()[:, :3], before[:, :3], atol=1e-3)
    np.testing.assert_allclose(momenta()[:, 3:], before[:, 3:], rtol=0.02, atol=2e-3)


def test_what_is_written_is_read(lopsided):
    asset = lopsided.articulations["robot"]
    write(asset)
    data = asset.data
    np.testing.assert_allclose(numpy(data.root_vel_w), [TWIST] * 3, atol=1e-6)
    np.testing.assert_allclose(numpy(data.root_quat_w), [QUAT] * 3, atol=1e-6)
    np.testing.assert_allclose(numpy(data.root_state_w), numpy(torch.cat((data.root_pose_w, data.root_vel_w), -1)))
    np.testing.assert_allclose(numpy(data.body_state_w[:, 0]), numpy(data.root_state_w), atol=1e-5)
    np.testing.assert_allclose(numpy(data.body_link_lin_vel_w[:, 0]), numpy(data.root_link_lin_vel_w), atol=1e-5)
    asset.write_root_link_velocity_to_sim(torch.tensor(TWIST, dtype=torch.float32).repeat(3, 1))
    np.testing.assert_allclose(numpy(data.root_link_lin_vel_w), [TWIST[:3]] * 3, atol=1e-5)
    offset = Rotation.from_quat(QUAT).apply(COM)
    np.testing.assert_allclose(numpy(data.root_lin_vel_w), [TWIST[:3] + np.cross(TWIST[3:], offset)] * 3, atol=1e-5)


def test_body_frame_quantities(lopsided):
    asset = lopsided.articulations["robot"]
    write(asset)
    data, inverse = asset.data, Rotation.from_quat(QUAT).inv()
    link = TWIST[:3] - np.cross(TWIST[3:], Rotation.from_quat(QUAT).apply(COM))
    for name, vector in (
        ("root_lin_vel_b", TWIST[:3]),
        ("root_ang_vel_b", TWIST[3:]),
        ("root_link_lin_vel_b", link),
        ("projected_gravity_b", (0.0, 0.0, -1.0)),
    ):
        np.testing.assert_allclose(numpy(getattr(data, name)), [inverse.apply(vector)] * 3, atol=1e-5, err_msg=name)
    forward = Rotation.from_quat(QUAT).apply((1.0, 0.0, 0.0))
    np.testing.assert_allclose(numpy(data.heading_w), [np.arctan2(forward[1], forward[0])] * 3, atol=1e-5)


@pytest.mark.parametrize("is_global", [True, False])
def test_external_force_at_a_point(lopsided, is_global):
    """Acceleration of the centre of mass and angular acceleration by Newton and Euler."""
    asset, sim = lopsided.articulations["robot"], lopsided.sim
    write(asset, twist=np.zeros(6))
    force, torque, point = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.05, -0.2]), np.array([0.2, 0.1, -0.3])
    tensors = [torch.tensor(x, dtype=torch.float32).repeat(2, 1, 1) for x in (force, torque, point)]
    asset.set_external_force_and_torque(tensors[0], tensors[1], tensors[2], env_ids=[0, 2], is_global=is_global)
    sim.step(1)
    rotation = Rotation.from_quat(QUAT)
    world_force = force if is_global else rotation.apply(force)
    wrench = torque + np.cross(point, force)
    body_torque = rotation.inv().apply(wrench) if is_global else wrench
    spin = rotation.apply(body_torque / np.array(INERTIA))
    expected = np.concatenate((world_force / 1.5, spin)) * DT
    velocity = numpy(asset.data.root_vel_w)
    np.testing.assert_allclose(velocity[[0, 2]], [expected] * 2, atol=2e-5)
    np.testing.assert_allclose(velocity[1], 0.0, atol=1e-7)
    asset.reset([0])
    sim.step(1)
    gained = numpy(asset.data.root_lin_vel_w) - velocity[:, :3]
    np.testing.assert_allclose(gained[0], 0.0, atol=1e-5)
    assert np.linalg.norm(gained[2]) == pytest.approx(np.linalg.norm(force) / 1.5 * DT, rel=1e-2)
    asset.reset()


# -- an articulation on a fixed base


def test_surface_of_an_articulation(arm):
    robot = arm.articulations["robot"]
    assert (robot.num_instances, robot.num_joints, robot.num_bodies, robot.is_fixed_base) == (3, 3, 4, True)
    assert robot.joint_names == robot.data.joint_names == ["shoulder", "elbow", "grip"]
    assert robot.body_names == robot.data.body_names == ["base", "upper", "lower", "hand"]
    assert robot._ALL_INDICES.tolist() == [0, 1, 2]
    assert robot._ALL_INDICES.dtype == torch.int64
    joints, bodies = (3, 3), (3, 4)
    shapes = {
        **dict.fromkeys(("joint_pos", "joint_vel", "joint_acc", "applied_torque", "default_joint_pos"), joints),
        **dict.fromkeys(("default_joint_vel", "joint_vel_limits", "joint_pos_target", "joint_stiffness"), joints),
        **dict.fromkeys(("joint_pos_limits", "soft_joint_pos_limits"), (3, 3, 2)),
        "default_root_state": (3, 13), "default_root_pose": (3, 7), "root_state_w": (3, 13), "heading_w": (3,),
        **dict.fromkeys(("root_pos_w", "root_lin_vel_w", "root_ang_vel_w", "root_lin_vel_b", "root_ang_vel_b"), (3, 3)),
        **dict.fromkeys(("projected_gravity_b", "root_link_lin_vel_w", "root_com_pos_w", "GRAVITY_VEC_W"), (3, 3)),
        "FORWARD_VEC_B": (3, 3), "root_quat_w": (3, 4), "root_pose_w": (3, 7), "root_vel_w": (3, 6),
        **dict.fromkeys(("body_pos_w", "body_lin_vel_w", "body_ang_vel_w", "body_com_pos_w"), (*bodies, 3)),
        "body_quat_w": (*bodies, 4), "body_state_w": (*bodies, 13), "body_pose_w": (*bodies, 7),
        "body_mass": bodies, "default_mass": bodies, "body_inertia": (*bodies, 3, 3),
    }  # fmt: skip
    for name, shape in shapes.items():
        value = getattr(robot.data, name)
        assert isinstance(value, torch.Tensor), name
        assert (tuple(value.shape), value.dtype, str(value.device)) == (shape, torch.float32, "cpu"), name


def test_limits(arm):
    data = arm.articulations["robot"].data
    limits = np.array([[-np.pi / 2, np.pi / 2], [-2 * np.pi / 3, np.pi / 3], [-0.1, 0.3]])
    np.testing.assert_allclose(numpy(data.joint_pos_limits), [limits] * 3, atol=1e-5)
    middle, half = limits.mean(1), 0.5 * (limits[:, 1] - limits[:, 0])
    soft = np.stack((middle - 0.5 * half, middle + 0.5 * half), 1)
    np.testing.assert_allclose(numpy(data.soft_joint_pos_limits), [soft] * 3, atol=1e-5)


def test_find_joints_and_bodies(arm):
    robot = arm.articulations["robot"]
    assert robot.find_joints(".*") == ([0, 1, 2], ["shoulder", "elbow", "grip"])
    assert robot.find_joints(["grip", "s.*"]) == ([0, 2], ["shoulder", "grip"])
    assert robot.find_joints(["grip", "s.*"], preserve_order=True) == ([2, 0], ["grip", "shoulder"])
    assert robot.find_joints(["g.*"], joint_subset=["elbow", "grip"]) == ([1], ["grip"])
    assert robot.find_bodies(["hand", "base"]) == ([0, 3], ["base", "hand"])
    assert robot.find_bodies(["hand", "base"], preserve_order=True) == ([3, 0], ["hand", "base"])
    with pytest.raises(ValueError, match=r"'knee', 'x.*' matches nothing; there is: shoulder, elbow, grip"):
        robot.find_joints(["knee", "x.*", "grip"])
    with pytest.raises(ValueError, match="'elbo' matches nothing; there is: base, upper, lower, hand"):
        robot.find_bodies("elbo")


@pytest.mark.parametrize("ids", [[2, 0], torch.tensor([2, 0]), slice(0, 3, 2), None, torch.tensor([True, False, True])])
def test_environments_by_index(arm, ids):
    robot = arm.articulations["robot"]
    arm.controller.reset_robots()
    rows = {"list": [2, 0], "slice": [0, 2], "None": [0, 1, 2]}
    chosen = rows["None"] if ids is None else rows["slice"] if isinstance(ids, slice) else [2, 0]
    if isinstance(ids, torch.Tensor) and ids.dtype == torch.bool:
        chosen = [0, 2]
    values = torch.arange(len(chosen) * 3, dtype=torch.float32).view(-1, 3) * 0.01
    expected = robot.data.joint_pos.clone()
    expected[chosen] = values
    robot.write_joint_state_to_sim(values, values + 1.0, None, ids)
    assert torch.equal(robot.data.joint_pos, expected)
    assert torch.equal(robot.data.joint_vel[chosen], values + 1.0)
    assert torch.equal(robot.data.joint_acc[chosen], torch.zeros(len(chosen), 3))
    pose = robot.data.default_root_state[chosen, :7].clone()
    pose[:, 0] += torch.arange(len(chosen)) + 1.0
    robot.write_root_pose_to_sim(pose, ids)
    arm.sim.forward()
    assert torch.allclose(robot.data.root_pos_w[chosen], pose[:, :3], atol=1e-6)
    arm.controller.reset_robots()
    arm.sim.forward()


@pytest.mark.parametrize("joints", [[2, 0], torch.tensor([2, 0]), slice(0, 2)])
@pytest.mark.parametrize("envs", [[1], None, slice(1, 3)])
def test_joints_and_environments_by_index(arm, joints, envs):
    robot = arm.articulations["robot"]
    arm.controller.reset_robots()
    rows = [0, 1, 2] if envs is None else [1, 2] if isinstance(envs, slice) else envs
    columns = [0, 1] if isinstance(joints, slice) else [2, 0]
    values = torch.rand(len(rows), 2)
    expected = robot.data.joint_pos.clone()
    expected[torch.tensor(rows)[:, None], torch.tensor(columns)] = values
    robot.write_joint_state_to_sim(values, 2.0 * values, joints, envs)
    assert torch.equal(robot.data.joint_pos, expected)
    robot.set_joint_position_target(values, joints, envs)
    assert torch.equal(robot.data.joint_pos_target[rows[0], columns], values[0])
    robot.set_joint_velocity_target(values, joints, envs)
    robot.set_joint_effort_target(values, joints, envs)
    assert torch.equal(robot.data.joint_effort_target[rows[-1], columns], values[-1])
    robot.reset()
    assert torch.equal(robot.data.joint_pos_target, robot.data.default_joint_pos)
    assert not robot.data.joint_effort_target.any()
    assert not robot.data.joint_vel_target.any()


def test_data_are_views_of_the_simulation(arm):
    robot, sim = arm.articulations["robot"], arm.sim
    arm.controller.reset_robots()
    robot.data.joint_pos[1, 2] = 0.25
    assert sim.state.joint_q.numpy().reshape(3, -1)[1, 2] == 0.25
    shared = robot.data.warp.joint_pos
    assert isinstance(shared, wp.array)
    assert shared.numpy()[1, 2] == 0.25
    shared.fill_(0.125)
    assert torch.equal(robot.data.joint_pos, torch.full((3, 3), 0.125))
    assert robot.data.warp.body_pose_w.dtype is wp.transform
    assert robot.data.warp.body_pos_w.dtype is wp.vec3
    np.testing.assert_array_equal(robot.data.warp.body_pos_w.numpy(), robot.data.body_pos_w.numpy())
    with pytest.raises(AttributeError, match="computed when asked for"):
        _ = robot.data.warp.joint_acc


def test_views_that_are_kept_stay_valid(arm):
    robot = arm.articulations["robot"]
    arm.controller.reset_robots()
    kept = robot.data.joint_pos, robot.data.body_pos_w
    before = [k.clone() for k in kept]
    arm.sim.step(20)
    assert not torch.equal(kept[0], before[0])
    assert not torch.equal(kept[1], before[1])
    assert torch.equal(kept[0], robot.data.joint_pos)


def arm_poses(joints: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Positions of the arm's links by forward kinematics in float64."""
    q1, q2, q3 = joints
    turn1, turn2 = Rotation.from_rotvec([0, q1, 0]), Rotation.from_rotvec([q2, 0, 0])
    upper = base + [0.2, 0.0, 0.1]
    lower = upper + turn1.apply([0.1, 0.0, -0.4])
    hand = lower + (turn1 * turn2).apply([0.0, 0.0, -0.3 + q3])
    return np.stack((base, upper, lower, hand))


def test_body_poses_follow_the_joints(arm):
    robot = arm.articulations["robot"]
    joints = np.array([0.4, -0.7, 0.2])
    robot.write_joint_state_to_sim(torch.tensor(joints, dtype=torch.float32).repeat(3, 1), torch.zeros(3, 3))
    stale = robot.data.body_pos_w.clone()
    arm.sim.forward(torch.tensor([False, True, True]))
    assert torch.equal(robot.data.body_pos_w[0], stale[0])
    arm.sim.forward()
    for env in range(3):
        base = arm.env_origins[env].numpy() + [0.1, 0.2, 1.0]
        np.testing.assert_allclose(numpy(robot.data.body_pos_w)[env], arm_poses(joints, base), atol=1e-5)


def test_body_velocities_are_derivatives_of_positions(arm):
    robot, data = arm.articulations["robot"], arm.articulations["robot"].data
    arm.controller.reset_robots()
    robot.write_joint_state_to_sim(torch.tensor([[0.1, 0.2, 0.1]] * 3), torch.tensor([[1.0, -2.0, 0.5]] * 3))
    arm.sim.forward()
    com, origin, speeds = numpy(data.body_com_pos_w), numpy(data.body_pos_w), numpy(data.body_link_lin_vel_w)
    arm.sim.step(1)
    np.testing.assert_allclose((numpy(data.body_com_pos_w) - com) / DT, numpy(data.body_lin_vel_w), atol=2e-2)
    middle = 0.5 * (speeds + numpy(data.body_link_lin_vel_w))
    np.testing.assert_allclose((numpy(data.body_pos_w) - origin) / DT, middle, atol=2e-2)


def test_a_fixed_base_moves_when_its_pose_is_written(arm):
    """Bodies move and turn with it, and gravity pulls in the new direction: as in a scene that was built so."""
    robot = arm.articulations["robot"]
    arm.controller.reset_robots()
    turn = Rotation.from_euler("xyz", [0.5, -0.3, 1.0])
    pose = torch.tensor([[1.0, -2.0, 3.0, *turn.as_quat()]], dtype=torch.float32)
    robot.write_root_pose_to_sim(pose, [1])
    arm.sim.forward()
    expected = turn.apply(arm_poses(np.array([0.2, -0.3, 0.1]), np.zeros(3))) + [1.0, -2.0, 3.0]
    np.testing.assert_allclose(numpy(robot.data.body_pos_w)[1], expected, atol=1e-5)
    np.testing.assert_allclose(numpy(robot.data.root_pose_w)[1], numpy(pose)[0], atol=1e-5)
    model = mujoco.MjModel.from_xml_string(
        ARM.replace("<mujoco>", f'<mujoco><option timestep="{DT}" integrator="implicitfast"/>')
    )
    model.opt.gravity[:] = turn.inv().apply([0.0, 0.0, -G])
    data = mujoco.MjData(model)
    data.qpos[:] = [0.2, -0.3, 0.1]
    mujoco.mj_step(model, data, 60)
    arm.sim.step(60)
    np.testing.assert_allclose(numpy(robot.data.joint_pos)[1], data.qpos, atol=2e-3)
    assert abs(float(robot.data.joint_pos[1, 0] - robot.data.joint_pos[0, 0])) > 0.01
    arm.controller.reset_robots()
    arm.sim.forward()
    np.testing.assert_allclose(numpy(robot.data.root_pos_w - arm.env_origins), [[0.1, 0.2, 1.0]] * 3, atol=1e-5)


def test_writing_the_same_root_pose_changes_nothing(arm):
    robot = arm.articulations["robot"]
    results = []
    for again in (False, True):
        arm.controller.reset_robots()
        arm.sim.forward()
        if again:
            pose = robot.data.default_root_state[:, :7].clone()
            pose[:, :3] += arm.env_origins
            robot.write_root_pose_to_sim(pose, robot._ALL_INDICES)
        arm.sim.step(30)
        results.append((robot.data.joint_pos.clone(), robot.data.body_pose_w.clone()))
    assert torch.equal(results[0][0], results[1][0])
    assert torch.equal(results[0][1], results[1][1])


# -- an articulation on a free base


def test_a_free_base_and_its_velocities(floating_arm):
    robot, data = floating_arm.articulations["robot"], floating_arm.articulations["robot"].data
    assert not robot.is_fixed_base
    assert robot.joint_names == ["shoulder", "elbow", "grip"]
    write(robot)
    robot.write_joint_state_to_sim(torch.tensor([[0.1, 0.2, 0.1]] * 3), torch.tensor([[1.0, -2.0, 0.5]] * 3))
    floating_arm.sim.forward()
    np.testing.assert_allclose(numpy(data.root_vel_w), [TWIST] * 3, atol=1e-6)
    np.testing.assert_allclose(numpy(data.body_vel_w)[:, 0], [TWIST] * 3, atol=1e-5)
    com, speed = numpy(data.body_com_pos_w), numpy(data.body_lin_vel_w)
    floating_arm.sim.step(1)
    middle = 0.5 * (speed + numpy(data.body_lin_vel_w))
    np.testing.assert_allclose((numpy(data.body_com_pos_w) - com) / DT, middle, atol=2e-2)
    np.testing.assert_allclose(numpy(data.body_vel_w)[:, 0], numpy(data.root_vel_w), atol=1e-4)


def test_centre_of_mass_of_a_floating_arm_falls_freely(floating_arm):
    robot, data = floating_arm.articulations["robot"], floating_arm.articulations["robot"].data
    write(robot, twist=np.zeros(6))
    robot.write_joint_state_to_sim(torch.tensor([[0.1, 0.2, 0.1]] * 3), torch.tensor([[3.0, -2.0, 0.0]] * 3))
    floating_arm.sim.forward()
    mass = numpy(data.body_mass)
    total = mass.sum(1, keepdims=True)

    def mean(field: str) -> np.ndarray:
        return (numpy(getattr(data, field)) * mass[..., None]).sum(1) / total

    start, speed, n = mean("body_com_pos_w"), mean("body_lin_vel_w"), 50
    floating_arm.sim.step(n)
    fallen = np.array([0.0, 0.0, -0.5 * G * (n * DT) * (n + 1) * DT])
    np.testing.assert_allclose(mean("body_com_pos_w"), start + speed * n * DT + fallen, atol=4e-3)


def test_a_free_base_can_be_written_in_one_environment(floating_arm):
    robot = floating_arm.articulations["robot"]
    write(robot)
    others = robot.data.root_state_w[[0, 2]].clone()
    state = torch.tensor([[5.0, 6.0, 7.0, 0.0, 0.0, 0.0, 1.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]])
    robot.write_root_state_to_sim(state, torch.tensor([1]))
    floating_arm.sim.forward()
    assert torch.equal(robot.data.root_state_w[1], state[0])
    assert torch.equal(robot.data.root_state_w[[0, 2]], others)
    np.testing.assert_allclose(numpy(robot.data.body_pos_w)[1, 0], [5.0, 6.0, 7.0], atol=1e-6)


# -- errors


def test_errors_say_what_there_is(tmp_path):
    box = CuboidCfg(size=(1.0, 1.0, 1.0), rigid_props=RigidBodyPropertiesCfg(), mass_props=MassPropertiesCfg(mass=1.0))
    static = CuboidCfg(size=(1.0, 1.0, 1.0))
    with pytest.raises(ValueError, match="no articulation or rigid body at '/World/envs/env_0/Thing'"):
        make_scene({"thing": RigidObjectCfg(prim_path="{ENV_REGEX_NS}/Thing", spawn=static)})
    with pytest.raises(ValueError, match="bodies belong in environments"):
        make_scene({"thing": RigidObjectCfg(prim_path="/World/Thing", spawn=box)})
    robot = mjcf_robot(tmp_path, ARM)
    with pytest.raises(ValueError, match=r"holds 4 bodies .*use ArticulationCfg"):
        make_scene({"thing": RigidObjectCfg(prim_path="{ENV_REGEX_NS}/Thing", spawn=robot.spawn)})
    with pytest.raises(ValueError, match="no prim there and 'spawn' is None"):
        make_scene({"thing": RigidObjectCfg(prim_path="{ENV_REGEX_NS}/Thing")})
    with pytest.raises(ConfigError, match=r"'no_such\.xml' does not exist"):
        make_scene(
            {"thing": ArticulationCfg(prim_path="{ENV_REGEX_NS}/T", spawn=MjcfFileCfg(asset_path="no_such.xml"))}
        )
    with pytest.raises(ValueError, match="must be absolute"):
        make_scene({"thing": RigidObjectCfg(prim_path="Thing", spawn=box)})
