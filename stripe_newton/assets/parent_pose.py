# SPDX-License-Identifier: Apache-2.0
"""Parent pose: where the prim above an asset is, in whose frame the config has the asset's initial pose."""

from __future__ import annotations

import torch
from pxr import Gf, Sdf, Usd, UsdGeom

from stripe_newton.sim.scene_context import ENV_0

__all__ = ["pose_above"]

_IDENTITY = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def pose_above(stage: Usd.Stage, path: str) -> torch.Tensor | None:
    """Pose of the prim above an asset's prim: in its environment, or in the world where it is in none.

    Args:
        stage: The stage.
        path: Prim path of the asset.

    Returns:
        Position [m] and quaternion (x, y, z, w), shape ``(7,)``. None for the identity.
    """
    parent = stage.GetPrimAtPath(Sdf.Path(path).GetParentPath())
    if not parent.IsValid() or parent.IsPseudoRoot():
        return None
    cache = UsdGeom.XformCache()
    matrix = cache.GetLocalToWorldTransform(parent)
    if path.startswith(f"{ENV_0}/"):
        matrix *= cache.GetLocalToWorldTransform(stage.GetPrimAtPath(ENV_0)).GetInverse()
    matrix = Gf.Matrix4d(matrix).RemoveScaleShear()
    turn = matrix.ExtractRotationQuat()
    pose = torch.tensor([*matrix.ExtractTranslation(), *turn.GetImaginary(), turn.GetReal()], dtype=torch.float32)
    return None if torch.allclose(pose, _IDENTITY) else pose
