# SPDX-License-Identifier: Apache-2.0
"""Environment base of the Isaac Lab dialect: scene and simulation of its environments, what hooks expect of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import numpy as np

from stripe_newton import envs as native
from stripe_newton.scene import InteractiveScene as NativeScene
from stripe_newton.sim import Simulation
from stripe_newton.sim import SimulationCfg as NativeSimulationCfg

from .needed_state import needed_observables
from .scene import InteractiveScene
from .simulation_context import SimulationContext

__all__ = ["DialectEnv"]


def _make_simulation(cfg: NativeSimulationCfg) -> Simulation:
    return SimulationContext(cfg, standalone=False)


class DialectEnv(native.RLEnv):
    """Base of the dialect's environments, before the class of the package in the order of bases."""

    scene_class: ClassVar[type[NativeScene]] = InteractiveScene
    simulation_class: ClassVar[Callable[[NativeSimulationCfg], Simulation]] = staticmethod(_make_simulation)

    def _prepare_simulation(self) -> None:
        super()._prepare_simulation()
        self.sim.camera = self.cfg.viewer  # type: ignore[attr-defined]  # of SimulationContext
        wanted = needed_observables(type(self), self.cfg)
        if wanted:
            cfg = self.sim.cfg
            self.sim.cfg = cfg.replace(observables=tuple({*cfg.observables, *wanted}))

    def render(self, recompute: bool = False) -> np.ndarray | None:
        """A picture.

        Args:
            recompute: Has no effect: the picture is always of the current state.
        """
        return super().render()

    def close(self, **kwargs: object) -> None:
        super().close(**kwargs)
        if SimulationContext.instance() is self.sim:
            SimulationContext.clear_instance()
