# SPDX-License-Identifier: Apache-2.0
"""Image corruption: noise of depths and delay of everything, between a rendered image and the one handed out."""

from __future__ import annotations

import zlib

import torch
import warp as wp

from stripe_kernels.episode import seed_streams
from stripe_kernels.sensors import picture_delay as kernels
from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from .corruption import Corruption
from .depth_noise import DepthNoise, DepthNoiseCfg

__all__ = ["ImageCorruption"]


class ImageCorruption:
    """Noise of depths and delay of all images of a camera, on the device.

    :class:`Corruption` delays floats; images are of several types and large, so they are delayed as 4-byte words, in a
    ring for each.

    Attributes:
        arrays: Arrays that persist from step to step, by name; what ends in ``rng`` are random streams.
    """

    def __init__(self, num_envs: int, delay: tuple[int, int], device: str, where: str):
        """Begin without images.

        Args:
            num_envs: Number of environments.
            delay: Least and largest age of the images that are handed out, in images; each episode draws one.
            device: Device of the images.
            where: The camera, by which the random streams of the delay are seeded.
        """
        self._num_envs, self._delay, self._device = num_envs, delay, device
        self._count, self._lag = (wp.zeros(num_envs, dtype=int, device=device) for _ in range(2))
        self._rng = wp.zeros(num_envs, dtype=wp.uint32, device=device)
        seed = zlib.crc32(f"{where}.delay".encode()) % 2**31
        wp.launch(seed_streams, dim=num_envs, inputs=[seed], outputs=[self._rng], device=device)
        self._begin(wp.full(num_envs, value=True, dtype=wp.bool, device=device))
        self._noisy: dict[str, tuple[Corruption | DepthNoise, float, wp.array]] = {}
        self._rings: dict[str, tuple[wp.array, wp.array, wp.array]] = {}

    def noise(
        self, name: str, raw: wp.array, cfg: NoiseCfg | NoiseModelCfg | DepthNoiseCfg, missing: float, where: str
    ) -> wp.array:
        """Put noise on depths.

        Args:
            name: Name of the image.
            raw: Depths, infinite where nothing was seen [m], shape ``(num_envs, height, width)``.
            cfg: The noise.
            missing: Depth of what is not seen, as handed out [m].
            where: Path of the config's field.

        Returns:
            The noisy depths, same shape.
        """
        # A pixel is a float of the environment: the same kernels as for any other sensor.
        flat = raw.reshape((self._num_envs, -1))
        out = wp.zeros(raw.shape, dtype=float, device=self._device)
        corruption: Corruption | DepthNoise
        if isinstance(cfg, DepthNoiseCfg):
            corruption = DepthNoise(flat, cfg, f"{where}.{name}")
        else:
            corruption = Corruption(flat, [(slice(0, flat.shape[1]), cfg)], 0, f"{where}.{name}")
        self._noisy[name] = corruption, missing, out.reshape(flat.shape)
        return out

    def lag(self, name: str, taken: wp.array) -> wp.array:
        """Delay an image.

        Args:
            name: Name of the image.
            taken: Array of 4-byte elements or vectors of them, shape ``(num_envs, ...)``.

        Returns:
            Where it is handed out later, an array of the same type and shape; ``taken`` itself without a delay.
        """
        if not self._delay[1] or not taken.size:
            return taken
        out = wp.zeros(taken.shape, dtype=taken.dtype, device=self._device)
        words = _words(taken)
        ring = wp.zeros((self._num_envs, self._delay[1] + 1, words.shape[1]), dtype=int, device=self._device)
        self._rings[name] = words, ring, _words(out)
        return out

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that persist from step to step, by name."""
        found = {"pictures": self._count, "lag": self._lag, "delay.rng": self._rng} if self._rings else {}
        for name, (corruption, _, out) in self._noisy.items():
            own = {f"{name}.{k.removeprefix('corruption.')}": v for k, v in corruption.arrays.items()}
            found |= own | {f"{name}.noisy": out}
        return found | {f"{name}.ring": ring for name, (_, ring, _) in self._rings.items()}

    def launch(self, due: wp.array) -> None:
        """Hand out the images of some environments; ``due`` is bool, shape ``(num_envs,)``."""
        for corruption, missing, out in self._noisy.values():
            corruption.launch(due)
            wp.launch(kernels.fill_missing, dim=out.shape, inputs=[due, missing, corruption.out], outputs=[out])
        # Noise before delay: a late image is one that was taken, noise included.
        for words, ring, out in self._rings.values():
            inputs = [due, self._count, self._lag, words]
            wp.launch(kernels.delay_words, dim=out.shape, inputs=inputs, outputs=[ring, out])
        if self._rings:
            depth = next(ring for _, ring, _ in self._rings.values()).shape[1]
            wp.launch(kernels.count_pictures, dim=self._num_envs, inputs=[due, depth], outputs=[self._count])

    def restart(self, env_mask: wp.array) -> None:
        """Begin episodes; ``env_mask`` is bool, shape ``(num_envs,)``."""
        for corruption, *_ in self._noisy.values():
            corruption.restart(env_mask)
        if self._rings:
            self._begin(env_mask)

    def _begin(self, env_mask: wp.array) -> None:
        """Forget the pictures of some environments and draw their delays."""
        inputs, outputs = [env_mask, *self._delay], [self._rng, self._count, self._lag]
        wp.launch(kernels.begin_episodes, dim=self._num_envs, inputs=inputs, outputs=outputs, device=self._device)


def _words(array: wp.array) -> wp.array:
    """The memory of an array as int32, shape ``(num_envs, size)``."""
    # torch has no uint32 that it can do much with: colours are taken as int32 from the start.
    values = wp.to_torch(array.view(wp.int32) if array.dtype is wp.uint32 else array)
    return wp.from_torch(values.view(len(values), -1).view(torch.int32), dtype=wp.int32)
