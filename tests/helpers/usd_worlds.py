# SPDX-License-Identifier: Apache-2.0
"""Worlds in USD that somebody else might have written: other units and axes, instances, joints of all kinds, motion."""

from __future__ import annotations

from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdSemantics, UsdShade

from .usd_stages import new_stage

UNITS = {"m kg": (1.0, 1.0), "cm kg": (0.01, 1.0), "mm g": (0.001, 0.001), "inch": (0.0254, 1.0), "t": (1.0, 1000.0)}
"""Metres and kilograms of a unit, by name."""


class WorldAuthor:
    """Authors prims of a stage by values in SI units."""

    def __init__(self, metres: float = 1.0, kilograms: float = 1.0, up: str = "Z"):
        self.stage = new_stage(metres, kilograms, up)
        self.length, self.mass = 1.0 / metres, 1.0 / kilograms

    def body(self, path: str, at: tuple = (0, 0, 0), mass: float | None = 2.0, turn: tuple = (0, 0, 0)) -> Usd.Prim:
        """A rigid body with a box of 0.2 m; without a mass it has density 500 kg/m^3."""
        prim = UsdGeom.Xform.Define(self.stage, path).GetPrim()
        UsdGeom.XformCommonAPI(prim).SetTranslate(Gf.Vec3d(*at) * self.length)
        UsdGeom.XformCommonAPI(prim).SetRotate(Gf.Vec3f(*turn))
        UsdPhysics.RigidBodyAPI.Apply(prim)
        api = UsdPhysics.MassAPI.Apply(prim)
        if mass is None:
            api.CreateDensityAttr(500.0 * self.mass / self.length**3)
        else:
            api.CreateMassAttr(mass * self.mass)
            api.CreateDiagonalInertiaAttr(Gf.Vec3f(0.02, 0.03, 0.025) * self.mass * self.length**2)
            api.CreateCenterOfMassAttr(Gf.Vec3f(0.01, 0.02, -0.03) * self.length)
        self.box(f"{path}/box")
        return prim

    def box(self, path: str) -> Usd.Prim:
        """A collider of 0.2 m."""
        cube = UsdGeom.Cube.Define(self.stage, path)
        cube.CreateSizeAttr(0.2 * self.length)
        UsdPhysics.CollisionAPI.Apply(cube.GetPrim())
        return cube.GetPrim()

    def joint(self, path: str, kind: str, body0: str, body1: str, at: tuple = (0.5, 0, 0)) -> Usd.Prim:
        """A joint of UsdPhysics between two bodies, at ``at`` in the frame of the first."""
        prim = self.stage.DefinePrim(path, kind)
        joint = UsdPhysics.Joint(prim)
        joint.CreateBody0Rel().SetTargets([body0])
        joint.CreateBody1Rel().SetTargets([body1])
        joint.CreateLocalPos0Attr(Gf.Vec3f(*at) * self.length)
        return prim

    def limit(self, joint: Usd.Prim, axis: str, low: float, high: float) -> None:
        """Limits of one axis of a D6 joint, in m or degrees."""
        scale = self.length if axis.startswith("trans") else 1.0
        api = UsdPhysics.LimitAPI.Apply(joint, axis)
        api.CreateLowAttr(low * scale)
        api.CreateHighAttr(high * scale)

    def drive(self, joint: Usd.Prim, axis: str, stiffness: float, damping: float, effort: float, target: float) -> None:
        """A drive, in N/m or N m/degree."""
        linear = axis == "linear" or axis.startswith("trans")
        gain, force = (self.mass, self.mass * self.length) if linear else (self.mass * self.length**2,) * 2
        api = UsdPhysics.DriveAPI.Apply(joint, axis)
        api.CreateStiffnessAttr(stiffness * gain)
        api.CreateDampingAttr(damping * gain)
        api.CreateMaxForceAttr(effort * force)
        api.CreateTargetPositionAttr(target * (self.length if linear else 1.0))
        state = Sdf.ValueTypeNames.Float
        joint.CreateAttribute(f"state:{axis}:physics:position", state).Set(0.1 * (self.length if linear else 1.0))


def robots(metres: float = 1.0, kilograms: float = 1.0, up: str = "Z") -> Usd.Stage:
    """Bodies in motion, joints of all kinds with limits, drives and states, materials, labels, a static floor."""
    author = WorldAuthor(metres, kilograms, up)
    stage = author.stage
    scene = UsdPhysics.Scene.Define(stage, "/World/physics")
    scene.CreateGravityMagnitudeAttr(3.7 * author.length)
    arm = UsdGeom.Xform.Define(stage, "/World/arm").GetPrim()
    UsdGeom.XformCommonAPI(arm).SetTranslate(Gf.Vec3d(0.5, 0.25, 2.0) * author.length)
    UsdPhysics.ArticulationRootAPI.Apply(arm)
    for k in range(6):
        author.body(f"/World/arm/link{k}", (0.5 * k, 0, 0), None if k % 2 else 2.0)
    kinds = ("PhysicsRevoluteJoint", "PhysicsPrismaticJoint", "PhysicsSphericalJoint", "PhysicsFixedJoint")
    for k, kind in enumerate(kinds):
        joint = author.joint(f"/World/arm/joint{k}", kind, f"/World/arm/link{k}", f"/World/arm/link{k + 1}")
        if k < 2:
            scale = author.length if k == 1 else 1.0
            joint.GetAttribute("physics:lowerLimit").Set(-0.4 * scale)
            joint.GetAttribute("physics:upperLimit").Set(0.6 * scale)
            author.drive(joint, ("angular", "linear")[k], 40.0, 3.0, 25.0, 0.2)
    d6 = author.joint("/World/arm/joint4", "PhysicsJoint", "/World/arm/link4", "/World/arm/link5")
    for axis in ("transY", "rotX", "rotZ"):
        author.limit(d6, axis, -0.3, 0.5)
        author.drive(d6, axis, 20.0, 2.0, 15.0, 0.1)
    for axis in ("transX", "transZ", "rotY"):
        author.limit(d6, axis, 1.0, -1.0)
    ball = author.body("/World/ball", (0, 3, 1), turn=(30, 20, 10))
    UsdPhysics.RigidBodyAPI(ball).CreateVelocityAttr(Gf.Vec3f(0.5, -0.25, 1.0) * author.length)
    UsdPhysics.RigidBodyAPI(ball).CreateAngularVelocityAttr(Gf.Vec3f(30, 0, -60))
    material = UsdShade.Material.Define(stage, "/World/rubber")
    physics = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    physics.CreateDynamicFrictionAttr(0.9)
    physics.CreateStaticFrictionAttr(0.9)
    physics.CreateRestitutionAttr(0.3)
    box = stage.GetPrimAtPath("/World/ball/box")
    UsdShade.MaterialBindingAPI.Apply(box).Bind(material, UsdShade.Tokens.weakerThanDescendants, "physics")
    UsdSemantics.LabelsAPI.Apply(ball, "category").CreateLabelsAttr(["ball", "toy"])
    UsdGeom.XformCommonAPI(author.box("/World/floor")).SetTranslate(Gf.Vec3d(0, 0, -1) * author.length)
    return stage


def instances(metres: float = 1.0, kilograms: float = 1.0, up: str = "Z") -> Usd.Stage:
    """Three instances of a pendulum, each with an instance of a weight inside, and a static one."""
    author = WorldAuthor(metres, kilograms, up)
    stage = author.stage
    stage.CreateClassPrim("/Weight")
    author.box("/Weight/box")
    stage.CreateClassPrim("/Pendulum")
    for name, x in (("base", 0.0), ("bob", 0.5)):
        author.body(f"/Pendulum/{name}", (x, 0, 0))
        weight = UsdGeom.Xform.Define(stage, f"/Pendulum/{name}/weight").GetPrim()
        weight.GetReferences().AddInternalReference("/Weight")
        weight.SetInstanceable(True)
    joint = author.joint("/Pendulum/joint", "PhysicsRevoluteJoint", "/Pendulum/base", "/Pendulum/bob")
    author.drive(joint, "angular", 4.0, 0.3, 5.0, 10.0)
    for k in range(3):
        prim = UsdGeom.Xform.Define(stage, f"/World/pendulum{k}").GetPrim()
        prim.GetReferences().AddInternalReference("/Pendulum")
        prim.SetInstanceable(True)
        UsdGeom.XformCommonAPI(prim).SetTranslate(Gf.Vec3d(0, 2 * k, 1) * author.length)
    return stage
