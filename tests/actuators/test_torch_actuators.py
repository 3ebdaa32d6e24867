# SPDX-License-Identifier: Apache-2.0
"""Torch actuators: a user's law drives the joints as the same law of the package does."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.actuators import (
    ActuatorCfg,
    IdealPDActuatorCfg,
    ImplicitActuatorCfg,
    JointGroup,
    TorchActuatorCfg,
    TorchTargetsCfg,
)
from stripe_newton.isaaclab import actuator_configs, actuators
from stripe_newton.isaaclab.configclass import configclass
from stripe_newton.isaaclab.env_types import ArticulationActions
from stripe_newton.scene import InteractiveScene
from stripe_tasks.robots import CARTPOLE_CFG
from tests.helpers.small_scenes import make_scene

NUMBERS = {
    "joint_names_expr": [".*"],
    "stiffness": 40.0,
    "damping": {"slider.*": 3.0, ".*pole": 1.0},
    "effort_limit": 9.0,
}


class PD:
    """The law of IdealPDActuatorCfg."""

    def __init__(self, cfg: ActuatorCfg, group: JointGroup):
        self.group, self.resets = group, list[list[int]]()

    def compute(self, pos_target, vel_target, effort_target, pos, vel):
        effort = self.group.stiffness * (pos_target - pos) + self.group.damping * (vel_target - vel) + effort_target
        return effort.clamp(-self.group.effort_limit, self.group.effort_limit)

    def reset(self, env_ids):
        self.resets.append(env_ids.tolist())


class WorkingPD(actuators.IdealPDActuator):
    """The same, as a class of a project on Isaac Lab."""

    def compute(self, control_action: ArticulationActions, joint_pos, joint_vel) -> ArticulationActions:
        return super().compute(control_action, joint_pos, joint_vel)


@configclass
class WorkingPDCfg(actuator_configs.IdealPDActuatorCfg):
    class_type: type = WorkingPD


@configclass
class WorkingDelayedCfg(actuator_configs.DelayedPDActuatorCfg):
    class_type: type = type("Late", (actuators.DelayedPDActuator,), {})


@configclass
class WorkingMotorCfg(actuator_configs.DCMotorCfg):
    class_type: type = type("Motor", (actuators.DCMotor,), {})


def driven(actuator: ActuatorCfg, steps: int = 7) -> InteractiveScene:
    scene = make_scene({"robot": CARTPOLE_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot", actuators={"all": actuator})})
    robot = scene.articulations["robot"]
    robot.set_joint_position_target(robot.data.default_joint_pos + torch.tensor([[0.5, -0.4]]))
    robot.set_joint_effort_target(torch.full_like(robot.data.joint_pos, 0.5))
    scene.sim.step(steps)
    return scene


@pytest.mark.parametrize(
    ("own", "like"),
    [
        (TorchActuatorCfg(make_law=PD, **NUMBERS), IdealPDActuatorCfg(**NUMBERS)),
        (WorkingPDCfg(**NUMBERS), IdealPDActuatorCfg(**NUMBERS)),
        (
            WorkingMotorCfg(saturation_effort=12.0, velocity_limit=4.0, **NUMBERS),
            actuator_configs.DCMotorCfg(saturation_effort=12.0, velocity_limit=4.0, **NUMBERS),
        ),
        (
            WorkingDelayedCfg(min_delay=2, max_delay=2, **NUMBERS),
            actuator_configs.DelayedPDActuatorCfg(min_delay=2, max_delay=2, **NUMBERS),
        ),
    ],
    ids=["law", "class", "motor", "delayed"],
)
def test_a_law_of_the_user_moves_the_joints_as_that_of_the_package(own, like):
    mine, theirs = (driven(cfg).articulations["robot"].data for cfg in (own, like))
    assert theirs.joint_vel.abs().max() > 0.05
    torch.testing.assert_close(mine.joint_pos, theirs.joint_pos, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(mine.applied_torque, theirs.applied_torque, atol=1e-3, rtol=1e-4)


def test_a_law_is_told_of_its_joints_and_of_resets():
    laws = []
    scene = driven(TorchActuatorCfg(make_law=lambda cfg, group: laws.append(PD(cfg, group)) or laws[-1], **NUMBERS))
    (law,) = laws
    assert law.group.names == scene.articulations["robot"].joint_names
    assert law.group.damping[0].tolist() == [3.0, 1.0]
    scene.reset(torch.tensor([1]))
    assert law.resets == [[0, 1], [1]]


class Shift:
    """Targets that are moved, and a constant effort."""

    def __init__(self, cfg: ActuatorCfg, group: JointGroup):
        self.group, self.resets = group, list[list[int]]()

    def compute(self, pos_target, vel_target, effort_target, pos, vel):
        return pos_target.add_(0.2), vel_target - 0.3, effort_target + 0.1

    def reset(self, env_ids):
        self.resets.append(env_ids.tolist())


class ShiftingDrive(actuators.ImplicitActuator):
    """The same, as a class of a project on Isaac Lab."""

    def compute(self, control_action: ArticulationActions, joint_pos, joint_vel) -> ArticulationActions:
        control_action.joint_positions += 0.2
        control_action.joint_velocities = control_action.joint_velocities - 0.3
        control_action.joint_efforts = control_action.joint_efforts + 0.1
        return super().compute(control_action, joint_pos, joint_vel)


@configclass
class ShiftingDriveCfg(actuator_configs.ImplicitActuatorCfg):
    class_type: type = ShiftingDrive


@pytest.mark.parametrize(
    "own", [TorchTargetsCfg(make_law=Shift, **NUMBERS), ShiftingDriveCfg(**NUMBERS)], ids=["law", "class"]
)
def test_targets_that_a_law_changes_move_the_joints_as_these_targets_do(own):
    mine = driven(own).articulations["robot"]
    scene = driven(ImplicitActuatorCfg(**NUMBERS), steps=0)
    theirs = scene.articulations["robot"]
    set_targets = theirs.data.joint_pos_target.clone()
    theirs.set_joint_position_target(set_targets + 0.2)
    theirs.set_joint_velocity_target(theirs.data.joint_vel_target - 0.3)
    theirs.set_joint_effort_target(theirs.data.joint_effort_target + 0.1)
    scene.sim.step(7)
    assert theirs.data.joint_vel.abs().max() > 0.05
    torch.testing.assert_close(mine.data.joint_pos, theirs.data.joint_pos, atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(mine.data.applied_torque, theirs.data.applied_torque, atol=1e-4, rtol=1e-5)
    torch.testing.assert_close(mine.data.joint_pos_target, set_targets)  # the caller's own are there again


def test_a_law_of_targets_is_told_of_its_joints_and_of_resets():
    laws = []
    scene = driven(TorchTargetsCfg(make_law=lambda cfg, group: laws.append(Shift(cfg, group)) or laws[-1], **NUMBERS))
    (law,) = laws
    assert law.group.damping[0].tolist() == [3.0, 1.0]
    assert law.group.effort_limit[0].tolist() == [9.0, 9.0]
    scene.reset(torch.tensor([1]))
    assert law.resets == [[0, 1], [1]]


def test_efforts_of_another_shape_are_refused():
    class Wrong(PD):
        def compute(self, *args):
            return super().compute(*args)[:, :1]

    with pytest.raises(ValueError, match=r"Wrong returned efforts of the shape \(2, 1\), must be \(2, 2\)"):
        driven(TorchActuatorCfg(make_law=Wrong, **NUMBERS))


def test_targets_of_another_shape_are_refused():
    class Wrong(Shift):
        def compute(self, pos_target, *args):
            return pos_target[:, :1], *args[:2]

    with pytest.raises(ValueError, match=r"Wrong returned targets of the shape \(2, 1\), must be \(2, 2\)"):
        driven(TorchTargetsCfg(make_law=Wrong, **NUMBERS))
