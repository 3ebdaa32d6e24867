# SPDX-License-Identifier: Apache-2.0
"""Term info: what a manager has to know of a Warp function beside its source, attached to it by decorators.

They stand above ``@wp.func``, and change nothing about the function::

    @writes(Each("joint_ids"))
    @wp.func
    def joint_pos(env: int, robot: ArticulationData, joint_ids: wp.array[int], out: wp.array[float]): ...
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import warp as wp

__all__ = [
    "Each",
    "ObservationSize",
    "Randomization",
    "TerrainNeeds",
    "for_each_asset",
    "is_for_each_asset",
    "needs_terrain",
    "observation_size",
    "randomization_of",
    "randomizes",
    "terrain_needs",
    "writes",
]

Function = TypeVar("Function", bound=wp.Function)


@dataclass(frozen=True)
class Each:
    """``size`` numbers for each of the indices or numbers called ``name``, which do not depend on each other.

    A manager may then compute each in a thread of its own.
    """

    name: str
    size: int = 1

    def __call__(self, counts: Mapping[str, int]) -> int:
        return self.size * counts[self.name]


ObservationSize = int | Callable[[Mapping[str, int]], int]
"""Numbers that an observation writes, or a function of the counts: lengths of index arrays by argument, and
``num_actions``, ``num_command``, ``num_objects`` and the like where they apply."""


@dataclass(frozen=True)
class Randomization:
    """What the config of an event that randomises the model may say."""

    defaults: Mapping[str, object] = field(default_factory=dict)
    """Parameters that may be left out."""
    ranges: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Ranges of the distribution: the field of the model that they change, and what its values must be, ``"positive"``,
    ``"not negative"`` or ``"any"``."""
    ignored: Mapping[str, str] = field(default_factory=dict)
    """Parameters that are accepted without effect, and why."""
    shapes: str = ""
    """Kind of shapes that ``shape_ids`` are, where the term takes them: ``"colliders"``, ``"primitives"`` (colliders
    whose size may change), ``"sites"`` or ``"visible shapes"``."""


@dataclass(frozen=True)
class TerrainNeeds:
    """What the ground of a scene must have for a term."""

    patches: str = ""
    """Name of the level patches that it chooses from; empty for none."""
    curriculum: bool = False
    """Whether the tiles must get harder from level to level."""


def writes(size: ObservationSize) -> Callable[[Function], Function]:
    """Decorator of an observation: how many numbers it writes, so that its config need not say ``size``."""

    def attach(function: Function) -> Function:
        function.stripe_size = size
        return function

    return attach


def observation_size(function: object) -> ObservationSize | None:
    """What :func:`writes` says of a function; None where it says nothing."""
    size: ObservationSize | None = getattr(function, "stripe_size", None)
    return size


def randomizes(
    ranges: Mapping[str, tuple[str, str]] | None = None,
    defaults: Mapping[str, object] | None = None,
    ignored: Mapping[str, str] | None = None,
    shapes: str = "",
) -> Callable[[Function], Function]:
    """Decorator of an event that changes the model; the arguments are the fields of :class:`Randomization`."""

    def attach(function: Function) -> Function:
        function.stripe_randomization = Randomization(defaults or {}, ranges or {}, ignored or {}, shapes)
        return function

    return attach


def randomization_of(function: object) -> Randomization:
    """What :func:`randomizes` says of a function; nothing for one without."""
    found: Randomization = getattr(function, "stripe_randomization", Randomization())
    return found


def needs_terrain(patches: str = "", curriculum: bool = False) -> Callable[[Function], Function]:
    """Decorator of a term about the ground; the arguments are the fields of :class:`TerrainNeeds`."""

    def attach(function: Function) -> Function:
        function.stripe_terrain = TerrainNeeds(patches, curriculum)
        return function

    return attach


def terrain_needs(function: object) -> TerrainNeeds:
    """What :func:`needs_terrain` says of a function; nothing for one without."""
    found: TerrainNeeds = getattr(function, "stripe_terrain", TerrainNeeds())
    return found


def for_each_asset(function: Function) -> Function:
    """Decorator of an event that is run for each asset of the scene where its config names none."""
    function.stripe_for_each_asset = True
    return function


def is_for_each_asset(function: object) -> bool:
    """Whether :func:`for_each_asset` stands above a function."""
    return bool(getattr(function, "stripe_for_each_asset", False))
