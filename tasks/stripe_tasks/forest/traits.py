# SPDX-License-Identifier: Apache-2.0
"""Species traits: what the stand model knows about each species of tree."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np

__all__ = ["BREAST_HEIGHT", "SPECIES", "SpeciesTraits", "site_suitability"]

BREAST_HEIGHT = 1.3
"""Height at which a trunk is measured [m]."""
_MOISTURE_FALL = 0.12  # deviation of the Gaussian beyond the range of moisture
_SLOPE_FALL = math.radians(6.0)  # deviation of the Gaussian beyond the range of slopes [rad]
_STEEPEST = 3.0  # deviations beyond the range of slopes after which nothing grows


@dataclass(frozen=True)
class SpeciesTraits:
    """Traits of a species: growth, site preferences and seed dispersal.

    Attributes:
        max_height: Asymptote of the height curve [m].
        growth_rate: ``k`` of ``h = max_height (1 - exp(-k t))^shape`` [1/year] (Richards 1959, J. Exp. Bot. 10;
            Chapman 1961).
        growth_shape: ``shape`` of that curve.
        hd_a: ``a`` of ``h = 1.3 + d^2 / (a + b d)^2``, ``d`` the diameter in centimetres (Naslund 1936).
        hd_b: ``b`` of that relation; ``1.3 + 1 / b^2`` lies above ``max_height``.
        crown_scale: ``c`` of ``crown radius = c d^e`` with ``d`` in metres (form of Pretzsch et al. 2015, Urban For.
            Urban Green. 14) [m].
        crown_exponent: ``e`` of that relation.
        shade_tolerance: 0 for a species of the open, 1 for one that survives in deep shade, in about the order of the
            ranking by Niinemets and Valladares 2006, Ecol. Monogr. 76.
        moisture: Range of moisture where it grows well, from 0, dry, to 1, wet; chosen so that species separate.
        slope: Range of slopes where it grows well [rad].
        dispersal: Median distance of a seed from its tree [m] (kernel of Clark et al. 1999, Ecology 80).
        longevity: Age that few trees exceed [years].
        maturity: Age at which it bears seed [years].
    """

    max_height: float
    growth_rate: float
    growth_shape: float
    hd_a: float
    hd_b: float
    crown_scale: float
    crown_exponent: float
    shade_tolerance: float
    moisture: tuple[float, float]
    slope: tuple[float, float]
    dispersal: float
    longevity: float
    maturity: float

    def __post_init__(self) -> None:
        for name in ("max_height", "growth_rate", "growth_shape", "hd_a", "hd_b", "crown_scale", "dispersal"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ValueError(f"species traits: {name} is {getattr(self, name)}, must be positive")
        if not BREAST_HEIGHT < self.max_height < BREAST_HEIGHT + 1.0 / self.hd_b**2:
            raise ValueError(
                f"species traits: max_height is {self.max_height} m, must lie between 1.3 and 1.3 + 1 / hd_b^2 = "
                f"{BREAST_HEIGHT + 1.0 / self.hd_b**2:.2f} m"
            )
        if not 0.0 <= self.shade_tolerance <= 1.0:
            raise ValueError(f"species traits: shade_tolerance is {self.shade_tolerance}, must be in [0, 1]")
        if not 0.0 < self.maturity < self.longevity:
            raise ValueError(f"species traits: maturity is {self.maturity}, must be in (0, longevity={self.longevity})")
        for name in ("moisture", "slope"):
            low, high = getattr(self, name)
            if not low <= high:
                raise ValueError(f"species traits: {name} is {(low, high)}, must be (low, high) with low <= high")

    def height_at(self, age: np.ndarray) -> np.ndarray:
        """Height of a tree without neighbours on a good site [m], at ages [years]."""
        return self.max_height * (1.0 - np.exp(-self.growth_rate * np.asarray(age))) ** self.growth_shape

    def age_at(self, height: float) -> float:
        """Age [years] at which such a tree is ``height`` [m] tall."""
        return -math.log(1.0 - (height / self.max_height) ** (1.0 / self.growth_shape)) / self.growth_rate

    def diameter_at(self, height: np.ndarray) -> np.ndarray:
        """Diameter at breast height [m] of the mean tree of a height [m]."""
        root = np.sqrt(np.maximum(np.asarray(height) - BREAST_HEIGHT, 0.0))
        return 0.01 * self.hd_a * root / (1.0 - self.hd_b * root)


# Round values of the magnitude found in yield tables and textbooks of forestry; none is fitted to data.
SPECIES: Mapping[str, SpeciesTraits] = MappingProxyType(
    {
        "spruce": SpeciesTraits(
            36.0, 0.024, 1.6, 1.65, 0.152, 4.4, 0.60, 0.75, (0.45, 0.85), (0.0, math.radians(38.0)), 14.0, 300.0, 30.0
        ),
        "pine": SpeciesTraits(
            30.0, 0.026, 1.3, 1.50, 0.168, 4.3, 0.60, 0.20, (0.00, 0.40), (0.0, math.radians(35.0)), 18.0, 300.0, 15.0
        ),
        "beech": SpeciesTraits(
            35.0, 0.020, 1.5, 1.45, 0.155, 6.4, 0.60, 1.00, (0.35, 0.65), (0.0, math.radians(30.0)), 6.0, 300.0, 40.0
        ),
        "birch": SpeciesTraits(
            26.0, 0.045, 1.3, 1.25, 0.178, 5.0, 0.60, 0.15, (0.25, 0.95), (0.0, math.radians(30.0)), 30.0, 110.0, 10.0
        ),
        "oak": SpeciesTraits(
            30.0, 0.020, 1.3, 1.60, 0.165, 6.4, 0.60, 0.35, (0.25, 0.70), (0.0, math.radians(20.0)), 9.0, 500.0, 40.0
        ),
    }
)
"""Traits by name, for a temperate European forest."""


def site_suitability(
    traits: SpeciesTraits, moisture: np.ndarray | None = None, slope: np.ndarray | None = None
) -> np.ndarray:
    """Suitability of a site for a species, in [0, 1]: 1 within its ranges, falling as a Gaussian outside of them.

    ``moisture`` is in [0, 1], ``slope`` in radians; ``None`` suits all. On slopes far beyond the range nothing grows
    (0); soil that is too dry or too wet leaves at least 0.02.
    """
    good: np.ndarray | np.float64 = np.float64(1.0)
    if moisture is not None:
        low, high = traits.moisture
        outside = np.maximum(np.maximum(low - moisture, moisture - high), 0.0)
        good = good * np.maximum(np.exp(-0.5 * (outside / _MOISTURE_FALL) ** 2), 0.02)
    if slope is not None:
        low, high = traits.slope
        outside = np.maximum(np.maximum(low - slope, slope - high), 0.0)
        good = good * np.where(outside > _STEEPEST * _SLOPE_FALL, 0.0, np.exp(-0.5 * (outside / _SLOPE_FALL) ** 2))
    return np.asarray(good)


def columns(traits: list[SpeciesTraits]) -> dict[str, np.ndarray]:
    """Traits that are single numbers, as arrays over species."""
    names = [f.name for f in fields(SpeciesTraits) if f.name not in ("moisture", "slope")]
    return {name: np.array([getattr(t, name) for t in traits]) for name in names}
