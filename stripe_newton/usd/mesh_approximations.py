# SPDX-License-Identifier: Apache-2.0
"""Mesh approximations: what becomes of ``physics:approximation`` where Newton would take something worse."""

from __future__ import annotations

import importlib
import importlib.util
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import newton
from pxr import Sdf, Usd, UsdGeom, UsdPhysics

__all__ = [
    "Replacement",
    "asks_for_distance_field",
    "can_approximate",
    "kept_decompositions",
    "quiet_decomposition",
    "replaced_approximations",
]

Replacement = tuple[Sdf.Path, str, str]
"""A mesh, its approximation, and why its own points and faces are taken."""
_LONG = 10.0
"""Seconds of reading a stage from which splitting its meshes is told."""


def can_approximate() -> bool:
    """Whether Newton can approximate meshes by hulls and boxes itself. If not, MuJoCo makes a hull of every mesh."""
    return importlib.util.find_spec("scipy") is not None


def quiet_decomposition() -> None:
    """Let CoACD, which decomposes meshes if it is installed, print errors only."""
    if importlib.util.find_spec("coacd") is not None:
        importlib.import_module("coacd").set_log_level("error")


@contextmanager
def kept_decompositions(stage: Usd.Stage, name: str) -> Iterator[None]:
    """Keep the convex parts that meshes are split into, and tell where it takes long: minutes for a robot's meshes.

    They are kept in ``~/.cache/stripe-newton/convex``, unless ``newton.config.cache_dir_meshes`` is set.

    Args:
        stage: The stage that is being read.
        name: Its name for the message.
    """
    before = newton.config.cache_dir_meshes
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = home / "stripe-newton" / "convex" if before is None else before
    text = (
        f"{name}: meshes whose physics:approximation is 'convexDecomposition' are split into convex parts, which takes "
        f"up to minutes; the parts are kept in {folder} for the next time. 'convexHull' is faster"
    )
    # Not as a warning: those of an import are collected for its report, and come when it ends.
    slow = threading.Timer(_LONG, lambda: print(text, file=sys.stderr, flush=True))
    newton.config.cache_dir_meshes = folder
    if any(_is_decomposed(prim) for prim in stage.Traverse(Usd.TraverseInstanceProxies())):
        slow.daemon = True
        slow.start()
    try:
        yield
    finally:
        slow.cancel()
        newton.config.cache_dir_meshes = before


def _is_decomposed(prim: Usd.Prim) -> bool:
    api = UsdPhysics.MeshCollisionAPI(prim) if prim.HasAPI(UsdPhysics.MeshCollisionAPI) else None
    return api is not None and api.GetApproximationAttr().Get() == UsdPhysics.Tokens.convexDecomposition


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
