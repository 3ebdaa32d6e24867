# SPDX-License-Identifier: Apache-2.0
"""Controllers against NumPy formulas, and what their physics must do."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.configclass import ConfigError
from stripe_newton.controllers import (
    DifferentialIKController,
    DifferentialIKControllerCfg,
    OperationalSpaceController,
    OperationalSpaceControllerCfg,
)

N, JOINTS = 3, 7
RNG = np.random.default_rng(0)
JACOBIAN = RNG.normal(size=(N, 6, JOINTS))
ROOT = RNG.normal(size=(N, JOINTS, JOINTS))
MASS = ROOT @ ROOT.transpose(0, 2, 1) + np.eye(JOINTS)
NOW, WANTED = RNG.normal(size=(N, 3)), RNG.normal(size=(N, 3))
TURN_NOW, TURN_WANTED = Rotation.random(N, random_state=0), Rotation.random(N, random_state=1)
ERROR = np.concatenate((WANTED - NOW, (TURN_WANTED * TURN_NOW.inv()).as_rotvec()), axis=-1)
VELOCITY = RNG.normal(size=(N, 6))


def tensor(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.asarray(values, dtype=np.float32))


def pose(position: np.ndarray, rotation: Rotation) -> torch.Tensor:
    return tensor(np.concatenate((position, rotation.as_quat()), axis=-1))


def inverse_kinematics(method: str, **numbers: float) -> np.ndarray:
    cfg = DifferentialIKControllerCfg(command_type="pose", ik_method=method, ik_params=numbers)
    controller = DifferentialIKController(cfg, N, "cpu")
    controller.set_command(pose(WANTED, TURN_WANTED))
    now = pose(NOW, TURN_NOW)
    return controller.compute(now[:, :3], now[:, 3:], tensor(JACOBIAN), torch.zeros(N, JOINTS)).numpy()


def test_steps_of_inverse_kinematics_are_those_of_numpy():
    transposed = JACOBIAN.transpose(0, 2, 1)
    damped = transposed @ np.linalg.inv(JACOBIAN @ transposed + 0.3**2 * np.eye(6))
    u, s, vh = np.linalg.svd(JACOBIAN, full_matrices=False)
    limit = float(np.sort(s, axis=None)[4])  # cuts some singular values of some robots
    cut = np.where(s > limit, 1.0 / s, 0.0)
    expected = {
        "pinv": (np.linalg.pinv(JACOBIAN), {}),
        "trans": (0.5 * transposed, {"k_val": 0.5}),
        "dls": (damped, {"lambda_val": 0.3}),
        "svd": ((vh.transpose(0, 2, 1) * cut[:, None]) @ u.transpose(0, 2, 1), {"min_singular_value": limit}),
    }
    for method, (matrix, numbers) in expected.items():
        step = inverse_kinematics(method, **numbers)
        np.testing.assert_allclose(step, (matrix @ ERROR[..., None])[..., 0], atol=2e-4, err_msg=method)


def test_positions_need_three_rows_in_each_method():
    for method in ("pinv", "svd", "dls"):
        cfg = DifferentialIKControllerCfg(command_type="position", ik_method=method)
        controller = DifferentialIKController(cfg, N, "cpu")
        now = pose(NOW, TURN_NOW)
        controller.set_command(tensor(WANTED), ee_quat=now[:, 3:])
        step = controller.compute(now[:, :3], now[:, 3:], tensor(JACOBIAN), torch.zeros(N, JOINTS)).numpy()
        moved = (JACOBIAN[:, :3] @ step[..., None])[..., 0]
        np.testing.assert_allclose(moved, WANTED - NOW, atol=2e-3, err_msg=method)


def test_commands_are_copied():
    cfg = DifferentialIKControllerCfg(command_type="pose", ik_method="pinv")
    controller = DifferentialIKController(cfg, N, "cpu")
    command = pose(WANTED, TURN_WANTED)
    controller.set_command(command)
    command.zero_()
    np.testing.assert_allclose(controller.ee_pos_des.numpy(), WANTED, rtol=1e-6)


def operational_space(**fields: object) -> OperationalSpaceController:
    cfg = OperationalSpaceControllerCfg(**fields)
    return OperationalSpaceController(cfg, N, "cpu")


def test_decoupled_efforts_accelerate_the_body_as_the_gains_say():
    # Khatib 1987: with efforts J^T L a the body accelerates by J M^-1 J^T L a = a, in each direction.
    controller = operational_space(
        target_types=["pose_abs"],
        inertial_dynamics_decoupling=True,
        motion_stiffness_task=40.0,
        motion_damping_ratio_task=0.8,
        nullspace_control="position",
    )
    controller.set_command(pose(WANTED, TURN_WANTED))
    efforts = controller.compute(
        tensor(JACOBIAN),
        pose(NOW, TURN_NOW),
        tensor(VELOCITY),
        mass_matrix=tensor(MASS),
        current_joint_pos=tensor(RNG.normal(size=(N, JOINTS))),
        current_joint_vel=tensor(RNG.normal(size=(N, JOINTS))),
    ).numpy()
    acceleration = (JACOBIAN @ np.linalg.solve(MASS, efforts[..., None]))[..., 0]
    expected = 40.0 * ERROR - 2.0 * np.sqrt(40.0) * 0.8 * VELOCITY
    # the null space adds nothing that the body feels
    np.testing.assert_allclose(acceleration, expected, atol=2e-4 * np.abs(expected).max())


def test_null_space_pulls_the_joints():
    controller = operational_space(target_types=["pose_abs"], nullspace_control="position")
    joints = tensor(RNG.normal(size=(N, JOINTS)))
    alone = controller.compute(tensor(JACOBIAN), current_joint_pos=joints, current_joint_vel=0.0 * joints)
    projector = np.eye(JOINTS) - JACOBIAN.transpose(0, 2, 1) @ np.linalg.pinv(JACOBIAN).transpose(0, 2, 1)
    np.testing.assert_allclose(alone.numpy(), (projector @ (-10.0 * joints.numpy()[..., None]))[..., 0], atol=1e-3)


def test_wrenches_of_another_frame():
    controller = operational_space(target_types=["wrench_abs"], contact_wrench_control_axes_task=(1,) * 6)
    wrench = RNG.normal(size=(N, 6))
    controller.set_command(tensor(wrench), current_task_frame_pose_b=pose(NOW, TURN_NOW))
    force, torque = TURN_NOW.apply(wrench[:, :3]), TURN_NOW.apply(wrench[:, 3:])
    expected = np.concatenate((force, torque + np.cross(NOW, force)), axis=-1)
    efforts = controller.compute(tensor(JACOBIAN)).numpy()
    np.testing.assert_allclose(efforts, (JACOBIAN.transpose(0, 2, 1) @ expected[..., None])[..., 0], atol=1e-4)
    controller.reset()
    assert not controller.compute(tensor(JACOBIAN)).any()


def test_variable_gains_are_bounded_and_leave_the_command_as_it_is():
    controller = operational_space(
        target_types=["pose_rel"], impedance_mode="variable", motion_stiffness_limits_task=(5.0, 20.0)
    )
    command = torch.cat((torch.full((N, 6), 0.1), torch.full((N, 6), 1e4), torch.zeros(N, 6)), dim=-1)
    before = command.clone()
    now = pose(NOW, TURN_NOW)
    controller.set_command(command, now)
    assert torch.equal(command, before)
    efforts = controller.compute(tensor(JACOBIAN), now, tensor(VELOCITY)).numpy()
    np.testing.assert_allclose(efforts, 20.0 * 0.1 * JACOBIAN.sum(axis=1), atol=1e-3)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"target_types": ["pose"]}, "target_types: is .*pose_abs"),
        ({"target_types": ["pose_abs", "pose_rel"]}, "one pose and one wrench"),
        ({"target_types": ["pose_abs"], "impedance_mode": "soft"}, "impedance_mode: is 'soft', must be one of 'fixed'"),
        ({"target_types": ["pose_abs"], "motion_control_axes_task": (1, 1, 1)}, "six numbers, each 0 or 1"),
        ({"target_types": ["pose_abs"], "motion_stiffness_task": (1.0, 2.0)}, "one number or six"),
        ({"target_types": ["pose_abs"], "motion_stiffness_limits_task": (3.0, 1.0)}, "least, greatest"),
    ],
)
def test_configs_that_are_wrong_say_so(fields, message):
    with pytest.raises(ConfigError, match=message):
        operational_space(**fields)


def test_what_is_missing_is_named():
    now = pose(NOW, TURN_NOW)
    controller = operational_space(target_types=["pose_rel"], inertial_dynamics_decoupling=True)
    with pytest.raises(ValueError, match=r"shape \(3, 6\), got \(3, 7\)"):
        controller.set_command(now)
    with pytest.raises(ValueError, match="current_ee_pose_b is missing, which a target 'pose_rel' needs"):
        controller.set_command(torch.zeros(N, 6))
    controller.set_command(torch.zeros(N, 6), now)
    with pytest.raises(ValueError, match="mass_matrix is missing, which inertial_dynamics_decoupling needs"):
        controller.compute(tensor(JACOBIAN), now, tensor(VELOCITY))
    ik = DifferentialIKController(DifferentialIKControllerCfg(command_type="position", ik_method="dls"), N, "cpu")
    with pytest.raises(ValueError, match="ee_quat is missing"):
        ik.set_command(torch.zeros(N, 3))
    short = operational_space(target_types=["pose_abs"], nullspace_control="position")
    with pytest.raises(ValueError, match="more than 6 joints, the Jacobian has 6"):
        short.compute(
            tensor(JACOBIAN[..., :6]), current_joint_pos=torch.zeros(N, 6), current_joint_vel=torch.zeros(N, 6)
        )
