# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics actions, against MuJoCo's Jacobians and NumPy in float64."""

from __future__ import annotations

import math

import newton
import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_kernels.data import ArticulationData
from stripe_kernels.mdp.kinematics import KinematicChain, jacobian_column
from stripe_newton.managers.kinematic_chain import kinematic_chain
from stripe_tasks.robots import ANT_CFG
from tests.helpers.inverse_kinematics_world import ARM, FLANGE, NONE, OFFSET, TROLLEY, World, action, frames_of
from tests.helpers.small_scenes import mjcf_robot, numpy

ANT = ANT_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("ik")


# -- the Jacobian


@wp.kernel(enable_backward=False)
def columns(
    robot: ArticulationData,
    joint_ids: wp.array[int],
    chain: KinematicChain,
    points: wp.array[wp.vec3],
    out: wp.array2d[wp.spatial_vector],
):
    env, index = wp.tid()
    out[env, index] = jacobian_column(env, robot, joint_ids, chain, index, points[env])


@pytest.mark.parametrize(
    ("robot", "body", "joints", "carrying"),
    [
        ("arm", FLANGE, [".*"], 6),
        ("arm", "forearm_link", [".*"], 3),
        ("ant", "left_back_foot", [".*"], 2),
        ("trolley", "rod", [".*"], 7),
        ("trolley", "rod", ["yaw", "roll", "lift", "turn"], 4),
        ("trolley", "side", [".*"], 4),
    ],
)
def test_jacobian_is_that_of_mujoco_and_of_newton(robot, body, joints, carrying, folder):
    cfg = {"arm": ARM, "ant": ANT, "trolley": mjcf_robot(folder, TROLLEY, fix_base=None)}[robot]
    world = World(cfg, action(body, joint_names=joints), folder)
    assert not world.problems, world.problems
    world.scatter(turn_root=robot == "ant")
    ids, asset = world.robot.find_joints(joints)[0], world.robot
    index, offset = asset.body_names.index(body), np.array(OFFSET.pos)
    chain = kinematic_chain(world.scene.sim, asset.layout, list(ids), index)
    known = [world.mujoco(env, index, offset) for env in range(world.num_envs)]
    points = wp.array(np.array([k[0] for k in known]), dtype=wp.vec3, device="cpu")
    out = wp.zeros((world.num_envs, len(ids)), dtype=wp.spatial_vector, device="cpu")
    indices = wp.array(list(ids), dtype=int, device="cpu")
    wp.launch(columns, dim=out.shape, inputs=[asset.data.struct, indices, chain, points], outputs=[out])
    found = out.numpy()
    for env, (point, _, jacobian) in enumerate(known):
        np.testing.assert_allclose(found[env].T, jacobian[:, ids], atol=5e-6)
        link = wp.transform_point(wp.transform(*numpy(asset.data.body_pose_w[env, index])), wp.vec3(*offset))
        np.testing.assert_allclose(point, link, atol=5e-6)
    assert (np.abs(found).max(axis=(0, 2)) > 0.0).sum() == carrying

    sim = world.scene.sim
    jacobian = newton.eval_jacobian(sim.model, sim.state).numpy()
    dofs = np.array(ids) + asset.layout.dofs.start
    for env in range(world.num_envs):
        rows = 6 * (asset.layout.bodies[index] - asset.layout.bodies[0]) + np.arange(6)
        at_com = jacobian[env][np.ix_(rows, dofs)]
        arm = known[env][0] - numpy(asset.data.body_com_pos_w[env, index])
        linear = at_com[:3] + np.cross(at_com[3:].T, arm).T
        np.testing.assert_allclose(found[env].T, np.concatenate([linear, at_com[3:]]), atol=5e-6)


# -- commands


@pytest.fixture(scope="module")
def ant(folder):
    """By relative mode and command type."""
    return {
        (relative, command): World(
            ANT,
            action(
                "left_back_foot", command, relative=relative, body_offset=OFFSET, scale=scale, joint_names=["left.*"]
            ),
            folder,
        )
        for relative, command, scale in (
            (False, "pose", [0.5, 1.0, 2.0, 3.0, 3.0, 3.0, 3.0]),
            (True, "pose", [0.5, 1.0, 2.0, 0.1, 0.2, 0.3]),
            (True, "position", 0.5),
            (False, "position", 2.0),
        )
    }


@pytest.mark.parametrize(("relative", "command"), [(a, b) for a in (False, True) for b in ("pose", "position")])
def test_desired_pose_is_what_the_command_says_in_the_root_frame(ant, relative, command):
    world = ant[relative, command]
    world.scatter(turn_root=True)
    pos, turn = frames_of(world, OFFSET, world.robot.body_names.index("left_back_foot"))
    raw = world.rng.normal(size=(world.num_envs, world.manager.total_action_dim))
    assert raw.shape[1] == {(True, "pose"): 6, (False, "pose"): 7}.get((relative, command), 3)
    u = raw * np.array(world.manager._terms["arm"].cfg.scale)
    found = world.process(raw)
    np.testing.assert_allclose(found[:, :3], u[:, :3] + relative * pos, atol=5e-6)
    if command == "pose":
        turn = Rotation.from_rotvec(u[:, 3:]) * turn if relative else Rotation.from_quat(raw[:, 3:])
    assert (turn.inv() * Rotation.from_quat(found[:, 3:])).magnitude().max() < 1e-5


def test_no_rotation_at_all_keeps_the_present_one(ant):
    world = ant[False, "pose"]
    world.scatter(turn_root=True)
    turn = frames_of(world, OFFSET, world.robot.body_names.index("left_back_foot"))[1]
    found = world.process(np.zeros((world.num_envs, 7)))
    assert (turn.inv() * Rotation.from_quat(found[:, 3:])).magnitude().max() < 1e-5
    world = ant[True, "pose"]
    turn = frames_of(world, OFFSET, world.robot.body_names.index("left_back_foot"))[1]
    found = world.process(np.zeros((world.num_envs, 6)))
    assert (turn.inv() * Rotation.from_quat(found[:, 3:])).magnitude().max() < 1e-3


# -- the methods


def inverse(method: str, jacobian: np.ndarray, error: np.ndarray, params: dict[str, float]) -> np.ndarray:
    if method == "pinv":
        return params["k_val"] * np.linalg.pinv(jacobian, rcond=1e-4) @ error
    if method == "svd":
        u, s, v = np.linalg.svd(jacobian, full_matrices=False)
        return params["k_val"] * v.T @ (np.where(s > params["min_singular_value"], 1.0 / s, 0.0) * (u.T @ error))
    if method == "trans":
        return params["k_val"] * jacobian.T @ error
    square = jacobian @ jacobian.T + params["lambda_val"] ** 2 * np.eye(len(error))
    return jacobian.T @ np.linalg.solve(square, error)


NUMBERS = {
    "pinv": {"k_val": 0.7},
    "svd": {"k_val": 0.8, "min_singular_value": 0.1},
    "trans": {"k_val": 0.4},
    "dls": {"lambda_val": 0.05},
}


@pytest.mark.parametrize("command", ["pose", "position"])
@pytest.mark.parametrize("method", list(NUMBERS))
def test_targets_are_those_of_numpy(method, command, folder):
    world = World(ARM, action(FLANGE, command, method, body_offset=OFFSET, ik_params=NUMBERS[method]), folder, 16)
    world.scatter(2.0)
    pos, turn = frames_of(world, OFFSET)
    shift, rotvec = world.rng.normal(scale=0.1, size=(2, 16, 3))
    desired = Rotation.from_rotvec(rotvec) * turn
    world.desired = np.concatenate([pos + shift, desired.as_quat()], axis=-1)
    found, truncated = world.steps(), 0
    for env in range(16):
        jacobian = world.mujoco(env, 6, np.array(OFFSET.pos))[2]
        error = np.concatenate([shift[env], rotvec[env]])  # the root's axes are the world's
        if command == "position":
            jacobian, error = jacobian[:3], error[:3]
        expected = inverse(method, jacobian, error, NUMBERS[method])
        values = np.linalg.svd(jacobian, compute_uv=False)
        truncated += (values < 0.1).any() and not (values < 0.1).all()
        np.testing.assert_allclose(found[env], expected, atol=2e-5 / values.min() if method == "pinv" else 2e-4)
    assert truncated > 0 or command == "position"


def test_few_joints_come_as_near_as_they_can(folder):
    """Two joints of a floating base cannot follow a pose: the pseudo-inverse is the least squares solution."""
    world = World(ANT, action("left_back_foot", method="pinv", joint_names=["left.*"]), folder)
    world.scatter(turn_root=True)
    body, ids = world.robot.body_names.index("left_back_foot"), world.robot.find_joints("left.*")[0]
    pos, turn = frames_of(world, NONE, body)
    shift, rotvec = world.rng.normal(scale=0.1, size=(2, world.num_envs, 3))
    world.desired = np.concatenate([pos + shift, (Rotation.from_rotvec(rotvec) * turn).as_quat()], axis=-1)
    found = world.steps()
    root = Rotation.from_quat(numpy(world.robot.data.root_quat_w))
    error = np.concatenate([root.apply(shift), root.apply(rotvec)], axis=-1)
    for env in range(world.num_envs):
        jacobian = world.mujoco(env, body, np.zeros(3))[2][:, ids]
        np.testing.assert_allclose(found[env, ids], np.linalg.lstsq(jacobian, error[env])[0], atol=5e-5)


SINGULAR = {
    "stretched": [0.3, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0],
    "wrist": [0.3, -1.7, 2.0, -1.87, 0.0, 0.5],
    "both": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
}


@pytest.mark.parametrize("method", list(NUMBERS))
def test_singular_configurations_stay_finite_and_are_left(method, folder):
    world = World(ARM, action(method=method), folder, len(SINGULAR))
    joints = np.array(list(SINGULAR.values()))
    world.put(joints)
    smallest = [np.linalg.svd(world.mujoco(i, 6, np.zeros(3))[2], compute_uv=False)[-1] for i in range(len(joints))]
    assert max(smallest) < 1e-6
    pos, turn = frames_of(world, NONE)
    toward = 0.05 * (np.array([0.0, 0.0, 0.4]) - pos) + [0.0, 0.01, 0.0]
    world.desired = np.concatenate([pos + toward, turn.as_quat()], axis=-1)
    found = world.steps()
    assert np.isfinite(found).all()
    assert np.abs(found).max() > 1e-4
    if method == "pinv":  # no part along what no joint can do
        for env in range(len(joints)):
            jacobian = world.mujoco(env, 6, np.zeros(3))[2]
            expected = np.linalg.pinv(jacobian, rcond=1e-4) @ np.concatenate([toward[env], np.zeros(3)])
            np.testing.assert_allclose(found[env], expected, atol=2e-3)


def test_numbers_of_the_method_may_be_changed(folder):
    world = World(ARM, action(ik_params={"lambda_val": 0.2}), folder)
    world.scatter()
    pos, turn = frames_of(world, NONE)
    world.desired = np.concatenate([pos + [0.05, 0.0, 0.02], turn.as_quat()], axis=-1)
    error = np.array([0.05, 0.0, 0.02, 0.0, 0.0, 0.0])
    before = world.steps()
    world.context.parameters["actions.arm.lambda_val"] = 1.0
    after = world.steps()
    for env in range(world.num_envs):
        jacobian = world.mujoco(env, 6, np.zeros(3))[2]
        for found, damping in ((before, 0.2), (after, 1.0)):
            expected = inverse("dls", jacobian, error, {"lambda_val": damping})
            np.testing.assert_allclose(found[env], expected, atol=2e-5)
