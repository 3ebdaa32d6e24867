# SPDX-License-Identifier: Apache-2.0
"""Launches of single terms with parameters to try, and comparison with references in float64."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import warp as wp

from stripe_kernels import mdp
from tests.helpers import term_kernels as tk
from tests.helpers import term_reference as reference

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
    "std_standing": [0.5, 1.0, 1.5, 2.0],
    "std_walking": [1.0, 2.0, 3.0, 0.7],
    "std_running": [2.5, 0.9, 3.5, 4.0],
    "walking_threshold": 0.8,
    "running_threshold": 1.8,
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
