# SPDX-License-Identifier: Apache-2.0
"""Ground in USD: a height field written as a mesh collider with its grid and tiles, and read back from it."""

from __future__ import annotations

from typing import Any, TypedDict

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from stripe_newton.sim import PreviewSurfaceCfg, RigidBodyMaterialCfg

from .ground import Ground

__all__ = ["Placement", "author_ground", "ground_prims", "placement", "read_ground"]

_PREFIX = "stripeNewton:heightField:"


class Placement(TypedDict, total=False):
    """Fields of ``TerrainImporterCfg`` that a stage keeps beside the heights."""

    use_terrain_origins: bool
    max_init_terrain_level: int | None
    physics_material: RigidBodyMaterialCfg | None
    visual_material: PreviewSurfaceCfg | None


def author_ground(
    stage: Usd.Stage,
    path: str,
    ground: Ground,
    *,
    use_terrain_origins: bool = True,
    max_init_terrain_level: int | None = None,
    physics_material: RigidBodyMaterialCfg | None = None,
    visual_material: PreviewSurfaceCfg | None = None,
) -> None:
    """Write a height field at ``PATH/terrain``, with its grid and tiles as custom attributes.

    The mesh has the triangles that contacts have, so another program finds the same surface.

    Args:
        stage: The stage to write to.
        path: Path of the terrain.
        ground: Heights, origins and patches.
        use_terrain_origins: As in ``TerrainImporterCfg``, like all that follow.
        max_init_terrain_level: None is not written.
        physics_material: Material that is bound to the mesh.
        visual_material: Its colour is the display colour of the mesh.
    """
    mesh = _author_mesh(stage, f"{path}/terrain", ground)
    prim = mesh.GetPrim()
    UsdPhysics.CollisionAPI.Apply(prim)
    # Approximation "none": a convex hull or decomposition would close the valleys.
    UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.none)
    if physics_material is not None:
        material = UsdShade.Material.Define(stage, f"{path}/physicsMaterial")
        api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
        api.CreateStaticFrictionAttr(physics_material.static_friction)
        api.CreateDynamicFrictionAttr(physics_material.dynamic_friction)
        api.CreateRestitutionAttr(physics_material.restitution)
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, UsdShade.Tokens.strongerThanDescendants, "physics")
    if visual_material is not None:
        mesh.CreateDisplayColorAttr([Gf.Vec3f(*visual_material.diffuse_color)])
    # A mesh does not say that its points are a grid, nor where environments start: these attributes do.
    types = Sdf.ValueTypeNames
    values = [
        ("shape", types.Int2, Gf.Vec2i(*ground.raw.shape)),
        ("lower", types.Double2, Gf.Vec2d(*ground.lower)),
        ("cell", types.Double2, Gf.Vec2d(*ground.cell)),
        ("seed", types.Int, ground.seed),
        ("useOrigins", types.Bool, use_terrain_origins),
    ]
    if max_init_terrain_level is not None:
        values.append(("maxInitLevel", types.Int, max_init_terrain_level))
    if ground.origins is not None:
        values += [
            ("tile", types.Double2, Gf.Vec2d(*ground.tile)),
            ("grid", types.Int2, Gf.Vec2i(*ground.origins.shape[:2])),
            ("origins", types.Point3dArray, Vt.Vec3dArray.FromNumpy(ground.origins.reshape(-1, 3))),
        ]
    for name, patches in ground.patches.items():
        values.append((f"patches:{name}", types.Point3dArray, Vt.Vec3dArray.FromNumpy(patches.reshape(-1, 3))))
    for name, kind, value in values:
        prim.CreateAttribute(_PREFIX + name, kind).Set(value)


def _author_mesh(stage: Usd.Stage, path: str, ground: Ground) -> UsdGeom.Mesh:
    """The surface as a mesh: two triangles per cell, cut as in :func:`surface_height`."""
    nrow, ncol = ground.raw.shape
    mesh = UsdGeom.Mesh.Define(stage, path)
    points = np.empty((nrow, ncol, 3), dtype=np.float32)
    points[..., 0] = (ground.lower[0] + ground.cell[0] * np.arange(ncol))[None, :]
    points[..., 1] = (ground.lower[1] + ground.cell[1] * np.arange(nrow))[:, None]
    points[..., 2] = ground.raw  # the heights as given: the same field is made from them again
    first = (np.arange(nrow - 1, dtype=np.int32)[:, None] * ncol + np.arange(ncol - 1, dtype=np.int32)).reshape(-1)
    faces = np.stack([first, first + 1, first + ncol, first + 1, first + ncol + 1, first + ncol], axis=1)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.reshape(-1, 3)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.reshape(-1)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(2 * len(first), 3, dtype=np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)  # the default, Catmull-Clark, would round the edges
    mesh.CreateExtentAttr([Gf.Vec3f(*map(float, f(points.reshape(-1, 3), axis=0))) for f in (np.min, np.max)])
    return mesh


def ground_prims(stage: Usd.Stage) -> list[Usd.Prim]:
    """Meshes that :func:`author_ground` wrote."""
    return [p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh) and p.HasAttribute(_PREFIX + "shape")]


def read_ground(prim: Usd.Prim) -> Ground:
    """Read a height field that :func:`author_ground` wrote.

    Raises:
        ValueError: if the number of points is not that of its grid.
    """
    nrow, ncol = _get(prim, "shape")
    points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(), dtype=np.float32).reshape(-1, 3)
    if len(points) != nrow * ncol:
        raise ValueError(f"'{prim.GetPath()}': has {len(points)} points, its grid of {nrow} by {ncol} has others")
    grid, patches = _get(prim, "grid"), {}
    if grid is not None:
        prefix = f"{_PREFIX}patches:"
        names = [a.GetName() for a in prim.GetAttributes() if a.GetName().startswith(prefix)]
        patches = {n.removeprefix(prefix): np.array(prim.GetAttribute(n).Get()).reshape(*grid, -1, 3) for n in names}
    origins = _get(prim, "origins")
    ground = Ground(
        points[:, 2].reshape(nrow, ncol),
        tuple(_get(prim, "lower")),
        tuple(_get(prim, "cell")),
        None if origins is None else np.array(origins).reshape(*grid, 3),
        tuple(_get(prim, "tile") or (0.0, 0.0)),
        patches,
        int(_get(prim, "seed") or 0),
    )
    colors = UsdGeom.Mesh(prim).GetDisplayColorAttr().Get()
    if colors is not None and len(colors) == len(points):
        # Newton's Heightfield has no colours of its own: the renderer looks for this attribute.
        ground.source.colors = np.array(colors, dtype=np.float32).reshape(nrow, ncol, 3)
    return ground


def placement(prim: Usd.Prim) -> Placement:
    """Read the fields of ``TerrainImporterCfg`` that :func:`author_ground` wrote."""
    use_origins = _get(prim, "useOrigins")
    fields: Placement = {
        "use_terrain_origins": True if use_origins is None else bool(use_origins),
        "max_init_terrain_level": _get(prim, "maxInitLevel"),
        "physics_material": None,
    }
    bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
    if bound and bound.GetPrim().HasAPI(UsdPhysics.MaterialAPI):
        api = UsdPhysics.MaterialAPI(bound.GetPrim())
        fields["physics_material"] = RigidBodyMaterialCfg(
            static_friction=api.GetStaticFrictionAttr().Get(),
            dynamic_friction=api.GetDynamicFrictionAttr().Get(),
            restitution=api.GetRestitutionAttr().Get(),
        )
    colors = UsdGeom.Mesh(prim).GetDisplayColorAttr().Get()
    if colors:
        red, green, blue = map(float, np.array(colors).mean(axis=0))
        fields["visual_material"] = PreviewSurfaceCfg(diffuse_color=(red, green, blue))
    return fields


def _get(prim: Usd.Prim, name: str) -> Any:
    """Value of one of the custom attributes; None if it is not authored."""
    attribute = prim.GetAttribute(_PREFIX + name)
    return attribute.Get() if attribute and attribute.HasValue() else None
