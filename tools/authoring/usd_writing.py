# SPDX-License-Identifier: Apache-2.0
"""USD writing: numbers and materials, as the tools that author robots write them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pxr import Gf, Sdf, Usd, UsdShade

__all__ = ["exact", "preview_surface"]


def exact(values: ArrayLike, digits: int = 9) -> np.ndarray:
    """Round off the last bits, in which platforms differ: the file is to be the same everywhere."""
    return np.round(np.asarray(values, dtype=float), digits) + 0.0


def preview_surface(
    stage: Usd.Stage,
    path: str,
    color: tuple[float, float, float],
    roughness: float,
    metallic: float,
    emits: bool = False,
) -> None:
    """Write a material with a preview surface.

    Args:
        stage: The stage.
        path: Path of the material.
        color: Linear RGB.
        roughness: 0 to 1.
        metallic: 0 to 1.
        emits: Whether it emits light of its color.
    """
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, f"{material.GetPath()}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*color))
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(roughness)
    shader.CreateInput("metallic", Sdf.ValueTypeNames.Float).Set(metallic)
    if emits:
        shader.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*color))
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
