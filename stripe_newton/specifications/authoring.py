# SPDX-License-Identifier: Apache-2.0
"""Authoring: a generated scene written as a USD stage.

Each mesh is one abstract prim below ``/Prototypes``. Its instances reference it and are instanceable, so that they
share it in memory, on disk and on the GPU. Visible surfaces and colliders are separate prims: meshes, and invisible
primitives with ``UsdPhysics.CollisionAPI``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdSemantics, UsdShade, Vt

from stripe_newton.scene.scenery import FOLIAGE_KEY, SCENERY_KEY
from stripe_newton.sim import DistantLightCfg, DomeLightCfg, PreviewSurfaceCfg, RigidBodyMaterialCfg
from stripe_newton.terrains.ground_usd import author_ground

from .asset_instance import AssetInstance
from .asset_mesh import AssetMesh, Collider, MeshPart
from .terrain_instance import TerrainInstance

__all__ = ["author_scene"]

_SHAPES = {"sphere": UsdGeom.Sphere, "capsule": UsdGeom.Capsule, "cylinder": UsdGeom.Cylinder, "box": UsdGeom.Cube}


def author_scene(
    terrain: TerrainInstance, dome_light: DomeLightCfg | None, distant_light: DistantLightCfg | None
) -> Usd.Stage:
    """Write a scene into a new stage: metres, z up, default prim ``/World``.

    ``/World/ground/terrain`` is the height field with the triangles that contacts have; the assets are
    ``/World/SPEC/INSTANCE``, the lights ``/World/Light`` and ``/World/Sun``. The same scene gives the same text.

    Args:
        terrain: The ground, with all assets in ``terrain.placed``.
        dome_light: The sky. None: no sky.
        distant_light: The sun. None: no sun.

    Raises:
        ValueError: if two different meshes have one name.
    """
    layer = Sdf.Layer.CreateAnonymous(".usda")
    _author_all_but_instances(Usd.Stage.Open(layer), terrain, dome_light, distant_light)
    # Instances are written when that stage is gone: it would recompose itself for each of thousands.
    for spec, instances in terrain.placed.items():
        if instances:
            _author_instances(layer, f"/World/{spec}", instances)
    return Usd.Stage.Open(layer)


def _author_all_but_instances(
    stage: Usd.Stage,
    terrain: TerrainInstance,
    dome_light: DomeLightCfg | None,
    distant_light: DistantLightCfg | None,
) -> None:
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdPhysics.SetStageKilogramsPerUnit(stage, 1.0)
    world = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(world)
    Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
    _author_terrain(stage, terrain)
    _author_lights(stage, dome_light, distant_light)
    # Meshes become prims by name, and one of two of a name would get the instances of both.
    names: dict[str, AssetMesh] = {}
    for instance in (instance for placed in terrain.placed.values() for instance in placed):
        mesh = names.setdefault(instance.mesh.name, instance.mesh)
        if mesh is not instance.mesh:
            raise ValueError(f"mesh '{mesh.name}': two different meshes have this name; give each its own")
    # A class is abstract: nobody draws or collides with the prototypes themselves.
    stage.CreateClassPrim("/Prototypes")
    for mesh in names.values():
        _author_prototype(stage, mesh)
    for spec, instances in terrain.placed.items():
        if instances:
            # USD's model hierarchy: an assembly of groups of components, without gaps.
            group = UsdGeom.Xform.Define(stage, f"/World/{spec}").GetPrim()
            Usd.ModelAPI(group).SetKind(Kind.Tokens.group)
            group.CreateAttribute(SCENERY_KEY, Sdf.ValueTypeNames.Bool).Set(True)


def _author_terrain(stage: Usd.Stage, terrain: TerrainInstance) -> None:
    root = UsdGeom.Xform.Define(stage, "/World/ground").GetPrim()
    _label(root, terrain.tags)
    red, green, blue = terrain.color
    author_ground(
        stage,
        "/World/ground",
        terrain.ground,
        max_init_terrain_level=terrain.max_init_level,
        physics_material=RigidBodyMaterialCfg(
            static_friction=terrain.static_friction, dynamic_friction=terrain.dynamic_friction
        ),
        visual_material=PreviewSurfaceCfg(diffuse_color=(red, green, blue)),
    )
    if terrain.colors is not None:  # a colour for each vertex, in place of the one of the material
        surface = UsdGeom.Mesh(stage.GetPrimAtPath("/World/ground/terrain"))
        colors = Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(terrain.colors, dtype=np.float32).reshape(-1, 3))
        surface.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(colors)
    prim = stage.GetPrimAtPath("/World/ground")
    x, y, z = terrain.origin or (0.0, 0.0, 0.0)
    prim.CreateAttribute("stripeNewton:origin", Sdf.ValueTypeNames.Point3d).Set(Gf.Vec3d(x, y, z))
    for index, (part, tags) in enumerate(terrain.parts):
        mesh = _author_mesh(stage, f"/World/ground/part_{index}_{part.name}", part)
        _label(mesh, tags)


def _author_lights(stage: Usd.Stage, dome_light: DomeLightCfg | None, distant_light: DistantLightCfg | None) -> None:
    if dome_light is not None:
        dome = UsdLux.DomeLight.Define(stage, "/World/Light")
        _author_light(dome, dome_light)
        if dome_light.texture_file:
            dome.CreateTextureFileAttr(dome_light.texture_file)
    if distant_light is not None:
        sun = UsdLux.DistantLight.Define(stage, "/World/Sun")
        _author_light(sun, distant_light)
        sun.CreateAngleAttr(distant_light.angle)
        # The config has no direction; this one gives shapes a lit and a dark side from most views.
        UsdGeom.Xformable(sun).AddRotateXYZOp().Set(Gf.Vec3f(40.0, 20.0, 30.0))


def _author_light(light: UsdLux.DomeLight | UsdLux.DistantLight, cfg: DomeLightCfg | DistantLightCfg) -> None:
    light.CreateColorAttr(Gf.Vec3f(*cfg.color))
    light.CreateIntensityAttr(cfg.intensity)
    light.CreateExposureAttr(cfg.exposure)


def _author_prototype(stage: Usd.Stage, mesh: AssetMesh) -> None:
    root = f"/Prototypes/{mesh.name}"
    UsdGeom.Xform.Define(stage, root)
    UsdGeom.Scope.Define(stage, f"{root}/Looks")
    for part in mesh.parts():
        _author_mesh(stage, f"{root}/{part.name}", part, f"{root}/Looks/{part.name}")
    for index, collider in enumerate(mesh.colliders()):
        _author_collider(stage, f"{root}/collider_{index}", collider)


def _author_mesh(stage: Usd.Stage, path: str, part: MeshPart, look: str | None = None) -> Usd.Prim:
    """Write a surface, with a material at the path ``look`` if given."""
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(part.vertices))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(part.faces.reshape(-1)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(part.faces), 3, dtype=np.int32)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)  # the default, Catmull-Clark, would round the edges
    mesh.CreateDoubleSidedAttr(part.double_sided)
    if part.foliage:
        mesh.GetPrim().CreateAttribute(FOLIAGE_KEY, Sdf.ValueTypeNames.Token, custom=True).Set(part.foliage)
    mesh.CreateExtentAttr([Gf.Vec3f(*map(float, f(part.vertices, axis=0))) for f in (np.min, np.max)])
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*part.color)])  # for programs that read no materials
    if look is not None:
        material = UsdShade.Material.Define(stage, look)
        shader = UsdShade.Shader.Define(stage, f"{look}/Shader")
        shader.CreateIdAttr("UsdPreviewSurface")
        shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*part.color))
        shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(part.roughness)
        material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
        UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    return mesh.GetPrim()


def _author_collider(stage: Usd.Stage, path: str, collider: Collider) -> None:
    shape = _SHAPES[collider.kind].Define(stage, path)
    size = collider.size
    if collider.kind == "box":
        shape.CreateSizeAttr(2.0)  # a USD cube has one size; the half extents are a scale
        reach = np.ones(3)
    else:
        shape.CreateRadiusAttr(size[0])
        reach = np.full(3, size[0])
    if collider.kind in ("capsule", "cylinder"):
        shape.CreateHeightAttr(2.0 * size[1])
        shape.CreateAxisAttr(UsdGeom.Tokens.z)
        reach[2] = size[1] + (size[0] if collider.kind == "capsule" else 0.0)
    shape.CreateExtentAttr([Gf.Vec3f(*map(float, -reach)), Gf.Vec3f(*map(float, reach))])
    shape.CreatePurposeAttr(UsdGeom.Tokens.guide)  # not rendered
    qx, qy, qz, qw = collider.rot  # Gf takes the real part first
    form = UsdGeom.Xformable(shape)
    form.AddTranslateOp().Set(Gf.Vec3d(*collider.pos))
    form.AddOrientOp().Set(Gf.Quatf(qw, qx, qy, qz))
    if collider.kind == "box":
        form.AddScaleOp().Set(Gf.Vec3f(*size))
    UsdPhysics.CollisionAPI.Apply(shape.GetPrim())


def _label(prim: Usd.Prim, labels: Sequence[str]) -> None:
    if labels:
        UsdSemantics.LabelsAPI.Apply(prim, "class").CreateLabelsAttr(Vt.TokenArray(list(labels)))


_TRANSFORM_OPS = ["xformOp:translate", "xformOp:orient", "xformOp:scale"]


def _author_instances(layer: Sdf.Layer, root: str, instances: list[AssetInstance]) -> None:
    """Write instances as copies of the first of each kind.

    Copying specs in the layer takes a third of the time of authoring prims on a stage.
    """
    first_of_kind: dict[tuple[str, bool, tuple[str, ...]], Sdf.Path] = {}
    with Sdf.ChangeBlock():
        for instance in instances:
            kind = instance.mesh.name, instance.mesh.instancable, tuple(instance.labels)
            path = Sdf.Path(f"{root}/{instance.name}")
            if kind in first_of_kind:
                Sdf.CopySpec(layer, first_of_kind[kind], layer, path)
            else:
                first_of_kind[kind] = path
                _author_instance(Sdf.CreatePrimInLayer(layer, path), *kind)
            qx, qy, qz, qw = instance.rotation
            pose = Gf.Vec3d(*instance.position), Gf.Quatf(qw, qx, qy, qz), Gf.Vec3f(instance.scale)
            for attribute, value in zip(_TRANSFORM_OPS, pose, strict=True):
                layer.GetAttributeAtPath(path.AppendProperty(attribute)).default = value


def _author_instance(prim: Sdf.PrimSpec, mesh: str, shared: bool, labels: tuple[str, ...]) -> None:
    """Write everything but the pose: a reference to the mesh's prototype, labels and empty transform operations."""
    types = Sdf.ValueTypeNames
    prim.specifier, prim.typeName = Sdf.SpecifierDef, "Xform"
    prim.instanceable = shared  # USD then composes the prototype once, whatever the number of instances
    prim.SetInfo("kind", Kind.Tokens.component)
    prim.referenceList.prependedItems = [Sdf.Reference(primPath=f"/Prototypes/{mesh}")]
    prim.SetInfo("apiSchemas", Sdf.TokenListOp.Create(prependedItems=["SemanticsLabelsAPI:class"]))
    Sdf.AttributeSpec(prim, "semantics:labels:class", types.TokenArray).default = Vt.TokenArray(labels)
    for name, kind in zip(_TRANSFORM_OPS, (types.Double3, types.Quatf, types.Float3), strict=True):
        Sdf.AttributeSpec(prim, name, kind)
    order = Sdf.AttributeSpec(prim, "xformOpOrder", types.TokenArray, Sdf.VariabilityUniform)
    order.default = Vt.TokenArray(_TRANSFORM_OPS)
