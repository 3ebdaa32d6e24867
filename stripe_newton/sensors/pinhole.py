# SPDX-License-Identifier: Apache-2.0
"""Pinhole intrinsics: from lens and film, as USD and Isaac Lab describe them, to pixels."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np

from stripe_newton.configclass import configclass
from stripe_newton.value_types import PositiveFloat

__all__ = ["PinholeIntrinsics"]

T = TypeVar("T", bound="PinholeIntrinsics")


@configclass
class PinholeIntrinsics:
    """Focal length and film. Only their ratios count; USD gives them in tenths of a scene unit."""

    focal_length: PositiveFloat = 24.0
    """Distance from the lens to the film."""
    horizontal_aperture: PositiveFloat = 20.955
    """Width of the film, in the same unit."""
    vertical_aperture: PositiveFloat | None = None
    """Height of the film; ``None`` for square pixels."""
    horizontal_aperture_offset: float = 0.0
    """Distance by which the optical axis meets the film to the right of its middle, in the same unit."""
    vertical_aperture_offset: float = 0.0
    """Distance by which it meets the film below its middle, in the same unit."""

    @classmethod
    def from_intrinsic_matrix(
        cls: type[T],
        intrinsic_matrix: Sequence[float],
        width: int,
        height: int,
        focal_length: float = 24.0,
        **others: Any,
    ) -> T:
        """The config of a camera whose matrix is known, such as from a calibration.

        Args:
            intrinsic_matrix: ``[fx, 0, cx, 0, fy, cy, 0, 0, 1]`` [px].
            width: Pixels in a row.
            height: Pixels in a column.
            focal_length: Unit of the film's sizes.
            others: Further fields.
        """
        fx, _, cx, _, fy, cy = (float(x) for x in list(np.ravel(intrinsic_matrix))[:6])
        film = focal_length * width / fx, focal_length * height / fy
        # Patterns of rays have the number of pixels themselves, cameras beside their lens.
        pixels = {"width": width, "height": height} if "width" in {f.name for f in dataclasses.fields(cls)} else {}
        return cls(
            focal_length=focal_length,
            horizontal_aperture=film[0],
            vertical_aperture=film[1],
            horizontal_aperture_offset=(cx / width - 0.5) * film[0],
            vertical_aperture_offset=(cy / height - 0.5) * film[1],
            **pixels,
            **others,
        )

    def matrix(self, width: int, height: int) -> np.ndarray:
        """``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` [px]; the middle of the upper left pixel is (0.5, 0.5).

        ``fx = width focal_length / horizontal_aperture``, ``cx = width (1/2 + offset / horizontal_aperture)``.
        """
        # USD and Isaac Lab keep pixels square unless both sides of the film are given.
        film_y = self.horizontal_aperture * height / width if self.vertical_aperture is None else self.vertical_aperture
        return np.array(
            [
                [
                    width * self.focal_length / self.horizontal_aperture,
                    0.0,
                    width * (0.5 + self.horizontal_aperture_offset / self.horizontal_aperture),
                ],
                [0.0, height * self.focal_length / film_y, height * (0.5 + self.vertical_aperture_offset / film_y)],
                [0.0, 0.0, 1.0],
            ]
        )

    def pixel_directions(self, width: int, height: int) -> np.ndarray:
        """``K^-1 (column + 1/2, row + 1/2, 1)``, in the ROS frame: x right, y down, z along the optical axis.

        Returns:
            float64, shape ``(height, width, 3)``; the last component is 1.
        """
        k = self.matrix(width, height)
        x, y = np.meshgrid((np.arange(width) + 0.5 - k[0, 2]) / k[0, 0], (np.arange(height) + 0.5 - k[1, 2]) / k[1, 1])
        return np.stack([x, y, np.ones_like(x)], axis=-1)
