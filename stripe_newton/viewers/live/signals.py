# SPDX-License-Identifier: Apache-2.0
"""Signals: what of an environment can be plotted, by name, each a few numbers of one environment."""

from __future__ import annotations

import numbers
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import torch

if TYPE_CHECKING:
    from .viewed_env import ViewedEnv

__all__ = ["MOST_CURVES", "Signal", "is_number", "signals_of"]

MOST_CURVES = 12
"""Most curves of a plot."""


@dataclass
class Signal:
    """Something that can be plotted."""

    name: str
    """Its name, ``GROUP: TERM``."""
    curves: list[str]
    """Names of its numbers."""
    read: Callable[[int], Sequence[float]]
    """Its numbers now, of an environment."""


def signals_of(env: ViewedEnv) -> list[Signal]:
    """All signals of an environment: rewards, observations, commands, actions, joints, contact forces."""
    return [
        *_rewards(env),
        *_observations(env),
        *_commands(env),
        *_actions(env),
        *_contacts(env),
        *_joints(env),
    ]


def is_number(value: object) -> bool:
    """Whether a value of the log is one number."""
    return isinstance(value, numbers.Real) or (isinstance(value, torch.Tensor) and value.numel() == 1)


def _rewards(env: ViewedEnv) -> Iterator[Signal]:
    manager = getattr(env, "reward_manager", None)
    names = list(getattr(manager, "active_terms", ()))
    if manager is not None and names:
        if len(names) <= MOST_CURVES:
            yield Signal("reward: all terms", names, lambda i: manager.step_reward[i].tolist())
        for index, name in enumerate(names):
            yield Signal(f"reward: {name}", [name], partial(_reward, manager, index))
    yield Signal("reward: total", ["total"], lambda i: [float(env.reward_buf[i])])


def _reward(manager: Any, term: int, index: int) -> list[float]:
    return [float(manager.step_reward[index, term])]


def _observations(env: ViewedEnv) -> Iterator[Signal]:
    manager = getattr(env, "observation_manager", None)
    for group, values in env.obs_buf.items():
        if isinstance(values, Mapping):
            for name, tensor in values.items():
                yield from _pieces(f"observation: {group} {name}", name, tensor[0].numel(), _reader(env, group, name))
            continue
        if not isinstance(values, torch.Tensor) or values.dim() > 2:
            continue  # a picture
        begin = 0
        names, sizes = _terms(manager, group)
        if sum(sizes) != values.shape[1]:
            names, sizes = [""], [values.shape[1]]
        for name, size in zip(names, sizes, strict=True):
            title = f"observation: {group} {name}".rstrip()
            yield from _pieces(title, name, size, _reader(env, group, None), begin)
            begin += size


def _terms(manager: Any, group: str) -> tuple[list[str], list[int]]:
    """Names and sizes of the terms of a group that are concatenated."""
    if manager is None:
        return [], []
    names = list(manager.active_terms.get(group, ()))
    shapes = manager.group_obs_term_dim.get(group, ())
    return names, [int(torch.Size(shape).numel()) for shape in shapes]


def _reader(env: ViewedEnv, group: str, name: str | None) -> Callable[[int], torch.Tensor]:
    """Reads the numbers of a group, or of a term in it, anew: a step returns new tensors."""

    def read(index: int) -> torch.Tensor:
        values = env.obs_buf[group]
        return (values if name is None else values[name])[index].reshape(-1)

    return read


def _pieces(title: str, name: str, size: int, read: Callable[[int], torch.Tensor], begin: int = 0) -> Iterator[Signal]:
    """Signals of a vector, at most so many numbers in each; of a long one, such as a height scan, the first few."""
    pieces = range(0, min(size, 4 * MOST_CURVES), MOST_CURVES)
    for first in pieces:
        count = min(MOST_CURVES, size - first)
        numbers_of = f" {first} to {first + count - 1}" if size > MOST_CURVES else ""
        curves = [name or "value"] if size == 1 else [str(first + k) for k in range(count)]
        yield Signal(f"{title}{numbers_of}", curves, partial(_part, read, begin + first, begin + first + count))


def _part(read: Callable[[int], torch.Tensor], low: int, high: int, index: int) -> list[float]:
    return read(index)[low:high].tolist()


def _commands(env: ViewedEnv) -> Iterator[Signal]:
    manager: Any = getattr(env, "command_manager", None)
    for name in getattr(manager, "active_terms", ()):
        try:
            size = manager.get_command(name).shape[1]
        except KeyError:  # a command without numbers
            continue
        yield from _pieces(f"command: {name}", name, size, partial(_command, manager, name))


def _command(manager: Any, name: str, index: int) -> torch.Tensor:
    return manager.get_command(name)[index]


def _actions(env: ViewedEnv) -> Iterator[Signal]:
    manager = getattr(env, "action_manager", None)
    tensor = getattr(manager, "action", None) if manager is not None else getattr(env, "actions", None)
    if isinstance(tensor, torch.Tensor) and tensor.dim() == 2:
        owner, field = (env, "actions") if manager is None else (manager, "action")
        yield from _pieces("actions", "action", tensor.shape[1], lambda i: getattr(owner, field)[i])


def _joints(env: ViewedEnv) -> Iterator[Signal]:
    robots = getattr(getattr(env, "scene", None), "articulations", {})
    for name, robot in robots.items():
        joints = list(robot.joint_names)
        for title, field in (("positions", "joint_pos"), ("velocities", "joint_vel"), ("efforts", "applied_torque")):
            if not isinstance(getattr(robot.data, field, None), torch.Tensor):
                continue
            for first in range(0, len(joints), MOST_CURVES):
                chosen = joints[first : first + MOST_CURVES]
                more = f" {first} to {first + len(chosen) - 1}" if len(joints) > MOST_CURVES else ""

                def read(index: int, robot: Any = robot, field: str = field, first: int = first) -> list[float]:
                    return getattr(robot.data, field)[index, first : first + MOST_CURVES].tolist()

                yield Signal(f"joint {title}: {name}{more}", chosen, read)


def _contacts(env: ViewedEnv) -> Iterator[Signal]:
    sensors = getattr(getattr(env, "scene", None), "sensors", {})
    for name, sensor in sensors.items():
        if not isinstance(getattr(sensor.data, "net_forces_w", None), torch.Tensor):
            continue
        bodies = list(sensor.body_names)
        for first in range(0, len(bodies), MOST_CURVES):
            chosen = bodies[first : first + MOST_CURVES]
            more = f" {first} to {first + len(chosen) - 1}" if len(bodies) > MOST_CURVES else ""

            def read(index: int, data: Any = sensor.data, first: int = first) -> list[float]:
                return data.net_forces_w[index, first : first + MOST_CURVES].norm(dim=-1).tolist()

            yield Signal(f"contact force: {name}{more}", chosen, read)
