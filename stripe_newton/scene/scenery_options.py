# SPDX-License-Identifier: Apache-2.0
"""Scenery options: where an imported stage stands, what becomes of the task's ground, where robots start on it."""

from __future__ import annotations

from collections.abc import Iterator

from stripe_newton.configclass import configclass
from stripe_newton.terrains.start_spots import StartSpotsCfg
from stripe_newton.value_types import PositiveFloat

__all__ = ["SceneryOptionsCfg"]

_GROUND = ("auto", "keep", "replace")


@configclass
class SceneryOptionsCfg:
    """Options of :attr:`InteractiveSceneCfg.scenery`; without a scenery they have no effect."""

    pos: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the stage's origin [m]."""
    rot: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Orientation of the stage, quaternion (x, y, z, w), after its up axis was turned to Z."""
    scale: PositiveFloat = 1.0
    """Factor on its size, after its units were converted to metres."""
    ground: str = "auto"
    """The task's own ground: ``"replace"`` leaves it out, ``"keep"`` keeps it, ``"auto"`` replaces it where the stage
    has floors of ``start.min_area`` that cover a quarter of its extent."""
    visuals_collide: bool = False
    """Make colliders of all visible shapes of a stage that has none of its own."""
    start: StartSpotsCfg = StartSpotsCfg()
    """Places where robots start."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not 0.99 < sum(x * x for x in self.rot) ** 0.5 < 1.01:
            yield "rot", f"is {self.rot}, must be a unit quaternion in the order (x, y, z, w)"
        if self.ground not in _GROUND:
            yield "ground", f"is '{self.ground}', must be one of {', '.join(map(repr, _GROUND))}"
