# SPDX-License-Identifier: Apache-2.0
"""Types that annotations of Isaac Lab's files name: results of a step, agents, and actions of actuators."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

__all__ = [
    "ActionType",
    "AgentID",
    "ArticulationActions",
    "EnvStepReturn",
    "ObsType",
    "SpaceType",
    "StateType",
    "VecEnvObs",
    "VecEnvStepReturn",
]

VecEnvObs = dict[str, torch.Tensor | dict[str, torch.Tensor]]
"""Observations by group, and by term in groups that are not concatenated."""
VecEnvStepReturn = tuple[VecEnvObs, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]
"""Observations, rewards, terminations, time-outs and extras of a step."""
AgentID = str
"""Name of an agent."""
ObsType = torch.Tensor | dict[str, torch.Tensor]
"""Observations of an agent."""
ActionType = torch.Tensor | dict[str, torch.Tensor]
"""Actions of an agent."""
StateType = torch.Tensor | dict[str, torch.Tensor]
"""State of a scene with several agents."""
SpaceType = object
"""A gymnasium space, or what a config writes in its place: a number, a set, a list, a tuple or a dict."""
EnvStepReturn = tuple[
    dict[str, ObsType],
    dict[str, torch.Tensor],
    dict[str, torch.Tensor],
    dict[str, torch.Tensor],
    dict[str, dict[str, Any]],
]
"""Observations, rewards, terminations, time-outs and extras of a step, by agent."""


@dataclass
class ArticulationActions:
    """Targets of a group of joints, as an actuator takes and returns them; ``None`` for none.

    Shapes are ``(num_envs, joints of the group)``.
    """

    joint_positions: torch.Tensor | None = None
    """Position targets [m or rad]."""
    joint_velocities: torch.Tensor | None = None
    """Velocity targets [m/s or rad/s]."""
    joint_efforts: torch.Tensor | None = None
    """Efforts [N or N m]."""
    joint_indices: torch.Tensor | Sequence[int] | slice | None = None
    """Indices of the joints in the articulation."""
