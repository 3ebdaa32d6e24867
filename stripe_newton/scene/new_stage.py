# SPDX-License-Identifier: Apache-2.0
"""New stage: an empty stage of a scene, in metres and with Z up."""

from __future__ import annotations

from pxr import Usd, UsdGeom

from stripe_newton.sim.scene_context import ENV_0

__all__ = ["new_stage"]


def new_stage() -> Usd.Stage:
    """An empty stage in memory with the prim of the template environment."""
    stage = Usd.Stage.CreateInMemory()
    # USD's own defaults are Y up and centimetres.
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    UsdGeom.Xform.Define(stage, ENV_0)
    return stage
