# SPDX-License-Identifier: Apache-2.0
"""Single rigid bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import torch

from stripe_newton.configclass import ConfigError, configclass

from .asset_base import AssetBaseCfg, AssetInitialStateCfg, BoundAsset, EnvIds
from .binding import place_root, select_layout

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

    from .root_data import RootData

__all__ = ["RigidObject", "RigidObjectCfg"]


def _rigid_object(cfg: RigidObjectCfg) -> Any:
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

    class_type: Callable[..., Any] | None = _rigid_object
    """Class that the scene makes of this config."""
    init_state: InitialStateCfg = InitialStateCfg()
    """State at the start of an episode."""


class RigidObject(BoundAsset):
    """A rigid body in every environment; its state is in :attr:`data`."""

    cfg: RigidObjectCfg
    _data: RootData

    @property
    def data(self) -> RootData:
        """State of the body."""
        return self._data

    def prepare(self, layouts: Any, builder: Any) -> None:
        self.layout = select_layout(self, layouts, None)
        if len(self.layout.bodies) != 1:
            names = ", ".join(self.layout.body_names)
            problem = f"holds {len(self.layout.bodies)} bodies ({names}); use ArticulationCfg"
            raise ConfigError([f"RigidObject '{self.cfg.prim_path}': {problem}"])
        place_root(builder, self.layout, self.cfg.init_state)

    def initialize(self, sim: Simulation) -> None:
        from .root_data import RootData

        super().initialize(sim)
        self._data = RootData(sim, self.layout)
        self._data.set_defaults(self.cfg.init_state, torch.from_numpy(sim.env_origins).to(sim.device))

    def reset(self, env_ids: EnvIds = None) -> None:
        """Remove external forces."""
        self._clear_wrench(self.env_indices(env_ids))
