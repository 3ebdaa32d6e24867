# SPDX-License-Identifier: Apache-2.0
"""Controllers of the Isaac Lab dialect beside Isaac Lab's own classes, on given Jacobians and mass matrices."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from types import ModuleType

import pytest
import torch

from stripe_newton.controllers import DifferentialIKControllerCfg, OperationalSpaceControllerCfg
from stripe_newton.isaaclab.controllers import DifferentialIKController, OperationalSpaceController
from tests.helpers.isaaclab_source import isaaclab_modules

N, JOINTS = 5, 7
METHODS = {
    "pinv": {"k_val": 0.7},
    "svd": {"k_val": 0.7, "min_singular_value": 0.9},
    "trans": {"k_val": 0.2},
    "dls": {"lambda_val": 0.1},
}
GAINS = (100.0, 50.0, 200.0, 10.0, 20.0, 30.0)
CASES = {
    "impedance": {"target_types": ["pose_abs"]},
    "relative": {"target_types": ["pose_rel"], "motion_stiffness_task": 80.0, "motion_damping_ratio_task": 0.5},
    "decoupled": {"target_types": ["pose_abs"], "inertial_dynamics_decoupling": True, "motion_stiffness_task": GAINS},
    "partial": {
        "target_types": ["pose_abs"],
        "inertial_dynamics_decoupling": True,
        "partial_inertial_dynamics_decoupling": True,
        "gravity_compensation": True,
    },
    "hybrid": {
        "target_types": ["pose_abs", "wrench_abs"],
        "motion_control_axes_task": [1, 1, 0, 1, 1, 1],
        "contact_wrench_control_axes_task": [0, 0, 1, 0, 0, 0],
        "contact_wrench_stiffness_task": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0],
        "inertial_dynamics_decoupling": True,
    },
    "wrench": {"target_types": ["wrench_abs"], "contact_wrench_control_axes_task": [1, 1, 1, 1, 1, 1]},
    "wrench first": {
        "target_types": ["wrench_abs", "pose_rel"],
        "contact_wrench_control_axes_task": [0, 1, 1, 0, 0, 0],
        "motion_control_axes_task": [1, 0, 0, 1, 1, 1],
    },
    "variable_kp": {"target_types": ["pose_abs"], "impedance_mode": "variable_kp", "motion_damping_ratio_task": GAINS},
    "variable": {
        "target_types": ["pose_rel"],
        "impedance_mode": "variable",
        "motion_stiffness_limits_task": (10.0, 200.0),
        "motion_damping_ratio_limits_task": (0.1, 1.0),
    },
    "nullspace": {
        "target_types": ["pose_abs"],
        "inertial_dynamics_decoupling": True,
        "nullspace_control": "position",
        "nullspace_stiffness": 30.0,
        "nullspace_damping_ratio": 0.7,
    },
    "nullspace, partial": {
        "target_types": ["pose_abs"],
        "inertial_dynamics_decoupling": True,
        "partial_inertial_dynamics_decoupling": True,
        "nullspace_control": "position",
    },
}


@pytest.fixture(scope="module")
def theirs() -> Iterator[dict[str, type]]:
    names = ["differential_ik", "differential_ik_cfg", "operational_space", "operational_space_cfg"]
    with isaaclab_modules(*(f"isaaclab.controllers.{name}" for name in names)) as modules:
        yield {name: thing for module in modules for name, thing in public(module).items()}


def public(module: ModuleType) -> dict[str, type]:
    return {name: thing for name, thing in vars(module).items() if isinstance(thing, type)}


class Draw:
    """Random tensors, the same for both sides."""

    def __init__(self):
        self.generator = torch.Generator().manual_seed(0)

    def __call__(self, *shape: int) -> torch.Tensor:
        return torch.randn((N, *shape), generator=self.generator)

    def pose(self) -> torch.Tensor:
        return torch.cat((self(3), torch.nn.functional.normalize(self(4), dim=-1)), dim=-1)

    def mass_matrix(self) -> torch.Tensor:
        root = 0.3 * self(JOINTS, JOINTS)
        return root @ root.mT + torch.eye(JOINTS)

    def jacobian(self) -> torch.Tensor:
        return 0.2 * self(6, JOINTS) + torch.eye(6, JOINTS)  # well-conditioned: both sides compute in float32


@pytest.mark.parametrize(
    ("method", "command_type", "relative"), list(itertools.product(METHODS, ("position", "pose"), (False, True)))
)
def test_inverse_kinematics(theirs, method, command_type, relative):
    if method == "svd" and command_type == "position":
        pytest.skip("Isaac Lab's own cannot multiply the matrices of a position")
    fields = {"command_type": command_type, "use_relative_mode": relative, "ik_method": method}
    outputs = []
    for controller_type, cfg_type in (
        (theirs["DifferentialIKController"], theirs["DifferentialIKControllerCfg"]),
        (DifferentialIKController, DifferentialIKControllerCfg),
    ):
        draw = Draw()
        controller = controller_type(cfg_type(**fields, ik_params=METHODS[method]), N, "cpu")
        controller.reset()
        now, command = draw.pose(), draw.pose() if controller.action_dim == 7 else draw(controller.action_dim)
        controller.set_command(command, now[:, :3], now[:, 3:])
        targets = controller.compute(now[:, :3], now[:, 3:], draw.jacobian(), draw(JOINTS))
        outputs.append((targets, controller.ee_pos_des, controller.ee_quat_des * 1.0))
    for expected, actual in zip(*outputs):
        torch.testing.assert_close(actual, expected, atol=2e-5, rtol=2e-5)


def test_default_numbers_of_the_methods(theirs):
    for method in METHODS:
        fields = {"command_type": "pose", "ik_method": method}
        numbers = theirs["DifferentialIKControllerCfg"](**fields).ik_params
        assert DifferentialIKControllerCfg(**fields).numbers == numbers


def test_default_fields_of_operational_space(theirs):
    cfg = theirs["OperationalSpaceControllerCfg"](target_types=["pose_abs"])
    ours = OperationalSpaceControllerCfg(target_types=["pose_abs"])
    fields = {name: value for name, value in vars(cfg).items() if name != "class_type"}
    assert {name: getattr(ours, name) for name in fields} == fields


@pytest.mark.parametrize("in_task_frame", [False, True])
@pytest.mark.parametrize("case", CASES)
def test_operational_space(theirs, case, in_task_frame):
    outputs = []
    for controller_type, cfg_type in (
        (theirs["OperationalSpaceController"], theirs["OperationalSpaceControllerCfg"]),
        (OperationalSpaceController, OperationalSpaceControllerCfg),
    ):
        draw = Draw()
        controller = controller_type(cfg_type(**CASES[case]), N, "cpu")
        now, frame = draw.pose(), draw.pose()
        parts = [draw.pose() if size == 7 else draw(size) for size in controller.target_list]
        gains = 300.0 * draw(controller.action_dim - controller.target_dim).abs()
        controller.set_command(torch.cat([*parts, gains], dim=-1), now, frame if in_task_frame else None)
        efforts = controller.compute(
            draw.jacobian(),
            now,
            draw(6),
            draw(3),
            draw.mass_matrix(),
            draw(JOINTS),
            draw(JOINTS),
            draw(JOINTS),
            draw(JOINTS),
        )
        pose, wrench = controller.desired_ee_pose_b, controller.desired_ee_wrench_b
        outputs.append([efforts, *(t * 1.0 for t in (pose, wrench) if t is not None)])
    assert len(outputs[0]) == len(outputs[1])
    scale = float(outputs[0][0].abs().max())
    torch.testing.assert_close(outputs[1][0], outputs[0][0], atol=1e-5 * scale, rtol=1e-4)
    for expected, actual in zip(outputs[0][1:], outputs[1][1:]):
        torch.testing.assert_close(actual, expected, atol=1e-5, rtol=1e-5)
