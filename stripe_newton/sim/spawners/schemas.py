# SPDX-License-Identifier: Apache-2.0
"""Physics properties of bodies, articulations, colliders and drives, authored on prims as USD schemas.

Fields that only PhysX has (sleeping, solver iterations, depenetration speed, ...) are written to the stage, so that an
export keeps them. Newton's solvers ignore them; each such field says "PhysX only".
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from stripe_newton.configclass import configclass
from stripe_newton.value_types import NonNegativeFloat, NonNegativeInt, NonNegativeLimit, PositiveFloat

__all__ = [
    "ArticulationRootPropertiesCfg",
    "CollisionPropertiesCfg",
    "JointDrivePropertiesCfg",
    "MassPropertiesCfg",
    "RigidBodyPropertiesCfg",
    "define_articulation_root_properties",
    "define_collision_properties",
    "define_mass_properties",
    "define_rigid_body_properties",
    "modify_articulation_root_properties",
    "modify_collision_properties",
    "modify_joint_drive_properties",
    "modify_mass_properties",
    "modify_rigid_body_properties",
]


@configclass
class RigidBodyPropertiesCfg:
    """Properties of a rigid body; ``None`` leaves what the prim says."""

    rigid_body_enabled: bool | None = None
    """Whether the body is simulated."""
    kinematic_enabled: bool | None = None
    """Whether its motion is prescribed."""
    disable_gravity: bool | None = None
    """PhysX only; Newton reads gravity for the whole world."""
    linear_damping: NonNegativeFloat | None = None
    """PhysX only [1/s]."""
    angular_damping: NonNegativeFloat | None = None
    """PhysX only [1/s]."""
    max_linear_velocity: NonNegativeLimit | None = None
    """PhysX only [m/s]."""
    max_angular_velocity: NonNegativeLimit | None = None
    """PhysX only [deg/s]."""
    max_depenetration_velocity: NonNegativeLimit | None = None
    """PhysX only [m/s]."""
    max_contact_impulse: NonNegativeLimit | None = None
    """PhysX only."""
    enable_gyroscopic_forces: bool | None = None
    """PhysX only; Newton's solvers always include them."""
    retain_accelerations: bool | None = None
    """PhysX only."""
    solver_position_iteration_count: NonNegativeInt | None = None
    """PhysX only."""
    solver_velocity_iteration_count: NonNegativeInt | None = None
    """PhysX only."""
    sleep_threshold: NonNegativeFloat | None = None
    """PhysX only."""
    stabilization_threshold: NonNegativeFloat | None = None
    """PhysX only."""


@configclass
class ArticulationRootPropertiesCfg:
    """Properties of an articulation; ``None`` leaves what the prim says."""

    articulation_enabled: bool | None = None
    """Whether the bodies form an articulation."""
    enabled_self_collisions: bool | None = None
    """Whether bodies of the articulation collide with each other."""
    fix_root_link: bool | None = None
    """Add (``True``) or remove (``False``) the fixed joint between world and root body."""
    solver_position_iteration_count: NonNegativeInt | None = None
    """PhysX only."""
    solver_velocity_iteration_count: NonNegativeInt | None = None
    """PhysX only."""
    sleep_threshold: NonNegativeFloat | None = None
    """PhysX only."""
    stabilization_threshold: NonNegativeFloat | None = None
    """PhysX only."""


@configclass
class CollisionPropertiesCfg:
    """Properties of a collider; ``None`` leaves what the prim says."""

    collision_enabled: bool | None = None
    """Whether the shape collides."""
    contact_offset: float | None = None
    """Distance at which contacts are found [m]."""
    rest_offset: float | None = None
    """Distance that contacts keep [m]."""
    torsional_patch_radius: float | None = None
    """PhysX only [m]."""
    min_torsional_patch_radius: float | None = None
    """PhysX only [m]."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.contact_offset is not None and self.rest_offset is not None and self.contact_offset < self.rest_offset:
            yield "contact_offset", f"is {self.contact_offset}, must not be less than rest_offset {self.rest_offset}"


@configclass
class MassPropertiesCfg:
    """Mass of a body; ``None`` leaves what the prim says."""

    mass: PositiveFloat | None = None
    """Mass [kg]; it overrides the density."""
    density: PositiveFloat | None = None
    """Density [kg/m^3]."""


@configclass
class JointDrivePropertiesCfg:
    """Drives of all joints below a prim; ``None`` leaves what the prims say."""

    drive_type: str | None = None
    """``"force"`` or ``"acceleration"``."""
    max_effort: NonNegativeLimit | None = None
    """Limit of the drive [N or N m]."""
    max_velocity: NonNegativeLimit | None = None
    """Velocity limit [m/s or rad/s]."""
    stiffness: NonNegativeFloat | None = None
    """Position gain [N/m or N m/rad]."""
    damping: NonNegativeFloat | None = None
    """Velocity gain [N s/m or N m s/rad]."""


_PHYSX_NAMES = {
    "disable_gravity": "physxRigidBody:disableGravity",
    "linear_damping": "physxRigidBody:linearDamping",
    "angular_damping": "physxRigidBody:angularDamping",
    "max_linear_velocity": "physxRigidBody:maxLinearVelocity",
    "max_angular_velocity": "physxRigidBody:maxAngularVelocity",
    "max_depenetration_velocity": "physxRigidBody:maxDepenetrationVelocity",
    "max_contact_impulse": "physxRigidBody:maxContactImpulse",
    "enable_gyroscopic_forces": "physxRigidBody:enableGyroscopicForces",
    "retain_accelerations": "physxRigidBody:retainAccelerations",
    "enabled_self_collisions": "physxArticulation:enabledSelfCollisions",
    "contact_offset": "physxCollision:contactOffset",
    "rest_offset": "physxCollision:restOffset",
    "torsional_patch_radius": "physxCollision:torsionalPatchRadius",
    "min_torsional_patch_radius": "physxCollision:minTorsionalPatchRadius",
}


def define_rigid_body_properties(prim: Usd.Prim, cfg: RigidBodyPropertiesCfg) -> None:
    """Make ``prim`` a rigid body."""
    UsdPhysics.RigidBodyAPI.Apply(prim)
    _set_rigid_body(prim, cfg)


def modify_rigid_body_properties(prim: Usd.Prim, cfg: RigidBodyPropertiesCfg) -> None:
    """Set the properties of every rigid body at and below ``prim``."""
    for body in _having(prim, UsdPhysics.RigidBodyAPI):
        _set_rigid_body(body, cfg)


def _set_rigid_body(prim: Usd.Prim, cfg: RigidBodyPropertiesCfg) -> None:
    api = UsdPhysics.RigidBodyAPI(prim)
    if cfg.rigid_body_enabled is not None:
        api.CreateRigidBodyEnabledAttr(cfg.rigid_body_enabled)
    if cfg.kinematic_enabled is not None:
        api.CreateKinematicEnabledAttr(cfg.kinematic_enabled)
    _set_physx(prim, cfg, "PhysxRigidBodyAPI", "physxRigidBody")


def define_articulation_root_properties(prim: Usd.Prim, cfg: ArticulationRootPropertiesCfg) -> None:
    """Make ``prim`` an articulation root."""
    UsdPhysics.ArticulationRootAPI.Apply(prim)
    modify_articulation_root_properties(prim, cfg)


def modify_articulation_root_properties(prim: Usd.Prim, cfg: ArticulationRootPropertiesCfg) -> None:
    """Set the properties of every articulation root at and below ``prim``."""
    # A list first: fixing a root adds a prim to the range that is gone through.
    for root in list(_having(prim, UsdPhysics.ArticulationRootAPI)):
        _set_physx(root, cfg, "PhysxArticulationAPI", "physxArticulation")
        if cfg.enabled_self_collisions is not None:
            root.AddAppliedSchema("NewtonArticulationRootAPI")
            root.CreateAttribute("newton:selfCollisionEnabled", Sdf.ValueTypeNames.Bool).Set(
                cfg.enabled_self_collisions
            )
        if cfg.fix_root_link is not None:
            _fix_root_link(root, cfg.fix_root_link)
        if cfg.articulation_enabled is False:
            root.RemoveAPI(UsdPhysics.ArticulationRootAPI)


def _fix_root_link(root: Usd.Prim, fixed: bool) -> None:
    to_world = [
        UsdPhysics.Joint(p)
        for p in Usd.PrimRange(root)
        if p.IsA(UsdPhysics.FixedJoint)
        and not (UsdPhysics.Joint(p).GetBody0Rel().GetTargets() and UsdPhysics.Joint(p).GetBody1Rel().GetTargets())
    ]
    for joint in to_world:
        joint.CreateJointEnabledAttr(fixed)
    if to_world or not fixed:
        return
    body = next(_having(root, UsdPhysics.RigidBodyAPI), None)
    if body is None:
        raise ValueError(f"fix_root_link: articulation '{root.GetPath()}' has no rigid body to fix")
    # Fixed where the body stands now, which is why spawners place a prim before they set its properties.
    joint = UsdPhysics.FixedJoint.Define(root.GetStage(), body.GetPath().AppendChild("root_joint"))
    joint.CreateBody1Rel().SetTargets([body.GetPath()])
    pose = UsdGeom.Xformable(body).ComputeLocalToWorldTransform(Usd.TimeCode.Default()).RemoveScaleShear()
    joint.CreateLocalPos0Attr(Gf.Vec3f(pose.ExtractTranslation()))
    joint.CreateLocalRot0Attr(Gf.Quatf(pose.ExtractRotationQuat()))
    joint.CreateLocalPos1Attr(Gf.Vec3f(0.0))
    joint.CreateLocalRot1Attr(Gf.Quatf(1.0))


def define_collision_properties(prim: Usd.Prim, cfg: CollisionPropertiesCfg) -> None:
    """Make ``prim`` a collider."""
    UsdPhysics.CollisionAPI.Apply(prim)
    _set_collision(prim, cfg)


def modify_collision_properties(prim: Usd.Prim, cfg: CollisionPropertiesCfg) -> None:
    """Set the properties of every collider at and below ``prim``."""
    for collider in _having(prim, UsdPhysics.CollisionAPI):
        _set_collision(collider, cfg)


def _set_collision(prim: Usd.Prim, cfg: CollisionPropertiesCfg) -> None:
    if cfg.collision_enabled is not None:
        UsdPhysics.CollisionAPI(prim).CreateCollisionEnabledAttr(cfg.collision_enabled)
    _set_physx(prim, cfg, "PhysxCollisionAPI", "physxCollision")


def define_mass_properties(prim: Usd.Prim, cfg: MassPropertiesCfg) -> None:
    """Give ``prim`` a mass or density."""
    UsdPhysics.MassAPI.Apply(prim)
    _set_mass(prim, cfg)


def modify_mass_properties(prim: Usd.Prim, cfg: MassPropertiesCfg) -> None:
    """Set mass or density of every body at and below ``prim`` that has a mass of its own."""
    for body in _having(prim, UsdPhysics.MassAPI):
        _set_mass(body, cfg)


def _set_mass(prim: Usd.Prim, cfg: MassPropertiesCfg) -> None:
    api = UsdPhysics.MassAPI(prim)
    if cfg.mass is not None:
        api.CreateMassAttr(cfg.mass)
    if cfg.density is not None:
        api.CreateDensityAttr(cfg.density)


def modify_joint_drive_properties(prim: Usd.Prim, cfg: JointDrivePropertiesCfg) -> None:
    """Set the drive of every revolute and prismatic joint at and below ``prim``; UsdPhysics has angles in degrees."""
    for joint in Usd.PrimRange(prim):
        angular = joint.IsA(UsdPhysics.RevoluteJoint)
        if not angular and not joint.IsA(UsdPhysics.PrismaticJoint):
            continue
        per_unit = math.pi / 180.0 if angular else 1.0  # a gain per radian is this much of it per degree
        drive = UsdPhysics.DriveAPI.Apply(joint, "angular" if angular else "linear")
        if cfg.drive_type is not None:
            drive.CreateTypeAttr(cfg.drive_type)
        if cfg.max_effort is not None:
            drive.CreateMaxForceAttr(cfg.max_effort)
        if cfg.stiffness is not None:
            drive.CreateStiffnessAttr(cfg.stiffness * per_unit)
        if cfg.damping is not None:
            drive.CreateDampingAttr(cfg.damping * per_unit)
        if cfg.max_velocity is not None:
            joint.AddAppliedSchema("NewtonJointAPI")
            joint.CreateAttribute("newton:velocityLimit", Sdf.ValueTypeNames.Float).Set(cfg.max_velocity / per_unit)


def _having(prim: Usd.Prim, api: type[Usd.APISchemaBase]) -> Iterator[Usd.Prim]:
    """Prims at and below ``prim`` that have an API schema."""
    return (p for p in Usd.PrimRange(prim) if p.HasAPI(api))


def _set_physx(
    prim: Usd.Prim,
    cfg: RigidBodyPropertiesCfg | ArticulationRootPropertiesCfg | CollisionPropertiesCfg,
    schema: str,
    prefix: str,
) -> None:
    """Author the PhysX attributes that ``cfg`` sets; a type is chosen from the value's."""
    types = {bool: Sdf.ValueTypeNames.Bool, int: Sdf.ValueTypeNames.Int, float: Sdf.ValueTypeNames.Float}
    for name in type(cfg).__dataclass_fields__:
        value = getattr(cfg, name)
        usd_name = _PHYSX_NAMES.get(name)
        if usd_name is None and name.startswith(("solver_", "sleep_", "stabilization_")):
            # Names that bodies and articulations share, each in its own schema: physxRigidBody:sleepThreshold.
            head, *rest = name.split("_")
            usd_name = f"{prefix}:{head}{''.join(map(str.capitalize, rest))}"
        if value is None or usd_name is None:  # left as the prim says, or a UsdPhysics attribute
            continue
        prim.AddAppliedSchema(schema)
        prim.CreateAttribute(usd_name, types[type(value)]).Set(value)
