# SPDX-License-Identifier: Apache-2.0
"""Author the arm of the reach task: ``python tools/authoring/author_arm.py [FILE]``.

FILE is ``tasks/stripe_tasks/assets/arm.usda`` by default. A fixed arm of six joints, similar to Universal
Robots' UR5e, with colliders and surfaces made here. The numbers are published:

* lengths (Denavit-Hartenberg parameters), masses and centres of mass: Universal Robots, "DH Parameters for calculations
  of kinematics and dynamics", UR5e;
* largest torques: Universal Robots, "Max. joint torques", UR5e; speeds and ranges of the joints: the UR5e's data sheet.

Moments of inertia are not published there: those of the links are of the solid cylinders in ``LINKS``. In the zero pose
the frames of all links are parallel, the arm is stretched along x and the flange faces y.

The file is the same, byte for byte, whenever the same version of OpenUSD writes it.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from lofts import Surface, puck, rounded, smooth
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt
from usd_writing import exact, preview_surface

OUTPUT = Path(__file__).parents[2] / "tasks" / "stripe_tasks" / "assets" / "arm.usda"

D1, A2, A3, D4, D5, D6 = 0.1625, 0.425, 0.3922, 0.1333, 0.0997, 0.0996
"""Lengths [m]: height of the shoulder, upper arm, forearm, and the offsets of the wrists."""
UPPER_Y, FORE_Y = 0.138, 0.007
"""Offsets of the tubes of upper arm and forearm along y, from the plane of the shoulder [m]."""

COLORS = {  # linear RGB, roughness, metallic
    "shell": ((0.60, 0.62, 0.64), 0.35, 0.3),
    "graphite": ((0.045, 0.048, 0.055), 0.5, 0.2),
    "cap": ((0.10, 0.30, 0.55), 0.4, 0.0),
    "flange": ((0.75, 0.75, 0.76), 0.25, 0.8),
}


class Link(NamedTuple):
    """Link of the arm, its joint to the link before it, and the cylinder from which its inertia is computed.

    Attributes:
        at: Place of the joint in the frame of the link before [m].
        axis: Axis of the joint; ``-Z`` turns the other way.
        mass: Mass [kg].
        com: Centre of mass [m].
        along: Axis of the cylinder, its radius and length [m].
        effort: Largest torque [N m].
    """

    at: tuple[float, float, float]
    axis: str
    mass: float
    com: tuple[float, float, float]
    along: tuple[str, float, float]
    effort: float


LINKS = {
    "shoulder": Link((0.0, 0.0, D1), "Z", 3.761, (0.0, 0.00193, -0.02561), ("Y", 0.06, 0.15), 150.0),
    "upper_arm": Link((0.0, 0.0, 0.0), "Y", 8.058, (0.2125, 0.11336, 0.0), ("X", 0.06, 0.54), 150.0),
    "forearm": Link((A2, 0.0, 0.0), "Y", 2.846, (A3 - 0.15, 0.0265, 0.0), ("X", 0.05, 0.49), 150.0),
    "wrist_1": Link((A3, D4, 0.0), "Y", 1.37, (0.0, -0.0018, -0.01634), ("Y", 0.04, 0.12), 28.0),
    "wrist_2": Link((0.0, 0.0, -D5), "-Z", 1.3, (0.0, 0.01634, 0.0018), ("Z", 0.04, 0.1), 28.0),
    "wrist_3": Link((0.0, D6, 0.0), "Y", 0.365, (0.0, -0.001159, 0.0), ("Y", 0.0375, 0.04), 28.0),
}
"""Links from the base on; the frame of ``wrist_3`` is in the middle of the flange."""
NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
SPEED, RANGES = math.pi, {"elbow": math.pi}
"""Speed of all joints [rad/s], and the range of those that turn less than 2 pi to each side [rad]."""
STIFFNESS, DAMPING = {150.0: 1500.0, 28.0: 300.0}, {150.0: 120.0, 28.0: 15.0}
"""Gains of the drives by largest torque [N m/rad, N m s/rad]."""


def tube(axis: str, start: float, end: float, radius: float, waist: float, centre: tuple[float, float]) -> Surface:
    """Round tube that is a little thinner in the middle."""
    low, high = sorted((start, end))
    rows = [
        (low, *centre, radius, radius),
        (0.5 * (low + high), *centre, waist, waist),
        (high, *centre, radius, radius),
    ]
    return rounded(axis, smooth(rows, 15), 0.004, 0.004, 2.0)


def housing(name: str, axis: str, low: float, high: float, radius: float, at: tuple[float, float], cap: int) -> list:
    """Housing of a joint, with a coloured cap at its high end (``cap`` 1), its low end (-1) or none (0)."""
    parts = [(name, puck(axis, low, high, radius, at, 0.010), "shell")]
    if cap:
        end = high if cap > 0 else low
        ring, lid = (sorted(end + cap * d for d in ends) for ends in ((-0.016, 0.002), (-0.004, 0.010)))
        parts.append((f"{name}_ring", puck(axis, *ring, radius + 0.001, at, 0.003), "graphite"))
        parts.append((f"{name}_cap", puck(axis, *lid, radius - 0.004, at, 0.007), "cap"))
    return parts


PARTS = {  # (u, v) of a centre are the two axes that follow the part's own in x, y, z, x, y
    "base": [
        ("foot", puck("z", 0.0, 0.022, 0.0755, fillet=0.004), "graphite"),
        ("column", puck("z", 0.018, 0.094, 0.060, fillet=0.008), "shell"),
    ],
    "shoulder": [
        ("turret", puck("z", -0.066, 0.0, 0.056, fillet=0.006), "shell"),
        ("gap", puck("z", -0.070, -0.063, 0.057, fillet=0.002), "graphite"),
        *housing("drive", "y", -0.070, 0.072, 0.0585, (0.0, 0.0), -1),
    ],
    "upper_arm": [
        *housing("lower_joint", "y", 0.076, 0.196, 0.0585, (0.0, 0.0), 1),
        ("tube", tube("x", 0.03, A2 - 0.03, 0.0500, 0.0445, (UPPER_Y, 0.0)), "shell"),
        *housing("upper_joint", "y", 0.070, 0.190, 0.0530, (0.0, A2), 1),
    ],
    "forearm": [
        *housing("elbow", "y", -0.062, 0.066, 0.0530, (0.0, 0.0), -1),
        ("tube", tube("x", 0.03, A3 - 0.02, 0.0420, 0.0365, (FORE_Y, 0.0)), "shell"),
        *housing("end", "y", -0.043, 0.072, 0.0390, (0.0, A3), -1),
    ],
    "wrist_1": [
        *housing("body", "y", -0.057, 0.052, 0.0390, (0.0, 0.0), 1),
        ("neck", puck("z", -0.050, 0.0, 0.0375, fillet=0.006), "shell"),
    ],
    "wrist_2": [
        *housing("body", "z", -0.052, 0.046, 0.0390, (0.0, 0.0), -1),
        ("neck", puck("y", 0.0, 0.060, 0.0375, fillet=0.006), "shell"),
    ],
    "wrist_3": [
        ("gap", puck("y", -0.040, -0.032, 0.0355, fillet=0.002), "graphite"),
        ("flange", puck("y", -0.036, 0.0, 0.0375, fillet=0.003), "flange"),
        ("plug", puck("z", 0.030, 0.048, 0.0080, (0.0, -0.018), 0.002), "graphite"),
    ],
}
"""Surfaces by link: name, surface, material."""

COLLIDERS = {  # axis, radius, length, centre
    "base": [("Z", 0.06, 0.09, (0.0, 0.0, 0.045))],
    "shoulder": [("Y", 0.058, 0.13, (0.0, 0.0, 0.0))],
    "upper_arm": [("X", 0.055, A2, (0.5 * A2, UPPER_Y, 0.0))],
    "forearm": [("X", 0.045, A3, (0.5 * A3, FORE_Y, 0.0))],
    "wrist_1": [("Y", 0.038, 0.1, (0.0, 0.0, 0.0))],
    "wrist_2": [("Z", 0.038, 0.09, (0.0, 0.0, 0.0))],
    "wrist_3": [("Y", 0.036, 0.036, (0.0, -0.018, 0.0))],
}
"""Colliders in the link's frame: cylinders [m]."""


def moments(link: Link) -> list[float]:
    """Moments of inertia of a solid cylinder about x, y and z through its centre [kg m^2]."""
    axis, radius, length = link.along
    across = link.mass * (3.0 * radius**2 + length**2) / 12.0
    return exact([0.5 * link.mass * radius**2 if axis == a else across for a in "XYZ"]).tolist()


class Author:
    """Writes the arm onto a stage."""

    def __init__(self, stage: Usd.Stage):
        self.stage = stage
        self.root = UsdGeom.Xform.Define(stage, "/arm").GetPrim()
        stage.SetDefaultPrim(self.root)
        Usd.ModelAPI(self.root).SetKind("component")
        UsdPhysics.ArticulationRootAPI.Apply(self.root)
        for name, (color, roughness, metallic) in COLORS.items():
            preview_surface(stage, f"/arm/materials/{name}", color, roughness, metallic)

    def body(
        self, name: str, at: tuple[float, ...], mass: float, com: tuple[float, ...], inertia: list[float]
    ) -> Usd.Prim:
        """Write a rigid body with its surfaces and colliders."""
        xform = UsdGeom.Xform.Define(self.stage, f"/arm/{name}")
        xform.AddTranslateOp().Set(Gf.Vec3d(*exact(at).tolist()))
        prim = xform.GetPrim()
        UsdPhysics.RigidBodyAPI.Apply(prim)
        properties = UsdPhysics.MassAPI.Apply(prim)
        properties.CreateMassAttr(mass)
        properties.CreateCenterOfMassAttr(Gf.Vec3f(*exact(com).tolist()))
        properties.CreateDiagonalInertiaAttr(Gf.Vec3f(*inertia))
        properties.CreatePrincipalAxesAttr(Gf.Quatf(1.0))
        part = name.removesuffix("_link")
        for label, surface, material in PARTS[part]:
            self.surface(f"{prim.GetPath()}/visuals/{label}", surface, material)
        for i, (axis, radius, length, centre) in enumerate(COLLIDERS[part]):
            shape = UsdGeom.Cylinder.Define(self.stage, f"{prim.GetPath()}/collisions/hull_{i}")
            shape.CreateAxisAttr(axis)
            shape.CreateRadiusAttr(radius)
            shape.CreateHeightAttr(length)
            shape.AddTranslateOp().Set(Gf.Vec3d(*exact(centre).tolist()))
            shape.CreatePurposeAttr(UsdGeom.Tokens.guide)
            UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
        return prim

    def surface(self, path: str, surface: Surface, material: str) -> None:
        """Write a mesh without collider."""
        mesh = UsdGeom.Mesh.Define(self.stage, path)
        points, normals = np.round(surface.points, 4) + 0.0, np.round(surface.normals, 2) + 0.0
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
        mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        mesh.CreateFaceVertexCountsAttr([len(face) for face in surface.faces])
        mesh.CreateFaceVertexIndicesAttr([i for face in surface.faces for i in face])
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        bounds = [Gf.Vec3f(*map(float, ends)) for ends in (points.min(axis=0), points.max(axis=0))]
        mesh.CreateExtentAttr(bounds)
        look = UsdShade.Material(self.stage.GetPrimAtPath(f"/arm/materials/{material}"))
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(look)

    def joint(self, name: str, link: Link, parent: Usd.Prim, child: Usd.Prim) -> None:
        """Write a joint with its limits and its drive."""
        joint = UsdPhysics.RevoluteJoint.Define(self.stage, f"/arm/joints/{name}_joint")
        # USD knows axes without a sign: the other way round both frames are turned over
        flip = Gf.Quatf(0.0, 1.0, 0.0, 0.0) if link.axis == "-Z" else Gf.Quatf(1.0)
        joint.CreateBody0Rel().SetTargets([parent.GetPath()])
        joint.CreateBody1Rel().SetTargets([child.GetPath()])
        joint.CreateLocalPos0Attr(Gf.Vec3f(*exact(link.at).tolist()))
        joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        joint.CreateLocalRot0Attr(flip)
        joint.CreateLocalRot1Attr(flip)
        joint.CreateAxisAttr(link.axis[-1])
        limit = math.degrees(RANGES.get(name, 2.0 * math.pi))
        joint.CreateLowerLimitAttr(-limit)
        joint.CreateUpperLimitAttr(limit)
        drive = UsdPhysics.DriveAPI.Apply(joint.GetPrim(), "angular")
        drive.CreateTypeAttr(UsdPhysics.Tokens.force)
        # angles of USD are degrees, and so are the gains of its drives
        drive.CreateStiffnessAttr(float(exact(math.radians(STIFFNESS[link.effort]), 6)))
        drive.CreateDampingAttr(float(exact(math.radians(DAMPING[link.effort]), 6)))
        drive.CreateMaxForceAttr(link.effort)
        joint.GetPrim().AddAppliedSchema("NewtonJointAPI")
        speed = joint.GetPrim().CreateAttribute("newton:velocityLimit", Sdf.ValueTypeNames.Float, False)
        speed.Set(float(exact(math.degrees(SPEED), 4)))


def author(path: Path) -> None:
    """Write the arm to ``path``."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = Usd.Stage.Open(layer)
    layer.documentation = (
        "An arm of six joints, written by tools/authoring/author_arm.py. Its docstring names the sources."
    )
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    arm = Author(stage)
    parent = arm.body("base_link", (0.0, 0.0, 0.0), 4.0, (0.0, 0.0, 0.05), [0.01, 0.01, 0.01])
    fixed = UsdPhysics.FixedJoint.Define(stage, "/arm/joints/world_joint")
    fixed.CreateBody1Rel().SetTargets([parent.GetPath()])
    at = np.zeros(3)
    for name, (part, link) in zip(NAMES, LINKS.items(), strict=True):
        at = at + link.at
        child = arm.body(f"{part}_link", tuple(at), link.mass, link.com, moments(link))
        arm.joint(name, link, parent, child)
        parent = child
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(layer.ExportToString(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else OUTPUT
    author(target)
    print(f"{target}: {target.stat().st_size // 1024} kB")
