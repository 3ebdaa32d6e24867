# SPDX-License-Identifier: Apache-2.0
"""Scaled shapes: shapes under a scale that makes another kind of shape of them, as meshes of what the stage shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import newton
import numpy as np
from newton import GeoType
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics, Vt

from stripe_newton.shape_mesh import shape_mesh

from .stage_overlay import StageOverlay

__all__ = ["ScaledShape", "bake_shape", "scaled_shapes"]

_SAME = 1e-4
"""Relative difference of scales, and cosine of axes, below which they count as equal and as orthogonal."""
_SAGITTA = 1e-3
"""Distance of the facets of round shapes from their surface [m]; finer ones would make a field of stones slow."""
_ROUND = {"Sphere": GeoType.SPHERE, "Capsule": GeoType.CAPSULE, "Cylinder": GeoType.CYLINDER, "Cone": GeoType.CONE}
_TURNS = {"X": (2, 0, 1), "Y": (1, 2, 0), "Z": (0, 1, 2)}
"""Coordinates of a shape along Z that become x, y and z of one along an axis."""


class ScaledShape(NamedTuple):
    """A shape that Newton would read as one of another form."""

    path: Sdf.Path
    what: str
    """Its scale."""
    why_not: str
    """Why it cannot become a mesh; empty if it can."""


def scaled_shapes(prims: Sequence[Usd.Prim]) -> list[ScaledShape]:
    """Shapes that are not a rotated one of their kind: an egg of a sphere, a sheared box or mesh.

    Args:
        prims: The prims of a stage.
    """
    cache, found = UsdGeom.XformCache(), []
    for prim in prims:
        kind = prim.GetTypeName()
        if kind in _ROUND or kind in ("Cube", "Mesh"):
            # USD multiplies a matrix from the right, so that its rows are the images of the axes.
            what = _distortion(prim, np.array(cache.GetLocalToWorldTransform(prim))[:3, :3])
            if what:
                found.append((prim, what))
    if not found:
        return []
    jointed = {path for prim in prims if prim.IsA(UsdPhysics.Joint) for path in _targets(prim)}
    shared = _reference_targets(prims)
    return [ScaledShape(prim.GetPath(), what, _why_not(prim, jointed, shared)) for prim, what in found]


def _why_not(prim: Usd.Prim, jointed: set[Sdf.Path], shared: set[Sdf.Path]) -> str:
    if any(child.IsA(UsdGeom.Xformable) for child in prim.GetAllChildren()):
        return "it has shapes below it"
    if prim.GetPath() in jointed:
        return "a joint holds it"
    # An edit of such a prim would reach the others, below other transforms.
    return "other prims refer to it" if any(prim.GetPath().HasPrefix(path) for path in shared) else ""


def _targets(prim: Usd.Prim) -> list[Sdf.Path]:
    joint = UsdPhysics.Joint(prim)
    return [*joint.GetBody0Rel().GetTargets(), *joint.GetBody1Rel().GetTargets()]


def _reference_targets(prims: Sequence[Usd.Prim]) -> set[Sdf.Path]:
    """Prims of a stage's own layers that others of it refer to, inherit or specialise."""
    found: set[Sdf.Path] = set()
    for prim in prims:
        if prim.HasAuthoredReferences() or prim.HasAuthoredInherits() or prim.HasAuthoredSpecializes():
            root = prim.GetPrimIndex().rootNode
            nodes = list(root.children)
            while nodes:
                node = nodes.pop()
                if node.layerStack == root.layerStack:
                    found.add(node.path)
                nodes.extend(node.children)
    return found


def _distortion(prim: Usd.Prim, rows: np.ndarray) -> str:
    """Part of a matrix that Newton does not apply to a shape, in words; empty if there is none."""
    scale = np.linalg.norm(rows, axis=1)
    cosines = (rows @ rows.T) / np.outer(scale, scale)
    if np.abs(cosines[np.triu_indices(3, 1)]).max() > _SAME:
        return "shear"
    if prim.GetTypeName() not in _ROUND:
        return ""
    must_agree = [0, 1, 2]
    if prim.GetTypeName() in ("Cylinder", "Cone"):  # their height may have a scale of its own
        must_agree.remove("XYZ".index(_axis(prim)))
    chosen = scale[must_agree]
    return "" if np.ptp(chosen) <= _SAME * chosen.max() else f"scale {' x '.join(f'{s:.4g}' for s in scale)}"


def _axis(prim: Usd.Prim) -> str:
    return "Z" if prim.IsA(UsdGeom.Sphere) else str(prim.GetAttribute("axis").Get())


def bake_shape(overlay: StageOverlay, path: Sdf.Path) -> None:
    """Replace a shape by a mesh in a frame without scale; where it is and what it is part of stay.

    A collider keeps its approximation. One that had none collides as a mesh without one does.

    Args:
        overlay: The stage to edit.
        path: The shape.
    """
    prim = overlay.prim(path)
    xformable, now = UsdGeom.Xformable(prim), Usd.TimeCode.Default()
    world, resets = np.array(xformable.ComputeLocalToWorldTransform(now)), xformable.GetResetXformStack()
    parent = np.eye(4) if resets else np.array(xformable.ComputeParentToWorldTransform(now))
    frame = np.eye(4)
    frame[:3, :3], frame[3, :3] = _nearest_rotation(world[:3, :3]), world[3, :3]
    into_frame = world @ np.linalg.inv(frame)
    if prim.IsA(UsdGeom.Mesh):
        points, faces = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(), dtype=float), None
    else:
        points, faces = _mesh_of(prim, np.linalg.norm(world[:3, :3], axis=1).max())
        prim.SetTypeName("Mesh")
    mesh = UsdGeom.Mesh(prim)
    moved = points @ into_frame[:3, :3] + into_frame[3, :3]
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(moved.astype(np.float32)))
    if faces is not None:
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray(len(faces), 3))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.reshape(-1).astype(np.int32)))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    if np.linalg.det(world[:3, :3]) < 0.0:
        left = mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded
        mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded if left else UsdGeom.Tokens.leftHanded)
    for name in ("normals", "primvars:normals", "extent"):
        if prim.HasAttribute(name):
            prim.GetAttribute(name).Block()
    centre = UsdPhysics.MassAPI(prim).GetCenterOfMassAttr()
    if centre and centre.HasAuthoredValue():  # it is in the scaled frame of the prim
        centre.Set(Gf.Vec3f(*(np.array(centre.Get(), dtype=float) @ into_frame[:3, :3]).tolist()))
    xformable.MakeMatrixXform().Set(Gf.Matrix4d((frame @ np.linalg.inv(parent)).tolist()))
    xformable.SetResetXformStack(resets)


def _nearest_rotation(rows: np.ndarray) -> np.ndarray:
    """The rotation nearest to a matrix, which may mirror."""
    u, _, v = np.linalg.svd(rows * np.sign(np.linalg.det(rows)))
    return u @ v


def _mesh_of(prim: Usd.Prim, scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and triangles of a shape in its own frame, whose facets fit its greatest scale in the world."""
    if prim.IsA(UsdGeom.Cube):
        box = newton.Mesh.create_box(*[UsdGeom.Cube(prim).GetSizeAttr().Get() / 2.0] * 3, compute_inertia=False)
        return np.array(box.vertices, dtype=float), np.array(box.indices).reshape(-1, 3)
    radius = float(prim.GetAttribute("radius").Get())
    half = 0.0 if prim.IsA(UsdGeom.Sphere) else float(prim.GetAttribute("height").Get()) / 2.0
    sizes = np.array([radius, half, 0.0]) * scale
    points, faces = shape_mesh(_ROUND[prim.GetTypeName()], sizes, None, str(prim.GetPath()), _SAGITTA)
    return points[:, _TURNS[_axis(prim)]] / scale, faces
