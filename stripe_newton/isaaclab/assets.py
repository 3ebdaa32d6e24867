# SPDX-License-Identifier: Apache-2.0
"""Assets of the Isaac Lab dialect: quaternions (w, x, y, z) in configs, in data and in what is written.

A config class knows the order of its own ``rot``: the package reads ``rot_xyzw``, so that configs of the package and of
the dialect work side by side, and none is converted twice.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch

from stripe_newton import assets as native
from stripe_newton.assets.asset_base import AssetInitialStateCfg as NativeInitialStateCfg
from stripe_newton.assets.root_writer import EnvIds, RootWriter
from stripe_newton.configclass import configclass

from .nucleus import actuator_for
from .quaternions import pose_to_xyzw
from .wxyz_config import WxyzOptionalRot
from .wxyz_data import WxyzData

__all__ = ["Articulation", "ArticulationCfg", "AssetBase", "AssetBaseCfg", "RigidObject", "RigidObjectCfg"]

AssetBase = native.AssetBase


class _WxyzAsset(RootWriter):
    """The boundary of an asset: ``data`` and all ``write_root_*`` methods that take an orientation."""

    _wxyz: WxyzData

    @property
    def data(self) -> Any:  # the type below is of the package: it cannot name what is converted
        """State of the asset, quaternions (w, x, y, z)."""
        if "_wxyz" not in self.__dict__:
            self._wxyz = WxyzData(self._data)
        return self._wxyz

    def write_root_pose_to_sim(self, root_pose: torch.Tensor, env_ids: EnvIds = None) -> None:
        super().write_root_pose_to_sim(pose_to_xyzw(root_pose), env_ids)

    def write_root_state_to_sim(self, root_state: torch.Tensor, env_ids: EnvIds = None) -> None:
        super().write_root_state_to_sim(pose_to_xyzw(root_state), env_ids)

    def write_root_link_pose_to_sim(self, root_pose: torch.Tensor, env_ids: EnvIds = None) -> None:
        super().write_root_link_pose_to_sim(pose_to_xyzw(root_pose), env_ids)

    def write_root_link_state_to_sim(self, root_state: torch.Tensor, env_ids: EnvIds = None) -> None:
        super().write_root_link_state_to_sim(pose_to_xyzw(root_state), env_ids)

    def write_root_com_pose_to_sim(self, root_pose: torch.Tensor, env_ids: EnvIds = None) -> None:
        super().write_root_com_pose_to_sim(pose_to_xyzw(root_pose), env_ids)

    def write_root_com_state_to_sim(self, root_state: torch.Tensor, env_ids: EnvIds = None) -> None:
        super().write_root_com_state_to_sim(pose_to_xyzw(root_state), env_ids)


class Articulation(_WxyzAsset, native.Articulation):
    """:class:`stripe_newton.assets.Articulation` with quaternions (w, x, y, z)."""

    def __init__(self, cfg: native.ArticulationCfg):
        super().__init__(cfg)
        self.cfg.actuators = {group: actuator_for(actuator) for group, actuator in self.cfg.actuators.items()}


class RigidObject(_WxyzAsset, native.RigidObject):
    """:class:`stripe_newton.assets.RigidObject` with quaternions (w, x, y, z)."""


@configclass
class AssetBaseCfg(native.AssetBaseCfg):
    """:class:`stripe_newton.assets.AssetBaseCfg` with quaternions (w, x, y, z)."""

    @configclass
    class InitialStateCfg(WxyzOptionalRot, NativeInitialStateCfg):
        """Pose at the start of an episode; ``rot`` is (w, x, y, z)."""

        rot: tuple[float, float, float, float] | None = (1.0, 0.0, 0.0, 0.0)

    init_state: InitialStateCfg = InitialStateCfg()


@configclass
class RigidObjectCfg(native.RigidObjectCfg):
    """:class:`stripe_newton.assets.RigidObjectCfg` with quaternions (w, x, y, z)."""

    @configclass
    class InitialStateCfg(WxyzOptionalRot, native.RigidObjectCfg.InitialStateCfg):
        """State at the start of an episode; ``rot`` is (w, x, y, z)."""

        rot: tuple[float, float, float, float] | None = (1.0, 0.0, 0.0, 0.0)

    class_type: Callable[..., native.AssetBase] | None = RigidObject
    init_state: InitialStateCfg = InitialStateCfg()


@configclass
class ArticulationCfg(native.ArticulationCfg):
    """:class:`stripe_newton.assets.ArticulationCfg` with quaternions (w, x, y, z)."""

    @configclass
    class InitialStateCfg(WxyzOptionalRot, native.ArticulationCfg.InitialStateCfg):
        """State at the start of an episode; ``rot`` is (w, x, y, z)."""

        rot: tuple[float, float, float, float] | None = (1.0, 0.0, 0.0, 0.0)

    class_type: Callable[..., native.AssetBase] | None = Articulation
    init_state: InitialStateCfg = InitialStateCfg()
