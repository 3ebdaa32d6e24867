# SPDX-License-Identifier: Apache-2.0
"""MJCF actuators: a row for each, as MuJoCo reads it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco

from stripe_newton.usd.text_table import number, table

__all__ = ["ActuatorRow", "actuator_rows", "actuator_table"]

_TARGETS = {
    mujoco.mjtTrn.mjTRN_JOINT: ("joint", mujoco.mjtObj.mjOBJ_JOINT),
    mujoco.mjtTrn.mjTRN_JOINTINPARENT: ("joint", mujoco.mjtObj.mjOBJ_JOINT),
    mujoco.mjtTrn.mjTRN_TENDON: ("tendon", mujoco.mjtObj.mjOBJ_TENDON),
    mujoco.mjtTrn.mjTRN_SITE: ("site", mujoco.mjtObj.mjOBJ_SITE),
    mujoco.mjtTrn.mjTRN_SLIDERCRANK: ("site", mujoco.mjtObj.mjOBJ_SITE),
    mujoco.mjtTrn.mjTRN_BODY: ("body", mujoco.mjtObj.mjOBJ_BODY),
}


@dataclass
class ActuatorRow:
    """An actuator."""

    name: str
    kind: str
    """``"position"``, ``"velocity"``, ``"motor"`` or ``"general"``."""
    target: str
    """Target of the actuator, such as ``"joint knee"``."""
    stiffness: float
    """Gain of the position, N m/rad or N/m."""
    damping: float
    """Gain of the velocity, N m s/rad or N s/m."""
    gear: float
    """Ratio of the force at the target and that of the actuator."""
    control_range: tuple[float, float] | None
    """None if unlimited."""
    force_range: tuple[float, float] | None
    """None if unlimited, N m or N."""


def actuator_rows(model: mujoco.MjModel) -> list[ActuatorRow]:
    """A row for each actuator of a model."""
    return [_row(model, actuator) for actuator in range(model.nu)]


def _row(model: mujoco.MjModel, actuator: int) -> ActuatorRow:
    gain, bias = model.actuator_gainprm[actuator], model.actuator_biasprm[actuator]
    kind = _kind(model, actuator)
    what, of = _TARGETS.get(mujoco.mjtTrn(model.actuator_trntype[actuator]), ("", mujoco.mjtObj.mjOBJ_UNKNOWN))
    target = mujoco.mj_id2name(model, of, model.actuator_trnid[actuator][0]) if what else None
    return ActuatorRow(
        name=model.actuator(actuator).name,
        kind=kind,
        target=f"{what} {target or ''}".strip(),
        stiffness=float(gain[0]) if kind == "position" else 0.0,
        damping=float(gain[0]) if kind == "velocity" else float(-bias[2]) if kind == "position" else 0.0,
        gear=float(model.actuator_gear[actuator][0]),
        control_range=_range(model.actuator_ctrlrange[actuator], model.actuator_ctrllimited[actuator]),
        force_range=_range(model.actuator_forcerange[actuator], model.actuator_forcelimited[actuator]),
    )


def _kind(model: mujoco.MjModel, actuator: int) -> str:
    """The kind that an actuator's law is, however it is written."""
    dynamics, gain_type = model.actuator_dyntype[actuator], model.actuator_gaintype[actuator]
    gain, bias = model.actuator_gainprm[actuator][0], model.actuator_biasprm[actuator]
    if dynamics != mujoco.mjtDyn.mjDYN_NONE or gain_type != mujoco.mjtGain.mjGAIN_FIXED:
        return "general"
    if model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE:
        return "motor"
    if bias[0] == 0.0 and gain == -bias[1] != 0.0:
        return "position"
    return "velocity" if bias[0] == bias[1] == 0.0 and gain == -bias[2] != 0.0 else "general"


def _range(values: tuple[float, float], limited: bool) -> tuple[float, float] | None:
    return (float(values[0]), float(values[1])) if limited else None


def _text(values: tuple[float, float] | None) -> str:
    return "" if values is None else f"{number(values[0])} .. {number(values[1])}"


_COLUMNS: dict[str, Callable[[ActuatorRow], str]] = {
    "name": lambda a: a.name,
    "kind": lambda a: a.kind,
    "acts on": lambda a: a.target,
    "kp": lambda a: number(a.stiffness),
    "kd": lambda a: number(a.damping),
    "gear": lambda a: number(a.gear),
    "control": lambda a: _text(a.control_range),
    "force": lambda a: _text(a.force_range),
}


def actuator_table(rows: list[ActuatorRow]) -> str:
    """The rows as text; empty without any."""
    return table("Actuators of the file", rows, _COLUMNS)
