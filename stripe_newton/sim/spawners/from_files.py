# SPDX-License-Identifier: Apache-2.0
"""File spawners: USD files by reference, URDF and MJCF files through Newton's importers; and the ground plane."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ClassVar

from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.input_files import why_no_file
from stripe_newton.robot_files import file_kind
from stripe_newton.sim.scene_context import authored_path, current_stage
from stripe_newton.usd import asset_prim, si_stage
from stripe_newton.usd.git_lfs import POINTER_REASON, is_pointer

from . import schemas
from .materials import PreviewSurfaceCfg, RigidBodyMaterialCfg, bind_material
from .model_names import ModelNamesCfg, author_names
from .spawner_cfg import Orientation, RigidObjectSpawnerCfg, SpawnerCfg, Translation, finish, place

__all__ = [
    "FixedTendonCfg",
    "GroundPlaneCfg",
    "MjcfFileCfg",
    "UrdfFileCfg",
    "UsdFileCfg",
    "spawn_from_mjcf",
    "spawn_from_urdf",
    "spawn_from_usd",
    "spawn_ground_plane",
]

FILE_KEY = "stripeNewton:file"
"""Custom data of a prim that represents a URDF or MJCF file: JSON of ``format``, ``path`` and importer options."""


def _missing(path: str, field: str) -> Iterator[tuple[str, str]]:
    """The problem of a config whose file is none, or does not exist."""
    if path is not MISSING and (problem := why_no_file(Path(path).expanduser())):
        yield field, f"'{path}' {problem}; give the path of a file"


def _existing(path: str, field: str) -> Path:
    file = Path(path).expanduser()
    if problem := why_no_file(file):
        raise FileNotFoundError(f"{field} '{path}': {problem}; give the path of an existing file")
    if is_pointer(file):
        raise ValueError(f"{field} '{path}' {POINTER_REASON}")
    return file.resolve()


def spawn_from_usd(
    prim_path: str, cfg: UsdFileCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Reference a USD file at ``prim_path`` and set the properties that ``cfg`` names on the prims it brings."""
    file = _existing(cfg.usd_path, "usd_path")
    prim = UsdGeom.Xform.Define(current_stage(), authored_path(prim_path)).GetPrim()
    asset = si_stage(file)  # metres, kilograms and z up, whatever the file is in
    prim.GetReferences().AddReference(asset.GetRootLayer().identifier, asset_prim(asset, cfg.source_prim_path))
    for name, variant in (cfg.variants or {}).items():
        variants = prim.GetVariantSets()
        # USD selects a variant that does not exist without a word.
        if not variants.HasVariantSet(name) or variant not in variants.GetVariantSet(name).GetVariantNames():
            known = {n: variants.GetVariantSet(n).GetVariantNames() for n in variants.GetNames()}
            raise ValueError(f"'{file}' has no variant {name}={variant}; it has {known or 'no variants'}")
        variants.GetVariantSet(name).SetVariantSelection(variant)
    if cfg.visual_material is not None:
        material = cfg.visual_material.func(f"{prim.GetPath()}/{cfg.visual_material_path}", cfg.visual_material)
        UsdShade.MaterialBindingAPI.Apply(prim)
        UsdShade.MaterialBindingAPI(prim).Bind(UsdShade.Material(material), UsdShade.Tokens.strongerThanDescendants)
    place(prim, translation, orientation, cfg.scale)  # first: a root link is fixed where it then stands
    _set_properties(prim, cfg)
    author_names(prim, cfg.names)
    return finish(prim, cfg)


def _set_properties(prim: Usd.Prim, cfg: UsdFileCfg) -> None:
    """Set the properties that ``cfg`` names on the prims below ``prim``."""
    # USD edits no prim inside an instance. Colliders often lie in instances, bodies and joints hardly ever.
    if cfg.collision_props is not None:
        while instances := [p for p in Usd.PrimRange(prim) if p.IsInstance()]:
            for instance in instances:
                instance.SetInstanceable(False)
    if cfg.rigid_props is not None:
        schemas.modify_rigid_body_properties(prim, cfg.rigid_props)
    if cfg.mass_props is not None:
        schemas.modify_mass_properties(prim, cfg.mass_props)
    if cfg.articulation_props is not None:
        schemas.modify_articulation_root_properties(prim, cfg.articulation_props)
    if cfg.joint_drive_props is not None:
        schemas.modify_joint_drive_properties(prim, cfg.joint_drive_props)
    if cfg.collision_props is not None:
        schemas.modify_collision_properties(prim, cfg.collision_props)


def _spawn_file(
    prim_path: str, cfg: _ImporterCfg, kind: str, translation: Translation, orientation: Orientation
) -> Usd.Prim:

    prim = UsdGeom.Xform.Define(current_stage(), authored_path(prim_path)).GetPrim()
    file = _existing(cfg.asset_path, "asset_path")
    if (found := file_kind(file)).name != kind:
        raise ValueError(f"asset_path '{cfg.asset_path}' {found.description}")
    options = {"format": kind, "path": str(file), **cfg.importer_options()}
    # Custom data, so that an exported stage refers to the file and a scene that opens it imports it again.
    prim.SetCustomDataByKey(FILE_KEY, json.dumps(options))
    author_names(prim, cfg.names)
    place(prim, translation, orientation)
    return finish(prim, cfg)


def spawn_from_urdf(
    prim_path: str, cfg: UrdfFileCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author a prim that represents a URDF file, which is imported when the model is built."""
    return _spawn_file(prim_path, cfg, "urdf", translation, orientation)


def spawn_from_mjcf(
    prim_path: str, cfg: MjcfFileCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author a prim that represents an MJCF file, which is imported when the model is built."""
    return _spawn_file(prim_path, cfg, "mjcf", translation, orientation)


def spawn_ground_plane(
    prim_path: str, cfg: GroundPlaneCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author an infinite ground plane: a ``UsdGeom.Plane`` collider with a physics material, facing +Z."""
    path = authored_path(prim_path)
    root = UsdGeom.Xform.Define(current_stage(), path).GetPrim()
    plane = UsdGeom.Plane.Define(current_stage(), f"{path}/CollisionPlane")
    plane.CreateAxisAttr("Z")
    plane.CreateWidthAttr(float(cfg.size[0]))
    plane.CreateLengthAttr(float(cfg.size[1]))
    if cfg.color is not None:
        plane.CreateDisplayColorAttr([Gf.Vec3f(*cfg.color)])
    UsdPhysics.CollisionAPI.Apply(plane.GetPrim())
    bind_material(
        plane.GetPrim(), cfg.physics_material.func(f"{path}/physicsMaterial", cfg.physics_material), "physics"
    )
    place(root, translation, orientation)
    return finish(root, cfg)


@configclass
class UsdFileCfg(RigidObjectSpawnerCfg):
    """A USD file, referenced into the scene."""

    func: Callable[..., Usd.Prim] = spawn_from_usd
    """Function that authors the prim."""
    usd_path: str = MISSING
    """The file."""
    source_prim_path: str | None = None
    """Prim of the file to reference. Default: its default prim, else the one root prim with physics."""
    scale: tuple[float, float, float] | None = None
    """Scale of the asset."""
    variants: dict[str, str] | None = None
    """Variant selections by variant set."""
    articulation_props: schemas.ArticulationRootPropertiesCfg | None = None
    """Changes to the articulation root."""
    joint_drive_props: schemas.JointDrivePropertiesCfg | None = None
    """Changes to the joint drives."""
    visual_material: PreviewSurfaceCfg | None = None
    """Appearance, in place of the file's."""
    visual_material_path: str = "material"
    """Path of the visual material below the prim."""
    names: ModelNamesCfg | None = None
    """Other names for joints and bodies."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from _missing(self.usd_path, "usd_path")
        given = self.source_prim_path
        if given is not None and not (given.startswith("/") and Sdf.Path.IsValidPathString(given)):
            yield "source_prim_path", f"is {given!r}, must be the path of a prim, such as '/Robot'"
        if self.names is not None and self.names.links:
            yield "names.links", "is set, but shapes of a USD file stay with their bodies; leave it empty"


@configclass
class _ImporterCfg(SpawnerCfg):
    """Base of the configs of URDF and MJCF files."""

    asset_path: str = MISSING
    """The file."""
    fix_base: bool | None = None
    """Fix the root body to the world; ``None``: as the file says. A URDF file says so by a link ``world`` that holds
    it; for one without such a link this must be set."""
    scale: float = 1.0
    """Scale of the asset."""
    self_collision: bool = True
    """Whether bodies of the asset collide with each other."""
    merge_fixed_joints: bool = False
    """Merge bodies that fixed joints connect."""
    names: ModelNamesCfg | None = None
    """Other names for joints and bodies."""
    max_hull_vertices: int | None = None
    """Corners of the convex hulls of mesh colliders at most. -1: all, as MuJoCo has it, which takes longer. ``None``:
    as the file says, otherwise Newton's default of 64."""
    articulation_props: schemas.ArticulationRootPropertiesCfg | None = None
    """Only ``enabled_self_collisions`` and ``fix_root_link`` apply; they override the fields above."""
    rigid_props: schemas.RigidBodyPropertiesCfg | None = None
    """Ignored: the bodies are as the file has them."""
    activate_contact_sensors: bool = False
    """For configs of Isaac Lab. It need not be set: contacts of every body can be sensed."""

    IGNORED: ClassVar[dict[str, str]] = {"rigid_props": "the bodies are as the file has them"}

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from _missing(self.asset_path, "asset_path")
        corners = self.max_hull_vertices
        if corners is not None and corners != -1 and corners < 4:
            yield "max_hull_vertices", f"is {corners}, must be 4 or more, or -1 for all"

    def importer_options(self) -> dict[str, object]:
        """Keyword arguments of Newton's importer."""
        fixed, collide = self.fix_base, self.self_collision
        if self.articulation_props is not None:
            props = self.articulation_props
            fixed = props.fix_root_link if props.fix_root_link is not None else fixed
            collide = props.enabled_self_collisions if props.enabled_self_collisions is not None else collide
        return {
            "floating": None if fixed is None else not fixed,
            "scale": self.scale,
            "enable_self_collisions": collide,
            "collapse_fixed_joints": self.merge_fixed_joints,
            "mesh_maxhullvert": self.max_hull_vertices,
        }


@configclass
class UrdfFileCfg(_ImporterCfg):
    """A URDF file, imported by Newton."""

    func: Callable[..., Usd.Prim] = spawn_from_urdf
    """Function that authors the prim."""
    parse_visuals_as_colliders: bool = False
    """Collide with the visual geometry."""
    packages: dict[str, str] = {}
    """Folder of a ROS package by its name, for ``package://``. Others are looked for in ``ROS_PACKAGE_PATH`` and
    ``AMENT_PREFIX_PATH``, and above the file."""
    joint_stiffness: float | dict[str, float] | None = None
    """Position gain of the joints' drives [N/m or N m/rad], one or by joint-name expression; a URDF file has none.
    Actuator groups override it."""
    joint_damping: float | dict[str, float] | None = None
    """Velocity gain of the joints' drives [N s/m or N m s/rad]."""
    replace_cylinders_with_capsules: bool = False
    """Collide by capsules in place of cylinders, of the same radius and with the cylinder's length between the centres
    of their caps."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        for name, folder in self.packages.items():
            if not Path(folder).expanduser().is_dir():
                yield f"packages[{name!r}]", f"'{folder}' is no folder"

    def importer_options(self) -> dict[str, object]:
        names = "parse_visuals_as_colliders", "packages", "joint_stiffness", "joint_damping"
        own = {name: getattr(self, name) for name in (*names, "replace_cylinders_with_capsules")}
        return {**super().importer_options(), **own}


@configclass
class FixedTendonCfg:
    """A fixed tendon: a coupling whose length is the sum of joint positions by coefficient."""

    coefficients: dict[str, float] = MISSING
    """Coefficient by the name of a joint in the file [1/rad or 1/m, times the unit of the length]."""
    limits: tuple[float, float] | None = None
    """Least and largest length. Two equal joints are coupled by coefficients 1 and -1 and narrow limits about 0."""
    stiffness: float = 0.0
    """Stiffness of a spring about the length in the file's initial pose."""
    damping: float = 0.0
    """Damping of the length."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.coefficients is not MISSING and not self.coefficients:
            yield "coefficients", "is empty, must have a joint or more"
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            yield "limits", f"is {self.limits}, must be (least, largest) with least < largest"


@configclass
class MjcfFileCfg(_ImporterCfg):
    """An MJCF file, imported by Newton."""

    func: Callable[..., Usd.Prim] = spawn_from_mjcf
    """Function that authors the prim."""
    ignore_names: list[str] = ["floor", "ground"]
    """Geometries and bodies left out, by name: the file's own ground."""
    keyframe: str | None = None
    """Keyframe of the file for what ``init_state`` leaves ``None``: positions of the joints, pose of a free root."""
    actuators: bool = True
    """Read the actuators of the file; without them only the drives of the config's actuator groups act."""
    condim: int | None = None
    """Dimension of the contacts of all its geoms: 1 without friction, 3 with sliding friction, 4 with torsional and 6
    with rolling friction too. Default: as the file says. PhysX has 3."""
    solimp: tuple[float, ...] | None = None
    """Impedance of the contacts of all its geoms, MuJoCo's five numbers. Default: as the file says. Feet that it makes
    soft creep under load with pyramidal friction cones; ``(0.9, 0.95, 0.001, 0.5, 2.0)``, MuJoCo's default, is hard."""
    root_pose: tuple[float, ...] | None = None
    """Pose of the root body in the frame of the prim: position [m] and quaternion (x, y, z, w). Default: the file's in
    its world. With the identity the root body begins at ``init_state``."""

    fixed_tendons: dict[str, FixedTendonCfg] = {}
    """Tendons to add to those of the file, by name."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.condim not in (None, 1, 3, 4, 6):
            yield "condim", f"is {self.condim}, must be 1, 3, 4 or 6, or None for the file's"
        if self.solimp is not None and len(self.solimp) != 5:
            yield "solimp", f"has {len(self.solimp)} numbers, must have 5"
        if self.root_pose is not None and len(self.root_pose) != 7:
            yield "root_pose", f"has {len(self.root_pose)} numbers, must have 7: position, quaternion (x, y, z, w)"

    def importer_options(self) -> dict[str, object]:
        names = "ignore_names", "keyframe", "actuators", "condim", "solimp", "root_pose"
        own = {name: getattr(self, name) for name in names}
        tendons = {name: tendon.to_dict() for name, tendon in self.fixed_tendons.items()}
        return {**super().importer_options(), **own, "fixed_tendons": tendons}


@configclass
class GroundPlaneCfg(SpawnerCfg):
    """An infinite ground plane."""

    func: Callable[..., Usd.Prim] = spawn_ground_plane
    """Function that authors the plane."""
    color: tuple[float, float, float] | None = (0.27, 0.29, 0.31)
    """Colour (linear RGB)."""
    size: tuple[float, float] = (100.0, 100.0)
    """Extent authored in the stage [m]; for physics the plane has no end."""
    physics_material: RigidBodyMaterialCfg = RigidBodyMaterialCfg()
    """Friction and restitution."""
