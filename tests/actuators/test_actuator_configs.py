# SPDX-License-Identifier: Apache-2.0
"""Actuator configs: errors of those that do not fit the robot."""

from __future__ import annotations

import math

import numpy as np
import pytest

from stripe_newton.actuators import (
    ActuatorNetLSTMCfg,
    ActuatorNetMLPCfg,
    DCMotorCfg,
    DelayedPDActuatorCfg,
    IdealPDActuatorCfg,
    ImplicitActuatorCfg,
    PIDActuatorCfg,
    RemotizedPDActuatorCfg,
)
from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import ConfigError
from tests.helpers.actuator_world import KINDS, actuator_scene
from tests.helpers.small_scenes import make_scene, mjcf_robot, sim_cfg, sliders


def test_problems_of_actuators_come_at_once(tmp_path):
    state = ArticulationCfg.InitialStateCfg(joint_pos={"nothing": 1.0})
    actuators = {
        "one": ImplicitActuatorCfg(joint_names_expr=["a"], stiffness={"zz": 1.0}),
        "two": ImplicitActuatorCfg(joint_names_expr=["q.*"]),
        "three": ImplicitActuatorCfg(joint_names_expr=["b"]),
        "four": ImplicitActuatorCfg(joint_names_expr=[".*"]),
    }
    robot = mjcf_robot(tmp_path, sliders({"a": "1 0 0", "b": "1 0 0"}), init_state=state, actuators=actuators)
    with pytest.raises(ConfigError) as caught:
        make_scene({"robot": robot})
    text = str(caught.value)
    assert len(caught.value.problems) == 4
    assert "'nothing' matches nothing; there is: a, b" in text
    assert "actuators.one" in text
    assert "'q.*' matches nothing" in text
    assert "joint 'b' is in group 'three' too" in text


@pytest.mark.parametrize(("field", "value"), [("stiffness", math.nan), ("damping", {"a": -1.0}), ("armature", "x")])
def test_gains_are_checked(field, value):
    cfg = ImplicitActuatorCfg(joint_names_expr=["a"]).replace(**{field: value})
    with pytest.raises(ConfigError, match=field):
        cfg.validate()


TABLE = [[0.0, 1.0, 1.0], [1.0, 1.0, 2.0]]


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (IdealPDActuatorCfg, {"effort_limit": -1.0}, "effort_limit: is -1.0, must not be negative"),
        (PIDActuatorCfg, {"integral_limit": {"a": -1.0}}, r"integral_limit\['a'\]: is -1.0, must not be negative"),
        (DCMotorCfg, {"velocity_limit": 2.0}, "saturation_effort: is missing, DCMotorCfg needs a value"),
        (DCMotorCfg, {"saturation_effort": 2.0}, "velocity_limit: is missing: a DC motor needs the speed"),
        (DCMotorCfg, {"saturation_effort": 2.0, "velocity_limit": 0.0}, "velocity_limit: is 0.0, must be positive"),
        (DCMotorCfg, {"saturation_effort": math.inf, "velocity_limit": 1.0}, "saturation_effort: is inf, must be"),
        (DelayedPDActuatorCfg, {"min_delay": 3, "max_delay": 2}, "min_delay: is 3, must not be larger than max_delay"),
        (DelayedPDActuatorCfg, {"max_delay": 1.5}, "max_delay: is 1.5, must be a whole number of at least 0"),
        (DelayedPDActuatorCfg, {"min_delay": -1}, "min_delay: is -1, must be a whole number"),
        (RemotizedPDActuatorCfg, {}, "joint_parameter_lookup: is missing"),
        (RemotizedPDActuatorCfg, {"joint_parameter_lookup": [[0.0, 1.0]]}, "must have rows of three numbers"),
        (RemotizedPDActuatorCfg, {"joint_parameter_lookup": TABLE[::-1]}, "has positions, .* that do not rise"),
        (RemotizedPDActuatorCfg, {"joint_parameter_lookup": [[0.0, 1.0, -1.0]]}, "has negative efforts"),
        (RemotizedPDActuatorCfg, {"joint_parameter_lookup": [[math.nan, 1.0, 1.0]]}, "must be a sequence of items"),
        (ActuatorNetLSTMCfg, {}, "network_file: is missing"),
        (ActuatorNetLSTMCfg, {"network_file": "x", "stiffness": 1.0}, "stiffness: is 1.0, but a network has no gains"),
        (ActuatorNetMLPCfg, {"network_file": "x", "pos_scale": 0.0}, "pos_scale: is 0.0, must be a number other than"),
        (ActuatorNetMLPCfg, {"network_file": "x", "input_order": "pos"}, "input_order: is 'pos', must be 'pos_vel'"),
        (ActuatorNetMLPCfg, {"network_file": "x", "input_idx": [0, -1]}, r"input_idx: is \[0, -1\], must be steps"),
        (ActuatorNetMLPCfg, {"network_file": "x", "saturation_effort": 1.0}, "velocity_limit: is missing"),
    ],
)
def test_problems_of_configs(kind, values, message):
    own = {"own": kind(joint_names_expr=["a"], **values)}
    cfg = ArticulationCfg(prim_path="/World/envs/env_.*/Robot", actuators=own)
    with pytest.raises(ConfigError, match=f"actuators.own.*{message}") as caught:
        cfg.validate()
    assert len(caught.value.problems) == 1


def test_a_number_for_some_joints_alone_is_an_error_where_the_file_says_none(tmp_path):
    motor = DCMotorCfg(joint_names_expr=["a", "b"], saturation_effort=9.0, velocity_limit={"a": 1.0})
    with pytest.raises(ConfigError, match=r"actuators.motor: velocity_limit: has no value for joint 'b'"):
        actuator_scene(tmp_path, {"motor": motor}, ["a", "b"])


def test_the_limit_of_the_solver_holds_for_explicit_actuators_that_have_no_other(tmp_path):
    gains = {"stiffness": 1000.0, "damping": 1.0}
    kinds = {
        "a": IdealPDActuatorCfg(joint_names_expr=["a"], effort_limit_sim=7.0, **gains),
        "b": IdealPDActuatorCfg(joint_names_expr=["b"], effort_limit_sim=7.0, effort_limit=5.0, **gains),
        "c": IdealPDActuatorCfg(joint_names_expr=["c"], effort_limit_sim={"c": 7.0}, effort_limit={"c": 9.0}, **gains),
    }
    robot = actuator_scene(tmp_path, kinds, list(kinds), num_envs=1)["robot"]
    robot.set_joint_position_target(robot.data.joint_pos + 1.0)
    robot._sim.step(1)
    limits = dict(zip(robot.joint_names, robot.data.joint_effort_limits[0].tolist(), strict=True))
    assert limits == {"a": 7.0, "b": 5.0, "c": 9.0}
    assert dict(zip(robot.joint_names, robot.data.applied_torque[0].tolist(), strict=True)) == limits


def test_two_actuators_of_newton_on_one_joint(tmp_path):
    from newton.actuators import DrivePD

    scene = actuator_scene(tmp_path, {"pd": KINDS["pd"]}, ["pd"], num_envs=1)
    builder, static = scene.sim.template, scene.sim.static
    builder.add_actuator(DrivePD, index=scene["robot"].layout.dofs[0], kp=1.0)
    with pytest.raises(ValueError, match=r"degrees of freedom \[0\] have two explicit actuators each"):
        type(scene.sim)(sim_cfg()).build(builder, static, np.zeros((1, 3)))
