# SPDX-License-Identifier: Apache-2.0
"""Terms of stripe_kernels.mdp, against float64 references on random states and known hard cases."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_kernels import mdp
from stripe_kernels.term_info import observation_size
from stripe_newton.envs import mdp as public
from tests.helpers import term_kernels as tk
from tests.helpers import term_reference as reference
from tests.helpers import term_reference_random as random_reference
from tests.helpers.checkout import ROOT
from tests.helpers.term_launch import (
    CASES,
    NAN,
    NUM_ENVS,
    PARAMS,
    SEED,
    Launch,
    as_numpy,
    close,
    params_of,
    values,
)
from tests.helpers.term_reference_random import Stream
from tools.documentation import term_table

ALL_CASES = [(kind, n, case) for kind in tk.KINDS for n in tk.term_names(kind) for case in CASES.get(n, [{}])]


def counts(params: dict[str, Any]) -> dict[str, int]:
    ids = {k: len(params[k]) for k in ("joint_ids", "body_ids")}
    return ids | {"num_actions": tk.NUM_ACTIONS, "num_command": tk.NUM_COMMAND}


@pytest.mark.parametrize(("kind", "name", "case"), ALL_CASES, ids=[f"{n}-{list(c)}" for _, n, c in ALL_CASES])
def test_term(kind, name, case, device):
    v = values()
    params = params_of(case, NUM_ENVS)
    stream = Stream(SEED, NUM_ENVS)
    if kind == "observation":
        params = params_of(case, NUM_ENVS, tk.size_of(getattr(mdp, name), counts(PARAMS | case)))
        expected = {"out": {"": reference.OBSERVATIONS[name](v, params)}}
        assert expected["out"][""].shape == params["out"].shape, "size"
    elif kind == "reward":
        expected = {"result": {"": np.asarray(reference.REWARDS[name](v, params), dtype=float)}}
    elif kind == "termination":
        expected = {"result": {"": reference.TERMINATIONS[name](v, params)}}
    else:
        table = {"event": random_reference.EVENTS, "command": random_reference.COMMANDS}.get(
            kind, random_reference.ACTIONS
        )
        expected = table[name](copy.deepcopy(v), as_numpy(params), stream)
    launch = Launch(kind, name, v, params, Stream(SEED, NUM_ENVS).n, device)

    for struct, fields in expected.items():
        for field, value in fields.items():
            actual = launch.read(struct, field)
            close(*turned_alike(field, actual, value), f"{struct}.{field}")
    for struct, instance in launch.structs.items():  # nothing else was touched
        for field, value in v[struct].items():
            if field not in expected.get(struct, {}) and hasattr(getattr(instance, field), "numpy"):
                np.testing.assert_array_equal(
                    getattr(instance, field).numpy(), np.asarray(value, dtype=getattr(instance, field).numpy().dtype)
                )
    if "rng" in launch.arguments:
        np.testing.assert_array_equal(launch.arguments["rng"].numpy(), stream.n, err_msg="numbers drawn")


def turned_alike(field: str, actual: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses with the same sign of their quaternions; angles with the same turn."""
    if field in ("root_pose", "pose"):
        sign = np.sign((actual[:, 3:] * expected[:, 3:]).sum(axis=1, keepdims=True))
        expected = np.concatenate((expected[:, :3], sign * expected[:, 3:]), axis=1)
    if field == "heading":
        expected = expected + 2.0 * np.pi * np.round((actual - expected) / (2.0 * np.pi))
    return actual, expected


def test_make_quat_unique_gives_a_real_part_that_is_not_negative(device):
    v = values()
    launch = Launch("command", "resample_uniform_pose", v, params_of({}, NUM_ENVS), Stream(1, NUM_ENVS).n, device)
    assert (launch.read("PoseCommandData", "pose")[:, 6] >= 0.0).all()


def test_errors_are_zero_where_the_pose_is_reached_and_pi_half_a_turn_away(device):
    v = values()
    robot = v["ArticulationData"]
    where, orientation = reference.desired(robot, v["PoseCommandData"])
    for turn, angle in ((Rotation.identity(), 0.0), (Rotation.from_rotvec([0.0, math.pi, 0.0]), math.pi)):
        robot["body_pose"][:, 0] = np.concatenate((where, (turn * orientation).as_quat()), axis=1)
        params = params_of({"body_ids": [0]}, NUM_ENVS)
        for name, expected in (("position_command_error", 0.0), ("orientation_command_error", angle)):
            launch = Launch("reward", name, v, params, Stream(0, NUM_ENVS).n, device)
            np.testing.assert_allclose(launch.read("result", ""), expected, atol=3e-6)


@pytest.mark.parametrize("name", ["root_height_below_minimum", "joint_pos_out_of_limit", "bad_orientation"])
def test_a_state_that_is_not_finite_terminates_nothing(name, device):
    v = values()
    for field in ("root_pose", "joint_pos"):
        v["ArticulationData"][field][:] = NAN
    launch = Launch("termination", name, v, params_of({}, NUM_ENVS), Stream(0, NUM_ENVS).n, device)
    assert not launch.read("result", "").any()


@pytest.mark.parametrize("name", ["reset_root_state_uniform", "push_by_setting_velocity", "resample_uniform_velocity"])
def test_a_term_draws_the_same_with_8_and_64_environments(name, device):
    kind = "command" if name.startswith("resample") else "event"
    struct = "VelocityCommandData" if kind == "command" else "ArticulationData"
    field = "command" if kind == "command" else "root_vel"
    found = []
    for num_envs in (8, 64):
        v = {s: {f: x[:num_envs] if np.ndim(x) and f != "gravity_dir" else x for f, x in fields.items()}
             for s, fields in values().items()}  # fmt: skip
        launch = Launch(kind, name, v, params_of({}, num_envs), Stream(SEED, num_envs).n, device)
        found.append(launch.read(struct, field)[:8])
    np.testing.assert_array_equal(*found)


# -- completeness

SENSORS = "reads a sensor; comes with it"
TERRAIN = "reads the terrain; test_terrain_terms.py tests it"
MODEL = "changes the model rather than the state; comes with domain randomisation"

EXPECTED: dict[str, str] = {
    "observation": """base_pos_z base_lin_vel base_ang_vel projected_gravity root_pos_w root_quat_w root_lin_vel_w
        root_ang_vel_w body_pose_w body_projected_gravity_b body_incoming_wrench joint_pos joint_pos_rel
        joint_pos_limit_normalized joint_vel joint_vel_rel joint_effort height_scan image imu_ang_vel imu_lin_acc
        imu_orientation last_action generated_commands current_time_s remaining_time_s""",
    "reward": """is_alive is_terminated is_terminated_term lin_vel_z_l2 ang_vel_xy_l2 flat_orientation_l2 base_height_l2
        body_lin_acc_l2 joint_torques_l2 joint_vel_l1 joint_vel_l2 joint_acc_l2 joint_deviation_l1 joint_pos_limits
        joint_vel_limits applied_torque_limits action_rate_l2 action_l2 undesired_contacts desired_contacts
        contact_forces track_lin_vel_xy_exp track_ang_vel_z_exp position_command_error position_command_error_tanh
        orientation_command_error feet_air_time feet_air_time_positive_biped feet_slide track_lin_vel_xy_yaw_frame_exp
        track_ang_vel_z_world_exp stand_still""",
    "termination": """time_out command_resample bad_orientation root_height_below_minimum joint_pos_out_of_limit
        joint_pos_out_of_manual_limit joint_vel_out_of_limit joint_vel_out_of_manual_limit joint_effort_out_of_limit
        illegal_contact terrain_out_of_bounds""",
    "event": """apply_external_force_torque push_by_setting_velocity randomize_actuator_gains randomize_joint_parameters
        randomize_physics_scene_gravity randomize_rigid_body_com randomize_rigid_body_inertia randomize_rigid_body_mass
        randomize_rigid_body_material randomize_rigid_body_collider_offsets reset_joints_by_offset
        reset_joints_by_scale reset_joints_within_limits_range reset_root_state_from_terrain reset_root_state_uniform
        reset_root_state_with_random_orientation reset_scene_to_default""",
    "command": """UniformVelocityCommand NormalVelocityCommand UniformPoseCommand UniformPose2dCommand
        TerrainBasedPose2dCommand NullCommand""",
    "action": """JointPosition RelativeJointPosition JointVelocity JointEffort JointPositionToLimits
        EMAJointPositionToLimits BinaryJointPosition BinaryJointVelocity NonHolonomic DifferentialInverseKinematics""",
}
"""The names that users of Isaac Lab expect."""

LEFT_OUT: dict[str, str] = {
    **dict.fromkeys(("height_scan", "image", "imu_ang_vel", "imu_lin_acc", "imu_orientation"), SENSORS),
    **dict.fromkeys(("undesired_contacts", "desired_contacts", "contact_forces", "illegal_contact"), SENSORS),
    **dict.fromkeys(("feet_air_time", "feet_air_time_positive_biped", "feet_slide"), SENSORS),
    **dict.fromkeys(("terrain_out_of_bounds", "reset_root_state_from_terrain"), TERRAIN),
    **{name: MODEL for name in EXPECTED["event"].split() if name.startswith("randomize_")},
    "NullCommand": "does nothing: the manager needs no function for it",
    "DifferentialInverseKinematics": "needs the joint frames of a model; tests/managers/test_inverse_kinematics.py",
}


def test_every_expected_term_exists_or_is_left_out_for_a_reason():
    for kind, names in EXPECTED.items():
        there = {"command": set(mdp.COMMANDS), "action": set(mdp.ACTIONS)}.get(kind, set(tk.term_names(kind)))
        missing = set(names.split()) - there - LEFT_OUT.keys()
        assert not missing, f"{kind}: {sorted(missing)}"
        assert not there & LEFT_OUT.keys(), "listed as left out, but there"


def test_every_term_has_a_reference_and_a_size():
    tables = {
        "observation": reference.OBSERVATIONS,
        "reward": reference.REWARDS,
        "termination": reference.TERMINATIONS,
        "event": random_reference.EVENTS,
        "command": random_reference.COMMANDS,
        "action": random_reference.ACTIONS,
    }
    for kind, table in tables.items():
        assert set(table) == set(tk.term_names(kind)), kind
    assert all(observation_size(getattr(mdp, name)) is not None for name in tk.term_names("observation"))


def test_signatures_are_those_of_their_kind():
    returns = {"observation": None, "reward": float, "termination": bool, "event": None}
    for kind in tk.KINDS:
        for name in tk.term_names(kind):
            types = getattr(mdp, name).func.__annotations__
            assert next(iter(types.items())) == ("env", int), name
            if kind in returns:
                assert types.get("return") is returns[kind], name
            if kind == "observation":
                assert list(types)[-1] == "out", name


def test_the_page_is_up_to_date():
    page = ROOT / "docs" / "terms.md"
    assert page.read_text() == term_table.page(), "python tools/documentation/term_table.py writes docs/terms.md anew"


def test_the_page_has_every_term_that_users_find():
    page = term_table.page()
    names = [n for n in public.__all__ if isinstance(getattr(public, n), wp.Function)]
    assert {"modify_reward_weight", "reach_object", "joint_pos"} <= set(names)
    assert [n for n in names if page.count(f"\n| `{n}` | ") != 1] == []
