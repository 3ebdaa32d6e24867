# SPDX-License-Identifier: Apache-2.0
"""Mesh approximations: what becomes of ``physics:approximation`` where Newton would take something worse."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Iterator, Sequence

from pxr import Sdf, Usd, UsdGeom, UsdPhysics

__all__ = [
    "Replacement",
    "asks_for_distance_field",
    "can_approximate",
    "quiet_decomposition",
    "replaced_approximations",
]

Replacement = tuple[Sdf.Path, str, str]
"""A mesh, its approximation, and why its own points and faces are taken."""


def can_approximate() -> bool:
    """Whether Newton can approximate meshes by hulls and boxes itself. If not, MuJoCo makes a hull of every mesh."""
    return importlib.util.find_spec("scipy") is not None


def quiet_decomposition() -> None:
    """Let CoACD, which decomposes meshes if it is installed, print errors only."""
    if importlib.util.find_spec("coacd") is not None:
        importlib.import_module("coacd").set_log_level("error")


def asks_for_distance_field(prim: Usd.Prim) -> bool:
    """Whether the approximation of a mesh collider is ``sdf``: the mesh as it is, by its signed distances."""
    api = UsdPhysics.MeshCollisionAPI(prim) if prim and prim.HasAPI(UsdPhysics.MeshCollisionAPI) else None
    return api is not None and api.GetApproximationAttr().Get() == "sdf"


def replaced_approximations(prims: Sequence[Usd.Prim], static_triangles: bool) -> Iterator[Replacement]:
    """Mesh colliders whose approximation is replaced by ``none``, as Newton's would be another shape.

    * A static mesh is met by its triangles, which are exact. Its convex parts are hundreds for a flight of stairs, and
      off by as much as a step.
    * A mesh that is simplified may lose a stair or open, and without the package for it would become its bounding box.

    Args:
        prims: The prims of a stage.
        static_triangles: Whether static meshes collide by their triangles.
    """
    for prim in prims:
        if not (prim.IsA(UsdGeom.Mesh) and prim.HasAPI(UsdPhysics.MeshCollisionAPI)):
            continue
        kind, path = UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get(), prim.GetPath()
        if kind == UsdPhysics.Tokens.meshSimplification:
            yield path, kind, "it is not simplified, as that may open it: all of its faces are taken"
        elif kind == UsdPhysics.Tokens.convexDecomposition and static_triangles and not _moves(prim):
            yield path, kind, "a static mesh collides by its triangles, of which convex parts are an estimate"
        elif kind == UsdPhysics.Tokens.convexDecomposition and importlib.util.find_spec("coacd") is None:
            yield path, kind, "CoACD is not installed: pip install 'stripe-newton[decomposition]'"


def _moves(prim: Usd.Prim) -> bool:
    """Whether a prim is part of a rigid body."""
    while prim and not prim.IsPseudoRoot():
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            return True
        prim = prim.GetParent()
    return False
