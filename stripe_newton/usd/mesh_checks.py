# SPDX-License-Identifier: Apache-2.0
"""Mesh checks: points, counts and indices of a mesh that fit together."""

from __future__ import annotations

import numpy as np
from pxr import Usd, UsdGeom

from .attribute_table import MAX_COORDINATE

__all__ = ["mesh_reason", "normals_reason"]


def mesh_reason(prim: Usd.Prim) -> str:
    """Why a mesh has no shape, such as ``"without points or faces"``; empty if it has one.

    Newton and the renderer index points without a check: a wrong index or count is a crash, or another shape.
    """
    mesh = UsdGeom.Mesh(prim)
    attributes = mesh.GetPointsAttr(), mesh.GetFaceVertexIndicesAttr(), mesh.GetFaceVertexCountsAttr()
    values = [attribute.Get() for attribute in attributes]
    if not all(values):
        animated = any(a.GetNumTimeSamples() and not v for a, v in zip(attributes, values, strict=True))
        return (
            "whose points or faces have time samples alone, which are not read"
            if animated
            else "without points or faces"
        )
    try:
        points, indices, counts = (np.asarray(value, dtype=float) for value in values)
    except (TypeError, ValueError):
        return "whose points or faces are not numbers"
    if points.ndim != 2 or points.shape[1] != 3 or indices.ndim != 1 or counts.ndim != 1:
        return "whose points or faces have the wrong type"
    if not np.isfinite(points).all():
        return "with points that are not finite"
    if np.abs(points).max() > MAX_COORDINATE:
        far = int(np.abs(points).max(axis=1).argmax())
        return f"whose point {far} is at {tuple(points[far].tolist())}, beyond {MAX_COORDINATE:g} from its origin"
    if counts.min() < 3:
        return f"with a face of {counts.min():g} points"
    if counts.sum() != len(indices):
        return f"whose faceVertexCounts add up to {counts.sum():g}, but it has {len(indices)} faceVertexIndices"
    if indices.max() >= len(points) or indices.min() < 0:
        wrong = indices.max() if indices.min() >= 0 else indices.min()
        return f"whose faces name point {wrong:g} of {len(points)}"
    return ""


def normals_reason(prim: Usd.Prim) -> str:
    """Why a mesh's normals are none, or fit neither its points nor its faces; empty if they do, or without any."""
    mesh = UsdGeom.Mesh(prim)
    attribute = mesh.GetNormalsAttr()
    value = attribute.Get()
    if value is None or np.size(value) == 0:
        return ""
    normals = np.asarray(value)
    if normals.ndim != 2 or normals.shape[1] != 3:
        authored = [spec.typeName for spec in attribute.GetPropertyStack() if spec.HasDefaultValue()]
        return f"normals of type {authored[0] if authored else type(value).__name__}, must be normal3f[]"
    counts = {
        UsdGeom.Tokens.constant: 1,
        UsdGeom.Tokens.uniform: len(mesh.GetFaceVertexCountsAttr().Get()),
        UsdGeom.Tokens.faceVarying: len(mesh.GetFaceVertexIndicesAttr().Get()),
    }
    interpolation = mesh.GetNormalsInterpolation()
    wanted = counts.get(interpolation, len(mesh.GetPointsAttr().Get()))
    return "" if len(normals) == wanted else f"{len(normals)} normals for {wanted} ({interpolation})"
