# SPDX-License-Identifier: Apache-2.0
"""Generated kernels, one for each term, and random states for the terms to read."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from stripe_kernels import data, mdp
from stripe_kernels.term_info import observation_size
from tools.documentation import term_table

KINDS: dict[str, tuple[Any, ...]] = {name.lower()[:-1]: modules for name, modules in term_table.KINDS.items()}
"""The modules of each kind: observation, reward, termination, event, command, action."""

SLICES = ("out", "action", "processed")
"""Arguments that are the slice of one environment: a kernel holds the array of all."""

SCALARS = {int: "int", float: "float", bool: "bool"}


def size_of(function: wp.Function, counts: Mapping[str, int]) -> int:
    """Number of values that an observation writes, by its decorator."""
    size = observation_size(function)
    assert size is not None, f"{function.key} declares no size"
    return size if isinstance(size, int) else size(counts)


def term_names(kind: str) -> list[str]:
    """The terms of a kind: every Warp function that its modules list."""
    return [n for module in KINDS[kind] for n in module.__all__ if isinstance(getattr(module, n), wp.Function)]


def type_name(annotation: Any) -> str:
    """An argument's type as a kernel's source writes it."""
    if annotation in SCALARS:
        return SCALARS[annotation]
    if getattr(annotation, "cls", None) is not None:  # a struct
        return f"data.{annotation.cls.__name__}"
    if hasattr(annotation, "ndim"):  # an array
        return f"wp.array[wp.{annotation.dtype.__name__}]"
    return f"wp.{annotation.__name__}"


def kernel_source(name: str) -> str:
    """Source of the kernel of a term: its arguments after the environment, then ``result`` where it returns one."""
    types = dict(getattr(mdp, name).func.__annotations__)
    returns = types.pop("return", None)
    types.pop("env")
    parameters = [f"{arg}: {'wp.array2d[float]' if arg in SLICES else type_name(t)}" for arg, t in types.items()]
    arguments = ["env", *(f"{arg}[env]" if arg in SLICES else arg for arg in types)]
    call = f"mdp.{name}({', '.join(arguments)})"
    if returns is not None:
        parameters.append(f"result: wp.array[{SCALARS[returns].replace('bool', 'wp.bool')}]")
        call = f"result[env] = {call}"
    head = f"@wp.kernel(enable_backward=False)\ndef {name}({', '.join(parameters)}):\n"
    return f"{head}    env = wp.tid()\n    {call}\n\n\n"


def build_kernels(kind: str, folder: Path) -> Any:
    """A module with one kernel for each term of a kind. Its name is the same everywhere, so Warp's cache knows it."""
    head = "import warp as wp\nfrom stripe_kernels import data, mdp\n\n\n"
    return import_source(f"term_kernels_{kind}", head + "".join(kernel_source(n) for n in term_names(kind)), folder)


def import_source(name: str, source: str, folder: Path) -> Any:
    """Import source as a module; Warp reads it from the file again."""
    path = folder / f"{name}.py"
    path.write_text(source)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


# -- states

NUM_JOINTS, NUM_BODIES, NUM_ACTIONS, NUM_COMMAND, NUM_TERMS = 7, 5, 6, 3, 4


def random_quats(rng: np.random.Generator, *shape: int) -> np.ndarray:
    q = rng.normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def random_poses(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return np.concatenate((rng.normal(size=(*shape, 3)), random_quats(rng, *shape)), axis=-1)


def special_quats() -> np.ndarray:
    """Orientations at which formulas break: none, upside down, half turns, a quarter turn of pitch, nearly none."""
    h = np.sqrt(0.5)
    return np.array(
        [[0, 0, 0, 1], [0, 0, 0, -1], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, -1, 0], [0, h, 0, h],
         [0, -h, 0, h], [1e-5, 0, 0, 1], [0, 0, h, -h]], dtype=float
    )  # fmt: skip


def random_values(num_envs: int, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Random values of the structs' fields, float32 or whole; special cases lie in the first environments."""
    rng = np.random.default_rng(seed)
    n, j, b = num_envs, NUM_JOINTS, NUM_BODIES
    lower = -rng.uniform(0.2, 2.0, (n, j))
    upper = rng.uniform(0.2, 2.0, (n, j))
    lower[:, 3], upper[:, 3] = -1e10, 1e10  # without limits
    robot: dict[str, Any] = {
        "root_pose": random_poses(rng, n),
        "root_vel": rng.normal(size=(n, 6)),
        "default_root_pose": random_poses(rng, n),
        "default_root_vel": rng.normal(size=(n, 6)),
        "body_pose": random_poses(rng, n, b),
        "body_vel": rng.normal(size=(n, b, 6)),
        "body_acc": 10.0 * rng.normal(size=(n, b, 6)),
        "body_parent_wrench": 50.0 * rng.normal(size=(n, b, 6)),
        "joint_pos": 1.5 * rng.normal(size=(n, j)),
        "joint_vel": 3.0 * rng.normal(size=(n, j)),
        "previous_joint_vel": 3.0 * rng.normal(size=(n, j)),
        "default_joint_pos": rng.uniform(-1.0, 1.0, (n, j)),
        "default_joint_vel": rng.uniform(-1.0, 1.0, (n, j)),
        "joint_pos_target": rng.normal(size=(n, j)),
        "joint_vel_target": rng.normal(size=(n, j)),
        "joint_effort_target": rng.normal(size=(n, j)),
        "joint_drive_effort": 20.0 * rng.normal(size=(n, j)),
        "joint_other_effort": 5.0 * rng.normal(size=(n, j)),
        "joint_stiffness": rng.uniform(0.0, 50.0, (n, j)),
        "joint_damping": rng.uniform(0.0, 5.0, (n, j)),
        "joint_pos_lower": lower,
        "joint_pos_upper": upper,
        "joint_vel_limit": rng.uniform(1.0, 5.0, (n, j)),
        "joint_effort_limit": rng.uniform(10.0, 200.0, (n, j)),
        "external_wrench": np.zeros((n, b, 6)),
        "soft_limit_factor": 0.9,
        "env_origin": 10.0 * rng.normal(size=(n, 3)),
        "gravity_dir": np.array([0.0, 0.0, -1.0]),
        "physics_dt": 0.005,
    }
    special = np.delete(special_quats(), [6, 7], axis=0)[:n]  # where x is upright there is no yaw
    robot["root_pose"][: len(special), 3:] = special
    robot["body_pose"][: len(special), 0, 3:] = special[::-1]
    robot["root_vel"][0] = 0.0
    robot["joint_vel"][1] = robot["previous_joint_vel"][1]
    robot["joint_pos"][2] = robot["default_joint_pos"][2]
    for field in ("joint_pos_target", "joint_vel_target", "joint_effort_target"):  # a law of zero
        robot[field][3] = {"joint_pos_target": robot["joint_pos"], "joint_vel_target": robot["joint_vel"]}.get(
            field, np.zeros((n, j))
        )[3]
    robot["joint_pos_lower"][4, 0] = robot["joint_pos_upper"][4, 0] = 0.5  # limits that coincide
    action = {"action": rng.normal(size=(n, NUM_ACTIONS)), "prev_action": rng.normal(size=(n, NUM_ACTIONS))}
    action["action"][5] = action["prev_action"][5]
    velocity = {
        "command": rng.normal(size=(n, 3)),
        "heading_target": rng.uniform(-np.pi, np.pi, n),
        "is_heading": rng.random(n) < 0.5,
        "is_standing": rng.random(n) < 0.3,
    }
    velocity["command"][6:9] = [[0.0, 0.0, 0.0], [0.03, 0.04, 1.0], [0.06, 0.0, 0.0]]
    pose = {"pose": random_poses(rng, n)}
    pose["pose"][:2] = [0, 0, 0, 0, 0, 0, 1]
    length = rng.integers(0, 1200, n)
    length[:4] = [0, 999, 1000, 1001]
    return {
        "ArticulationData": robot,
        "ActionData": action,
        "VelocityCommandData": velocity,
        "PoseCommandData": pose,
        "Pose2dCommandData": {
            "command": np.zeros((n, 4)), "pos": rng.normal(size=(n, 3)), "heading": rng.uniform(-np.pi, np.pi, n),
        },
        "CommandData": {
            "command": rng.normal(size=(n, NUM_COMMAND)),
            "time_left": np.where(rng.random(n) < 0.5, 0.01, 0.03),
            "counter": rng.integers(1, 4, n),
        },
        "EpisodeData": {
            "length": length,
            "terminated": rng.random(n) < 0.5,
            "truncated": rng.random(n) < 0.5,
            "term_terminated": rng.random((n, NUM_TERMS)) < 0.5,
            "max_length": 1000,
            "max_length_s": 19.99,
            "step_dt": 0.02,
        },
    }  # fmt: skip


def build_struct(name: str, values: dict[str, Any], device: str) -> Any:
    """An instance of a struct of stripe_kernels.data with arrays of the values."""
    struct = getattr(data, name)
    instance = struct()
    for field, value in values.items():
        kind = struct.vars[field].type
        if hasattr(kind, "ndim"):  # an array
            instance_value = wp.array(np.ascontiguousarray(value), dtype=kind.dtype, device=device)
        elif isinstance(value, np.ndarray):
            instance_value = kind(*value)
        else:
            instance_value = value
        setattr(instance, field, instance_value)
    return instance
