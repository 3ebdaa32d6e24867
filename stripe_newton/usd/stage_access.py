# SPDX-License-Identifier: Apache-2.0
"""Stage access: opening a stage, iterating over its prims, and finding the prim to use as an asset."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from pxr import Sdf, Tf, Usd, UsdPhysics, UsdUtils

from .composition_errors import composition_problem
from .file_errors import open_error, path_reason
from .irregular_files import irregular_file

__all__ = ["StageError", "api_schemas", "asset_prim", "first_path", "labelled_prim", "open_stage", "stage_name", "walk"]


class StageError(ValueError):
    """A stage that cannot be simulated: ``file: prim: what is wrong; what would be right``."""

    def __init__(self, file: str, prim: str, reason: str):
        self.file, self.prim, self.reason = file, prim, reason
        super().__init__(": ".join(part for part in (file, prim, reason) if part))


def stage_name(stage: Usd.Stage) -> str:
    """The file a stage comes from, or ``stage in memory``."""
    layer = stage.GetRootLayer()
    return layer.realPath or ("stage in memory" if layer.anonymous else layer.identifier)


def open_stage(source: str | Path | Usd.Stage) -> Usd.Stage:
    """Open a stage with all payloads loaded; an open stage is returned as it is.

    Raises:
        StageError: the file is missing or not USD, or a sublayer, reference or payload does not resolve.
            A missing file may hold a link of a robot, so none is skipped silently. Files of MaterialX may be missing.
    """
    if isinstance(source, Usd.Stage):
        stage = source
    else:
        path = Path(source)
        if reason := path_reason(path):
            raise StageError(str(path), "", reason)
        if pipe := irregular_file(path):
            raise StageError(str(path), "", f"refers to {pipe}, which is no regular file; name a USD file")
        quiet = UsdUtils.CoalescingDiagnosticDelegate()  # USD would print what the errors below say
        try:
            stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
        except (Tf.ErrorException, UnicodeDecodeError) as error:
            raise StageError(str(path), "", f"is not a USD file that can be read: {open_error(path, error)}") from error
        finally:
            del quiet
    # USD opens a stage whose references do not resolve, and only prints a warning.
    prim, problem = composition_problem(stage)
    if problem:
        raise StageError(stage_name(stage), prim, problem)
    return stage


def first_path(text: str, stage: Usd.Stage) -> str:
    """The first prim path that an error text names."""
    for word in text.replace("'", " ").replace('"', " ").replace(",", " ").split():
        word = word.rstrip(".:;")
        if word.startswith("/") and len(word) > 1 and stage.GetPrimAtPath(word):
            return word
    return ""


def labelled_prim(stage: Usd.Stage, label: str) -> Usd.Prim:
    """The prim that a label of a model names; an invalid one if it names none, as names of MJCF and URDF files do."""
    # USD prints a line for each text that is no path, such as one with a space.
    is_path = label.startswith("/") and Sdf.Path.IsValidPathString(label)
    return stage.GetPrimAtPath(label) if is_path else Usd.Prim()


def walk(stage: Usd.Stage, root_path: str = "/", ignore: Iterable[str] = ()) -> Iterator[Usd.Prim]:
    """Iterate over the active, defined prims at and below ``root_path``, including instance proxies.

    Args:
        stage: The stage.
        root_path: Where to start.
        ignore: Regular expressions; prims whose path starts with a match are left out, as in ``ModelBuilder.add_usd``.
    """
    patterns = [re.compile(pattern) for pattern in ignore]
    # Instance proxies: by default USD does not descend into instances, and a robot is often one.
    for prim in Usd.PrimRange(stage.GetPrimAtPath(root_path), Usd.TraverseInstanceProxies()):
        if not any(pattern.match(str(prim.GetPath())) for pattern in patterns):
            yield prim


def api_schemas(prim: Usd.Prim) -> list[str]:
    """Names of the API schemas applied to a prim, including those that this USD build has no plug-in for."""
    names = list(prim.GetAppliedSchemas())
    # GetAppliedSchemas() leaves out schemas without a plug-in, such as PhysX's.
    authored = prim.GetMetadata("apiSchemas")
    if authored is not None:
        names += [name for name in authored.ApplyOperations([]) if name not in names]
    return names


def has_physics(prim: Usd.Prim) -> bool:
    """Whether there is a rigid body, collider or joint at or below ``prim``."""
    return any(
        p.HasAPI(UsdPhysics.RigidBodyAPI) or p.HasAPI(UsdPhysics.CollisionAPI) or p.IsA(UsdPhysics.Joint)
        for p in Usd.PrimRange(prim, Usd.TraverseInstanceProxies())
    )


def asset_prim(source: str | Path | Usd.Stage, prim_path: str | None = None) -> str:
    """Path of the prim to reference when a stage is used as one asset.

    The first of these that exists:

    1. ``prim_path``, if given;
    2. the default prim, if there is physics at or below it, or nowhere in the stage;
    3. the only root prim with physics;
    4. the root prim above the only articulation root;
    5. the only root prim, if nothing has physics.

    A root prim is chosen even if the articulation is deeper, so that materials and joints beside it are included.

    Raises:
        StageError: ``prim_path`` does not exist, or several prims qualify: they are listed.
    """
    stage = open_stage(source)
    roots = [p for p in stage.GetPseudoRoot().GetChildren() if p.IsDefined() and not p.IsAbstract()]
    if prim_path is not None:
        if not stage.GetPrimAtPath(prim_path):
            raise StageError(stage_name(stage), prim_path, f"there is no such prim; root prims: {_paths(roots)}")
        return prim_path
    default = stage.GetDefaultPrim()
    physical = [p for p in roots if not p.IsA(UsdPhysics.Scene) and has_physics(p)]
    if default and (not physical or has_physics(default)):
        return str(default.GetPath())
    if chosen := _only_asset(roots, physical):
        return str(chosen.GetPath())
    named = stage.GetRootLayer().defaultPrim
    state = f"defaultPrim '{named}' is no prim of it" if named and not default else "it has no defaultPrim with physics"
    reason = f"{state} and several prims qualify; set defaultPrim, or name one of: {_paths(physical or roots)}"
    raise StageError(stage_name(stage), "", reason)


def _only_asset(roots: list[Usd.Prim], physical: list[Usd.Prim]) -> Usd.Prim | None:
    """The one root prim that qualifies as the asset; None if there are several.

    Args:
        roots: All root prims.
        physical: Those with physics at or below them.
    """
    if len(physical) == 1:
        return physical[0]
    # A file of a robot often holds a ground beside it: the only articulation is what was meant.
    articulated = [p for p in physical if _articulation_roots(p)]
    if len(articulated) == 1 and len(_articulation_roots(articulated[0])) == 1:
        return articulated[0]
    return roots[0] if not physical and len(roots) == 1 else None


def _paths(prims: list[Usd.Prim]) -> str:
    return ", ".join(str(p.GetPath()) for p in prims) or "none"


def _articulation_roots(prim: Usd.Prim) -> list[Usd.Prim]:
    prims = Usd.PrimRange(prim, Usd.TraverseInstanceProxies())
    return [p for p in prims if p.HasAPI(UsdPhysics.ArticulationRootAPI)]
