# SPDX-License-Identifier: Apache-2.0
"""Stage units: a stage in units other than metres and kilograms, converted to SI.

Newton reads lengths and masses as they are authored. A stage in centimetres is therefore copied (flattened), and each
authored value of a known physical dimension is multiplied by a factor. The up axis stays: Newton rotates by itself.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, Vt

from .attribute_checks import numbers
from .stage_access import open_stage

__all__ = ["mixed_units", "si_stage", "stage_units", "to_si"]

# Exponents (length, mass) of a quantity; time and angle need no conversion.
_LENGTH, _MASS, _FORCE, _TORQUE, _DENSITY = (1, 0), (0, 1), (1, 1), (2, 1), (-3, 1)
# A force per length has no length left, a torque per angle is a torque.
_LINEAR_GAIN, _ANGULAR_GAIN, _INERTIA = (0, 1), (2, 1), (2, 1)

_BY_NAME: list[tuple[re.Pattern[str], tuple[int, int]]] = [
    (re.compile(pattern), dimension)
    for pattern, dimension in (
        (r"xformOp:(translate|transform)(:.*)?", _LENGTH),
        (r"(points|extent|velocities|widths|positions)", _LENGTH),
        (r"physics:(localPos[01]|centerOfMass|velocity|gravityMagnitude|minDistance|maxDistance)", _LENGTH),
        (r"physics:mass", _MASS),
        (r"physics:density", _DENSITY),
        (r"physics:diagonalInertia", _INERTIA),
        (r"physics:breakForce", _FORCE),
        (r"physics:breakTorque", _TORQUE),
        (r"limit:(trans[XYZ]|distance):physics:(low|high)", _LENGTH),
        (r"drive:(linear|trans[XYZ]):physics:target(Position|Velocity)", _LENGTH),
        (r"drive:(linear|trans[XYZ]):physics:(stiffness|damping)", _LINEAR_GAIN),
        (r"drive:(linear|trans[XYZ]):physics:maxForce", _FORCE),
        (r"drive:(angular|rot[XYZ]):physics:(stiffness|damping)", _ANGULAR_GAIN),
        (r"drive:(angular|rot[XYZ]):physics:maxForce", _TORQUE),
        (r"state:(linear|trans[XYZ]):physics:(position|velocity)", _LENGTH),
        (r"physxLimit:(linear|trans[XYZ]):(stiffness|damping)", _LINEAR_GAIN),
        (r"physxLimit:(angular|rot[XYZ]):(stiffness|damping)", _ANGULAR_GAIN),
        (r"physxCollision:(contactOffset|restOffset)", _LENGTH),
        (r"newton:(contactMargin|contactGap|shellThickness)", _LENGTH),
        (r"newton:inertia", _INERTIA),
    )
]
# Names that mean a length or an angle, depending on the type of the joint.
_BY_TYPE: dict[str, dict[str, tuple[int, int]]] = {
    "PhysicsPrismaticJoint": {
        "physics:lowerLimit": _LENGTH,
        "physics:upperLimit": _LENGTH,
        "physxJoint:armature": _MASS,
        "newton:armature": _MASS,
        "physxJoint:maxJointVelocity": _LENGTH,
        "newton:velocityLimit": _LENGTH,
        "newton:friction": _FORCE,
        "newton:damping": _LINEAR_GAIN,
        "newton:limitStiffness": _LINEAR_GAIN,
        "newton:limitDamping": _LINEAR_GAIN,
    },
    "PhysicsRevoluteJoint": {
        "physxJoint:armature": _INERTIA,
        "newton:armature": _INERTIA,
        "newton:friction": _TORQUE,
        "newton:damping": _ANGULAR_GAIN,
        "newton:limitStiffness": _ANGULAR_GAIN,
        "newton:limitDamping": _ANGULAR_GAIN,
    },
}
# Default sizes of shapes in stage units. A size that is not authored must be scaled too, so it is authored first.
_SHAPE_SIZES: dict[str, dict[str, float]] = {
    "Cube": {"size": 2.0},
    "Sphere": {"radius": 1.0},
    "Cylinder": {"radius": 1.0, "height": 2.0},
    "Capsule": {"radius": 0.5, "height": 1.0},
    "Cone": {"radius": 1.0, "height": 2.0},
    "Plane": {"width": 2.0, "length": 2.0},
}


def stage_units(stage: Usd.Stage) -> tuple[float, float]:
    """Metres and kilograms per unit of the stage. Metadata that is not authored means SI, as in Newton."""
    metres = UsdGeom.GetStageMetersPerUnit(stage) if UsdGeom.StageHasAuthoredMetersPerUnit(stage) else 1.0
    authored = UsdPhysics.StageHasAuthoredKilogramsPerUnit(stage)
    return metres, (UsdPhysics.GetStageKilogramsPerUnit(stage) if authored else 1.0)


def mixed_units(stage: Usd.Stage) -> list[tuple[str, str, str]]:
    """``(path, what, why)`` where units look wrong: referenced files with other units, or an unlikely gravity.

    USD does not rescale referenced files; the scale must be authored where the reference is.
    """
    metres, rows = stage_units(stage)[0], []
    resolved = _resolved_units(stage)
    for layer in stage.GetUsedLayers():
        other = layer.pseudoRoot.GetInfo("metersPerUnit") if layer.pseudoRoot.HasInfo("metersPerUnit") else metres
        if not math.isclose(other, metres) and not any(math.isclose(other, metres * s, rel_tol=1e-3) for s in resolved):
            why = f"{layer.identifier} has {other:g} m a unit, the stage {metres:g}: references are not rescaled"
            rows.append(("/", "metersPerUnit", why))
    for prim in stage.Traverse():
        magnitude = UsdPhysics.Scene(prim).GetGravityMagnitudeAttr().Get() if prim.IsA(UsdPhysics.Scene) else None
        # Such as 981 in a stage that claims metres: its lengths are centimetres.
        if magnitude is not None and magnitude * metres > 100.0:
            why = f"is {magnitude * metres:g} m/s^2: are lengths in other units than metersPerUnit {metres:g} says?"
            rows.append((str(prim.GetPath()), "gravityMagnitude", why))
    return rows


def _resolved_units(stage: Usd.Stage) -> set[float]:
    """Scales that Omniverse authors where it references a file with other units."""
    scales = (p.GetAttribute("xformOp:scale:unitsResolve").Get() for p in stage.Traverse())
    return {float(scale[0]) for scale in scales if scale is not None}


def to_si(stage: Usd.Stage) -> Usd.Stage:
    """The stage itself if it is in metres and kilograms, otherwise a flattened copy that is."""
    metres, kilograms = stage_units(stage)
    if math.isclose(metres, 1.0) and math.isclose(kilograms, 1.0):
        return stage
    # Into one layer of our own: the files must not change, and one of them may be referenced several times.
    layer = stage.Flatten()
    prims: list[Sdf.PrimSpec] = []
    layer.Traverse(Sdf.Path.absoluteRootPath, lambda path: _collect(layer, path, prims))
    for prim in prims:
        _add_shape_sizes(prim)
        for attribute in list(prim.attributes):
            dimension = _dimension(prim.typeName, attribute.name)
            if dimension is not None:
                factor = metres ** dimension[0] * kilograms ** dimension[1]
                _scale_attribute(layer, attribute, factor)
    converted = Usd.Stage.Open(layer, Usd.Stage.LoadAll)
    UsdGeom.SetStageMetersPerUnit(converted, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(converted, 1.0)
    return converted


def si_stage(path: str | Path) -> Usd.Stage:
    """Open a file to reference it from a scene in metres, kilograms and Z up, converted to these units.

    USD neither rescales nor rotates referenced files. A file with another up axis would lie on its side: it warns.
    """
    stage = open_stage(path)
    if UsdGeom.GetStageUpAxis(stage) != UsdGeom.Tokens.z:
        what = f"'{path}' has the up axis {UsdGeom.GetStageUpAxis(stage)}, scenes have Z"
        warnings.warn(f"{what}: give the orientation that stands it up, such as (0.7071, 0, 0, 0.7071)", stacklevel=3)
    return to_si(stage)


def _collect(layer: Sdf.Layer, path: Sdf.Path, prims: list[Sdf.PrimSpec]) -> None:
    if path.IsPrimPath() and path != Sdf.Path.absoluteRootPath:
        prims.append(layer.GetPrimAtPath(path))


def _add_shape_sizes(prim: Sdf.PrimSpec) -> None:
    for name, size in _SHAPE_SIZES.get(prim.typeName, {}).items():
        if name not in prim.attributes:  # the default of the schema is in stage units, too
            Sdf.AttributeSpec(prim, name, Sdf.ValueTypeNames.Double).default = size


def _dimension(type_name: str, name: str) -> tuple[int, int] | None:
    """Exponents of length and mass in an attribute's unit; None for a number without unit."""
    if name in _SHAPE_SIZES.get(type_name, {}):
        return _LENGTH
    if name in _BY_TYPE.get(type_name, {}):
        return _BY_TYPE[type_name][name]
    return next((dimension for pattern, dimension in _BY_NAME if pattern.fullmatch(name)), None)


def _scale_attribute(layer: Sdf.Layer, attribute: Sdf.AttributeSpec, factor: float) -> None:
    """Convert the values of an attribute. What is no number stays: the checks that come after name it."""
    for time in layer.ListTimeSamplesForPath(attribute.path):
        value = layer.QueryTimeSample(attribute.path, time)
        if numbers(value) is not None:
            layer.SetTimeSample(attribute.path, time, _scaled(value, factor))
    if attribute.HasDefaultValue() and numbers(attribute.default) is not None:
        attribute.default = _scaled(attribute.default, factor)


def _scaled(value: object, factor: float) -> object:
    if isinstance(value, (Gf.Matrix4d, Gf.Matrix4f)):
        matrix = type(value)(value)
        for column in range(3):  # the translation alone: rotation and scale have no unit
            matrix[3, column] = matrix[3, column] * factor
        return matrix
    if isinstance(value, (int, float)):
        return value * factor
    # Gf's vectors and Vt's arrays have no common base: they are told apart by the names of their types.
    if type(value).__name__.endswith("Array"):
        make: Callable[..., object] = getattr(Vt, type(value).__name__).FromNumpy
        given = np.array(value)
        return make(np.ascontiguousarray(given * factor, dtype=given.dtype))
    return type(value)(*(component * factor for component in value))  # type: ignore[attr-defined]
