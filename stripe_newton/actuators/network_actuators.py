# SPDX-License-Identifier: Apache-2.0
"""Network actuators: laws that were learned from measurements."""

from __future__ import annotations

from collections.abc import Iterator

from newton.actuators import DriveNeuralLSTM, DriveNeuralMLP

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.value_types import CodeName

from .actuator_cfg import PerJointLimit
from .explicit_actuators import DCMotorCfg, Law

__all__ = ["ActuatorNetLSTMCfg", "ActuatorNetMLPCfg"]


@configclass
class ActuatorNetLSTMCfg(DCMotorCfg):
    """A recurrent network: position error and velocity in, effort out. Velocity and effort targets have no part in it.

    Its memory starts an episode at zero. The effort is limited as a DC motor's, or by ``effort_limit`` alone without a
    ``saturation_effort``.
    """

    network_file: CodeName = MISSING
    """The network: ONNX as ``newton.actuators.DriveNeuralLSTM`` reads it, or TorchScript of one LSTM followed by one
    linear layer, ``effort, (h, c) = net(input, (h, c))``, which is converted."""
    saturation_effort: PerJointLimit = None
    """Effort of the motor at standstill [N or N m]; ``None`` for no torque-speed curve."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        for name in ("stiffness", "damping"):
            if getattr(self, name) is not None:
                yield name, f"is {getattr(self, name)}, but a network has no gains: leave it out"

    def _needs(self) -> tuple[str, ...]:
        return tuple(name for name in super()._needs() if name not in ("stiffness", "damping"))

    def _law(self) -> Law:
        from .network_files import prepare_lstm  # loads onnx, which few scenes need

        arguments: dict[str, object] = {"model_path": str(prepare_lstm(self.network_file))}
        return lambda joint: (DriveNeuralLSTM, arguments)


@configclass
class ActuatorNetMLPCfg(ActuatorNetLSTMCfg):
    """A network of the last position errors and velocities. Velocity and effort targets have no part in it.

    ``effort = torque_scale net([pos_scale (q* - q)[i], vel_scale qd[i]] for i in input_idx)``, with ``i`` counted back
    from the present physics step; what lies before the episode is zero. Limited as :class:`ActuatorNetLSTMCfg`.
    """

    network_file: CodeName = MISSING
    """The network: ONNX, or TorchScript, which is converted; input ``(n, 2 * len(input_idx))``, output ``(n, 1)``."""
    pos_scale: float | None = None
    """Factor on position errors. Where this and the following are ``None``, the file's metadata decide, and without
    them it is 1."""
    vel_scale: float | None = None
    """Factor on velocities."""
    torque_scale: float | None = None
    """Factor on the output."""
    input_order: str | None = None
    """``"pos_vel"`` or ``"vel_pos"``: which inputs come first; ``"pos_vel"`` without metadata."""
    input_idx: list[int] | None = None
    """Steps back in time that the network looks at, 0 the present; ``[0]`` without metadata."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        for name in ("pos_scale", "vel_scale", "torque_scale"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, (int, float)) and 0.0 < abs(value) < float("inf")):
                yield name, f"is {value!r}, must be a number other than zero"
        if self.input_order not in (None, "pos_vel", "vel_pos"):
            yield "input_order", f"is {self.input_order!r}, must be 'pos_vel' or 'vel_pos'"
        if self.input_idx is not None and (
            not len(self.input_idx) or any(not isinstance(i, int) or i < 0 for i in self.input_idx)
        ):
            yield "input_idx", f"is {self.input_idx}, must be steps back in time, whole numbers of 0 or more"

    def _law(self) -> Law:
        from .network_files import prepare_mlp  # loads onnx, which few scenes need

        given = {
            "pos_scale": self.pos_scale, "vel_scale": self.vel_scale, "effort_scale": self.torque_scale,
            "input_order": self.input_order, "input_idx": self.input_idx and list(self.input_idx),
        }  # fmt: skip
        path = prepare_mlp(self.network_file, **{name: value for name, value in given.items() if value is not None})
        return lambda joint: (DriveNeuralMLP, {"model_path": str(path)})
