# SPDX-License-Identifier: Apache-2.0
"""Joint export: drives, initial states and passive properties that configs changed, as attributes of the joints' prims.

What the stage says already stays as it is: the same importer reads it back from the same attributes, so that nothing is
lost which Newton and UsdPhysics express differently.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import newton
from newton import JointType
from pxr import Sdf, Usd, UsdPhysics

from stripe_newton.usd import labelled_prim

from .export_actuators import Actuator, actuators_by_dof, author_actuator, remove_actuators

__all__ = ["AuthoredJoints", "export_joints"]

_NO_LIMIT = 1.0e9
"""Efforts and speeds above this are unlimited; Newton writes 1e10 where a file gives none."""
_DRIVE = ("joint_target_mode", "joint_target_ke", "joint_target_kd", "joint_target_qd", "joint_effort_limit")
_PASSIVE = {
    "armature": "joint_armature",
    "friction": "joint_friction",
    "damping": "joint_damping",
    "velocityLimit": "joint_velocity_limit",
}
"""Attributes of Newton's joint schema, and the arrays of a builder that hold them."""


class AuthoredJoints:
    """The joints of a builder as the stage authors them, before configs write onto the builder.

    Attributes:
        actuators: Explicit actuators by degree of freedom.
    """

    def __init__(self, builder: newton.ModelBuilder):
        names = (*_DRIVE, *_PASSIVE.values(), "joint_q", "joint_qd", "joint_target_q")
        self._values = {name: list(getattr(builder, name)) for name in names}
        self.actuators: dict[int, Actuator] = actuators_by_dof(builder)

    def changed(self, builder: newton.ModelBuilder, names: Sequence[str], index: int) -> bool:
        """Whether one of a builder's arrays ``names`` has another value at ``index`` than the stage gave it."""
        return any(getattr(builder, name)[index] != self._values[name][index] for name in names)

    def moved(self, builder: newton.ModelBuilder, coord: int) -> bool:
        """Whether the free joint whose coordinates start at ``coord`` has another pose than in the stage."""
        return any(self.changed(builder, ("joint_q",), k) for k in range(coord, coord + 7))


class _Axis(NamedTuple):
    """One degree of freedom of a joint, and where USD authors it."""

    prim: Usd.Prim
    token: str
    """Instance name of the drive and the state: ``angular``, ``linear``, or ``rotX`` and so on."""
    angular: bool
    dof: int
    coord: int

    @property
    def degrees(self) -> float:
        """UsdPhysics has angles in degrees."""
        return 180.0 / math.pi if self.angular else 1.0


def export_joints(stage: Usd.Stage, builder: newton.ModelBuilder, authored: AuthoredJoints, folder: Path) -> None:
    """Author what configs changed of the joints.

    Args:
        stage: The stage to edit, without instances.
        builder: Builder of one environment.
        authored: Its joints as the stage gave them.
        folder: Folder of the exported file, where networks of actuators are copied to.

    Raises:
        ValueError: an explicit actuator that USD has no way to express.
    """
    actuators = actuators_by_dof(builder)
    for joint, label in enumerate(builder.joint_label):
        prim = labelled_prim(stage, label)
        if not prim or builder.joint_type[joint] not in (JointType.REVOLUTE, JointType.PRISMATIC, JointType.D6):
            continue
        axes = _axes(stage, prim, builder, joint)
        for axis in axes:
            _author_drive(axis, builder, authored)
            _author_state(axis, builder, authored)
            if actuators.get(axis.dof) != authored.actuators.get(axis.dof):
                remove_actuators(axis.prim)
                if axis.dof in actuators:
                    author_actuator(axis.prim, len(axes) == 1, actuators[axis.dof], folder)
        for owner in dict.fromkeys(axis.prim for axis in axes):
            _author_passive(owner, [axis for axis in axes if axis.prim == owner], builder, authored)


def _axes(stage: Usd.Stage, prim: Usd.Prim, builder: newton.ModelBuilder, joint: int) -> list[_Axis]:
    """Degrees of freedom of a joint in Newton's order: linear ones first."""
    linear, angular = builder.joint_dof_dim[joint]
    dof, coord = builder.joint_qd_start[joint], builder.joint_q_start[joint]
    prims = [prim] * (linear + angular)
    one_axis_each = prim.IsA(UsdPhysics.RevoluteJoint) or prim.IsA(UsdPhysics.PrismaticJoint)
    if one_axis_each and linear + angular > 1:
        prims = _merged_prims(stage, prim)
    axes = []
    for k, owner in enumerate(prims[: linear + angular]):
        turns = k >= linear
        token = ("angular" if turns else "linear") if one_axis_each else _axis_token(builder.joint_axis[dof + k], turns)
        axes.append(_Axis(owner, token, turns, dof + k, coord + k))
    return axes


def _merged_prims(stage: Usd.Stage, prim: Usd.Prim) -> list[Usd.Prim]:
    """Prims of the joints between the same two bodies, which Newton merges into one joint: linear ones first."""

    def bodies(joint: Usd.Prim) -> tuple[list[Sdf.Path], list[Sdf.Path]]:
        api = UsdPhysics.Joint(joint)
        return api.GetBody0Rel().GetTargets(), api.GetBody1Rel().GetTargets()

    own = bodies(prim)
    joints = [p for p in stage.Traverse() if p.IsA(UsdPhysics.Joint) and bodies(p) == own]
    joints = [p for p in joints if UsdPhysics.Joint(p).GetJointEnabledAttr().Get() is not False]
    linear = [p for p in joints if p.IsA(UsdPhysics.PrismaticJoint)]
    return [*linear, *(p for p in joints if p.IsA(UsdPhysics.RevoluteJoint))]


def _axis_token(axis: Sequence[float], angular: bool) -> str:
    """``rotX`` and so on, for an axis of a joint with several degrees of freedom."""
    largest = max(range(3), key=lambda k: abs(axis[k]))
    return ("rot" if angular else "trans") + "XYZ"[largest]


def _author_drive(axis: _Axis, builder: newton.ModelBuilder, authored: AuthoredJoints) -> None:
    i, q, degrees = axis.dof, axis.coord, axis.degrees
    if not authored.changed(builder, _DRIVE, i) and not authored.changed(builder, ("joint_target_q",), q):
        return
    if builder.joint_target_mode[i] == newton.JointTargetMode.NONE:
        axis.prim.RemoveAPI(UsdPhysics.DriveAPI, axis.token)
        return
    drive = UsdPhysics.DriveAPI.Apply(axis.prim, axis.token)
    drive.CreateTypeAttr("force")
    drive.CreateStiffnessAttr(builder.joint_target_ke[i] / degrees)
    drive.CreateDampingAttr(builder.joint_target_kd[i] / degrees)
    drive.CreateTargetPositionAttr(builder.joint_target_q[q] * degrees)
    drive.CreateTargetVelocityAttr(builder.joint_target_qd[i] * degrees)
    effort = builder.joint_effort_limit[i]
    drive.CreateMaxForceAttr(effort if effort < _NO_LIMIT else math.inf)


def _author_state(axis: _Axis, builder: newton.ModelBuilder, authored: AuthoredJoints) -> None:
    for name, array, index in (("position", "joint_q", axis.coord), ("velocity", "joint_qd", axis.dof)):
        if authored.changed(builder, (array,), index):
            attribute = axis.prim.CreateAttribute(f"state:{axis.token}:physics:{name}", Sdf.ValueTypeNames.Float)
            attribute.Set(getattr(builder, array)[index] * axis.degrees)


def _author_passive(prim: Usd.Prim, axes: list[_Axis], builder: newton.ModelBuilder, authored: AuthoredJoints) -> None:
    """Author passive properties, which Newton's own schema has for the joint as a whole."""
    for name, array in _PASSIVE.items():
        if not any(authored.changed(builder, (array,), axis.dof) for axis in axes):
            continue
        values = [_passive(name, getattr(builder, array)[axis.dof], axis.degrees) for axis in axes]
        if len(set(values)) > 1:
            what = f"'{prim.GetPath()}': {name} differs between its axes, which USD cannot say; the first is written"
            warnings.warn(what, stacklevel=5)
        prim.AddAppliedSchema("NewtonJointAPI")
        prim.CreateAttribute(f"newton:{name}", Sdf.ValueTypeNames.Float).Set(values[0])


def _passive(name: str, value: float, degrees: float) -> float:
    """A passive property in USD's units; infinite for no limit."""
    if name == "velocityLimit":
        return value * degrees if value < _NO_LIMIT else math.inf
    return value / degrees if name == "damping" else value
