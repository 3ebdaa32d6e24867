# SPDX-License-Identifier: Apache-2.0
"""Term info: metadata of terms for managers, attached to their Warp functions by decorators.

The decorators stand above ``@wp.func`` and do not change what the function computes::

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
    "parts_reset",
    "randomization_of",
    "randomizes",
    "resets",
    "terrain_needs",
    "writes",
]

Function = TypeVar("Function", bound=wp.Function)


@dataclass(frozen=True)
class Each:
    """Observation size: ``size`` numbers for each of the indices or numbers called ``name``.

    The numbers of one index do not depend on those of another, so a manager may compute each in a thread of its own.
    """

    name: str
    size: int = 1

    def __call__(self, counts: Mapping[str, int]) -> int:
        return self.size * counts[self.name]


ObservationSize = int | Callable[[Mapping[str, int]], int]
"""Number of floats that an observation writes, or a function of the counts: the lengths of index arrays by argument,
and ``num_actions``, ``num_command``, ``num_objects`` and ``num_slots`` where they apply."""


@dataclass(frozen=True)
class Randomization:
    """Parameters of an event that randomises the model: defaults, ranges, and parameters without effect."""

    defaults: Mapping[str, object] = field(default_factory=dict)
    """Values of the parameters that a config may leave out."""
    ranges: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    """Ranges of the distribution by parameter: the field of the model that it changes, and the values allowed there,
    ``"positive"``, ``"not negative"`` or ``"any"``."""
    ignored: Mapping[str, str] = field(default_factory=dict)
    """Parameters that are accepted without effect, with the reason."""
    shapes: str = ""
    """Kind of shapes that ``shape_ids`` are, where the term takes them: ``"colliders"``, ``"primitives"`` (colliders
    whose size may change), ``"sites"`` or ``"visible shapes"``."""


@dataclass(frozen=True)
class TerrainNeeds:
    """Terrain requirements of a term."""

    patches: str = ""
    """Name of the flat patches that the term draws from; empty for none."""
    curriculum: bool = False
    """Whether the tiles must get harder from level to level."""


def writes(size: ObservationSize) -> Callable[[Function], Function]:
    """Decorator of an observation that declares how many numbers it writes; its config then needs no ``size``."""

    def attach(function: Function) -> Function:
        function.stripe_size = size
        return function

    return attach


def observation_size(function: object) -> ObservationSize | None:
    """Size of an observation as :func:`writes` declares it; None for a function without that decorator."""
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
    """Parameters of an event as :func:`randomizes` declares them; empty for a function without that decorator."""
    found: Randomization = getattr(function, "stripe_randomization", Randomization())
    return found


def resets(*parts: str) -> Callable[[Function], Function]:
    """Decorator of an event that brings parts of an asset to a state that does not depend on the last episode.

    Args:
        parts: ``"root"``, and ``"joints"``: all joints, or those of the argument ``joint_ids``.
    """

    def attach(function: Function) -> Function:
        function.stripe_resets = frozenset(parts)
        return function

    return attach


def parts_reset(function: object) -> frozenset[str]:
    """Parts of an asset that an event resets, as :func:`resets` declares them; none without that decorator."""
    found: frozenset[str] = getattr(function, "stripe_resets", frozenset())
    return found


def needs_terrain(patches: str = "", curriculum: bool = False) -> Callable[[Function], Function]:
    """Decorator of a term that needs a certain terrain; the arguments are the fields of :class:`TerrainNeeds`."""

    def attach(function: Function) -> Function:
        function.stripe_terrain = TerrainNeeds(patches, curriculum)
        return function

    return attach


def terrain_needs(function: object) -> TerrainNeeds:
    """Terrain requirements of a term as :func:`needs_terrain` declares them; empty without that decorator."""
    found: TerrainNeeds = getattr(function, "stripe_terrain", TerrainNeeds())
    return found


def for_each_asset(function: Function) -> Function:
    """Decorator of an event that runs once for each asset of the scene if its config names no asset."""
    function.stripe_for_each_asset = True
    return function


def is_for_each_asset(function: object) -> bool:
    """Whether a function has the decorator :func:`for_each_asset`."""
    return bool(getattr(function, "stripe_for_each_asset", False))
