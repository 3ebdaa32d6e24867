# SPDX-License-Identifier: Apache-2.0
"""Reference of events, commands and actions in float64.

Each takes the values, the parameters and a stream, and returns the expected content of the fields that it writes, by
struct and field.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tests.helpers.term_reference import (
    Params,
    Values,
    ang_vel_b,
    heading,
    in_yaw_frame,
    lin_vel_b,
    rotation,
    soft_limits,
    wrap,
)

Written = dict[str, dict[str, np.ndarray]]


def pcg(x: np.ndarray) -> np.ndarray:
    """The hash PCG-RXS-M-XS of 32 bits."""
    b = x.astype(np.uint32) * np.uint32(747796405) + np.uint32(2891336453)
    c = ((b >> ((b >> np.uint32(28)) + np.uint32(4))) ^ b) * np.uint32(277803737)
    return (c >> np.uint32(22)) ^ c


class Stream:
    """The random numbers of all environments."""

    def __init__(self, seed: int, num_envs: int):
        self.env = np.arange(num_envs, dtype=np.uint32)
        self.n = pcg(np.uint32(seed) + pcg(self.env))

    def uniform(self, low: Any = 0.0, high: Any = 1.0, where: np.ndarray | None = None) -> np.ndarray:
        bits = pcg(pcg(self.env + pcg(self.n)))
        self.n = np.where(True if where is None else where, self.n + np.uint32(1), self.n).astype(np.uint32)
        return low + (high - low) * (bits >> np.uint32(8)).astype(float) / 2.0**24

    def normal(self) -> np.ndarray:
        u, v = self.uniform(), self.uniform()
        return np.sqrt(-2.0 * np.log(1.0 - u)) * np.cos(2.0 * np.pi * v)

    def rows(self, bounds: np.ndarray) -> np.ndarray:
        return np.stack([self.uniform(*b) for b in bounds], axis=-1)


def from_euler(angles: np.ndarray) -> Rotation:
    return Rotation.from_euler("xyz", angles)  # lower case: about the fixed axes


# -- events


def _write_joints(v: Values, ids: list[int], pos: np.ndarray, vel: np.ndarray) -> Written:
    r = v["ArticulationData"]
    lower, upper = soft_limits(r)
    new_pos, new_vel = r["joint_pos"].copy(), r["joint_vel"].copy()
    new_pos[:, ids] = np.clip(pos, lower[:, ids], upper[:, ids])
    new_vel[:, ids] = np.clip(vel, -r["joint_vel_limit"][:, ids], r["joint_vel_limit"][:, ids])
    return {"ArticulationData": {"joint_pos": new_pos, "joint_vel": new_vel}}


def _draw_joints(s: Stream, p: Params) -> tuple[np.ndarray, np.ndarray]:
    pairs = [(s.uniform(*p["position_range"]), s.uniform(*p["velocity_range"])) for _ in p["joint_ids"]]
    return np.stack([a for a, _ in pairs], axis=-1), np.stack([b for _, b in pairs], axis=-1)


def reset_joints_by_offset(v: Values, p: Params, s: Stream) -> Written:
    r, ids = v["ArticulationData"], p["joint_ids"]
    pos, vel = _draw_joints(s, p)
    return _write_joints(v, ids, r["default_joint_pos"][:, ids] + pos, r["default_joint_vel"][:, ids] + vel)


def reset_joints_by_scale(v: Values, p: Params, s: Stream) -> Written:
    r, ids = v["ArticulationData"], p["joint_ids"]
    pos, vel = _draw_joints(s, p)
    return _write_joints(v, ids, r["default_joint_pos"][:, ids] * pos, r["default_joint_vel"][:, ids] * vel)


def reset_joints_within_limits_range(v: Values, p: Params, s: Stream) -> Written:
    r = v["ArticulationData"]
    speed = r["joint_vel_limit"]
    out = {}
    for field, limits in (("position", soft_limits(r)), ("velocity", (-speed, speed))):
        name = f"joint_{field[:3]}"
        new = r[f"default_{name}"].copy()
        for joint, bounds in zip(p[f"{field}_joint_ids"], p[f"{field}_range"]):
            ends = []
            for bound, limit in zip(bounds, limits):
                given = limit[:, joint] * bound if p["scale"] else np.full(len(new), bound)
                ends.append(limit[:, joint] if np.isnan(bound) else given)
            offset = r[f"default_{name}"][:, joint] if p["use_default_offset"] else 0.0
            drawn = s.uniform(ends[0] + offset, ends[1] + offset)
            new[:, joint] = np.clip(drawn, limits[0][:, joint], limits[1][:, joint])
        out[name] = new
    return {"ArticulationData": out}


def reset_root_state_uniform(v: Values, p: Params, s: Stream) -> Written:
    r = v["ArticulationData"]
    offset, angles = s.rows(p["pose_range"][:3]), s.rows(p["pose_range"][3:])
    turned = rotation(r["default_root_pose"]) * from_euler(angles)
    pose = np.concatenate((r["default_root_pose"][:, :3] + r["env_origin"] + offset, turned.as_quat()), axis=1)
    return {"ArticulationData": {"root_pose": pose, "root_vel": r["default_root_vel"] + s.rows(p["velocity_range"])}}


def reset_root_state_with_random_orientation(v: Values, p: Params, s: Stream) -> Written:
    r = v["ArticulationData"]
    position = r["default_root_pose"][:, :3] + r["env_origin"] + s.rows(p["pose_range"][:3])
    u, a, b = s.uniform(), s.uniform(0.0, 2.0 * np.pi), s.uniform(0.0, 2.0 * np.pi)
    quat = [np.sqrt(1 - u) * np.sin(a), np.sqrt(1 - u) * np.cos(a), np.sqrt(u) * np.sin(b), np.sqrt(u) * np.cos(b)]
    pose = np.concatenate((position, np.stack(quat, axis=1)), axis=1)
    return {"ArticulationData": {"root_pose": pose, "root_vel": r["default_root_vel"] + s.rows(p["velocity_range"])}}


def reset_root_to_default(v: Values, p: Params, s: Stream) -> Written:
    r = v["ArticulationData"]
    pose = r["default_root_pose"].copy()
    pose[:, :3] += r["env_origin"]
    return {"ArticulationData": {"root_pose": pose, "root_vel": r["default_root_vel"]}}


def reset_joints_to_default(v: Values, p: Params, s: Stream) -> Written:
    r = v["ArticulationData"]
    return {"ArticulationData": {"joint_pos": r["default_joint_pos"], "joint_vel": r["default_joint_vel"]}}


def reset_joint_targets_to_default(v: Values, p: Params, s: Stream) -> Written:
    r = v["ArticulationData"]
    return {
        "ArticulationData": {"joint_pos_target": r["default_joint_pos"], "joint_vel_target": r["default_joint_vel"]}
    }


def reset_scene_to_default(v: Values, p: Params, s: Stream) -> Written:
    terms = [reset_root_to_default, reset_joints_to_default]
    terms += [reset_joint_targets_to_default] if p["reset_joint_targets"] else []
    return {"ArticulationData": {k: x for term in terms for k, x in term(v, p, s)["ArticulationData"].items()}}


def push_by_setting_velocity(v: Values, p: Params, s: Stream) -> Written:
    return {"ArticulationData": {"root_vel": v["ArticulationData"]["root_vel"] + s.rows(p["velocity_range"])}}


def apply_external_force_torque(v: Values, p: Params, s: Stream) -> Written:
    wrench = v["ArticulationData"]["external_wrench"].copy()
    for body in p["body_ids"]:
        wrench[:, body] = s.rows([p["force_range"]] * 3 + [p["torque_range"]] * 3)
    return {"ArticulationData": {"external_wrench": wrench}}


EVENTS: dict[str, Callable[[Values, Params, Stream], Written]] = {
    f.__name__: f
    for f in (
        reset_joints_by_offset, reset_joints_by_scale, reset_joints_within_limits_range, reset_root_state_uniform,
        reset_root_state_with_random_orientation, reset_root_to_default, reset_joints_to_default,
        reset_joint_targets_to_default, reset_scene_to_default, push_by_setting_velocity, apply_external_force_torque,
    )
}  # fmt: skip


# -- commands


def restart_command(v: Values, p: Params, s: Stream) -> Written:
    drawn = s.uniform(*p["resampling_time_range"])
    return {"CommandData": {"time_left": drawn, "counter": np.ones(len(drawn), dtype=int)}}


def advance_command(v: Values, p: Params, s: Stream) -> Written:
    c = v["CommandData"]
    left = c["time_left"] - p["step_dt"]
    due = left <= 0.0
    drawn = s.uniform(*p["resampling_time_range"], where=due)
    return {
        "CommandData": {"time_left": np.where(due, drawn, left), "counter": c["counter"] + due},
        "result": {"": due},
    }


def resample_uniform_velocity(v: Values, p: Params, s: Stream) -> Written:
    command = s.rows([p["lin_vel_x"], p["lin_vel_y"], p["ang_vel_z"]])
    target = s.uniform(*p["heading"])
    is_heading, is_standing = s.uniform() < p["rel_heading_envs"], s.uniform() < p["rel_standing_envs"]
    written = {"command": command, "heading_target": target, "is_heading": is_heading, "is_standing": is_standing}
    return {"VelocityCommandData": written}


def update_uniform_velocity(v: Values, p: Params, s: Stream) -> Written:
    c = v["VelocityCommandData"]
    command = c["command"].copy()
    rate = p["heading_control_stiffness"] * wrap(c["heading_target"] - heading(v["ArticulationData"]["root_pose"]))
    command[:, 2] = np.where(c["is_heading"], np.clip(rate, *p["ang_vel_z"]), command[:, 2])
    command[c["is_standing"]] = 0.0
    return {"VelocityCommandData": {"command": command}}


def resample_normal_velocity(v: Values, p: Params, s: Stream) -> Written:
    standing = s.uniform() < p["rel_standing_envs"]
    columns = []
    for mean, std, zero in zip(p["mean_vel"], p["std_vel"], p["zero_prob"]):
        value = mean + std * s.normal()
        value = np.where(s.uniform() < 0.5, -value, value)
        columns.append(np.where((s.uniform() < zero) | standing, 0.0, value))
    none = np.zeros(len(standing), dtype=bool)
    written = {"command": np.stack(columns, axis=1), "is_heading": none, "is_standing": standing}
    return {"VelocityCommandData": written}


def velocity_error_xy(v: Values, p: Params, s: Stream) -> Written:
    error = v["VelocityCommandData"]["command"][:, :2] - lin_vel_b(v["ArticulationData"])[:, :2]
    return {"result": {"": np.linalg.norm(error, axis=1)}}


def velocity_error_yaw(v: Values, p: Params, s: Stream) -> Written:
    return {"result": {"": np.abs(v["VelocityCommandData"]["command"][:, 2] - ang_vel_b(v["ArticulationData"])[:, 2])}}


def resample_uniform_pose(v: Values, p: Params, s: Stream) -> Written:
    position, angles = s.rows(p["pose_range"][:3]), s.rows(p["pose_range"][3:])
    quat = from_euler(angles).as_quat(canonical=bool(p["make_quat_unique"]))
    return {"PoseCommandData": {"pose": np.concatenate((position, quat), axis=1)}}


def resample_uniform_pose_2d(v: Values, p: Params, s: Stream) -> Written:
    r = v["ArticulationData"]
    offset = s.rows([p["pos_x"], p["pos_y"]])
    target = s.uniform(*p["heading"])
    position = r["env_origin"] + np.concatenate((offset, r["default_root_pose"][:, 2:3]), axis=1)
    if p["simple_heading"]:
        way = position - r["root_pose"][:, :3]
        there = np.arctan2(way[:, 1], way[:, 0])
        back = wrap(there + np.pi)
        now = heading(r["root_pose"])
        target = np.where(np.abs(wrap(there - now)) < np.abs(wrap(back - now)), there, back)
    return {"Pose2dCommandData": {"pos": position, "heading": target}}


def update_uniform_pose_2d(v: Values, p: Params, s: Stream) -> Written:
    r, c = v["ArticulationData"], v["Pose2dCommandData"]
    local = in_yaw_frame(r["root_pose"], c["pos"] - r["root_pose"][:, :3])
    turn = wrap(c["heading"] - heading(r["root_pose"]))
    return {"Pose2dCommandData": {"command": np.concatenate((local, turn[:, None]), axis=1)}}


def pose_2d_error_pos(v: Values, p: Params, s: Stream) -> Written:
    way = v["Pose2dCommandData"]["pos"] - v["ArticulationData"]["root_pose"][:, :3]
    return {"result": {"": np.linalg.norm(way[:, :2], axis=1)}}


def pose_2d_error_heading(v: Values, p: Params, s: Stream) -> Written:
    turn = wrap(v["Pose2dCommandData"]["heading"] - heading(v["ArticulationData"]["root_pose"]))
    return {"result": {"": np.abs(turn)}}


COMMANDS: dict[str, Callable[[Values, Params, Stream], Written]] = {
    f.__name__: f
    for f in (
        restart_command, advance_command, resample_uniform_velocity, update_uniform_velocity, resample_normal_velocity,
        velocity_error_xy, velocity_error_yaw, resample_uniform_pose, resample_uniform_pose_2d, update_uniform_pose_2d,
        pose_2d_error_pos, pose_2d_error_heading,
    )
}  # fmt: skip


# -- actions


def process_action(v: Values, p: Params, s: Stream) -> Written:
    return {"processed": {"": np.clip(p["scale"] * p["action"] + p["offset"], p["clip"][:, 0], p["clip"][:, 1])}}


def _process_joint(v: Values, p: Params, default: str) -> Written:
    offset = v["ArticulationData"][default][:, p["joint_ids"]] if p["use_default_offset"] else p["offset"]
    return {"processed": {"": np.clip(p["scale"] * p["action"] + offset, p["clip"][:, 0], p["clip"][:, 1])}}


def process_joint_position(v: Values, p: Params, s: Stream) -> Written:
    return _process_joint(v, p, "default_joint_pos")


def process_joint_velocity(v: Values, p: Params, s: Stream) -> Written:
    return _process_joint(v, p, "default_joint_vel")


def process_joint_position_to_limits(v: Values, p: Params, s: Stream) -> Written:
    lower, upper = (limit[:, p["joint_ids"]] for limit in soft_limits(v["ArticulationData"]))
    y = np.clip(p["scale"] * p["action"], p["clip"][:, 0], p["clip"][:, 1])
    if p["rescale_to_limits"]:
        y = lower + (np.clip(y, -1.0, 1.0) + 1.0) / 2.0 * (upper - lower)
    return {"processed": {"": y}}


def process_ema_joint_position_to_limits(v: Values, p: Params, s: Stream) -> Written:
    lower, upper = (limit[:, p["joint_ids"]] for limit in soft_limits(v["ArticulationData"]))
    new = process_joint_position_to_limits(v, p, s)["processed"][""]
    return {"processed": {"": np.clip(p["alpha"] * new + (1.0 - p["alpha"]) * p["processed"], lower, upper)}}


def reset_ema_joint_position_to_limits(v: Values, p: Params, s: Stream) -> Written:
    return {"processed": {"": v["ArticulationData"]["joint_pos"][:, p["joint_ids"]]}}


def process_binary_joint(v: Values, p: Params, s: Stream) -> Written:
    chosen = np.where(p["action"][:, :1] < 0.0, p["close_command"], p["open_command"])
    return {"processed": {"": np.clip(chosen, p["clip"][:, 0], p["clip"][:, 1])}}


def _apply(v: Values, p: Params, field: str, values: np.ndarray) -> Written:
    new = v["ArticulationData"][field].copy()
    new[:, p["joint_ids"]] = values
    return {"ArticulationData": {field: new}}


def apply_joint_position(v: Values, p: Params, s: Stream) -> Written:
    return _apply(v, p, "joint_pos_target", p["processed"])


def apply_relative_joint_position(v: Values, p: Params, s: Stream) -> Written:
    return _apply(v, p, "joint_pos_target", v["ArticulationData"]["joint_pos"][:, p["joint_ids"]] + p["processed"])


def apply_joint_velocity(v: Values, p: Params, s: Stream) -> Written:
    return _apply(v, p, "joint_vel_target", p["processed"])


def apply_joint_effort(v: Values, p: Params, s: Stream) -> Written:
    return _apply(v, p, "joint_effort_target", p["processed"])


def apply_non_holonomic(v: Values, p: Params, s: Stream) -> Written:
    yaw = heading(v["ArticulationData"]["body_pose"][:, p["body_ids"][0]])
    u = p["processed"]
    targets = np.stack((np.cos(yaw) * u[:, 0], np.sin(yaw) * u[:, 0], u[:, 1]), axis=1)
    return _apply(v, p | {"joint_ids": p["joint_ids"][:3]}, "joint_vel_target", targets)


ACTIONS: dict[str, Callable[[Values, Params, Stream], Written]] = {
    f.__name__: f
    for f in (
        process_action, process_joint_position, process_joint_velocity, process_joint_position_to_limits,
        process_ema_joint_position_to_limits, reset_ema_joint_position_to_limits, process_binary_joint,
        apply_joint_position, apply_relative_joint_position, apply_joint_velocity, apply_joint_effort,
        apply_non_holonomic,
    )
}  # fmt: skip
