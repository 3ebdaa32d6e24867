# SPDX-License-Identifier: Apache-2.0
"""Command controls: what of a task's commands can be set by hand, as numbers with bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from stripe_newton.math import euler_xyz_from_quat, quat_from_euler_xyz

if TYPE_CHECKING:
    from .viewed_env import ViewedEnv

__all__ = ["CommandControl", "command_controls"]

_HOLD_S = 1.0e6
"""Time for which the task draws no other command [s]."""
_LEAST = 1.0
"""Least half of a range, for ranges that a task has shrunk to a point."""
_MOST_NUMBERS = 12
"""Most numbers of a command of an unknown kind that get a slider."""
_ANGLES = ("roll", "pitch", "yaw")


@dataclass
class CommandControl:
    """A command that can be set by hand."""

    name: str
    """Its name."""
    numbers: dict[str, tuple[float, float]]
    """Bounds of each number by its name."""
    read: Callable[[int], Sequence[float]]
    """The numbers of an environment."""
    write: Callable[[torch.Tensor, Sequence[float]], None]
    """Sets them in some environments, given by index."""
    release: Callable[[torch.Tensor], None]
    """Lets the task draw new ones there."""


def command_controls(env: ViewedEnv) -> list[CommandControl]:
    """Controls of all commands of an environment: the terms of its command manager, or its tensor of commands.

    A direct environment may have its commands in ``commands``, ``_commands``, ``command`` or ``_command``, a tensor
    ``(num_envs, n)``. Recorded motions have no numbers to set.
    """
    manager = getattr(env, "command_manager", None)
    if manager is not None:
        found = (_of_term(env, name, manager.get_term(name)) for name in _names(manager))
        return [control for control in found if control is not None]
    for name in ("commands", "_commands", "command", "_command"):
        tensor = vars(env).get(name)
        if isinstance(tensor, torch.Tensor) and tensor.dim() == 2 and len(tensor) == env.num_envs:
            return [_plain(name.strip("_"), tensor, None)]
    return []


def _names(manager: Any) -> Iterator[str]:
    for name in manager.active_terms:
        try:
            manager.get_command(name)
        except KeyError:  # a command without numbers
            continue
        yield name


def _of_term(env: ViewedEnv, name: str, term: Any) -> CommandControl | None:
    """The control of a term of the command manager, by what it has."""
    ranges = getattr(term.cfg, "ranges", None)
    if hasattr(term, "joint_pos") and hasattr(term, "frame"):
        return None  # a motion: its numbers follow from its frame
    if hasattr(term, "vel_command_b"):
        return _velocity(name, term, ranges)
    if hasattr(term, "pos_command_w"):
        return _place(env, name, term, ranges)
    if hasattr(term, "pose_command_b") and getattr(term.cfg, "update", None) is None:
        return _pose(name, term, ranges)
    return _plain(name, term.command, term)


def _velocity(name: str, term: Any, ranges: object) -> CommandControl:
    means, spreads = getattr(ranges, "mean_vel", None), getattr(ranges, "std_vel", None)
    numbers = {}
    for index, axis in enumerate(("lin_vel_x", "lin_vel_y", "ang_vel_z")):
        if means is not None and spreads is not None:
            bound = abs(means[index]) + 2.0 * spreads[index]
        else:
            bound = max(map(abs, getattr(ranges, axis, None) or (0.0,)))
        bound = max(bound, _LEAST)
        numbers[axis] = (-bound, bound)

    def write(envs: torch.Tensor, values: Sequence[float]) -> None:
        term.vel_command_b[envs] = torch.tensor(values, dtype=torch.float32, device=envs.device)
        for flags in ("is_heading_env", "is_standing_env"):
            if (tensor := getattr(term, flags, None)) is not None:
                tensor[envs] = False
        _hold(term, envs)

    return CommandControl(name, numbers, lambda i: term.vel_command_b[i].tolist(), write, lambda e: _release(term, e))


def _place(env: ViewedEnv, name: str, term: Any, ranges: object) -> CommandControl:
    """A position on the ground relative to the environment's origin, and a heading."""
    numbers = {axis: _range(ranges, axis, 5.0) for axis in ("pos_x", "pos_y")}
    numbers["heading"] = (-math.pi, math.pi)

    def origin(envs: torch.Tensor | int) -> torch.Tensor:
        origins = env.sim.env_origins if env.sim.env_origin is None else env.sim.env_origin.numpy()
        return torch.as_tensor(origins, dtype=torch.float32, device=term.pos_command_w.device)[envs, :2]

    def read(index: int) -> list[float]:
        place = (term.pos_command_w[index, :2] - origin(index)).tolist()
        return [*place, float(term.heading_command_w[index])]

    def write(envs: torch.Tensor, values: Sequence[float]) -> None:
        term.pos_command_w[envs, :2] = origin(envs) + torch.tensor(values[:2], device=envs.device)
        term.heading_command_w[envs] = float(values[2])
        _hold(term, envs)

    return CommandControl(name, numbers, read, write, lambda e: _release(term, e))


def _pose(name: str, term: Any, ranges: object) -> CommandControl:
    """A pose in the root's frame."""
    numbers = {axis: _range(ranges, axis, 0.5) for axis in ("pos_x", "pos_y", "pos_z")}
    numbers |= {axis: _range(ranges, axis, 0.5) for axis in _ANGLES}

    def read(index: int) -> list[float]:
        pose = term.pose_command_b[index : index + 1]
        angles = (math.remainder(float(a), 2.0 * math.pi) for a in euler_xyz_from_quat(pose[:, 3:]))
        return [*pose[0, :3].tolist(), *angles]

    def write(envs: torch.Tensor, values: Sequence[float]) -> None:
        given = torch.tensor(values, dtype=torch.float32, device=envs.device)
        turn = quat_from_euler_xyz(*(given[i : i + 1] for i in (3, 4, 5)))[0]
        term.pose_command_b[envs] = torch.cat([given[:3], turn])
        _hold(term, envs)

    return CommandControl(name, numbers, read, write, lambda e: _release(term, e))


def _plain(name: str, tensor: torch.Tensor, term: Any) -> CommandControl:
    """A command of which only its numbers are known."""
    count = min(tensor.shape[1], _MOST_NUMBERS)
    bound = max(2.0, 1.5 * float(torch.nan_to_num(tensor[:, :count]).abs().max()) if len(tensor) else 2.0)
    numbers = {str(index): (-bound, bound) for index in range(count)}

    def write(envs: torch.Tensor, values: Sequence[float]) -> None:
        tensor[envs, :count] = torch.tensor(values, dtype=tensor.dtype, device=envs.device)
        _hold(term, envs)

    return CommandControl(name, numbers, lambda i: tensor[i, :count].tolist(), write, lambda e: _release(term, e))


def _range(ranges: object, axis: str, spread: float) -> tuple[float, float]:
    """Bounds of a number: those of the task, with room beyond where they are a point."""
    low, high = getattr(ranges, axis, None) or (-spread, spread)
    if high - low < 1e-6:
        return low - spread, high + spread
    return float(low), float(high)


def _hold(term: Any, envs: torch.Tensor) -> None:
    """Let the task draw no other command for a long time."""
    if term is not None and hasattr(term, "time_left"):
        term.time_left[envs] = _HOLD_S


def _release(term: Any, envs: torch.Tensor) -> None:
    """Let the task draw a new command in the next step."""
    if term is not None and hasattr(term, "time_left"):
        term.time_left[envs] = 0.0
