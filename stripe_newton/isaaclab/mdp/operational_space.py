# SPDX-License-Identifier: Apache-2.0
"""Operational space actions of ``isaaclab.envs.mdp``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from stripe_newton.assets.asset_base import BoundAsset
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.managers import TermEnv
from stripe_newton.managers import operational_space_action as native

from .actions import NOT_DRAWN, BodyOffsetCfg

__all__ = ["OperationalSpaceControllerAction", "OperationalSpaceControllerActionCfg"]


class OperationalSpaceControllerAction(native.OperationalSpaceControllerAction):
    """:class:`stripe_newton.envs.mdp.OperationalSpaceControllerAction`; quaternions of actions are (w, x, y, z)."""

    cfg: OperationalSpaceControllerActionCfg

    @staticmethod
    def _find_task(cfg: native.OperationalSpaceControllerActionCfg, env: TermEnv) -> BoundAsset | None:
        """The asset at ``task_frame_rel_path``."""
        path = getattr(cfg, "task_frame_rel_path", None)
        if path is None:
            return native.OperationalSpaceControllerAction._find_task(cfg, env)
        assets = [asset for asset in env.scene.assets if isinstance(asset, BoundAsset)]
        for asset in assets:
            if asset.cfg.prim_path.endswith(f"/{path}"):
                return asset
        paths = ", ".join(asset.cfg.prim_path for asset in assets)
        raise ValueError(f"task_frame_rel_path: '{path}' is no asset of an environment; the scene has {paths}")


@configclass
class OperationalSpaceControllerActionCfg(native.OperationalSpaceControllerActionCfg):
    """:class:`stripe_newton.envs.mdp.OperationalSpaceControllerActionCfg` with quaternions (w, x, y, z)."""

    OffsetCfg: ClassVar[type] = BodyOffsetCfg
    scalar_first: ClassVar[bool] = True
    class_type: type | None = OperationalSpaceControllerAction
    asset_name: str = MISSING
    joint_names: Sequence[str] = MISSING
    task_frame_rel_path: str | None = None
    """Prim path of a rigid object below the environment's, whose frame is the task's frame."""
    debug_vis: bool = False
    clip: dict[str, tuple[float, float]] | None = None
    IGNORED: ClassVar[dict[str, str]] = NOT_DRAWN | {"clip": "commands of the controller are not clipped"}
