# SPDX-License-Identifier: Apache-2.0
"""Author the quadruped of the velocity tasks: ``python tools/authoring/author_quadruped.py [FILE]``.

FILE is ``tasks/stripe_tasks/assets/quadruped.usda`` by default. A robot similar to Unitree's Go2, with colliders and
surfaces made here. The numbers are published:

* masses, centres of mass, inertia tensors, positions and limits of the joints, the place of the IMU, efforts and
  speeds of hips and thighs: Unitree's description of the Go2, github.com/unitreerobotics/unitree_ros,
  robots/go2_description/urdf/go2_description.urdf;
* effort of the knees, 45.43 N m: the Go2's MJCF in MuJoCo Menagerie, unitree_go2/go2.xml. The motor is that of the
  other joints, behind a linkage of 45.43 / 23.7 = 1.917, which makes its speed 30.1 / 1.917 = 15.7 rad/s;
* armature: the rotor's inertia, 1.11842e-4 kg m^2 (unitree_ros, robots/go1_description/urdf/go1.urdf; a motor of the
  same class), times the gear ratio squared: 6.33 for the GO-M8010-6 (Unitree's actuator SDK), 6.33 x 1.917 at the
  knees;
* friction of the feet, 0.8, and of the shell, 0.6: MuJoCo Menagerie, as above.

The file is the same, byte for byte, whenever the same version of OpenUSD writes it.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt
from quadruped_shapes import PARTS
from usd_writing import exact, preview_surface

OUTPUT = Path(__file__).parents[2] / "tasks" / "stripe_tasks" / "assets" / "quadruped.usda"

LEGS = ("FL", "FR", "RL", "RR")
THIGH = CALF = 0.213
"""Lengths of the links, knee to hip and foot to knee [m]."""
FOOT_RADIUS = 0.022
LINKAGE = 45.43 / 23.7
ROTOR, GEAR = 1.11842e-4, 6.33
STIFFNESS, DAMPING = 25.0, 0.6
CONTACT_GAP = 0.005
"""Distance at which contacts are found [m]; Newton's default of 0.1 would keep four times as many."""
STANDING = {"hip": 0.1, "front_thigh": 0.8, "rear_thigh": 1.0, "calf": -1.5}
"""Joint angles of the authored pose [rad]; hips outward."""

COLORS = {  # linear RGB, roughness, metallic
    "shell": ((0.82, 0.81, 0.78), 0.45, 0.0),
    "graphite": ((0.035, 0.040, 0.048), 0.5, 0.2),
    "accent": ((0.85, 0.26, 0.045), 0.45, 0.0),
    "glass": ((0.006, 0.007, 0.009), 0.12, 0.0),
    "light": ((0.55, 0.90, 1.00), 0.3, 0.0),
    "rubber": ((0.018, 0.018, 0.020), 0.9, 0.0),
}


class Link(NamedTuple):
    """Mass properties of a link: kg, m, kg m^2 (xx, yy, zz, xy, xz, yz about the centre of mass)."""

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]

    def mirror(self, x: float, y: float) -> Link:
        """The same link on the other side: ``x`` and ``y`` are 1 or -1."""
        (a, b, c), (xx, yy, zz, xy, xz, yz) = self.com, self.inertia
        return Link(self.mass, (x * a, y * b, c), (xx, yy, zz, x * y * xy, x * xz, y * yz))


BASE = Link(6.921, (0.021112, 0.0, -0.005366), (0.02448, 0.098077, 0.107, 0.00012166, 0.0014849, -3.12e-5))
HIP = Link(0.678, (-0.0054, 0.00194, -0.000105), (0.00048, 0.000884, 0.000596, -3.01e-6, 1.11e-6, -1.42e-6))
UPPER = Link(1.152, (-0.00374, -0.0223, -0.0327), (0.00584, 0.0058, 0.00103, 8.72e-5, -0.000289, 0.000808))
LOWER = Link(0.154, (0.00548, -0.000975, -0.115), (0.00108, 0.0011, 3.29e-5, 3.4e-7, 1.72e-5, 8.28e-6))
FOOT = Link(0.04, (0.0, 0.0, 0.0), (9.6e-6, 9.6e-6, 9.6e-6, 0.0, 0.0, 0.0))


class Joint(NamedTuple):
    """A revolute joint: its axis, limits [rad], effort [N m], speed [rad/s] and armature [kg m^2]."""

    axis: str
    lower: float
    upper: float
    effort: float = 23.7
    speed: float = 30.1
    armature: float = ROTOR * GEAR**2


JOINTS = {
    "hip": Joint("X", -1.0472, 1.0472),
    "front_thigh": Joint("Y", -1.5708, 3.4907),
    "rear_thigh": Joint("Y", -0.5236, 4.5379),
    "calf": Joint("Y", -2.7227, -0.83776, 23.7 * LINKAGE, 30.1 / LINKAGE, ROTOR * (GEAR * LINKAGE) ** 2),
}


def turn(axis: str, angle: float) -> Gf.Quatd:
    """Rotation by ``angle`` [rad] about an axis of the frame."""
    vector = Gf.Vec3d(*(float(a == axis) for a in "XYZ"))
    return Gf.Quatd(math.cos(0.5 * angle), vector * math.sin(0.5 * angle))


class Author:
    """Writes the robot onto a stage."""

    def __init__(self, stage: Usd.Stage):
        self.stage = stage
        self.root = UsdGeom.Xform.Define(stage, "/quadruped").GetPrim()
        stage.SetDefaultPrim(self.root)
        Usd.ModelAPI(self.root).SetKind("component")

    # -- looks

    def materials(self) -> None:
        UsdGeom.Scope.Define(self.stage, "/quadruped/materials")
        for name, (color, roughness, metallic) in COLORS.items():
            path = f"/quadruped/materials/{name}"
            preview_surface(self.stage, path, color, roughness, metallic, emits=name == "light")
        for name, friction in (("shell", 0.6), ("rubber", 0.8)):
            prim = self.stage.GetPrimAtPath(f"/quadruped/materials/{name}")
            physics = UsdPhysics.MaterialAPI.Apply(prim)
            physics.CreateStaticFrictionAttr(friction)
            physics.CreateDynamicFrictionAttr(friction)
            physics.CreateRestitutionAttr(0.0)

    def parts(self) -> None:
        """Write the surfaces as classes, from which the links inherit: those of a leg are written once."""
        for link, parts in PARTS.items():
            path = f"/quadruped/parts/{link}"
            for parent in ("/quadruped/parts", path):
                self.stage.CreateClassPrim(parent)
            for part in parts:
                mesh = UsdGeom.Mesh.Define(self.stage, f"{path}/{part.name}")
                surface = part.surface
                points, normals = exact(surface.points, 4), exact(surface.normals, 2)
                mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
                mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
                mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
                mesh.CreateFaceVertexCountsAttr([len(face) for face in surface.faces])
                mesh.CreateFaceVertexIndicesAttr([i for face in surface.faces for i in face])
                mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
                low, high = points.min(axis=0), points.max(axis=0)
                mesh.CreateExtentAttr([Gf.Vec3f(*map(float, low)), Gf.Vec3f(*map(float, high))])
                self.look(mesh.GetPrim(), part.material)

    def look(self, prim: Usd.Prim, material: str, purpose: str = UsdShade.Tokens.allPurpose) -> None:
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(
            UsdShade.Material(self.stage.GetPrimAtPath(f"/quadruped/materials/{material}")),
            UsdShade.Tokens.weakerThanDescendants,
            purpose,
        )

    # -- bodies

    def body(self, name: str, link: Link, pose: Gf.Matrix4d, part: str, turned: bool = False) -> Usd.Prim:
        """Write a rigid body with its surfaces, turned by half a turn about z for the right side."""
        xform = UsdGeom.Xform.Define(self.stage, f"/quadruped/{name}")
        prim = xform.GetPrim()
        xform.AddTranslateOp().Set(Gf.Vec3d(*exact(pose.ExtractTranslation()).tolist()))
        quat = pose.ExtractRotationQuat()
        real, *imaginary = exact([quat.GetReal(), *quat.GetImaginary()]).tolist()
        xform.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(Gf.Quatd(real, Gf.Vec3d(*imaginary)))
        UsdPhysics.RigidBodyAPI.Apply(prim)
        moments, axes = principal(link.inertia)
        mass = UsdPhysics.MassAPI.Apply(prim)
        mass.CreateMassAttr(link.mass)
        mass.CreateCenterOfMassAttr(Gf.Vec3f(*link.com))
        mass.CreateDiagonalInertiaAttr(Gf.Vec3f(*moments))
        mass.CreatePrincipalAxesAttr(Gf.Quatf(axes[3], *axes[:3]))
        visuals = UsdGeom.Xform.Define(self.stage, f"{prim.GetPath()}/visuals")
        visuals.GetPrim().GetInherits().AddInherit(f"/quadruped/parts/{part}")
        if turned:
            visuals.AddRotateZOp().Set(180.0)
        UsdGeom.Scope.Define(self.stage, f"{prim.GetPath()}/collisions")
        return prim

    def collider(
        self, body: Usd.Prim, kind: type, name: str, at: tuple[float, ...], material: str = "shell", **size: float | str
    ) -> Usd.Prim:
        shape = kind.Define(self.stage, f"{body.GetPath()}/collisions/{name}")
        for key, value in size.items():
            if key == "tilt":
                continue
            getattr(shape, f"Create{key.capitalize()}Attr")(value)
        shape.AddTranslateOp().Set(Gf.Vec3d(*at))
        if "tilt" in size:
            shape.AddRotateYOp().Set(size["tilt"])
        shape.CreatePurposeAttr(UsdGeom.Tokens.guide)
        prim = shape.GetPrim()
        UsdPhysics.CollisionAPI.Apply(prim)
        prim.AddAppliedSchema("NewtonCollisionAPI")
        prim.CreateAttribute("newton:contactGap", Sdf.ValueTypeNames.Float, False).Set(CONTACT_GAP)
        self.look(prim, material, "physics")
        return prim

    def base(self) -> Usd.Prim:
        """Write the trunk, the root of the articulation, at the height of the standing pose."""
        height = FOOT_RADIUS + max(drop("front_thigh"), drop("rear_thigh"))
        pose = Gf.Matrix4d().SetTranslate(Gf.Vec3d(0.0, 0.0, float(exact(height, 4))))
        base = self.body("base", BASE, pose, "trunk")
        UsdPhysics.ArticulationRootAPI.Apply(base)
        base.AddAppliedSchema("NewtonArticulationRootAPI")
        base.CreateAttribute("newton:selfCollisionEnabled", Sdf.ValueTypeNames.Bool, False).Set(True)
        trunk = self.collider(base, UsdGeom.Cube, "trunk", (0.0, 0.0, 0.0), size=1.0)
        UsdGeom.Xformable(trunk).AddScaleOp().Set(Gf.Vec3f(0.3762, 0.11, 0.114))
        self.collider(base, UsdGeom.Capsule, "head", (0.285, 0.0, -0.016), axis="Z", radius=0.05, height=0.02)
        imu = UsdGeom.Sphere.Define(self.stage, "/quadruped/base/imu")
        imu.CreateRadiusAttr(0.005)
        imu.AddTranslateOp().Set(Gf.Vec3d(-0.02557, 0.0, 0.04232))
        imu.CreatePurposeAttr(UsdGeom.Tokens.guide)
        imu.GetPrim().AddAppliedSchema("NewtonSiteAPI")
        return base

    def leg(self, base: Usd.Prim, name: str) -> None:
        """Write the links, joints and colliders of a leg, such as ``"FL"``."""
        front, side = (1.0 if name[0] == "F" else -1.0), (1.0 if name[1] == "L" else -1.0)
        thigh_kind = "front_thigh" if front > 0 else "rear_thigh"
        chain = [
            ("hip", "hip", HIP.mirror(front, side), (front * 0.1934, side * 0.0465, 0.0), "hip"),
            ("thigh", thigh_kind, UPPER.mirror(1, side), (0.0, side * 0.0955, 0.0), "thigh"),
            ("calf", "calf", LOWER.mirror(1, side), (0.0, 0.0, -THIGH), "calf"),
        ]
        parent, pose = base, UsdGeom.Xformable(base).GetLocalTransformation()
        bodies = {}
        for short, kind, link, offset, part in chain:
            angle = STANDING[kind] * (side if kind == "hip" else 1.0)
            step = Gf.Matrix4d().SetRotate(turn(JOINTS[kind].axis, angle)).SetTranslateOnly(Gf.Vec3d(*offset))
            pose = step * pose
            bodies[short] = self.body(f"{name}_{short}", link, pose, part, turned=side < 0 and part != "calf")
            self.joint(f"{name}_{short}_joint", JOINTS[kind], parent, bodies[short], offset, angle)
            parent = bodies[short]
        pose = Gf.Matrix4d().SetTranslate(Gf.Vec3d(0.0, 0.0, -CALF)) * pose
        foot = self.body(f"{name}_foot", FOOT, pose, "foot")
        self.fixed(f"{name}_foot_joint", parent, foot, (0.0, 0.0, -CALF))
        sole = UsdGeom.Sphere.Define(self.stage, f"{foot.GetPath()}/visuals/sole")
        sole.CreateRadiusAttr(FOOT_RADIUS)
        sole.AddTranslateOp().Set(Gf.Vec3d(-0.002, 0.0, 0.0))
        self.look(sole.GetPrim(), "rubber")
        self.collider(bodies["hip"], UsdGeom.Sphere, "motor", (0.0, side * 0.08, 0.0), radius=0.046)
        self.collider(bodies["thigh"], UsdGeom.Capsule, "thigh", (0, 0, -0.115), axis="Z", radius=0.018, height=0.16)
        calf = {"axis": "Z", "radius": 0.013, "height": 0.12, "tilt": -5.0}
        self.collider(bodies["calf"], UsdGeom.Capsule, "calf", (0.009, 0.0, -0.095), **calf)
        self.collider(foot, UsdGeom.Sphere, "sole", (-0.002, 0.0, 0.0), "rubber", radius=FOOT_RADIUS)
        # joints already filter neighbours; these pairs overlap beyond their joint
        for body, others in ((base, ["thigh"]), (bodies["hip"], ["calf"]), (bodies["thigh"], ["foot"])):
            pairs = UsdPhysics.FilteredPairsAPI.Apply(body).CreateFilteredPairsRel()
            for other in others:
                pairs.AddTarget(f"/quadruped/{name}_{other}")

    # -- joints

    def joint(self, name: str, joint: Joint, parent: Usd.Prim, child: Usd.Prim, at: tuple[float, ...], angle: float):
        prim = UsdPhysics.RevoluteJoint.Define(self.stage, f"/quadruped/joints/{name}")
        self.connect(prim, parent, child, at)
        prim.CreateAxisAttr(joint.axis)
        prim.CreateLowerLimitAttr(float(exact(math.degrees(joint.lower), 4)))
        prim.CreateUpperLimitAttr(float(exact(math.degrees(joint.upper), 4)))
        drive = UsdPhysics.DriveAPI.Apply(prim.GetPrim(), "angular")
        drive.CreateTypeAttr(UsdPhysics.Tokens.force)
        drive.CreateStiffnessAttr(float(exact(math.radians(STIFFNESS), 6)))
        drive.CreateDampingAttr(float(exact(math.radians(DAMPING), 6)))
        drive.CreateMaxForceAttr(float(exact(joint.effort, 4)))
        drive.CreateTargetPositionAttr(float(exact(math.degrees(angle), 4)))
        owner = prim.GetPrim()
        owner.AddAppliedSchema("PhysicsJointStateAPI:angular")
        owner.AddAppliedSchema("NewtonJointAPI")
        for key, value in (
            ("state:angular:physics:position", math.degrees(angle)),
            ("newton:armature", joint.armature),
            ("newton:velocityLimit", math.degrees(joint.speed)),
        ):
            owner.CreateAttribute(key, Sdf.ValueTypeNames.Float, False).Set(float(exact(value, 6)))

    def fixed(self, name: str, parent: Usd.Prim, child: Usd.Prim, at: tuple[float, ...]) -> None:
        self.connect(UsdPhysics.FixedJoint.Define(self.stage, f"/quadruped/joints/{name}"), parent, child, at)

    def connect(self, joint: UsdPhysics.Joint, parent: Usd.Prim, child: Usd.Prim, at: tuple[float, ...]) -> None:
        joint.CreateBody0Rel().SetTargets([parent.GetPath()])
        joint.CreateBody1Rel().SetTargets([child.GetPath()])
        joint.CreateLocalPos0Attr(Gf.Vec3f(*at))
        joint.CreateLocalRot0Attr(Gf.Quatf(1.0))
        joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
        joint.CreateLocalRot1Attr(Gf.Quatf(1.0))


def drop(thigh: str) -> float:
    """Distance of the centre of a foot below the middle of the trunk, in the authored pose [m]."""
    hip, angle = STANDING["hip"], STANDING[thigh]
    length = THIGH * math.cos(angle) + CALF * math.cos(angle + STANDING["calf"])
    return length * math.cos(hip) - 0.0955 * math.sin(hip)


def principal(inertia: tuple[float, ...]) -> tuple[list[float], list[float]]:
    """Principal moments, and the quaternion (x, y, z, w) of their axes, of (xx, yy, zz, xy, xz, yz)."""
    xx, yy, zz, xy, xz, yz = inertia
    moments, axes = np.linalg.eigh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    # eigenvectors have no sign: choose one, and right-handed axes, so that the file is the same everywhere
    axes *= np.where(axes[np.abs(axes).argmax(axis=0), range(3)] < 0, -1.0, 1.0)
    if np.linalg.det(axes) < 0:
        axes[:, 2] *= -1.0
    quat = Gf.Matrix3d(*axes.T.reshape(-1).tolist()).ExtractRotation().GetQuat()
    values = exact([*quat.GetImaginary(), quat.GetReal()], 7)
    return exact(moments).tolist(), (values if quat.GetReal() >= 0 else -values + 0.0).tolist()


def author(path: Path) -> None:
    """Write the robot to ``path``."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = Usd.Stage.Open(layer)
    layer.documentation = (
        "A quadruped of 12 joints and 15 kg, written by tools/authoring/author_quadruped.py. "
        "Its docstring names the sources."
    )
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    robot = Author(stage)
    robot.materials()
    robot.parts()
    base = robot.base()
    UsdGeom.Scope.Define(stage, "/quadruped/joints")
    for leg in LEGS:
        robot.leg(base, leg)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(layer.ExportToString(), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else OUTPUT
    author(target)
    print(f"{target}: {target.stat().st_size // 1024} kB")
