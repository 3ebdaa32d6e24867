# SPDX-License-Identifier: Apache-2.0
"""Depth noise: errors of a depth camera that grow with the distance, lost pixels and steps of the depth."""

from __future__ import annotations

import zlib

import warp as wp

from stripe_kernels.episode import seed_streams
from stripe_kernels.sensors import depth_noise as kernels
from stripe_kernels.sensors.corruption import begin_corruption
from stripe_newton.configclass import configclass
from stripe_newton.value_types import NonNegativeFloat, UnitFloat

__all__ = ["DepthNoise", "DepthNoiseCfg"]


@configclass
class DepthNoiseCfg:
    """Noise of a depth camera, drawn anew for each pixel of each image.

    Formula: ``z' = z + (std + relative_std z + quadratic_std z^2) N(0, 1)``, rounded to a multiple of
    ``quantization``. Pixels that are lost look like those that see nothing.

    Reference:
        Nguyen et al. "Modeling Kinect sensor noise for improved 3D reconstruction and tracking" (2012): the error of
        depth by disparity grows with the square of the distance.
    """

    std: NonNegativeFloat = 0.0
    """Standard deviation at any distance [m]."""
    relative_std: NonNegativeFloat = 0.0
    """Standard deviation as a share of the depth."""
    quadratic_std: NonNegativeFloat = 0.0
    """Standard deviation by the square of the depth [1/m]."""
    dropout: UnitFloat = 0.0
    """Share of the pixels that are lost."""
    quantization: NonNegativeFloat = 0.0
    """Step of the depth [m]; 0 for none."""


class DepthNoise:
    """Noise of :class:`DepthNoiseCfg` on the depths of one image type: two launches an image.

    What an environment draws does not depend on the number of environments.

    Attributes:
        out: Noisy depths, infinite where nothing is seen [m], shape ``(num_envs, size)``.
        arrays: Arrays that persist from step to step, by name; ``rng`` are the random streams.
    """

    def __init__(self, raw: wp.array, cfg: DepthNoiseCfg, where: str):
        """Allocate.

        Args:
            raw: Depths, infinite where nothing was seen [m], shape ``(num_envs, size)``.
            cfg: The noise.
            where: Path of the config's field, by which the random streams are seeded.
        """
        self._raw, (self._count, size) = raw, raw.shape
        self._draws = 3 * size
        self._noise = noise = kernels.DepthNoise()
        noise.std = wp.vec3(cfg.std, cfg.relative_std, cfg.quadratic_std)
        noise.dropout, noise.quantization = float(cfg.dropout), float(cfg.quantization)
        with wp.ScopedDevice(raw.device):
            self.out = wp.zeros(raw.shape, dtype=float)
            self._rng, self._first = (wp.zeros(self._count, dtype=wp.uint32) for _ in range(2))
            self._measured = wp.zeros(self._count, dtype=int)
            # A stream of its own: what a camera draws does not change when another sensor is added.
            seed = zlib.crc32(where.encode()) % 2**31
            wp.launch(seed_streams, dim=self._count, inputs=[seed], outputs=[self._rng])

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that persist from step to step, by name."""
        return {"rng": self._rng}

    def launch(self, due: wp.array) -> None:
        """Compute :attr:`out` where an image was taken; ``due`` is bool, shape ``(num_envs,)``."""
        counters = [self._rng, self._first, self._measured]
        wp.launch(begin_corruption, dim=self._count, inputs=[due, self._draws, 1], outputs=counters)
        inputs = [due, self._noise, self._first, self._raw]
        wp.launch(kernels.add_depth_noise, dim=self._raw.shape, inputs=inputs, outputs=[self.out])

    def restart(self, env_mask: wp.array) -> None:
        """Do nothing: this noise has no part that lasts for an episode."""
