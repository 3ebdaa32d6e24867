# SPDX-License-Identifier: Apache-2.0
"""Rigid object: a single rigid body in every environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import newton
import numpy as np
import torch

from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.sim.spawners.choices import AssetChoiceCfg

from .asset_base import AssetBase, AssetBaseCfg, AssetInitialStateCfg, BoundAsset, EnvIds
from .layout import Layout
from .root_data import RootData

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["RigidObject", "RigidObjectCfg"]


def _rigid_object(cfg: RigidObjectCfg) -> RigidObject:
    return RigidObject(cfg)


@configclass
class RigidObjectCfg(AssetBaseCfg):
    """A rigid body in every environment."""

    @configclass
    class InitialStateCfg(AssetInitialStateCfg):
        """State at the start of an episode."""

        lin_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)
        """Velocity of the centre of mass, world frame [m/s]."""
        ang_vel: tuple[float, float, float] = (0.0, 0.0, 0.0)
        """Angular velocity, world frame [rad/s]."""

    class_type: Callable[..., AssetBase] | None = _rigid_object
    """Class that the scene makes of this config."""
    init_state: InitialStateCfg = InitialStateCfg()
    """State at the start of an episode."""


class RigidObject(BoundAsset):
    """A rigid body in every environment; its state is in :attr:`data`."""

    cfg: RigidObjectCfg
    asset_index: torch.Tensor
    """Which asset of a ``MultiAssetSpawnerCfg`` or ``MultiUsdFileCfg`` each environment holds, int64, shape
    ``(num_envs,)``; 0 where all hold the same."""

    def prepare(self, layouts: Sequence[Layout], builder: newton.ModelBuilder) -> None:
        self.layout = self._find_layout(layouts)
        if len(self.layout.bodies) != 1:
            names = ", ".join(self.layout.body_names)
            problem = f"holds {len(self.layout.bodies)} bodies ({names}); use ArticulationCfg"
            raise ConfigError([f"RigidObject '{self.cfg.prim_path}': {problem}"])
        self._place_root(builder)

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        self._data = RootData(sim, self.layout)
        start, origins = self.cfg.init_state, torch.from_numpy(sim.env_origins).to(sim.device)
        self._data.set_defaults(start.lin_vel, start.ang_vel, origins)
        spawn, indices = self.cfg.spawn, np.zeros(sim.num_envs, dtype=np.int64)
        if isinstance(spawn, AssetChoiceCfg):
            indices = spawn.choices(sim.num_envs)
        self.asset_index = torch.as_tensor(indices, device=sim.device)

    def reset(self, env_ids: EnvIds = None) -> None:
        """Remove external forces."""
        self._clear_wrench(self.env_indices(env_ids))
