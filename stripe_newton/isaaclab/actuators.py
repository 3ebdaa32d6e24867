# SPDX-License-Identifier: Apache-2.0
"""Actuator classes of Isaac Lab, from which projects derive their own, in torch.

A config whose ``class_type`` is one of these themselves is computed by the package. Only a class of the user's is
called, before every physics step.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import torch

from stripe_newton.actuators import ActuatorCfg
from stripe_newton.actuators.torch_targets import Targets
from stripe_newton.matching import match_values

from .buffers import DelayBuffer
from .env_types import ArticulationActions

__all__ = [
    "ActuatorBase",
    "DCMotor",
    "DelayedPDActuator",
    "IdealPDActuator",
    "ImplicitActuator",
    "RemotizedPDActuator",
]

Ids = Sequence[int] | torch.Tensor | slice | None
Number = torch.Tensor | float


class ActuatorBase:
    """Base of the actuators: a group of joints with its numbers.

    All tensors have the shape ``(num_envs, num_joints)``.

    Attributes:
        cfg: The config.
        computed_effort: Efforts of the law in the last physics step [N or N m].
        applied_effort: The same within the limits.
    """

    is_implicit_model: ClassVar[bool] = False

    def __init__(
        self,
        cfg: Any,
        joint_names: list[str],
        joint_ids: slice | torch.Tensor,
        num_envs: int,
        device: str,
        stiffness: Number = 0.0,
        damping: Number = 0.0,
        armature: Number = 0.0,
        friction: Number = 0.0,
        dynamic_friction: Number = 0.0,
        viscous_friction: Number = 0.0,
        effort_limit: Number = torch.inf,
        velocity_limit: Number = torch.inf,
    ):
        """Take the joints' numbers: those of the config, elsewhere the arguments."""
        self.cfg = cfg
        self._num_envs, self._device = num_envs, device
        self._joint_names, self._joint_indices = joint_names, joint_ids
        given = {
            "stiffness": stiffness, "damping": damping, "armature": armature, "friction": friction,
            "dynamic_friction": dynamic_friction, "viscous_friction": viscous_friction,
            "effort_limit": effort_limit, "velocity_limit": velocity_limit,
        }  # fmt: skip
        for name, default in given.items():
            setattr(self, name, self._parse_joint_parameter(getattr(cfg, name, None), default))
        self.effort_limit: torch.Tensor
        self.velocity_limit: torch.Tensor
        self.stiffness: torch.Tensor
        self.damping: torch.Tensor
        self.effort_limit_sim = self._parse_joint_parameter(cfg.effort_limit_sim, self.effort_limit)
        self.velocity_limit_sim = self._parse_joint_parameter(cfg.velocity_limit_sim, self.velocity_limit)
        self.computed_effort = torch.zeros(num_envs, self.num_joints, device=device)
        self.applied_effort = torch.zeros_like(self.computed_effort)

    @property
    def num_joints(self) -> int:
        """Number of joints of the group."""
        return len(self._joint_names)

    @property
    def joint_names(self) -> list[str]:
        """Names of the joints."""
        return self._joint_names

    @property
    def joint_indices(self) -> slice | torch.Tensor:
        """Indices of the joints in the articulation."""
        return self._joint_indices

    def reset(self, env_ids: Ids) -> None:
        """Forget the past of environments."""

    def compute(
        self, control_action: ArticulationActions, joint_pos: torch.Tensor, joint_vel: torch.Tensor
    ) -> ArticulationActions:
        """Turn targets into efforts.

        Args:
            control_action: Targets of the group.
            joint_pos: Positions [m or rad].
            joint_vel: Velocities [m/s or rad/s].
        """
        raise NotImplementedError(f"{type(self).__name__} has no compute()")

    def _parse_joint_parameter(
        self, cfg_value: float | Mapping[str, float] | None, default_value: Number | None
    ) -> torch.Tensor:
        """A number of every joint.

        Args:
            cfg_value: Number of all joints, numbers by expression, or ``None`` for the default.
            default_value: Number or tensor.

        Raises:
            ValueError: neither has a value.
        """
        if default_value is None and (cfg_value is None or isinstance(cfg_value, Mapping)):
            default_value = 0.0 if cfg_value is not None else None
        if default_value is None and cfg_value is None:
            raise ValueError(f"a parameter of {type(self).__name__} has neither a value nor a default")
        numbers = torch.zeros(self._num_envs, self.num_joints, device=self._device)
        numbers[:] = torch.as_tensor(0.0 if default_value is None else default_value, device=self._device)
        if cfg_value is not None:
            for index, value in match_values(cfg_value, self._joint_names, what="joint").items():
                numbers[:, index] = value
        return numbers

    def _clip_effort(self, effort: torch.Tensor) -> torch.Tensor:
        """Efforts within the limits."""
        return torch.clip(effort, min=-self.effort_limit, max=self.effort_limit)

    def _set_pd_efforts(self, targets: ArticulationActions, pos: torch.Tensor, vel: torch.Tensor) -> None:
        """Set :attr:`computed_effort` and :attr:`applied_effort` to those of the PD law."""
        effort = torch.zeros_like(pos) if targets.joint_efforts is None else targets.joint_efforts
        if targets.joint_positions is not None:
            effort = effort + self.stiffness * (targets.joint_positions - pos)
        if targets.joint_velocities is not None:
            effort = effort + self.damping * (targets.joint_velocities - vel)
        self.computed_effort = effort
        self.applied_effort = self._clip_effort(effort)


class IdealPDActuator(ActuatorBase):
    """A PD law with limited effort."""

    def compute(
        self, control_action: ArticulationActions, joint_pos: torch.Tensor, joint_vel: torch.Tensor
    ) -> ArticulationActions:
        self._set_pd_efforts(control_action, joint_pos, joint_vel)
        control_action.joint_positions = control_action.joint_velocities = None
        control_action.joint_efforts = self.applied_effort
        return control_action


class DCMotor(IdealPDActuator):
    """A PD law whose effort is limited by the torque-speed curve of a DC motor."""

    def __init__(self, cfg: Any, *args: Any, **kwargs: Any):
        super().__init__(cfg, *args, **kwargs)
        self._saturation_effort = self._parse_joint_parameter(cfg.saturation_effort, None)
        self._joint_vel = torch.zeros_like(self.computed_effort)

    def compute(
        self, control_action: ArticulationActions, joint_pos: torch.Tensor, joint_vel: torch.Tensor
    ) -> ArticulationActions:
        self._joint_vel[:] = joint_vel
        return super().compute(control_action, joint_pos, joint_vel)

    def _clip_effort(self, effort: torch.Tensor) -> torch.Tensor:
        # Beyond the speed where the curve reaches the limit of the other side it stays there.
        fastest = self.velocity_limit * (1.0 + self.effort_limit / self._saturation_effort)
        speed = torch.clip(self._joint_vel, min=-fastest, max=fastest) / self.velocity_limit
        most = torch.minimum(self._saturation_effort * (1.0 - speed), self.effort_limit)
        least = torch.maximum(self._saturation_effort * (-1.0 - speed), -self.effort_limit)
        return torch.clip(effort, min=least, max=most)


class DelayedPDActuator(IdealPDActuator):
    """A PD law whose targets arrive some physics steps late, by a delay drawn for each episode."""

    def __init__(self, cfg: Any, *args: Any, **kwargs: Any):
        super().__init__(cfg, *args, **kwargs)
        self.positions_delay_buffer, self.velocities_delay_buffer, self.efforts_delay_buffer = (
            DelayBuffer(cfg.max_delay, self._num_envs, device=self._device) for _ in range(3)
        )

    @property
    def _buffers(self) -> tuple[DelayBuffer, DelayBuffer, DelayBuffer]:
        return self.positions_delay_buffer, self.velocities_delay_buffer, self.efforts_delay_buffer

    def reset(self, env_ids: Ids) -> None:
        """Draw a delay for each of the environments, and forget their past."""
        super().reset(env_ids)
        count = self._num_envs if env_ids is None or isinstance(env_ids, slice) else len(env_ids)
        span = (self.cfg.min_delay, self.cfg.max_delay + 1)
        lags = torch.randint(*span, (count,), dtype=torch.int, device=self._device)
        for buffer in self._buffers:
            buffer.set_time_lag(lags, env_ids)
            buffer.reset(env_ids)

    def compute(
        self, control_action: ArticulationActions, joint_pos: torch.Tensor, joint_vel: torch.Tensor
    ) -> ArticulationActions:
        names = "joint_positions", "joint_velocities", "joint_efforts"
        for name, buffer in zip(names, self._buffers, strict=True):
            if (target := getattr(control_action, name)) is not None:
                setattr(control_action, name, buffer.compute(target))
        return super().compute(control_action, joint_pos, joint_vel)


class RemotizedPDActuator(DelayedPDActuator):
    """A delayed PD law behind a linkage: the largest effort depends on the joint's position."""

    def __init__(self, cfg: Any, *args: Any, **kwargs: Any):
        super().__init__(cfg, *args, **kwargs)
        self._table = torch.tensor(cfg.joint_parameter_lookup, dtype=torch.float32, device=self._device)
        self._joint_pos = torch.zeros_like(self.computed_effort)

    def compute(
        self, control_action: ArticulationActions, joint_pos: torch.Tensor, joint_vel: torch.Tensor
    ) -> ArticulationActions:
        self._joint_pos[:] = joint_pos
        return super().compute(control_action, joint_pos, joint_vel)

    def _clip_effort(self, effort: torch.Tensor) -> torch.Tensor:
        places, most = self._table[:, 0].contiguous(), self._table[:, 2]
        pos = self._joint_pos.clamp(float(places[0]), float(places[-1]))
        right = torch.searchsorted(places, pos).clamp(1, len(places) - 1)
        share = (pos - places[right - 1]) / (places[right] - places[right - 1])
        limit = torch.minimum(torch.lerp(most[right - 1], most[right], share), self.effort_limit)
        return torch.clip(effort, min=-limit, max=limit)


class ImplicitActuator(ActuatorBase):
    """A drive inside the solver: :meth:`compute` returns the targets that the drive follows in a physics step."""

    is_implicit_model: ClassVar[bool] = True

    def compute(
        self, control_action: ArticulationActions, joint_pos: torch.Tensor, joint_vel: torch.Tensor
    ) -> ArticulationActions:
        self._set_pd_efforts(control_action, joint_pos, joint_vel)
        return control_action


class _OfGroup:
    """A user's actuator class, made for a group of joints."""

    def __init__(self, cfg: ActuatorCfg, class_type: type[ActuatorBase], group: Any):
        """Make the actuator of a :class:`stripe_newton.actuators.JointGroup`."""
        names = "stiffness", "damping", "armature", "friction", "viscous_friction", "effort_limit", "velocity_limit"
        ids = torch.tensor(group.ids, device=group.device)
        self.actuator = class_type(
            cfg, group.names, ids, group.num_envs, group.device, **{name: getattr(group, name) for name in names}
        )

    def reset(self, env_ids: torch.Tensor) -> None:
        """Pass on the environments whose episode begins."""
        self.actuator.reset(env_ids)


class ClassTargets(_OfGroup):
    """A user's class of a drive in the solver, as a law of :class:`stripe_newton.actuators.TorchTargetsCfg`."""

    def compute(
        self,
        pos_target: torch.Tensor,
        vel_target: torch.Tensor,
        effort_target: torch.Tensor,
        pos: torch.Tensor,
        vel: torch.Tensor,
    ) -> Targets:
        """Targets that the actuator's ``compute`` returns; where it returns none, those that were set."""
        given = pos_target, vel_target, effort_target
        action = ArticulationActions(*given, self.actuator.joint_indices)
        made = self.actuator.compute(action, pos, vel)
        returned = made.joint_positions, made.joint_velocities, made.joint_efforts
        first, second, third = (old if new is None else new for new, old in zip(returned, given, strict=True))
        return first, second, third


class ClassLaw(_OfGroup):
    """A user's actuator class as a law of :class:`stripe_newton.actuators.TorchActuatorCfg`."""

    def compute(
        self,
        pos_target: torch.Tensor,
        vel_target: torch.Tensor,
        effort_target: torch.Tensor,
        pos: torch.Tensor,
        vel: torch.Tensor,
    ) -> torch.Tensor:
        """Efforts that the actuator's ``compute`` returns [N or N m].

        Raises:
            ValueError: it returns none.
        """
        action = ArticulationActions(pos_target, vel_target, effort_target, self.actuator.joint_indices)
        efforts = self.actuator.compute(action, pos, vel).joint_efforts
        if efforts is None:
            raise ValueError(f"{type(self.actuator).__name__}.compute() returned no joint_efforts")
        return efforts
