# SPDX-License-Identifier: Apache-2.0
"""Config of the obstacles in collider slots."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from stripe_newton.configclass import ConfigError, configclass

from .capsules import Capsules
from .obstacles import Obstacles

__all__ = ["ObstaclesCfg"]

_SIZE_FIELDS = "positions", "rotations", "radius", "half_length"


@configclass
class ObstaclesCfg:
    """Capsules in the world frame, as arrays or from a function; a field of the scene's config."""

    class_type: Callable[..., Any] | None = Obstacles
    prim_path: str = "/World/obstacles"
    """Where the labels of the slots lie, for contact sensors that tell them apart; nothing is authored there."""
    positions: Any = None
    """Centres in the world [m], ``(N, 3)``."""
    rotations: Any = (0.0, 0.0, 0.0, 1.0)
    """Orientations, xyzw, ``(N, 4)`` or one for all; the axis of a capsule is z."""
    radius: Any = None
    """Radii [m], ``(N,)`` or one for all."""
    half_length: Any = 0.0
    """Half lengths of the axes, without the caps [m], ``(N,)`` or one for all; 0 for spheres."""
    source: Callable[[], Capsules] | None = None
    """What returns the obstacles instead, such as with :meth:`Capsules.from_colliders`."""
    of_scenery: bool = False
    """Whether they are the colliders of the assets of the scene's specification, which then are no shapes otherwise."""
    capacity: int | None = None
    """Most obstacles that may take their place later; by default as many as there are, a quarter more with
    ``of_scenery``."""
    asset_name: str = "robot"
    """The asset that touches them, by its name in the scene."""
    slots: int = 8
    """How many obstacles a robot can touch at a time."""
    reach: float = 1.5
    """Distance from the robot's root within which no obstacle may be missed [m]: the robot's own reach and what it
    moves in a step of the environment."""
    sight: float | None = None
    """Distance from the root up to which obstacles are found, and get slots that nearer ones leave [m], for terms that
    see them from afar; by default ``reach``. It is the size of a cell of the grid, too."""
    directions: int = 32
    """In how many directions about the robot ``mdp.obstacle_proximity`` looks."""
    friction: float | None = None
    """Coefficient of friction; by default that of ``SimulationCfg.physics_material``."""

    @property
    def farthest(self) -> float:
        """Distance up to which obstacles are looked for [m]."""
        return self.reach if self.sight is None else self.sight

    def capsules(self) -> Capsules:
        """The obstacles; none with ``of_scenery``, as the scene brings them.

        Raises:
            ConfigError: if they are not all there, or not capsules.
        """
        if self.of_scenery:
            return Capsules(np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0), np.zeros(0))
        if self.source is not None:
            found = self.source()
            if not isinstance(found, Capsules):
                raise ConfigError([f"source: returned a {type(found).__name__}, must return Capsules"])
            return found
        try:
            return Capsules(*(getattr(self, name) for name in _SIZE_FIELDS))
        except ValueError as error:
            raise ConfigError([str(error)]) from error

    def problems(self) -> Iterator[tuple[str, str]]:
        given = [self.source is not None, self.positions is not None, self.of_scenery]
        if sum(given) > 1:
            yield "source", "is one of source, positions and of_scenery that are set; set one of them"
        if self.source is None and not self.of_scenery:
            for name in ("positions", "radius"):
                if getattr(self, name) is None:
                    yield name, "is missing; give arrays of positions and radius, a source, or of_scenery=True"
        if self.source is None and self.positions is not None and self.radius is not None:
            try:
                self.capsules()
            except ConfigError as error:
                name, _, text = error.problems[0].partition(": ")
                yield name, text
        for name in ("slots", "directions"):
            if not isinstance(getattr(self, name), int) or getattr(self, name) < 1:
                yield name, f"is {getattr(self, name)!r}, must be a whole number, 1 or more"
        if not (math.isfinite(self.reach) and self.reach > 0.0):
            yield "reach", f"is {self.reach}, must be a distance above 0 [m]"
        if self.sight is not None and not (math.isfinite(self.sight) and self.sight >= self.reach):
            yield "sight", f"is {self.sight}, must be at least reach, {self.reach} [m]"
        if self.friction is not None and not (math.isfinite(self.friction) and self.friction >= 0.0):
            yield "friction", f"is {self.friction}, must be 0 or more"
        if self.capacity is not None and (not isinstance(self.capacity, int) or self.capacity < 1):
            yield "capacity", f"is {self.capacity!r}, must be a whole number, 1 or more"
        elif self.capacity is not None and np.ndim(self.positions) == 2 and len(self.positions) > self.capacity:
            yield "capacity", f"is {self.capacity}, but there are {len(self.positions)} obstacles"
