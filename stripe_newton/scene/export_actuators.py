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

__all__ = ["BuilderActuator", "actuator_dofs", "author_actuator"]

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
class BuilderActuator:
    """An explicit actuator in a builder, which keeps actuators of one kind in one entry."""

    entry: newton.ModelBuilder.ActuatorEntry
    """Entry of the builder that holds the actuator."""
    index: int
    """Its place in the entry."""


def actuator_dofs(builder: newton.ModelBuilder) -> dict[int, BuilderActuator]:
    """Explicit actuators by degree of freedom."""
    entries = builder.actuator_entries.values()
    return {dof: BuilderActuator(entry, k) for entry in entries for k, dof in enumerate(entry.indices)}


def author_actuator(joint: Usd.Prim, single: bool, actuator: BuilderActuator, folder: Path) -> None:
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
    entry, index = actuator.entry, actuator.index
    prim = joint.GetStage().DefinePrim(joint.GetPath().AppendChild("actuator"), "NewtonActuator")
    prim.CreateRelationship("newton:targets").SetTargets([joint.GetPath()])
    parts = [(entry.drive_class, {**entry.drive_shared_kwargs, **entry.drive_args[index]})]
    for kind, shared, own in zip(
        entry.clamping_classes, entry.clamping_shared_kwargs, entry.clamping_args[index], strict=True
    ):
        parts.append((kind, {**shared, **own}))
    for kind, arguments in parts:
        if kind not in _SCHEMAS:
            raise ValueError(f"'{joint.GetPath()}' has a {kind.__name__}, which USD has no schema for")
        prim.AddAppliedSchema(_SCHEMAS[kind])
        for name, value in arguments.items():
            _author(prim, name, value, folder)
    if entry.delay_args:
        prim.AddAppliedSchema("NewtonActuatorDelayAPI")
        steps = int(entry.delay_args[index]["delay_steps"])
        prim.CreateAttribute("newton:delaySteps", Sdf.ValueTypeNames.Int).Set(steps)


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
