# SPDX-License-Identifier: Apache-2.0
"""Checks of a stage: reasons to refuse it, before and after Newton has read it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import newton
import numpy as np
from newton import GeoType, JointType
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from .stage_access import StageError, api_schemas, stage_name, walk

__all__ = ["BuilderStart", "check_builder", "check_stage"]

_MUJOCO_JOINTS = {
    JointType.FREE,
    JointType.FIXED,
    JointType.REVOLUTE,
    JointType.PRISMATIC,
    JointType.BALL,
    JointType.D6,
}
# Attributes of these names enter the simulation; a NaN in any other, such as a texture coordinate, is harmless.
_PHYSICS_PREFIXES = ("physics:", "drive:", "limit:", "state:", "newton:", "physxJoint:", "physxLimit:", "xformOp:")
# Of those, the ones that must have an end, by the last part of their name: not limits, efforts and break forces.
_FINITE = {
    "stiffness", "damping", "targetPosition", "targetVelocity", "velocity", "angularVelocity", "gravityDirection",
    "centerOfMass", "staticFriction", "dynamicFriction", "restitution", "localPos0", "localPos1", "armature",
    "friction",
}  # fmt: skip


class BuilderStart:
    """Counts of a builder before a stage is read into it: what comes after them belongs to the stage."""

    def __init__(self, builder: newton.ModelBuilder):
        self.body, self.joint, self.shape = builder.body_count, builder.joint_count, builder.shape_count
        self.dof, self.coord = builder.joint_dof_count, builder.joint_coord_count
        self.articulation = builder.articulation_count


def check_stage(
    stage: Usd.Stage, root_path: str, ignore: Iterable[str], solver: str, allow_static: bool, name: str | None = None
) -> None:
    """Refuse problems that the stage itself shows.

    Raises:
        StageError: the first reason found.
    """
    name = name or stage_name(stage)
    if not stage.GetPrimAtPath(root_path):
        raise StageError(name, root_path, "there is no such prim to load from")
    prims = list(walk(stage, root_path, ignore))
    for path, reason in _reasons(stage, prims, solver):
        raise StageError(name, path, reason)
    # Last, so that a stage with a better reason is refused for that.
    bodies = any(p.HasAPI(UsdPhysics.RigidBodyAPI) for p in prims)
    if not bodies and not allow_static:
        colliders = sum(p.HasAPI(UsdPhysics.CollisionAPI) for p in prims)
        what = f"only {colliders} static collider(s)" if colliders else "no rigid body and no collider"
        reason = f"nothing to simulate: {what}; apply PhysicsRigidBodyAPI to what should move"
        raise StageError(name, "" if root_path == "/" else root_path, reason)


def _reasons(stage: Usd.Stage, prims: list[Usd.Prim], solver: str) -> Iterator[tuple[str, str]]:
    """``(path, reason)`` for everything that keeps the prims from being simulated."""
    for prim in prims:  # first, as the other checks would speak of such a prim's attributes
        yield from ((str(prim.GetPath()), reason) for reason in _deformable(prim))
    for prim in prims:
        yield from ((str(prim.GetPath()), reason) for reason in _physics_reasons(stage, prim, solver))


def _physics_reasons(stage: Usd.Stage, prim: Usd.Prim, solver: str) -> Iterator[str]:
    body, collider = prim.HasAPI(UsdPhysics.RigidBodyAPI), prim.HasAPI(UsdPhysics.CollisionAPI)
    joint, mass = prim.IsA(UsdPhysics.Joint), prim.HasAPI(UsdPhysics.MassAPI)
    if not (body or collider or joint or mass or prim.IsA(UsdPhysics.Scene)):
        return
    yield from _not_finite(prim)
    if body or collider:
        yield from _transform(prim, body)
    if mass:
        yield from _mass(prim)
    if collider and prim.IsA(UsdGeom.Mesh):
        yield from _mesh(prim)
    if joint and UsdPhysics.Joint(prim).GetJointEnabledAttr().Get() is not False:
        yield from _joint(stage, prim, solver)


def _deformable(prim: Usd.Prim) -> Iterator[str]:
    names = [n for n in api_schemas(prim) if "Deformable" in n or "Particle" in n or "NewtonMPM" in n]
    type_name = str(prim.GetTypeName())
    if type_name == "TetMesh" or type_name.startswith("PhysxParticle"):
        names.append(type_name)
    if names:
        yield (
            f"is deformable or made of particles ({names[0]}); this package simulates rigid bodies: "
            "take it out, or add its path to ignore_paths"
        )


def _not_finite(prim: Usd.Prim) -> Iterator[str]:
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        if not name.startswith(_PHYSICS_PREFIXES):
            continue
        numbers = _numbers(attribute.Get())
        if numbers is None:
            continue
        if np.isnan(numbers).any():
            yield f"{name} is not a number ({attribute.Get()}); author a finite value or remove it"
        # A gravity of -inf is that of the Earth, by the schema.
        elif (name.endswith(":gravityMagnitude") and np.isposinf(numbers).any()) or (
            name.rpartition(":")[2] in _FINITE and np.isinf(numbers).any()
        ):
            yield f"{name} is infinite ({attribute.Get()}); author a finite value or remove it"


def _numbers(value: object) -> np.ndarray | None:
    """A value of an attribute as an array; None if it is no number."""
    if isinstance(value, (bool, str)) or value is None:
        return None
    if isinstance(value, (Gf.Quatf, Gf.Quatd, Gf.Quath)):
        value = (value.GetReal(), *value.GetImaginary())  # NumPy cannot convert Gf's quaternions
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return None


def _transform(prim: Usd.Prim, body: bool) -> Iterator[str]:
    matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default()))
    if not np.isfinite(matrix).all():
        yield "its world transform is not finite; author finite xformOps"
        return
    scale = np.linalg.norm(matrix[:3, :3], axis=1)  # of the rows, as USD multiplies rows of coordinates
    if scale.min() < 1e-9:
        yield f"its world scale is zero ({', '.join(f'{s:g}' for s in scale)}); author a scale other than 0"
    elif body and np.linalg.det(matrix[:3, :3]) < 0.0:
        yield "is a rigid body under a mirroring scale; bake the mirror into the meshes and scale the body by 1"


def _mass(prim: Usd.Prim) -> Iterator[str]:
    api = UsdPhysics.MassAPI(prim)
    for name, value in (("mass", api.GetMassAttr().Get()), ("density", api.GetDensityAttr().Get())):
        if value is not None and (value < 0.0 or math.isinf(value)):
            yield f"physics:{name} is {value:g}; it must be positive and finite, or 0 to have it computed"
    inertia = api.GetDiagonalInertiaAttr().Get()
    if inertia is not None and not all(0.0 <= v < math.inf for v in inertia):
        yield f"physics:diagonalInertia is {tuple(inertia)}; it must be positive and finite, or 0 to have it computed"


def _mesh(prim: Usd.Prim) -> Iterator[str]:
    points = UsdGeom.Mesh(prim).GetPointsAttr().Get()
    indices = UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get()
    if not points or not indices:
        yield "is a mesh collider without points or faces; author both, or remove PhysicsCollisionAPI"
    elif not np.isfinite(np.asarray(points)).all():
        yield "is a mesh collider with points that are not finite"
    elif max(indices) >= len(points) or min(indices) < 0:
        yield f"is a mesh collider whose faces name point {max(indices)} of {len(points)}"


def _joint(stage: Usd.Stage, prim: Usd.Prim, solver: str) -> Iterator[str]:
    joint = UsdPhysics.Joint(prim)
    if prim.IsA(UsdPhysics.DistanceJoint) and solver == "mujoco":
        yield "is a distance joint, which the MuJoCo solver does not take; use another joint, or another solver"
    if any(name.startswith("MjcEquality") for name in api_schemas(prim)):
        return  # an equality constraint may connect sites, so the checks of its bodies do not apply
    ends = {"body0": joint.GetBody0Rel().GetTargets(), "body1": joint.GetBody1Rel().GetTargets()}
    for name, targets in ends.items():  # no target is the world, one that does not exist is a mistake
        if targets and not stage.GetPrimAtPath(targets[0]):
            yield f"its physics:{name} names {targets[0]}, which does not exist; name a body, or none for the world"
            return
    owners = {name: _body_above(stage, targets) for name, targets in ends.items()}
    if not owners["body0"] and not owners["body1"]:
        yield "joins no rigid body: neither physics:body0 nor physics:body1 is one, or stands below one"
    elif owners["body0"] == owners["body1"]:
        yield f"joins rigid body {owners['body0']} to itself; name two bodies"


def _body_above(stage: Usd.Stage, targets: list[Sdf.Path]) -> str:
    """Path of the rigid body at or above a joint's target; empty if there is none."""
    prim = stage.GetPrimAtPath(targets[0]) if targets else None
    while prim and not prim.IsPseudoRoot():
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            return str(prim.GetPath())
        prim = prim.GetParent()
    return ""


def check_builder(builder: newton.ModelBuilder, start: BuilderStart, solver: str, name: str) -> None:
    """Refuse problems that show only after Newton has read the stage.

    Raises:
        StageError: a body without mass, a body without a joint, a joint that the solver does not support, a value that
            is not finite, a plane on a moving body.
    """
    _check_bodies(builder, start, name)
    _check_joints(builder, start, solver, name)
    for shape in range(start.shape, builder.shape_count):
        if builder.shape_type[shape] == GeoType.PLANE and builder.shape_body[shape] >= 0 and solver == "mujoco":
            reason = "is a plane on a rigid body, which MuJoCo does not take; use a box, or take it off the body"
            raise StageError(name, builder.shape_label[shape], reason)


def _check_bodies(builder: newton.ModelBuilder, start: BuilderStart, name: str) -> None:
    articulated = {
        builder.joint_child[j] for j in range(start.joint, builder.joint_count) if builder.joint_articulation[j] >= 0
    }
    group_mass = _group_masses(builder, start)
    for body in range(start.body, builder.body_count):
        label = builder.body_label[body]
        mass, inertia = builder.body_mass[body], np.array(builder.body_inertia[body]).reshape(3, 3)
        if mass < 0.0 or not math.isfinite(mass):
            raise StageError(name, label, f"has mass {mass:g}; it must be positive and finite")
        # A body without mass is fine if it is welded to one that has some, as a sensor's frame is.
        if not group_mass[body] > 0.0:
            raise StageError(name, label, "has no mass: author physics:mass, or give it a collider with a density")
        if mass and (not np.isfinite(inertia).all() or np.linalg.eigvalsh((inertia + inertia.T) / 2).min() <= 0.0):
            raise StageError(name, label, f"its inertia is not positive: {np.diag(inertia)}; author diagonalInertia")
        if body not in articulated:
            reason = "hangs on a joint outside every articulation; apply PhysicsArticulationRootAPI above both"
            raise StageError(name, label, reason)
        if not np.isfinite(np.array(builder.body_q[body])).all():
            raise StageError(name, label, "its pose is not finite")


def _check_joints(builder: newton.ModelBuilder, start: BuilderStart, solver: str, name: str) -> None:
    for joint in range(start.joint, builder.joint_count):
        kind = JointType(builder.joint_type[joint])
        if solver == "mujoco" and kind not in _MUJOCO_JOINTS:
            reason = (
                f"is a {kind.name} joint, which the MuJoCo solver does not take; use another joint, or another solver"
            )
            raise StageError(name, builder.joint_label[joint], reason)
        frames = [*builder.joint_X_p[joint], *builder.joint_X_c[joint]]
        if not np.isfinite(np.array(frames, dtype=float)).all():
            raise StageError(name, builder.joint_label[joint], "its local frames are not finite")
    if not np.isfinite(np.array(builder.joint_q[start.coord :], dtype=float)).all():
        raise StageError(name, "", "an initial joint position is not finite")


def _group_masses(builder: newton.ModelBuilder, start: BuilderStart) -> dict[int, float]:
    """Mass of each body with everything that is welded to it; infinite where that is the world."""
    # Union-find over the fixed joints; -1 is the world.
    group = {body: body for body in range(-1, builder.body_count)}

    def top(body: int) -> int:
        while group[body] != body:
            body = group[body]
        return body

    for joint in range(start.joint, builder.joint_count):
        if builder.joint_type[joint] == JointType.FIXED and builder.joint_articulation[joint] >= 0:
            group[top(builder.joint_child[joint])] = top(builder.joint_parent[joint])
    masses = dict.fromkeys(group, 0.0)
    masses[top(-1)] = math.inf
    for body in range(start.body, builder.body_count):
        masses[top(body)] += builder.body_mass[body]
    return {body: masses[top(body)] for body in group}
