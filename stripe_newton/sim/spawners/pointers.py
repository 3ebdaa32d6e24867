# SPDX-License-Identifier: Apache-2.0
"""Pointer spawners: arrows and frames, whose prims touch nothing; prototypes of markers."""

from __future__ import annotations

from collections.abc import Callable

import newton
import numpy as np
from pxr import Gf, Usd, UsdGeom

from stripe_newton.configclass import configclass
from stripe_newton.sim.scene_context import authored_path, current_stage

from .materials import PreviewSurfaceCfg, bind_material
from .shapes import author_mesh
from .spawner_cfg import Orientation, SpawnerCfg, Translation, finish, place

__all__ = ["ArrowCfg", "FrameCfg", "spawn_arrow", "spawn_frame"]

_AXES = {"x": (0.85, 0.05, 0.04), "y": (0.06, 0.6, 0.1), "z": (0.05, 0.2, 0.85)}
"""Colours of the axes of a frame, linear RGB."""


def spawn_arrow(
    prim_path: str, cfg: ArrowCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author an arrow from the origin along x."""
    path = authored_path(prim_path)
    root = UsdGeom.Xform.Define(current_stage(), path).GetPrim()
    geometry = author_mesh(current_stage(), f"{path}/arrow", _arrow_mesh(cfg.length, cfg.width, cfg.head, "x"))
    material = cfg.visual_material or PreviewSurfaceCfg(diffuse_color=cfg.color)
    bind_material(geometry, material.func(f"{path}/material", material))
    place(root, translation, orientation, cfg.scale)
    return finish(root, cfg)


def spawn_frame(
    prim_path: str, cfg: FrameCfg, translation: Translation = None, orientation: Orientation = None
) -> Usd.Prim:
    """Author a frame: an arrow along each axis, x red, y green and z blue."""
    path = authored_path(prim_path)
    root = UsdGeom.Xform.Define(current_stage(), path).GetPrim()
    for axis, color in _AXES.items():
        mesh = _arrow_mesh(cfg.length, cfg.width, cfg.head, axis)
        geometry = UsdGeom.Mesh(author_mesh(current_stage(), f"{path}/axis_{axis}", mesh))
        geometry.CreateDisplayColorAttr([Gf.Vec3f(*color)])
    place(root, translation, orientation, cfg.scale)
    return finish(root, cfg)


def _arrow_mesh(length: float, width: float, head: float, axis: str) -> newton.Mesh:
    """Shaft and head of an arrow from the origin along an axis."""
    up = newton.Axis.from_any(axis.upper())
    direction = np.eye(3)["xyz".index(axis)]
    shaft_half, head_half = 0.5 * length * (1.0 - head), 0.5 * length * head
    shaft = newton.Mesh.create_cylinder(0.5 * width, shaft_half, up_axis=up, compute_inertia=False)
    cone = newton.Mesh.create_cone(width, head_half, up_axis=up, compute_inertia=False)
    parts = [(shaft, shaft_half), (cone, 2.0 * shaft_half + head_half)]
    vertices = np.concatenate([np.asarray(m.vertices) + at * direction for m, at in parts])
    first = np.asarray(shaft.indices).reshape(-1)
    indices = np.concatenate([first, np.asarray(cone.indices).reshape(-1) + len(shaft.vertices)])
    return newton.Mesh(vertices.astype(np.float32), indices.astype(np.int32), compute_inertia=False)


@configclass
class _PointerCfg(SpawnerCfg):
    """Base of arrows and frames."""

    length: float = 1.0
    """Length of an arrow with its head [m]."""
    width: float = 0.1
    """Width of its shaft; the head is twice as wide [m]."""
    head: float = 0.35
    """Share of the length that is the head."""
    scale: tuple[float, float, float] | None = None
    """Scale along its axes."""


@configclass
class ArrowCfg(_PointerCfg):
    """An arrow from the origin along x."""

    func: Callable[..., Usd.Prim] = spawn_arrow
    """Function that authors the prim."""
    color: tuple[float, float, float] = (0.85, 0.05, 0.04)
    """Colour, linear RGB."""
    visual_material: PreviewSurfaceCfg | None = None
    """Appearance, in place of the colour."""


@configclass
class FrameCfg(_PointerCfg):
    """The three axes of a frame, x red, y green and z blue."""

    func: Callable[..., Usd.Prim] = spawn_frame
    """Function that authors the prim."""
    width: float = 0.05
    """Width of a shaft [m]."""
    head: float = 0.2
    """Share of the length that is the head."""
