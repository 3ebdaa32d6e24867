# SPDX-License-Identifier: Apache-2.0
"""MJCF stage: what stands still in an MJCF file, as a USD stage, so that the file can be the scenery of a task."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
from pxr import Gf, Tf, Usd, UsdGeom, UsdPhysics, UsdShade, Vt

from .error import RobotFileError
from .mjcf_checks import compile_mjcf
from .urdf_checks import Row

__all__ = ["mjcf_stage"]

_SHAPES = {
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}")): name
    for name in ("PLANE", "HFIELD", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
}
_FIRST_HIDDEN_GROUP = 3
"""MuJoCo's viewer shows the groups below: the others are the colliders of what is seen."""


def mjcf_stage(path: Path) -> tuple[Usd.Stage, list[Row]]:
    """The geometry of a file that is fixed to the world, in metres and with Z up, at the coordinates of the start.

    Args:
        path: The file.

    Returns:
        The stage, and rows of what it lacks.

    Raises:
        RobotFileError: MuJoCo refuses the file, or nothing in it stands still.
    """
    model = compile_mjcf(path, for_newton=False)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    moving = _moving_bodies(model)
    geoms = [g for g in range(model.ngeom) if not moving[model.geom_bodyid[g]] and int(model.geom_type[g]) in _SHAPES]
    if not geoms:
        raise RobotFileError(path, ["nothing with a shape stands still in it: load it as an asset, with file_spawner"])
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Arena").GetPrim())
    for geom in geoms:
        _add_geom(stage, model, data, geom)
    return stage, list(_rows(model, moving, geoms))


def _moving_bodies(model: mujoco.MjModel) -> np.ndarray:
    """Which bodies have a joint between them and the world, shape ``(nbody,)``; bodies of ``mocap`` have none."""
    moving = np.zeros(model.nbody, dtype=bool)
    for body in range(1, model.nbody):
        moving[body] = moving[model.body_parentid[body]] or model.body_dofnum[body] > 0
    return moving


def _rows(model: mujoco.MjModel, moving: np.ndarray, geoms: list[int]) -> Iterator[Row]:
    if count := int(moving.sum()):
        first = model.body(int(np.flatnonzero(moving)[0])).name or "a body"
        more = f" (+{count - 1} more)" if count > 1 else ""
        yield first + more, "moves", "left out: scenery of an MJCF file stands still; load what moves as an asset"
    if model.nflex:
        yield f"{model.nflex} flexes", "not read", "this package simulates rigid bodies"
    for count, what in ((model.nlight, "lights"), (model.ncam, "cameras"), (model.nskin, "skins")):
        if count:
            yield f"{count} {what}", "not read", "a scene's config has its own"
    used = {int(m) for m in model.geom_matid[geoms] if m >= 0}
    if textured := [m for m in used if _texture(model, m) >= 0]:
        yield f"{len(textured)} textures", "not drawn", "the colour is the mean of the texture"
    unusual = (
        not np.allclose(model.geom_solref[geoms], (0.02, 1.0))
        or not np.allclose(model.geom_solimp[geoms], (0.9, 0.95, 0.001, 0.5, 2.0))
        or not np.allclose(model.geom_friction[geoms, 1:], (0.005, 0.0001))
        or not np.allclose(model.geom_margin[geoms], 0.0)
    )
    if unusual:
        yield "geoms", "solref, solimp, margin", "not read, nor friction other than sliding: USD has sliding friction"


def _add_geom(stage: Usd.Stage, model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> None:
    kind = _SHAPES[int(model.geom_type[geom])]
    body = model.body(int(model.geom_bodyid[geom])).name
    name = Tf.MakeValidIdentifier(model.geom(geom).name or f"{body}_{kind.lower()}")
    path, number = f"/Arena/{name}", 1
    while stage.GetPrimAtPath(path):
        number += 1
        path = f"/Arena/{name}_{number}"
    shape, scale = _define(stage, path, model, geom, kind)
    turn = Gf.Matrix3d(*data.geom_xmat[geom].reshape(3, 3).T.reshape(-1).tolist())  # USD's matrices act on rows
    pose = Gf.Matrix4d(turn, Gf.Vec3d(*data.geom_xpos[geom].tolist()))
    shape.AddTransformOp().Set(Gf.Matrix4d().SetScale(Gf.Vec3d(*scale)) * pose)
    colour, opacity = _colour(model, geom)
    shape.CreateDisplayColorAttr([Gf.Vec3f(*colour)])
    if opacity < 1.0:
        shape.CreateDisplayOpacityAttr([opacity])
    if model.geom_group[geom] >= _FIRST_HIDDEN_GROUP or opacity == 0.0:
        shape.MakeInvisible()
    if model.geom_contype[geom] or model.geom_conaffinity[geom]:
        UsdPhysics.CollisionAPI.Apply(shape.GetPrim())
        if kind == "MESH":  # as MuJoCo has it
            mesh = UsdPhysics.MeshCollisionAPI.Apply(shape.GetPrim())
            mesh.CreateApproximationAttr(UsdPhysics.Tokens.convexHull)
        _bind_friction(stage, shape.GetPrim(), float(model.geom_friction[geom, 0]))


def _define(
    stage: Usd.Stage, path: str, model: mujoco.MjModel, geom: int, kind: str
) -> tuple[UsdGeom.Gprim, tuple[float, ...]]:
    """A prim for a geom in its own frame, and the factors on its axes."""
    x, y, z = (float(v) for v in model.geom_size[geom])
    if kind == "BOX":
        cube = UsdGeom.Cube.Define(stage, path)
        cube.CreateSizeAttr(2.0)
        return cube, (x, y, z)
    if kind in ("SPHERE", "ELLIPSOID"):
        sphere = UsdGeom.Sphere.Define(stage, path)
        sphere.CreateRadiusAttr(x if kind == "SPHERE" else 1.0)
        return sphere, (1.0, 1.0, 1.0) if kind == "SPHERE" else (x, y, z)
    if kind in ("CAPSULE", "CYLINDER"):
        round_ = (UsdGeom.Capsule if kind == "CAPSULE" else UsdGeom.Cylinder).Define(stage, path)
        round_.CreateRadiusAttr(x)
        round_.CreateHeightAttr(2.0 * y)
        round_.CreateAxisAttr(UsdGeom.Tokens.z)
        return round_, (1.0, 1.0, 1.0)
    if kind == "PLANE":  # it has no end in MuJoCo, whatever its size; that is how far it is drawn
        plane = UsdGeom.Plane.Define(stage, path)
        plane.CreateAxisAttr(UsdGeom.Tokens.z)
        return plane, (1.0, 1.0, 1.0)
    points, faces = _mesh(model, int(model.geom_dataid[geom])) if kind == "MESH" else _field(model, geom)
    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.reshape(-1).tolist())
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    return mesh, (1.0, 1.0, 1.0)


def _mesh(model: mujoco.MjModel, mesh: int) -> tuple[np.ndarray, np.ndarray]:
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    start, faces = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
    return model.mesh_vert[first : first + count], model.mesh_face[start : start + faces]


def _field(model: mujoco.MjModel, geom: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the surface of a height field, without its sides and base."""
    field = int(model.geom_dataid[geom])
    rows, columns, first = (int(a[field]) for a in (model.hfield_nrow, model.hfield_ncol, model.hfield_adr))
    x, y, z, _ = (float(v) for v in model.hfield_size[field])
    heights = z * model.hfield_data[first : first + rows * columns].reshape(rows, columns)
    across, along = np.meshgrid(np.linspace(-x, x, columns), np.linspace(-y, y, rows))
    points = np.stack([across, along, heights], axis=-1).reshape(-1, 3)
    corner = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (p.reshape(-1) for p in (corner[:-1, :-1], corner[:-1, 1:], corner[1:, 1:], corner[1:, :-1]))
    return points, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _colour(model: mujoco.MjModel, geom: int) -> tuple[tuple[float, ...], float]:
    """Colour and opacity, with the mean of the texture of the material."""
    material = int(model.geom_matid[geom])
    rgba = np.array(model.geom_rgba[geom] if material < 0 else model.mat_rgba[material], dtype=float)
    if material >= 0 and (texture := _texture(model, material)) >= 0:
        size = int(model.tex_height[texture]) * int(model.tex_width[texture])
        channels, first = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
        pixels = model.tex_data[first : first + size * channels].reshape(size, channels)
        rgba[:3] *= pixels[:, :3].mean(axis=0) / 255.0 if channels >= 3 else pixels.mean() / 255.0
    return tuple(float(v) for v in rgba[:3]), float(rgba[3])


def _texture(model: mujoco.MjModel, material: int) -> int:
    """Texture of a material's colour; -1 without one."""
    roles = (mujoco.mjtTextureRole.mjTEXROLE_RGB, mujoco.mjtTextureRole.mjTEXROLE_RGBA)
    return max(int(model.mat_texid[material, int(role)]) for role in roles)


def _bind_friction(stage: Usd.Stage, prim: Usd.Prim, friction: float) -> None:
    path = f"/Arena/Friction/{Tf.MakeValidIdentifier(f'mu_{friction:g}')}"
    material = UsdShade.Material.Define(stage, path)
    physics = UsdPhysics.MaterialAPI.Apply(material.GetPrim())
    physics.CreateDynamicFrictionAttr(friction)
    physics.CreateStaticFrictionAttr(friction)
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    binding.Bind(material, materialPurpose="physics")
