# SPDX-License-Identifier: Apache-2.0
"""Assets of the Isaac Lab dialect: quaternions (w, x, y, z) in configs, in data and in what is written.

A config class knows the order of its own ``rot``: the package reads ``rot_xyzw``, so that configs of the package and of
the dialect work side by side, and none is converted twice.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from functools import cache, cached_property
from typing import Any

import torch
from pxr import Usd

from stripe_newton import assets as native
from stripe_newton.assets.asset_base import AssetInitialStateCfg as NativeInitialStateCfg
from stripe_newton.assets.parent_pose import pose_above
from stripe_newton.assets.root_writer import EnvIds
from stripe_newton.configclass import configclass

from .joint_methods import JointMethods
from .nucleus import actuator_for, joint_order_for
from .physx_view import ArticulationView, RigidBodyView
from .quaternions import pose_to_xyzw
from .tendon_methods import TendonMethods
from .wrench_composer import AssetWrenches, WrenchComposer
from .wxyz_config import WxyzOptionalRot
from .wxyz_data import WxyzAssetData, WxyzData

__all__ = [
    "Articulation",
    "ArticulationCfg",
    "AssetBase",
    "AssetBaseCfg",
    "RigidObject",
    "RigidObjectCfg",
    "RigidObjectCollection",
    "RigidObjectCollectionCfg",
    "StaticAsset",
]

AssetBase = native.AssetBase

_log = logging.getLogger(__name__)


class StaticAsset(native.AssetBase):
    """A static asset with its prims, as Isaac Sim's view of prims has them."""

    @property
    def prims(self) -> list[Usd.Prim]:
        """Its prim on the stage, once. What is changed after the scene is built is not drawn."""
        if self._scene.built:
            _say_undrawn(self.path)
        return [self._scene.stage.GetPrimAtPath(self.path)]

    @property
    def prim_paths(self) -> list[str]:
        """Path of its prim."""
        return [self.path]


@cache
def _say_undrawn(path: str) -> None:
    _log.warning("'%s': changes of its prim have no effect from now on, the scene is built", path)


class _WxyzAsset(native.BoundAsset):
    """The boundary of an asset: ``data``, what takes an orientation, and Isaac Lab's composers of wrenches."""

    _wxyz: WxyzData

    @property
    def data(self) -> Any:  # the type below is of the package: it cannot name what is converted
        """State of the asset, quaternions (w, x, y, z)."""
        if "_wxyz" not in self.__dict__:
            above = pose_above(self._scene.stage, self.path)
            self._wxyz = WxyzData(self._data) if above is None else WxyzAssetData(self._data, above)
        return self._wxyz

    @cached_property
    def _wrenches(self) -> AssetWrenches:
        return AssetWrenches(self)

    @property
    def permanent_wrench_composer(self) -> WrenchComposer:
        """Wrenches that act until they are changed or the environment is reset."""
        return self._wrenches.permanent

    @property
    def instantaneous_wrench_composer(self) -> WrenchComposer:
        """Wrenches that act until the next ``write_data_to_sim``, so in one step."""
        return self._wrenches.instantaneous

    def set_external_force_and_torque(
        self,
        forces: torch.Tensor,
        torques: torch.Tensor,
        positions: torch.Tensor | None = None,
        body_ids: Sequence[int] | slice | None = None,
        env_ids: EnvIds = None,
        is_global: bool = False,
    ) -> None:
        self.permanent_wrench_composer.set_forces_and_torques(forces, torques, positions, body_ids, env_ids, is_global)
        self._wrenches.write()

    def write_data_to_sim(self) -> None:
        super().write_data_to_sim()
        if "_wrenches" in self.__dict__:
            self._wrenches.write()

    def reset(self, env_ids: EnvIds = None) -> None:
        super().reset(env_ids)
        if "_wrenches" in self.__dict__:
            self._wrenches.reset(env_ids)

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


class Articulation(_WxyzAsset, TendonMethods, JointMethods):
    """:class:`stripe_newton.assets.Articulation` with quaternions (w, x, y, z)."""

    @cached_property
    def root_physx_view(self) -> ArticulationView:
        """View of the articulation, with what tasks read from that of PhysX."""
        return ArticulationView(self)

    def __init__(self, cfg: native.ArticulationCfg):
        super().__init__(cfg)
        if (order := joint_order_for(self.cfg.spawn)) is not None and self.cfg.joint_order == "breadth_first":
            self.cfg.joint_order = order
        self.cfg.actuators = {group: actuator_for(actuator) for group, actuator in self.cfg.actuators.items()}


class RigidObject(_WxyzAsset, native.RigidObject):
    """:class:`stripe_newton.assets.RigidObject` with quaternions (w, x, y, z)."""

    @cached_property
    def root_physx_view(self) -> RigidBodyView:
        """View of the body, with what tasks read from that of PhysX."""
        return RigidBodyView(self)


@configclass
class AssetBaseCfg(native.AssetBaseCfg):
    """:class:`stripe_newton.assets.AssetBaseCfg` with quaternions (w, x, y, z)."""

    @configclass
    class InitialStateCfg(WxyzOptionalRot, NativeInitialStateCfg):
        """Pose at the start of an episode; ``rot`` is (w, x, y, z)."""

        rot: tuple[float, float, float, float] | None = (1.0, 0.0, 0.0, 0.0)

    class_type: Callable[..., native.AssetBase] | None = StaticAsset
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


class RigidObjectCollection(native.RigidObjectCollection):
    """:class:`stripe_newton.assets.RigidObjectCollection` with quaternions (w, x, y, z)."""

    @cached_property
    def data(self) -> Any:  # as of the assets: what is converted has no type of its own
        """State of the objects, quaternions (w, x, y, z)."""
        return WxyzData(self.native_data)


@configclass
class RigidObjectCollectionCfg(native.RigidObjectCollectionCfg):
    """:class:`stripe_newton.assets.RigidObjectCollectionCfg` with quaternions (w, x, y, z)."""

    class_type: Callable[..., native.RigidObjectCollection] | None = RigidObjectCollection


@configclass
class ArticulationCfg(native.ArticulationCfg):
    """:class:`stripe_newton.assets.ArticulationCfg` with quaternions (w, x, y, z)."""

    @configclass
    class InitialStateCfg(WxyzOptionalRot, native.ArticulationCfg.InitialStateCfg):
        """State at the start of an episode; ``rot`` is (w, x, y, z)."""

        rot: tuple[float, float, float, float] | None = (1.0, 0.0, 0.0, 0.0)

    class_type: Callable[..., native.AssetBase] | None = Articulation
    init_state: InitialStateCfg = InitialStateCfg()
    joint_order: str | Sequence[str] = "breadth_first"
