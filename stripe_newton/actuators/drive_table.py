# SPDX-License-Identifier: Apache-2.0
"""Drive table: Newton's actuators as numbers for one launch, ``stripe_kernels.actuators.drive_joints``."""

from __future__ import annotations

from collections.abc import Sequence

import newton
import numpy as np
from newton.actuators import (
    Actuator,
    ClampingBase,
    ClampingDCMotor,
    ClampingMaxEffort,
    ClampingPositionBased,
    Delay,
    DrivePD,
    DrivePID,
)

from stripe_kernels.actuators import LAW_MADE, LAW_PD, LAW_PID

__all__ = ["MADE", "NO_LIMIT", "DriveTable", "coordinate", "read_drives"]

NO_LIMIT = 1.0e10
"""Efforts above this are unlimited [N or N m]."""

MADE = "joint_made_f"
"""Attribute of the control that Newton's own steps of actuators write to."""

_LAWS = {DrivePD: int(LAW_PD), DrivePID: int(LAW_PID)}
_LIMITS = ClampingMaxEffort, ClampingDCMotor, ClampingPositionBased
_ATTRIBUTES = (
    "state_pos_attr", "state_vel_attr", "control_target_pos_attr", "control_target_vel_attr",
    "control_feedforward_attr", "control_output_attr",
)  # fmt: skip
_FLOATS = "integral_gain", "integral_limit", "bias_effort", "saturation_effort", "no_load_speed"


def coordinate(
    joint_types: Sequence[int] | np.ndarray,
    q_start: Sequence[int] | np.ndarray,
    qd_start: Sequence[int] | np.ndarray,
    dof: int,
) -> int:
    """Coordinate of a degree of freedom, -1 in joints whose coordinates are a quaternion.

    Args:
        joint_types: Types of the joints.
        q_start: First coordinate of each.
        qd_start: First degree of freedom of each.
        dof: The degree of freedom.
    """
    # The joint is the last one that starts at or before the degree of freedom; joints without any start there too.
    joint = int(np.searchsorted(np.asarray(qd_start)[: len(joint_types)], dof, side="right")) - 1
    if joint_types[joint] in (newton.JointType.BALL, newton.JointType.FREE, newton.JointType.DISTANCE):
        return -1
    return int(q_start[joint]) + dof - int(qd_start[joint])


class DriveTable:
    """Laws, limits and delays of the joints of one environment, and their numbers in all environments.

    Names are those of the fields of ``JointDrives``.
    """

    def __init__(self, model: newton.Model, num_envs: int):
        self.dofs = dofs = model.joint_dof_count // num_envs
        self.num_envs = num_envs
        joints = model.joint_count // num_envs
        starts = model.joint_type.numpy()[:joints], model.joint_q_start.numpy(), model.joint_qd_start.numpy()
        self.coord = np.array([coordinate(*starts, d) for d in range(dofs)], dtype=np.int32)
        self.law, self.table_start, self.table_count = (np.zeros(dofs, dtype=np.int32) for _ in range(3))
        self.delay_slot = np.full(dofs, -1, dtype=np.int32)
        self.has_curve = np.zeros(dofs, dtype=bool)
        self.table_pos, self.table_effort = np.zeros(0, dtype=np.float32), np.zeros(0, dtype=np.float32)
        self.floats = {name: np.zeros(num_envs * dofs, dtype=np.float32) for name in _FLOATS}
        self.gains: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        self.lag = np.zeros((num_envs, 0), dtype=np.int32)
        self.depth = 0
        self.stepped: list[Actuator] = []
        """Actuators of other laws, the networks, which Newton steps itself."""

    def write_gains(self, model: newton.Model) -> None:
        """Write gains and limits of explicit actuators to the model's arrays."""
        for name, written in self.gains.items():
            array = getattr(model, name)
            values = array.numpy()
            for rows, numbers in written:
                values[rows] = numbers
            array.assign(values)

    def add(self, actuator: Actuator) -> None:
        """Take over an actuator, or at least its limits if there is no law for it.

        Raises:
            ValueError: if another drives the same joint.
        """
        # An actuator of Newton's covers all environments: its first part is that of the first one.
        rows = actuator.indices.numpy().astype(np.int64)
        dofs = rows[: len(rows) // self.num_envs]
        if self.law[dofs].any():
            raise ValueError(f"degrees of freedom {dofs[self.law[dofs] > 0].tolist()} have two explicit actuators each")
        kinds = [type(clamp) for clamp in actuator.clamping]
        limited = set(kinds) <= set(_LIMITS) and len(kinds) == len(set(kinds))
        # One of each kind of limit and the usual arrays: what the one launch can do. Anything else Newton steps.
        law = _LAWS.get(type(actuator.drive)) if limited and self._is_plain(actuator, rows) else None
        self.law[dofs] = LAW_MADE if law is None else law
        if law is None:
            actuator.control_output_attr = MADE
            self.stepped.append(actuator)
        else:
            self._add_drive(actuator.drive, rows)
            self._add_delay(actuator.delay, dofs)
        # Limits that no state changes are one number, the least of them, and lie in the model as an effort limit.
        limit = np.full(len(rows), NO_LIMIT, dtype=np.float32)
        for clamp in actuator.clamping if limited else ():
            limit = np.minimum(limit, self._add_limit(clamp, rows, dofs))
        self._gain("joint_effort_limit", rows, limit)
        if law is None and limited:
            actuator.clamping = []  # it is limited in the launch, where its limits can be changed as all others
            actuator.set_effort_mode_explicit()

    def _is_plain(self, actuator: Actuator, rows: np.ndarray) -> bool:
        """Whether it reads and writes the usual arrays, at its own degrees of freedom."""
        coords = np.array([self.coord[d] for d in rows[: len(rows) // self.num_envs]])
        pos = actuator.pos_indices.numpy()[: len(coords)]
        usual = "joint_q", "joint_qd", "joint_target_q", "joint_target_qd", "joint_act", "joint_f"
        return (
            tuple(getattr(actuator, name) for name in _ATTRIBUTES) == usual
            and np.array_equal(coords, pos)
            and actuator.effort_indices is actuator.indices
            and actuator.target_pos_indices is actuator.pos_indices
        )

    def _add_drive(self, drive: DrivePD | DrivePID, rows: np.ndarray) -> None:
        self._gain("joint_target_ke", rows, drive.kp.numpy())
        self._gain("joint_target_kd", rows, drive.kd.numpy())
        if drive.const_effort is not None:
            self.floats["bias_effort"][rows] = drive.const_effort.numpy()
        if isinstance(drive, DrivePID):
            self.floats["integral_gain"][rows] = drive.ki.numpy()
            self.floats["integral_limit"][rows] = drive.integral_max.numpy()

    def _add_delay(self, delay: Delay | None, dofs: np.ndarray) -> None:
        if delay is not None:
            self.delay_slot[dofs] = np.arange(len(dofs)) + self.lag.shape[1]
            self.lag = np.hstack([self.lag, delay.delay_steps.numpy().reshape(self.num_envs, -1)])
            self.depth = max(self.depth, delay.buf_depth)

    def _add_limit(self, clamp: ClampingBase, rows: np.ndarray, dofs: np.ndarray) -> np.ndarray | float:
        """Take over a limit; returns the largest effort that it allows in any state."""
        if isinstance(clamp, ClampingMaxEffort):
            return clamp.max_effort.numpy()
        if isinstance(clamp, ClampingDCMotor):
            self.has_curve[dofs] = True
            self.floats["saturation_effort"][rows] = clamp.saturation_effort.numpy()
            self.floats["no_load_speed"][rows] = clamp.velocity_limit.numpy()
            return clamp.max_motor_effort.numpy()
        self.table_start[dofs], self.table_count[dofs] = len(self.table_pos), clamp.lookup_size
        self.table_pos = np.append(self.table_pos, clamp.lookup_positions.numpy())
        self.table_effort = np.append(self.table_effort, clamp.lookup_efforts.numpy())
        return clamp.lookup_efforts.numpy().max()

    def _gain(self, name: str, rows: np.ndarray, values: np.ndarray) -> None:
        self.gains.setdefault(name, []).append((rows, values))


def read_drives(model: newton.Model, num_envs: int) -> DriveTable:
    """Take over the actuators of a model.

    Raises:
        ValueError: if two of them drive the same joint.
    """
    table = DriveTable(model, num_envs)
    for actuator in model.actuators:
        table.add(actuator)
    return table
