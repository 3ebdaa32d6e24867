# SPDX-License-Identifier: Apache-2.0
"""Shape spawners: boxes, spheres, capsules, cylinders and cones, as UsdGeom primitives or meshes.

A shape is visual, a static collider or a rigid body.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import ClassVar

import newton
import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdPhysics, Vt

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.sim.scene_context import authored_path, current_stage
from stripe_newton.value_types import NonNegativeFloat, PositiveFloat

from . import schemas
from .materials import PreviewSurfaceCfg, RigidBodyMaterialCfg, bind_material
from .spawner_cfg import Orientation, RigidObjectSpawnerCfg, Translation, finish, place

__all__ = [
    "CapsuleCfg",
    "ConeCfg",
    "CuboidCfg",
    "CylinderCfg",
    "MeshCapsuleCfg",
    "MeshConeCfg",
    "MeshCuboidCfg",
    "MeshCylinderCfg",
    "MeshSphereCfg",
    "ShapeCfg",
    "SphereCfg",
    "author_mesh",
    "spawn_shape",
]


def spawn_shape(
    prim_path: str, cfg: ShapeCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author a shape: an Xform at ``prim_path`` with the geometry below it at ``geometry/mesh``.

    The Xform carries body and mass, the geometry collider and materials, as Isaac Lab lays them out.
    """
    path = authored_path(prim_path)
    stage = current_stage()
    if stage.GetPrimAtPath(path).IsValid():
        raise ValueError(f"cannot spawn a shape at '{path}': a prim is there already, choose another prim_path")
    prim = UsdGeom.Xform.Define(stage, path).GetPrim()
    UsdGeom.Scope.Define(stage, f"{path}/geometry")
    geometry = cfg.author(stage, f"{path}/geometry/mesh")
    if cfg.collision_props is not None:
        schemas.define_collision_properties(geometry, cfg.collision_props)
    for material, name, purpose in (
        (cfg.visual_material, cfg.visual_material_path, ""),
        (cfg.physics_material, cfg.physics_material_path, "physics"),
    ):
        if material is not None:
            where = name if name.startswith("/") else f"{path}/{name}"
            bind_material(geometry, material.func(where, material), purpose)
    if cfg.rigid_props is not None:
        schemas.define_rigid_body_properties(prim, cfg.rigid_props)
    if cfg.mass_props is not None:
        schemas.define_mass_properties(prim, cfg.mass_props)
    place(prim, translation, orientation)
    return finish(prim, cfg)


@configclass
class ShapeCfg(RigidObjectSpawnerCfg):
    """Base of the shapes."""

    func: Callable[..., Usd.Prim] = spawn_shape
    """Function that authors the shape."""
    visual_material: PreviewSurfaceCfg | None = None
    """Appearance."""
    visual_material_path: str = "material"
    """Path of the visual material, below the shape unless absolute."""
    physics_material: RigidBodyMaterialCfg | None = None
    """Friction and restitution."""
    physics_material_path: str = "physics_material"
    """Path of the physics material, below the shape unless absolute."""

    lengths: ClassVar[tuple[str, ...]] = ()
    """Fields that are lengths [m], which must be positive."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        """Author the geometry at ``path``."""
        raise NotImplementedError

    def problems(self) -> Iterator[tuple[str, str]]:
        for name in self.lengths:
            value = getattr(self, name)
            if value is not MISSING and not (math.isfinite(value) and value > 0):
                yield name, f"is {value}, must be a positive length [m]"


def _with_axis(geometry: UsdGeom.Capsule | UsdGeom.Cylinder | UsdGeom.Cone, cfg: CapsuleCfg) -> Usd.Prim:
    geometry.CreateRadiusAttr(cfg.radius)
    geometry.CreateHeightAttr(cfg.height)
    geometry.CreateAxisAttr(cfg.axis.upper())
    return geometry.GetPrim()


@configclass
class CuboidCfg(ShapeCfg):
    """A box centred at its origin."""

    size: tuple[PositiveFloat, PositiveFloat, PositiveFloat] = MISSING
    """Edge lengths [m]."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        cube = UsdGeom.Cube.Define(stage, path)
        # UsdGeom.Cube has one edge length, so a box is a unit cube with a scale; the geometry prim has no children that
        # would be scaled with it.
        cube.CreateSizeAttr(1.0)
        cube.AddScaleOp().Set(Gf.Vec3f(*map(float, self.size)))
        return cube.GetPrim()


@configclass
class SphereCfg(ShapeCfg):
    """A sphere centred at its origin."""

    lengths: ClassVar[tuple[str, ...]] = ("radius",)

    radius: PositiveFloat = MISSING
    """Radius [m]."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        sphere = UsdGeom.Sphere.Define(stage, path)
        sphere.CreateRadiusAttr(self.radius)
        return sphere.GetPrim()


@configclass
class CapsuleCfg(ShapeCfg):
    """A capsule centred at its origin."""

    lengths: ClassVar[tuple[str, ...]] = ("radius", "height")

    radius: PositiveFloat = MISSING
    """Radius [m]."""
    height: NonNegativeFloat = MISSING
    """Length of the cylindrical part [m]."""
    axis: str = "Z"
    """Axis of symmetry."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        return _with_axis(UsdGeom.Capsule.Define(stage, path), self)


@configclass
class CylinderCfg(CapsuleCfg):
    """A cylinder centred at its origin; ``height`` is its whole length."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        return _with_axis(UsdGeom.Cylinder.Define(stage, path), self)


@configclass
class ConeCfg(CapsuleCfg):
    """A cone centred at its origin; ``height`` is its whole length."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        return _with_axis(UsdGeom.Cone.Define(stage, path), self)


def author_mesh(stage: Usd.Stage, path: str, mesh: newton.Mesh, approximation: str | None = None) -> Usd.Prim:
    """Write a Newton mesh as ``UsdGeom.Mesh``, with a collision approximation if one is given."""
    geometry = UsdGeom.Mesh.Define(stage, path)
    indices = np.asarray(mesh.indices, dtype=np.int32).reshape(-1)
    geometry.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(np.asarray(mesh.vertices, dtype=np.float32)))
    geometry.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(indices))
    geometry.CreateFaceVertexCountsAttr(Vt.IntArray([3] * (len(indices) // 3)))
    # USD's default is Catmull-Clark, which would round the edges.
    geometry.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    if approximation is not None:
        UsdPhysics.MeshCollisionAPI.Apply(geometry.GetPrim()).CreateApproximationAttr(approximation)
    return geometry.GetPrim()


@configclass
class MeshCuboidCfg(CuboidCfg):
    """A box as a triangle mesh."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        half = [float(s) / 2.0 for s in self.size]
        return author_mesh(stage, path, newton.Mesh.create_box(*half, compute_inertia=False), "convexHull")


@configclass
class MeshSphereCfg(SphereCfg):
    """A sphere as a triangle mesh."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        return author_mesh(stage, path, newton.Mesh.create_sphere(self.radius, compute_inertia=False), "convexHull")


def _axis_mesh(create: Callable[..., newton.Mesh], cfg: CapsuleCfg) -> newton.Mesh:
    return create(cfg.radius, cfg.height / 2.0, up_axis=newton.Axis.from_any(cfg.axis.upper()), compute_inertia=False)


@configclass
class MeshCapsuleCfg(CapsuleCfg):
    """A capsule as a triangle mesh."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        return author_mesh(stage, path, _axis_mesh(newton.Mesh.create_capsule, self), "convexHull")


@configclass
class MeshCylinderCfg(CapsuleCfg):
    """A cylinder as a triangle mesh; ``height`` is its whole length."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        return author_mesh(stage, path, _axis_mesh(newton.Mesh.create_cylinder, self), "convexHull")


@configclass
class MeshConeCfg(CapsuleCfg):
    """A cone as a triangle mesh; ``height`` is its whole length."""

    def author(self, stage: Usd.Stage, path: str) -> Usd.Prim:
        return author_mesh(stage, path, _axis_mesh(newton.Mesh.create_cone, self), "convexHull")
