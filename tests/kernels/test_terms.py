# SPDX-License-Identifier: Apache-2.0
"""Every term of stripe_kernels.mdp against float64 references, on random states and the known hard cases."""

from __future__ import annotations

import copy
import math
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_kernels import mdp
from stripe_newton.envs import mdp as public
from tests.helpers import term_kernels as tk
from tests.helpers import term_reference as reference
from tests.helpers import term_reference_random as random_reference
from tests.helpers.checkout import ROOT
from tests.helpers.term_reference_random import Stream
from tools.documentation import term_table

NUM_ENVS = 64
SEED = 42
INF, NAN = math.inf, math.nan

PARAMS: dict[str, Any] = {
    "joint_ids": [5, 0, 3, 2],
    "body_ids": [0, 4, 2],
    "term_ids": [1, 3],
    "std": 1.5,
    "target_height": 0.3,
    "target": 0.2,
    "soft_ratio": 0.8,
    "command_threshold": 0.06,
    "make_quat_unique": True,
    "num_resamples": 2,
    "limit_angle": 1.0,
    "minimum_height": -0.2,
    "bounds": (-1.2, 2.0),
    "max_velocity": 4.0,
    "position_range": (-0.5, 0.8),
    "velocity_range": [(-0.5, 0.5), (0.1, 0.1), (-1.0, 0.0), (-0.2, 0.2), (0.0, 0.0), (-3.0, 3.0)],
    "pose_range": [(-0.5, 0.5), (0.25, 0.25), (0.0, 0.3), (-0.7, 0.7), (-1.5, 1.5), (-3.14, 3.14)],
    "force_range": (-5.0, 10.0),
    "torque_range": (-1.0, 1.0),
    "use_default_offset": True,
    "scale": [0.5, -1.0, 2.0, 0.1],
    "offset": [0.1, 0.2, -0.3, 0.0],
    "clip": [(-INF, INF), (-0.5, 0.7), (-1.5, INF), (-0.02, 0.02)],
    "alpha": [1.0, 0.3, 0.9, 0.0],
    "rescale_to_limits": True,
    "open_command": [0.04, 0.04, -0.2, 1.0],
    "close_command": [0.0, 0.01, 0.2, -1.0],
    "position_joint_ids": [5, 0, 3],
    "velocity_joint_ids": [1, 5],
    "resampling_time_range": (4.0, 8.0),
    "step_dt": 0.02,
    "lin_vel_x": (-1.0, 1.5),
    "lin_vel_y": (-0.5, 0.5),
    "ang_vel_z": (-1.0, 0.7),
    "heading": (-3.0, 3.0),
    "rel_heading_envs": 0.6,
    "rel_standing_envs": 0.2,
    "heading_control_stiffness": 0.5,
    "mean_vel": (0.5, 0.0, 1.0),
    "std_vel": (0.1, 0.2, 0.0),
    "zero_prob": (0.1, 0.0, 0.5),
    "pos_x": (-3.0, 3.0),
    "pos_y": (-2.0, 1.0),
    "simple_heading": False,
}
"""Parameters by name, where a case says nothing else."""

PER_JOINT: dict[str, Any] = {
    "position_range": [(-0.3, NAN), (NAN, 0.4), (-1.0, 1.0)],
    "velocity_range": [(-0.5, 0.5), (NAN, NAN)],
}
JOINT_RANGES = {"position_range": (-0.5, 0.8), "velocity_range": (-1.0, 6.0)}
CASES: dict[str, list[dict[str, Any]]] = {
    "root_quat_w": [{}, {"make_quat_unique": False}],
    "joint_vel_l2": [{}, {"joint_ids": []}, {"joint_ids": list(range(tk.NUM_JOINTS))}, {"joint_ids": [6]}],
    "joint_pos_out_of_limit": [{}, {"joint_ids": []}, {"joint_ids": [3]}, {"joint_ids": [0]}],
    "is_terminated_term": [{}, {"term_ids": []}, {"term_ids": [0, 1, 2, 3]}],
    "bad_orientation": [{}, {"limit_angle": 0.1}, {"limit_angle": 3.0}, {"limit_angle": math.pi}],
    "command_resample": [{}, {"num_resamples": 1}],
    "stand_still": [{}, {"command_threshold": 0.04}],
    "body_pose_w": [{}, {"body_ids": [3]}],
    "orientation_command_error": [{}, {"body_ids": [1]}],
    "reset_joints_by_offset": [JOINT_RANGES, {"position_range": (0.0, 0.0), "velocity_range": (0.0, 0.0)}],
    "reset_joints_by_scale": [JOINT_RANGES, {"position_range": (1.0, 1.0), "velocity_range": (0.0, 0.0)}],
    "reset_joints_within_limits_range": [
        PER_JOINT | {"scale": False, "use_default_offset": False},
        PER_JOINT | {"scale": True, "use_default_offset": False},
        PER_JOINT | {"scale": False, "use_default_offset": True},
        PER_JOINT | {"scale": True, "use_default_offset": True, "position_joint_ids": [], "velocity_joint_ids": []},
    ],
    "reset_scene_to_default": [{"reset_joint_targets": True}, {"reset_joint_targets": False}],
    "resample_uniform_velocity": [
        {},
        {"rel_heading_envs": 0.0, "rel_standing_envs": 1.0},
        {"rel_heading_envs": 1.0, "rel_standing_envs": 0.0},
    ],
    "resample_normal_velocity": [{}, {"rel_standing_envs": 1.0}, {"zero_prob": (1.0, 1.0, 1.0)}],
    "resample_uniform_pose": [{}, {"make_quat_unique": False}],
    "resample_uniform_pose_2d": [{}, {"simple_heading": True}],
    "process_joint_position": [{}, {"use_default_offset": False}],
    "process_joint_velocity": [{}, {"use_default_offset": False}],
    "process_joint_position_to_limits": [{}, {"rescale_to_limits": False}],
    "process_ema_joint_position_to_limits": [{}, {"rescale_to_limits": False}],
}
"""Parameters to try for a term; one case with those of ``PARAMS`` where nothing is listed."""

ALL_CASES = [(kind, n, case) for kind in tk.KINDS for n in tk.term_names(kind) for case in CASES.get(n, [{}])]


@cache
def kernels(kind: str) -> Any:
    return tk.build_kernels(kind, Path(mkdtemp()))


def rounded(value: Any) -> Any:
    """The value as float32 holds it, in float64."""
    if isinstance(value, dict):
        return {k: rounded(x) for k, x in value.items()}
    if isinstance(value, float):
        return float(np.float32(value))
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        return value.astype(np.float32).astype(np.float64)
    return value


def values(num_envs: int = NUM_ENVS, seed: int = 0) -> reference.Values:
    return rounded(tk.random_values(num_envs, seed))


class Launch:
    """One launch of a term's kernel, and what it left behind."""

    def __init__(
        self, kind: str, name: str, v: reference.Values, params: dict[str, Any], stream: np.ndarray, device: str
    ):
        self.num_envs = len(stream)
        self.structs: dict[str, Any] = {}
        self.arguments: dict[str, Any] = {}
        types = dict(getattr(mdp, name).func.__annotations__)
        returns = types.pop("return", None)
        types.pop("env")
        inputs = []
        for arg, kind_of in types.items():
            if arg == "rng":
                value = wp.array(stream, dtype=wp.uint32, device=device)
            elif arg in tk.SLICES:
                value = wp.array(np.asarray(params[arg], dtype=np.float32), device=device)
            elif getattr(kind_of, "cls", None) is not None:
                struct = kind_of.cls.__name__
                value = self.structs.setdefault(struct, tk.build_struct(struct, v[struct], device))
            elif hasattr(kind_of, "ndim"):
                value = wp.array(params[arg], dtype=kind_of.dtype, device=device)
            else:
                value = kind_of(*params[arg]) if isinstance(params[arg], tuple) else kind_of(params[arg])
            self.arguments[arg] = value
            inputs.append(value)
        if returns is not None:
            dtype = wp.bool if returns is bool else returns
            self.arguments["result"] = wp.zeros(self.num_envs, dtype=dtype, device=device)
            inputs.append(self.arguments["result"])
        wp.launch(getattr(kernels(kind), name), dim=self.num_envs, inputs=inputs, device=device)

    def read(self, struct: str, field: str) -> np.ndarray:
        array = self.arguments[struct] if field == "" else getattr(self.structs[struct], field)
        return array.numpy()


def params_of(case: dict[str, Any], num_envs: int, size: int | None = None) -> dict[str, Any]:
    """Parameters, and slices for a number of joints."""
    params = {k: rounded(x) for k, x in (PARAMS | case).items()}
    rng = np.random.default_rng(5)
    width = len(params["joint_ids"])
    params["action"] = rounded(rng.normal(size=(num_envs, width)))
    params["processed"] = rounded(rng.normal(size=(num_envs, width)))
    params["action"][0] = 0.0
    params["out"] = np.full((num_envs, size or 1), NAN)
    return params


def as_numpy(params: dict[str, Any]) -> dict[str, Any]:
    """The parameters as the references read them: float32 numbers in float64 arrays."""
    lists = {k: np.array(x) for k, x in params.items() if k in ("scale", "offset", "clip", "alpha") and np.ndim(x)}
    lists |= {k: np.array(params[k]) for k in ("open_command", "close_command")}
    return params | {k: rounded(x) for k, x in lists.items()}


def close(actual: np.ndarray, expected: np.ndarray, what: str) -> None:
    if expected.dtype == bool:
        np.testing.assert_array_equal(actual, expected, err_msg=what)
    else:
        scale = max(1.0, float(np.abs(expected[np.abs(expected) < 1e9]).max(initial=0.0)))
        np.testing.assert_allclose(actual, expected, rtol=1e-5, atol=4e-6 * scale, err_msg=what)


def counts(params: dict[str, Any]) -> dict[str, int]:
    ids = {k: len(params[k]) for k in ("joint_ids", "body_ids")}
    return ids | {"num_actions": tk.NUM_ACTIONS, "num_command": tk.NUM_COMMAND}


@pytest.mark.parametrize(("kind", "name", "case"), ALL_CASES, ids=[f"{n}-{list(c)}" for _, n, c in ALL_CASES])
def test_term(kind, name, case, device):
    v = values()
    params = params_of(case, NUM_ENVS)
    stream = Stream(SEED, NUM_ENVS)
    if kind == "observation":
        params = params_of(case, NUM_ENVS, mdp.OBSERVATION_SIZES[name](counts(PARAMS | case)))
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


# -- frames

FRAMES = """import warp as wp
from stripe_kernels.mdp import frames


@wp.kernel(enable_backward=False)
def angles(x: wp.array[float], wrapped: wp.array[float]):
    i = wp.tid()
    wrapped[i] = frames.wrap_to_pi(x[i])


@wp.kernel(enable_backward=False)
def rotations(
    p: wp.array[wp.quat], q: wp.array[wp.quat], u: wp.array[wp.vec3], euler: wp.array[wp.vec3],
    error: wp.array[wp.vec3], magnitude: wp.array[float], yaw: wp.array[wp.quat], level: wp.array[wp.vec3],
    unique: wp.array[wp.quat],
):
    i = wp.tid()
    euler[i] = frames.euler_xyz(q[i])
    error[i] = frames.quat_error(p[i], q[i])
    magnitude[i] = frames.quat_error_magnitude(p[i], q[i])
    yaw[i] = frames.yaw_quat(q[i])
    level[i] = frames.rotate_inverse_yaw(q[i], u[i])
    unique[i] = frames.quat_unique(q[i])
"""


@cache
def frame_kernels() -> Any:
    return tk.import_source("term_kernels_frames", FRAMES, Path(mkdtemp()))


def test_wrap_to_pi(device):
    inside = np.array([0.0, 1.0, -1.0, 3.14159, -3.14159, 3.1415925, -3.1415925], dtype=np.float32)
    x = np.concatenate((inside, np.linspace(-40.0, 40.0, 801, dtype=np.float32)))
    out = wp.empty(len(x), dtype=float, device=device)
    wp.launch(frame_kernels().angles, dim=len(x), inputs=[wp.array(x, device=device), out], device=device)
    wrapped = out.numpy()
    np.testing.assert_array_equal(wrapped[: len(inside)], inside)
    assert (np.abs(wrapped) <= np.float32(np.pi)).all()
    turns = (x.astype(float) - wrapped) / (2.0 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=2e-6)


def test_rotations(device):
    rng = np.random.default_rng(1)
    special = tk.special_quats()
    q = np.concatenate((special, tk.random_quats(rng, 200))).astype(np.float32)
    p = np.concatenate((tk.random_quats(rng, len(special)), q[len(special) : -5], q[-5:])).astype(np.float32)
    p[len(special) : -5] = tk.random_quats(rng, len(q) - len(special) - 5)
    p[-5:] = -p[-5:]  # the same rotations
    u = rng.normal(size=(len(q), 3)).astype(np.float32)
    n = len(q)
    types = (wp.vec3, wp.vec3, wp.float32, wp.quat, wp.vec3, wp.quat)
    outs = [wp.empty(n, dtype=t, device=device) for t in types]
    ins = [wp.array(a, dtype=t, device=device) for a, t in ((p, wp.quat), (q, wp.quat), (u, wp.vec3))]
    wp.launch(frame_kernels().rotations, dim=n, inputs=[*ins, *outs], device=device)
    euler, error, magnitude, yaw, level, unique = (o.numpy() for o in outs)
    rp, rq = Rotation.from_quat(p), Rotation.from_quat(q)

    back = Rotation.from_euler("xyz", euler)
    assert (back * rq.inv()).magnitude().max() < 2e-6
    assert np.abs(euler[:, 1]).max() <= np.float32(np.pi / 2) + 1e-6
    assert np.abs(euler).max() <= np.float32(np.pi)
    # a rotation vector of half a turn has two signs
    assert (Rotation.from_rotvec(error) * rp * rq.inv()).magnitude().max() < 3e-6
    np.testing.assert_allclose(magnitude, (rq * rp.inv()).magnitude(), atol=2e-6)
    heading = reference.heading(q.astype(float))
    level_x = rq.apply([1.0, 0.0, 0.0])
    defined = np.hypot(level_x[:, 0], level_x[:, 1]) > 1e-3
    expected = Rotation.from_euler("z", heading[:, None])
    assert (Rotation.from_quat(yaw) * expected.inv()).magnitude()[defined].max() < 2e-4
    np.testing.assert_allclose(level[defined], expected.inv().apply(u)[defined], atol=2e-4)
    np.testing.assert_array_equal(unique, np.where(q[:, 3:] < 0.0, -q, q))


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
    assert set(mdp.OBSERVATION_SIZES) == set(tk.term_names("observation"))


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
