# SPDX-License-Identifier: Apache-2.0
"""Body prims: prims for the bodies of URDF and MJCF files, as tasks look for those of NVIDIA's files on the stage."""

from __future__ import annotations

from pxr import Gf, Sdf, Usd, UsdGeom

from stripe_newton.assets import Articulation
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim.spawners.from_files import FILE_KEY

__all__ = ["author_body_prims"]


def author_body_prims(scene: InteractiveScene) -> None:
    """Author a prim below each articulation of the first environment for each body that has none there.

    It is an ``Xform`` where the body is when the model is built. The prims are in the session layer: nothing else reads
    them, and an exported scene does not have them.
    """
    stage = scene.stage
    for asset in scene.articulations.values():
        root = stage.GetPrimAtPath(asset.path)
        if root and root.GetCustomDataByKey(FILE_KEY) is not None:
            with Usd.EditContext(stage, stage.GetSessionLayer()):
                _author(stage, root.GetPath(), asset)


def _author(stage: Usd.Stage, root: Sdf.Path, asset: Articulation) -> None:
    poses = asset.native_data.body_pose_w[0].tolist()
    for name, (x, y, z, qx, qy, qz, qw) in zip(asset.body_names, poses, strict=True):
        path = root.AppendChild(name) if Sdf.Path.IsValidIdentifier(name) else None
        if path is None or stage.GetPrimAtPath(path):
            continue
        pose = Gf.Matrix4d(Gf.Rotation(Gf.Quatd(qw, qx, qy, qz)), Gf.Vec3d(x, y, z))
        xform = UsdGeom.Xform.Define(stage, path)
        xform.MakeMatrixXform().Set(pose)
        xform.SetResetXformStack(True)  # the pose is in the world
