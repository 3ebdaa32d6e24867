# SPDX-License-Identifier: Apache-2.0
"""Actuator export: explicit actuators as USD prims, by the schemas that Newton reads."""

from __future__ import annotations

import math
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import newton
from newton import actuators
from pxr import Sdf, Usd

__all__ = ["Actuator", "actuators_by_dof", "author_actuator", "remove_actuators"]

_SCHEMAS = {
    actuators.DrivePD: "NewtonPDControlAPI",
    actuators.DrivePID: "NewtonPIDControlAPI",
    actuators.DriveNeuralMLP: "NewtonNeuralControlAPI",
    actuators.DriveNeuralLSTM: "NewtonNeuralControlAPI",
    actuators.DriveNeuralGRU: "NewtonNeuralControlAPI",
    actuators.ClampingMaxEffort: "NewtonMaxEffortClampingAPI",
    actuators.ClampingDCMotor: "NewtonDCMotorClampingAPI",
    actuators.ClampingPositionBased: "NewtonPositionBasedClampingAPI",
}


@dataclass(frozen=True)
class Actuator:
    """An explicit actuator of one degree of freedom, as the builder holds it."""

    parts: list[tuple[type, dict[str, Any]]]
    """Classes of the drive and its clampings, with their arguments."""
    delay_steps: int | None
    """Delay in physics steps; None without one."""


def actuators_by_dof(builder: newton.ModelBuilder) -> dict[int, Actuator]:
    """Explicit actuators by degree of freedom. A builder keeps actuators of one kind in one entry."""
    found = {}
    for entry in builder.actuator_entries.values():
        for k, dof in enumerate(entry.indices):
            parts = [(entry.drive_class, {**entry.drive_shared_kwargs, **entry.drive_args[k]})]
            clampings = zip(entry.clamping_classes, entry.clamping_shared_kwargs, entry.clamping_args[k], strict=True)
            parts += [(kind, {**shared, **own}) for kind, shared, own in clampings]
            found[dof] = Actuator(parts, int(entry.delay_args[k]["delay_steps"]) if entry.delay_args else None)
    return found


def remove_actuators(joint: Usd.Prim) -> None:
    """Deactivate the actuators of a joint that the stage authors, as others take their place."""
    for prim in list(joint.GetStage().Traverse()):
        targets = prim.GetRelationship("newton:targets")
        if prim.GetTypeName() == "NewtonActuator" and targets and joint.GetPath() in targets.GetTargets():
            prim.SetActive(False)


def author_actuator(joint: Usd.Prim, single: bool, actuator: Actuator, folder: Path) -> None:
    """Author an actuator below its joint.

    Args:
        joint: The joint.
        single: Whether it has one axis alone.
        actuator: The actuator.
        folder: Folder of the stage, where networks are copied to.

    Raises:
        ValueError: if USD has no way to say it.
    """
    if not single:
        raise ValueError(f"'{joint.GetPath()}' has an explicit actuator and several axes, which USD cannot say")
    # A name of its own where an actuator of the stage, now inactive, has it.
    stage, path, number = joint.GetStage(), joint.GetPath().AppendChild("actuator"), 2
    while stage.GetPrimAtPath(path):
        path, number = joint.GetPath().AppendChild(f"actuator_{number}"), number + 1
    prim = stage.DefinePrim(path, "NewtonActuator")
    prim.CreateRelationship("newton:targets").SetTargets([joint.GetPath()])
    for kind, arguments in actuator.parts:
        if kind not in _SCHEMAS:
            raise ValueError(f"'{joint.GetPath()}' has a {kind.__name__}, which USD has no schema for")
        prim.AddAppliedSchema(_SCHEMAS[kind])
        for name, value in arguments.items():
            _author(prim, name, value, folder)
    if actuator.delay_steps is not None:
        prim.AddAppliedSchema("NewtonActuatorDelayAPI")
        prim.CreateAttribute("newton:delaySteps", Sdf.ValueTypeNames.Int).Set(actuator.delay_steps)


def _author(prim: Usd.Prim, name: str, value: Any, folder: Path) -> None:
    """Author an argument of Newton's as the attribute of that name."""
    first, *others = name.split("_")
    name = "newton:" + first + "".join(part.capitalize() for part in others)
    if name == "newton:modelPath":
        copy = folder / "networks" / Path(value).name
        copy.parent.mkdir(parents=True, exist_ok=True)
        if not copy.exists() or not copy.samefile(value):
            shutil.copyfile(value, copy)
        prim.CreateAttribute(name, Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(f"./networks/{copy.name}"))
    elif isinstance(value, (tuple, list)):
        prim.CreateAttribute(name, Sdf.ValueTypeNames.FloatArray).Set([float(x) for x in value])
    elif not math.isinf(value):  # which is the default
        prim.CreateAttribute(name, Sdf.ValueTypeNames.Float).Set(float(value))
