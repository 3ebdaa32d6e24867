# SPDX-License-Identifier: Apache-2.0
"""A height field in a USD stage: a mesh collider that says of what grid it is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from stripe_newton.sim import PreviewSurfaceCfg, RigidBodyMaterialCfg

from .ground import Ground

if TYPE_CHECKING:
    from .terrain_importer import TerrainImporter

__all__ = ["author_ground", "found_terrain", "ground_prims", "placement", "read_ground"]

_PREFIX = "stripeNewton:heightField:"


def author_ground(stage: Usd.Stage, terrain: TerrainImporter) -> None:
    """Write the height field of ``terrain`` at ``PATH/terrain``, with its tiles as custom attributes.

    The mesh has the triangles that contacts have, so another program finds the same surface.
    """
    ground, cfg = terrain.ground, terrain.cfg
    if ground is None:
        return
    nrow, ncol = ground.raw.shape
    mesh = UsdGeom.Mesh.Define(stage, f"{terrain.path}/terrain")
    prim = mesh.GetPrim()
    points = np.empty((nrow, ncol, 3), dtype=np.float32)
    points[..., 0] = (ground.lower[0] + ground.cell[0] * np.arange(ncol))[None, :]
    points[..., 1] = (ground.lower[1] + ground.cell[1] * np.arange(nrow))[:, None]
    points[..., 2] = ground.raw
    first = (np.arange(nrow - 1, dtype=np.int32)[:, None] * ncol + np.arange(ncol - 1, dtype=np.int32)).reshape(-1)
    faces = np.stack([first, first + 1, first + ncol, first + 1, first + ncol + 1, first + ncol], axis=1)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.reshape(-1, 3)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.reshape(-1)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(2 * len(first), 3, dtype=np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr([Gf.Vec3f(*map(float, f(points.reshape(-1, 3), axis=0))) for f in (np.min, np.max)])
    UsdPhysics.CollisionAPI.Apply(prim)
    UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.none)
    if cfg.physics_material is not None:
        material = UsdShade.Material.Define(stage, f"{terrain.path}/physicsMaterial")
        api = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
        api.CreateStaticFrictionAttr(cfg.physics_material.static_friction)
        api.CreateDynamicFrictionAttr(cfg.physics_material.dynamic_friction)
        api.CreateRestitutionAttr(cfg.physics_material.restitution)
        UsdShade.MaterialBindingAPI.Apply(prim).Bind(material, UsdShade.Tokens.strongerThanDescendants, "physics")
    if cfg.visual_material is not None:
        mesh.CreateDisplayColorAttr([Gf.Vec3f(*cfg.visual_material.diffuse_color)])
    types = Sdf.ValueTypeNames
    values = [
        ("shape", types.Int2, Gf.Vec2i(nrow, ncol)),
        ("lower", types.Double2, Gf.Vec2d(*ground.lower)),
        ("cell", types.Double2, Gf.Vec2d(*ground.cell)),
        ("seed", types.Int, ground.seed),
        ("useOrigins", types.Bool, cfg.use_terrain_origins),
    ]
    if cfg.max_init_terrain_level is not None:
        values.append(("maxInitLevel", types.Int, cfg.max_init_terrain_level))
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


def ground_prims(stage: Usd.Stage) -> list[Usd.Prim]:
    """Prims that :func:`author_ground` wrote."""
    return [p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh) and p.HasAttribute(_PREFIX + "shape")]


def found_terrain(stage: Usd.Stage) -> Any:
    """Config of the terrain whose height field a stage holds; None if it holds none.

    Raises:
        ValueError: if it holds several.
    """
    from .terrain_importer_cfg import TerrainImporterCfg

    prims = ground_prims(stage)
    if not prims:
        return None
    if len(prims) > 1:
        raise ValueError(f"'{prims[0].GetPath()}' and '{prims[1].GetPath()}' are height fields; a scene has one ground")
    path = str(prims[0].GetPath().GetParentPath())
    return TerrainImporterCfg(prim_path=path, terrain_type="stage", **placement(prims[0]))


def _get(prim: Usd.Prim, name: str, default: Any = None) -> Any:
    attribute = prim.GetAttribute(_PREFIX + name)
    return attribute.Get() if attribute and attribute.HasValue() else default


def read_ground(prim: Usd.Prim) -> Ground:
    """What :func:`author_ground` wrote.

    Raises:
        ValueError: if the mesh has another number of points than its grid.
    """
    nrow, ncol = _get(prim, "shape")
    points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(), dtype=np.float32).reshape(-1, 3)
    if len(points) != nrow * ncol:
        raise ValueError(f"'{prim.GetPath()}': has {len(points)} points, its grid of {nrow} by {ncol} has others")
    grid, lists = _get(prim, "grid"), {}
    if grid is not None:
        prefix = f"{_PREFIX}patches:"
        names = [a.GetName() for a in prim.GetAttributes() if a.GetName().startswith(prefix)]
        lists = {n.removeprefix(prefix): np.array(prim.GetAttribute(n).Get()).reshape(*grid, -1, 3) for n in names}
    origins = _get(prim, "origins")
    ground = Ground(
        points[:, 2].reshape(nrow, ncol),
        tuple(_get(prim, "lower")),
        tuple(_get(prim, "cell")),
        None if origins is None else np.array(origins).reshape(*grid, 3),
        tuple(_get(prim, "tile", (0.0, 0.0))),
        lists,
        int(_get(prim, "seed", 0)),
    )
    colors = UsdGeom.Mesh(prim).GetDisplayColorAttr().Get()
    if colors is not None and len(colors) == len(points):
        ground.source.colors = np.array(colors, dtype=np.float32).reshape(nrow, ncol, 3)  # for what draws it
    return ground


def placement(prim: Usd.Prim) -> dict[str, Any]:
    """Fields of ``TerrainImporterCfg`` that :func:`author_ground` wrote."""
    fields: dict[str, Any] = {
        "use_terrain_origins": bool(_get(prim, "useOrigins", True)),
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
