# SPDX-License-Identifier: Apache-2.0
"""Actuator groups of an articulation as ``Articulation.actuators`` of Isaac Lab shows them."""

from __future__ import annotations

from typing import Any

import torch

from stripe_newton.actuators import ActuatorCfg, ImplicitActuatorCfg
from stripe_newton.assets import ArticulationData
from stripe_newton.matching import match_names

from .quaternions import ReadOnlyTensor

__all__ = ["ActuatorGroup"]

_FIELDS = {
    "stiffness": "joint_stiffness",
    "damping": "joint_damping",
    "armature": "joint_armature",
    "friction": "joint_friction_coeff",
    "effort_limit": "joint_effort_limits",
    "effort_limit_sim": "joint_effort_limits",
    "velocity_limit": "joint_vel_limits",
    "velocity_limit_sim": "joint_vel_limits",
    "computed_effort": "computed_torque",
    "applied_effort": "applied_torque",
}


class ActuatorGroup:
    """The joints of an actuator config and their present numbers.

    ``stiffness``, ``damping``, ``armature``, ``friction``, ``effort_limit``, ``velocity_limit``, ``computed_effort``
    and ``applied_effort`` are read-only copies of the shape ``(num_envs, num_joints)``. The articulation's
    ``write_joint_*_to_sim`` methods change them, of explicit actuators, too.

    Attributes:
        cfg: The config.
        joint_names: Names of the joints.
        joint_indices: Their indices in the articulation: a slice where they are all of its joints.
    """

    def __init__(self, cfg: ActuatorCfg, data: ArticulationData):
        self.cfg, self._data = cfg, data
        ids, self.joint_names = match_names(cfg.joint_names_expr, data.joint_names, what="joint")
        self._ids = torch.tensor(ids, device=data.joint_pos.device)
        every = ids == list(range(len(data.joint_names)))
        self.joint_indices: slice | torch.Tensor = slice(None) if every else self._ids

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def is_implicit_model(self) -> bool:
        """Whether the solver drives the joints."""
        return isinstance(self.cfg, ImplicitActuatorCfg)

    def __getattr__(self, name: str) -> Any:
        if name not in _FIELDS:
            raise AttributeError(f"an actuator group has no '{name}'; it has {', '.join(_FIELDS)}")
        return getattr(self._data, _FIELDS[name])[:, self._ids].as_subclass(ReadOnlyTensor)
