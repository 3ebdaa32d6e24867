# SPDX-License-Identifier: Apache-2.0
"""Viewed simulation: what the viewers read of a simulation, as a protocol."""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import newton
    import numpy as np
    import warp as wp

    from stripe_newton.sim.body_choice import BodyChoice
    from stripe_newton.usd import Light

    from .markers import VisualizationMarkers

__all__ = ["ViewedSimulation"]


class ViewedSimulation(Protocol):
    """A :class:`Simulation`, or a scene in which nothing moves.

    Attributes:
        device: Device that pictures are traced on.
        num_envs: Number of environments.
        template: Builder of one environment, at the origin.
        body_choices: Bodies of the template that are another asset in each environment.
        static: Builder of what all environments share.
        env_origins: Where the environments were built in the world frame [m], shape ``(num_envs, 3)``.
        env_origin: Where they start now, on the device [m], shape ``(num_envs,)``; None if they never moved.
        state: State with the poses of all environments' bodies; not read if there are none.
        lights: Lights of the scene.
        markers: Markers to draw.
    """

    @property
    def device(self) -> str | wp.Device: ...

    @property
    def num_envs(self) -> int: ...

    @property
    def template(self) -> newton.ModelBuilder: ...

    @property
    def body_choices(self) -> Sequence[BodyChoice]: ...

    @property
    def static(self) -> newton.ModelBuilder: ...

    @property
    def env_origins(self) -> np.ndarray: ...

    @property
    def env_origin(self) -> wp.array | None: ...

    @property
    def state(self) -> newton.State: ...

    @property
    def lights(self) -> Sequence[Light]: ...

    @property
    def markers(self) -> MutableSequence[VisualizationMarkers]: ...
