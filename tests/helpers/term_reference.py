# SPDX-License-Identifier: Apache-2.0
"""Reference of the terms in float64, with NumPy and SciPy, for all environments at once.

``v`` holds the values of the structs' fields by struct, ``p`` the parameters by name.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

Values = dict[str, dict[str, Any]]
Params = dict[str, Any]


def rotation(poses: np.ndarray) -> Rotation:
    return Rotation.from_quat(poses.reshape(-1, poses.shape[-1])[:, -4:])


def wrap(angle: np.ndarray) -> np.ndarray:
    return np.pi - np.mod(np.pi - angle, 2.0 * np.pi)


def heading(poses: np.ndarray) -> np.ndarray:
    x = rotation(poses).apply([1.0, 0.0, 0.0])
    return np.arctan2(x[:, 1], x[:, 0])


def in_yaw_frame(poses: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return Rotation.from_euler("z", heading(poses)[:, None]).inv().apply(vectors)


def soft_limits(r: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    middle, width = (r["joint_pos_lower"] + r["joint_pos_upper"]) / 2, r["joint_pos_upper"] - r["joint_pos_lower"]
    return middle - r["soft_limit_factor"] * width / 2, middle + r["soft_limit_factor"] * width / 2


def lin_vel_b(r: dict[str, Any]) -> np.ndarray:
    return rotation(r["root_pose"]).inv().apply(r["root_vel"][:, :3])


def ang_vel_b(r: dict[str, Any]) -> np.ndarray:
    return rotation(r["root_pose"]).inv().apply(r["root_vel"][:, 3:])


def gravity_b(r: dict[str, Any]) -> np.ndarray:
    return rotation(r["root_pose"]).inv().apply(r["gravity_dir"])


def effort(r: dict[str, Any]) -> np.ndarray:
    return r["joint_drive_effort"] + r["joint_other_effort"]


def drive_law(r: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    law = r["joint_stiffness"] * (r["joint_pos_target"] - r["joint_pos"])
    law = law + r["joint_damping"] * (r["joint_vel_target"] - r["joint_vel"]) + r["joint_effort_target"]
    return law, np.clip(law, -r["joint_effort_limit"], r["joint_effort_limit"])


def desired(r: dict[str, Any], c: dict[str, Any]) -> tuple[np.ndarray, Rotation]:
    root = rotation(r["root_pose"])
    return r["root_pose"][:, :3] + root.apply(c["pose"][:, :3]), root * rotation(c["pose"])


# -- observations: (num_envs, size)


def body_pose_w(v: Values, p: Params) -> np.ndarray:
    r = v["ArticulationData"]
    poses = r["body_pose"][:, p["body_ids"]].copy()
    poses[..., :3] -= r["env_origin"][:, None]
    return poses.reshape(len(poses), -1)


def body_projected_gravity_b(v: Values, p: Params) -> np.ndarray:
    r = v["ArticulationData"]
    poses = r["body_pose"][:, p["body_ids"]]
    return rotation(poses).inv().apply(r["gravity_dir"]).reshape(len(poses), -1)


def joint_pos_limit_normalized(v: Values, p: Params) -> np.ndarray:
    r, ids = v["ArticulationData"], p["joint_ids"]
    lower, upper = (limit[:, ids] for limit in soft_limits(r))
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = 2.0 * (r["joint_pos"][:, ids] - (lower + upper) / 2) / (upper - lower)
    return np.where(upper > lower, scaled, 0.0)


def root_quat_w(v: Values, p: Params) -> np.ndarray:
    q = v["ArticulationData"]["root_pose"][:, 3:]
    return np.where((q[:, 3:] < 0.0) & p["make_quat_unique"], -q, q)


def _joints(formula: Callable[[dict[str, Any]], np.ndarray]) -> Callable[[Values, Params], np.ndarray]:
    return lambda v, p: formula(v["ArticulationData"])[:, p["joint_ids"]]


def _robot(formula: Callable[[dict[str, Any]], np.ndarray]) -> Callable[[Values, Params], np.ndarray]:
    return lambda v, p: formula(v["ArticulationData"])


OBSERVATIONS: dict[str, Callable[[Values, Params], np.ndarray]] = {
    "base_pos_z": _robot(lambda r: r["root_pose"][:, 2:3]),
    "base_lin_vel": _robot(lin_vel_b),
    "base_ang_vel": _robot(ang_vel_b),
    "projected_gravity": _robot(gravity_b),
    "root_pos_w": _robot(lambda r: r["root_pose"][:, :3] - r["env_origin"]),
    "root_quat_w": root_quat_w,
    "root_lin_vel_w": _robot(lambda r: r["root_vel"][:, :3]),
    "root_ang_vel_w": _robot(lambda r: r["root_vel"][:, 3:]),
    "body_pose_w": body_pose_w,
    "body_projected_gravity_b": body_projected_gravity_b,
    "body_incoming_wrench": lambda v, p: v["ArticulationData"]["body_parent_wrench"][:, p["body_ids"]].reshape(
        -1, 6 * len(p["body_ids"])
    ),
    "joint_pos": _joints(lambda r: r["joint_pos"]),
    "joint_pos_rel": _joints(lambda r: r["joint_pos"] - r["default_joint_pos"]),
    "joint_pos_limit_normalized": joint_pos_limit_normalized,
    "joint_vel": _joints(lambda r: r["joint_vel"]),
    "joint_vel_rel": _joints(lambda r: r["joint_vel"] - r["default_joint_vel"]),
    "joint_effort": _joints(effort),
    "last_action": lambda v, p: v["ActionData"]["action"],
    "generated_commands": lambda v, p: v["CommandData"]["command"],
    "current_time_s": lambda v, p: (v["EpisodeData"]["length"] * v["EpisodeData"]["step_dt"])[:, None],
    "remaining_time_s": lambda v, p: (
        v["EpisodeData"]["max_length_s"] - v["EpisodeData"]["length"] * v["EpisodeData"]["step_dt"]
    )[:, None],
}


# -- rewards: (num_envs,)


def is_terminated_term(v: Values, p: Params) -> np.ndarray:
    e = v["EpisodeData"]
    return e["term_terminated"][:, p["term_ids"]].sum(axis=1) * ~e["truncated"]


def joint_pos_limits(r: dict[str, Any]) -> np.ndarray:
    lower, upper = soft_limits(r)
    return np.maximum(lower - r["joint_pos"], 0.0) + np.maximum(r["joint_pos"] - upper, 0.0)


def joint_vel_limits(v: Values, p: Params) -> np.ndarray:
    r, ids = v["ArticulationData"], p["joint_ids"]
    excess = np.abs(r["joint_vel"]) - p["soft_ratio"] * r["joint_vel_limit"]
    return np.clip(excess, 0.0, 1.0)[:, ids].sum(axis=1)


def position_command_error(v: Values, p: Params) -> np.ndarray:
    r = v["ArticulationData"]
    position, _ = desired(r, v["PoseCommandData"])
    return np.linalg.norm(r["body_pose"][:, p["body_ids"][0], :3] - position, axis=1)


def orientation_command_error(v: Values, p: Params) -> np.ndarray:
    r = v["ArticulationData"]
    _, orientation = desired(r, v["PoseCommandData"])
    return (orientation * rotation(r["body_pose"][:, p["body_ids"][0]]).inv()).magnitude()


def stand_still(v: Values, p: Params) -> np.ndarray:
    r = v["ArticulationData"]
    speed = np.linalg.norm(v["VelocityCommandData"]["command"][:, :2], axis=1)
    deviation = np.abs(r["joint_pos"] - r["default_joint_pos"])[:, p["joint_ids"]].sum(axis=1)
    return np.where(speed < p["command_threshold"], deviation, 0.0)


def _tracking(
    velocity: Callable[[dict[str, Any]], np.ndarray], columns: slice
) -> Callable[[Values, Params], np.ndarray]:
    def value(v: Values, p: Params) -> np.ndarray:
        error = v["VelocityCommandData"]["command"][:, columns] - velocity(v["ArticulationData"])
        return np.exp(-(error**2).sum(axis=1) / p["std"] ** 2)

    return value


def upright(v: Values, p: Params) -> np.ndarray:
    r = v["ArticulationData"]
    tilts = [rotation(r["body_pose"][:, i]).inv().apply(r["gravity_dir"])[:, :2] for i in p["body_ids"]]
    return np.exp(-(np.stack(tilts) ** 2).sum(axis=(0, 2)) / p["std"] ** 2)


def variable_posture(v: Values, p: Params) -> np.ndarray:
    r, c = v["ArticulationData"], v["VelocityCommandData"]["command"]
    speed = np.hypot(c[:, 0], c[:, 1]) + np.abs(c[:, 2])
    kind = np.digitize(speed, [p["walking_threshold"], p["running_threshold"]])
    assert set(kind) == {0, 1, 2}, "every gait occurs"
    std = np.array([p["std_standing"], p["std_walking"], p["std_running"]], dtype=np.float32)[kind]
    error = (r["joint_pos"] - r["default_joint_pos"])[:, p["joint_ids"]] / std
    return np.exp(-(error**2).mean(axis=1))


def _sum(formula: Callable[[dict[str, Any]], np.ndarray]) -> Callable[[Values, Params], np.ndarray]:
    return lambda v, p: formula(v["ArticulationData"])[:, p["joint_ids"]].sum(axis=1)


REWARDS: dict[str, Callable[[Values, Params], np.ndarray]] = {
    "is_alive": lambda v, p: 1.0 - v["EpisodeData"]["terminated"],
    "is_terminated": lambda v, p: 1.0 * v["EpisodeData"]["terminated"],
    "is_terminated_term": is_terminated_term,
    "lin_vel_z_l2": _robot(lambda r: lin_vel_b(r)[:, 2] ** 2),
    "ang_vel_xy_l2": _robot(lambda r: (ang_vel_b(r)[:, :2] ** 2).sum(axis=1)),
    "flat_orientation_l2": _robot(lambda r: (gravity_b(r)[:, :2] ** 2).sum(axis=1)),
    "base_height_l2": lambda v, p: (v["ArticulationData"]["root_pose"][:, 2] - p["target_height"]) ** 2,
    "body_lin_acc_l2": lambda v, p: np.linalg.norm(
        v["ArticulationData"]["body_acc"][:, p["body_ids"], :3], axis=-1
    ).sum(axis=1),
    "joint_torques_l2": _sum(lambda r: effort(r) ** 2),
    "joint_vel_l1": _sum(lambda r: np.abs(r["joint_vel"])),
    "joint_vel_l2": _sum(lambda r: r["joint_vel"] ** 2),
    "joint_acc_l2": _sum(lambda r: ((r["joint_vel"] - r["previous_joint_vel"]) / r["physics_dt"]) ** 2),
    "joint_deviation_l1": _sum(lambda r: np.abs(r["joint_pos"] - r["default_joint_pos"])),
    "joint_pos_target_l2": lambda v, p: ((wrap(v["ArticulationData"]["joint_pos"]) - p["target"]) ** 2)[
        :, p["joint_ids"]
    ].sum(axis=1),
    "joint_pos_limits": _sum(joint_pos_limits),
    "joint_vel_limits": joint_vel_limits,
    "applied_torque_limits": _sum(lambda r: np.abs(drive_law(r)[0] - drive_law(r)[1])),
    "action_rate_l2": lambda v, p: ((v["ActionData"]["action"] - v["ActionData"]["prev_action"]) ** 2).sum(axis=1),
    "action_l2": lambda v, p: (v["ActionData"]["action"] ** 2).sum(axis=1),
    "track_lin_vel_xy_exp": _tracking(lambda r: lin_vel_b(r)[:, :2], slice(0, 2)),
    "track_ang_vel_z_exp": _tracking(lambda r: ang_vel_b(r)[:, 2:], slice(2, 3)),
    "track_lin_vel_xy_yaw_frame_exp": _tracking(
        lambda r: in_yaw_frame(r["root_pose"], r["root_vel"][:, :3])[:, :2], slice(0, 2)
    ),
    "track_ang_vel_z_world_exp": _tracking(lambda r: r["root_vel"][:, 5:], slice(2, 3)),
    "stand_still": stand_still,
    "position_command_error": position_command_error,
    "position_command_error_tanh": lambda v, p: 1.0 - np.tanh(position_command_error(v, p) / p["std"]),
    "orientation_command_error": orientation_command_error,
    "track_linear_velocity": lambda v, p: np.exp(
        -((v["VelocityCommandData"]["command"] * [1, 1, 0] - lin_vel_b(v["ArticulationData"])) ** 2).sum(axis=1)
        / p["std"] ** 2
    ),
    "track_angular_velocity": lambda v, p: np.exp(
        -((v["VelocityCommandData"]["command"] * [0, 0, 1] - ang_vel_b(v["ArticulationData"])) ** 2).sum(axis=1)
        / p["std"] ** 2
    ),
    "upright": upright,
    "body_angular_velocity_penalty": lambda v, p: (v["ArticulationData"]["body_vel"][:, p["body_ids"], 3:5] ** 2).sum(
        axis=(1, 2)
    ),
    "variable_posture": variable_posture,
}


# -- terminations: (num_envs,) bool


def joint_pos_out_of_limit(r: dict[str, Any]) -> np.ndarray:
    lower, upper = soft_limits(r)
    return (r["joint_pos"] < lower) | (r["joint_pos"] > upper)


def _any(formula: Callable[[dict[str, Any], Params], np.ndarray]) -> Callable[[Values, Params], np.ndarray]:
    return lambda v, p: formula(v["ArticulationData"], p)[:, p["joint_ids"]].any(axis=1)


TERMINATIONS: dict[str, Callable[[Values, Params], np.ndarray]] = {
    "time_out": lambda v, p: v["EpisodeData"]["length"] >= v["EpisodeData"]["max_length"],
    "command_resample": lambda v, p: (
        (v["CommandData"]["time_left"] <= v["EpisodeData"]["step_dt"])
        & (v["CommandData"]["counter"] == p["num_resamples"])
    ),
    "bad_orientation": lambda v, p: (
        np.arccos(np.clip(-gravity_b(v["ArticulationData"])[:, 2], -1.0, 1.0)) > p["limit_angle"]
    ),
    "root_height_below_minimum": lambda v, p: v["ArticulationData"]["root_pose"][:, 2] < p["minimum_height"],
    "joint_pos_out_of_limit": _any(lambda r, p: joint_pos_out_of_limit(r)),
    "joint_pos_out_of_manual_limit": _any(
        lambda r, p: (r["joint_pos"] < p["bounds"][0]) | (r["joint_pos"] > p["bounds"][1])
    ),
    "joint_vel_out_of_limit": _any(lambda r, p: np.abs(r["joint_vel"]) > r["joint_vel_limit"]),
    "joint_vel_out_of_manual_limit": _any(lambda r, p: np.abs(r["joint_vel"]) > p["max_velocity"]),
    "joint_effort_out_of_limit": _any(lambda r, p: ~np.isclose(*drive_law(r))),
}
