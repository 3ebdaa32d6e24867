# SPDX-License-Identifier: Apache-2.0
"""Opening a stage, walking it, and finding the prim that stands for an asset."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from pxr import Sdf, Tf, Usd, UsdPhysics

__all__ = ["StageError", "api_schemas", "asset_prim", "open_stage", "stage_name", "walk"]


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
    """Open a stage with all payloads loaded; an open stage is handed through.

    Raises:
        StageError: the file is missing or not USD, or a sublayer, reference or payload does not resolve.
            What stands in a missing file may be a robot's link, so none is passed over.
    """
    if isinstance(source, Usd.Stage):
        stage = source
    else:
        path = Path(source)
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "there is no such file"
            raise StageError(str(path), "", f"{what}; give a .usd, .usda, .usdc or .usdz file")
        try:
            stage = Usd.Stage.Open(str(path), Usd.Stage.LoadAll)
        except Tf.ErrorException as error:
            lines = str(error).strip().splitlines()
            detail = lines[-1].strip() if lines else ""
            raise StageError(str(path), "", f"is not a USD file that can be read ({detail})") from error
    errors = stage.GetCompositionErrors()
    if errors:
        texts = list(dict.fromkeys(_composition_text(error) for error in errors))
        reason = f"{len(texts)} composition arc(s) do not resolve: " + " | ".join(texts)
        prim = str(getattr(errors[0], "rootSite", Sdf.Path()) or "")
        raise StageError(stage_name(stage), _site_path(prim), reason)
    return stage


def _composition_text(error: object) -> str:
    text = str(error).strip() or type(error).__name__
    return re.sub(r"\s+", " ", text)


def _site_path(text: str) -> str:
    found = re.search(r"<([^>]*)>", text)
    return found.group(1) if found else ""


def walk(stage: Usd.Stage, root_path: str = "/", ignore: Iterable[str] = ()) -> Iterator[Usd.Prim]:
    """Every active, defined prim at and below ``root_path``, instance proxies too.

    ``ignore`` are regular expressions matched from the start of the prim path, as ``ModelBuilder.add_usd`` does.
    """
    patterns = [re.compile(pattern) for pattern in ignore]
    for prim in Usd.PrimRange(stage.GetPrimAtPath(root_path), Usd.TraverseInstanceProxies()):
        if not any(pattern.match(str(prim.GetPath())) for pattern in patterns):
            yield prim


def api_schemas(prim: Usd.Prim) -> list[str]:
    """Names of the API schemas applied to a prim, also those this USD build has no plug-in for."""
    names = list(prim.GetAppliedSchemas())
    authored = prim.GetMetadata("apiSchemas")
    if authored is not None:
        names += [name for name in authored.ApplyOperations([]) if name not in names]
    return names


def has_physics(prim: Usd.Prim) -> bool:
    """Whether a rigid body, collider or joint stands at or below ``prim``."""
    return any(
        p.HasAPI(UsdPhysics.RigidBodyAPI) or p.HasAPI(UsdPhysics.CollisionAPI) or p.IsA(UsdPhysics.Joint)
        for p in Usd.PrimRange(prim, Usd.TraverseInstanceProxies())
    )


def asset_prim(source: str | Path | Usd.Stage, prim_path: str | None = None) -> str:
    """The prim to reference when a stage is used as one asset.

    In this order: ``prim_path`` if given; the default prim, where it exists and has physics below it; the root prim
    above the only articulation root; the only root prim that has physics; the default prim, where nothing has
    physics; the only root prim. A default prim that names nothing counts as none.

    A root prim is chosen even where the articulation stands deeper, so that materials and joints beside it come along.

    Raises:
        StageError: ``prim_path`` does not exist, or several prims qualify: they are listed.
    """
    stage = open_stage(source)
    name = stage_name(stage)
    roots = [p for p in stage.GetPseudoRoot().GetChildren() if p.IsDefined() and not p.IsAbstract()]
    listed = ", ".join(str(p.GetPath()) for p in roots) or "none"
    if prim_path is not None:
        if not stage.GetPrimAtPath(prim_path):
            raise StageError(name, prim_path, f"there is no such prim; root prims: {listed}")
        return prim_path
    default = stage.GetDefaultPrim()
    physical = [p for p in roots if not p.IsA(UsdPhysics.Scene) and has_physics(p)]
    if default and (not physical or has_physics(default)):
        return str(default.GetPath())
    if len(physical) == 1:
        return str(physical[0].GetPath())
    articulated = [p for p in physical if _articulation_roots(p)]
    if len(articulated) == 1 and len(_articulation_roots(articulated[0])) == 1:
        return str(articulated[0].GetPath())
    if not physical and len(roots) == 1:
        return str(roots[0].GetPath())
    named = stage.GetRootLayer().defaultPrim
    state = f"defaultPrim '{named}' is no prim of it" if named and not default else "it has no defaultPrim with physics"
    candidates = ", ".join(str(p.GetPath()) for p in physical) or listed
    raise StageError(name, "", f"{state} and several prims qualify; set defaultPrim, or name one of: {candidates}")


def _articulation_roots(prim: Usd.Prim) -> list[Usd.Prim]:
    prims = Usd.PrimRange(prim, Usd.TraverseInstanceProxies())
    return [p for p in prims if p.HasAPI(UsdPhysics.ArticulationRootAPI)]
