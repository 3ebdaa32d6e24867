# SPDX-License-Identifier: Apache-2.0
"""Latest simulation: the one that calls of Isaac Lab mean that name none, such as ``InteractiveScene(cfg)``."""

from __future__ import annotations

from typing import Any, Protocol

from pxr import Usd

from stripe_newton.scene import InteractiveScene as NativeScene
from stripe_newton.viewers import ViewerCfg

__all__ = ["LatestSimulation", "latest_simulation", "set_latest_simulation"]


class LatestSimulation(Protocol):
    """Simulation context, as far as a scene, markers and the application need it."""

    camera: ViewerCfg
    scene: NativeScene | None

    @property
    def stage(self) -> Usd.Stage:
        """The USD stage."""
        ...

    def take_scene(self, scene: NativeScene) -> None:
        """Go on with another scene."""
        ...


_latest: list[Any] = []
"""The simulation, if there is one. Its class imports what needs this module."""


def latest_simulation() -> Any:
    """The simulation context that was made last; None if there is none."""
    return _latest[0] if _latest else None


def set_latest_simulation(sim: LatestSimulation | None) -> None:
    """Make a simulation context the latest; None for none."""
    _latest[:] = [] if sim is None else [sim]
