# SPDX-License-Identifier: Apache-2.0
"""Corruption: noise, bias and delay of a sensor, on the device."""

from __future__ import annotations

import zlib
from collections.abc import Iterable

import numpy as np
import torch
import warp as wp

from stripe_kernels.episode import seed_streams
from stripe_kernels.processing import NOISE_ABS, NOISE_ADD, NOISE_SCALE
from stripe_kernels.sensors import corruption as kernels
from stripe_newton.configclass import ConfigError
from stripe_newton.noise import (
    ConstantNoiseCfg,
    GaussianNoiseCfg,
    NoiseCfg,
    NoiseModelCfg,
    NoiseModelWithAdditiveBiasCfg,
    UniformNoiseCfg,
)

__all__ = ["Corruption"]

_KINDS: dict[type[NoiseCfg], tuple[int, str, str | None]] = {
    ConstantNoiseCfg: (int(kernels.NOISE_CONSTANT), "bias", None),
    UniformNoiseCfg: (int(kernels.NOISE_UNIFORM), "n_min", "n_max"),
    GaussianNoiseCfg: (int(kernels.NOISE_GAUSSIAN), "mean", "std"),
}
"""Number of each kind of noise in the kernels, and the fields with its two numbers."""
_OPERATIONS = {"add": int(NOISE_ADD), "scale": int(NOISE_SCALE), "abs": int(NOISE_ABS)}


class Corruption:
    """Puts noise on a sensor's floats and delays them: two launches a measurement.

    What an environment draws does not depend on the number of environments. A noise model with bias draws it at the
    start of an episode. Before an episode is as old as the delay, its first measurement is read.

    Attributes:
        raw: What the sensor writes, shape ``(num_envs, size)``.
        out: What is read, same shape.
        delay: Age of what is read, in measurements.
        arrays: Arrays that persist from step to step, by name; ``rng`` are the random streams.
    """

    def __init__(
        self,
        raw: wp.array,
        noise: Iterable[tuple[slice, NoiseCfg | NoiseModelCfg]] = (),
        delay: int = 0,
        where: str = "noise",
        out: wp.array | None = None,
    ):
        """Allocate.

        Args:
            raw: float, shape ``(num_envs, size)``.
            noise: Floats that get noise, and their noise.
            delay: Age of what is read, in measurements.
            where: Path of the config's field, for errors; the random streams are seeded by it too.
            out: Array for what is read, same shape as ``raw``; by default a new one.

        Raises:
            ConfigError: for noise of an unknown kind, or with numbers that do not fit.
        """
        self.raw, self.delay = raw, delay
        self._count, size = raw.shape
        steps, biases, self._shared = _Table(size, where), _Table(size, where), np.zeros(size, dtype=bool)
        for part, cfg in noise:
            steps.add(part, cfg.noise_cfg if isinstance(cfg, NoiseModelCfg) else cfg)
            if isinstance(cfg, NoiseModelWithAdditiveBiasCfg):
                biases.add(part, cfg.bias_noise_cfg)
                if not cfg.sample_bias_per_component:  # all floats but the first take the bias of the one before
                    self._shared[part.start + 1 : part.stop] = True
        # Two numbers for each float, whatever its kind: what a float draws stays the same when noise is put on another.
        self._draws = 2 * size if steps.kind.any() else 0
        with wp.ScopedDevice(raw.device):
            self.out = wp.zeros(raw.shape, dtype=float) if out is None else out
            self._steps = steps.struct()
            self._biases = (biases if biases.kind.any() else _Table(0, where)).struct()
            self._shared_biases = wp.array(self._shared, dtype=wp.bool)
            self._rng, self._first = (wp.zeros(self._count, dtype=wp.uint32) for _ in range(2))
            self._measured = wp.zeros(self._count, dtype=int)
            self._bias = wp.zeros(raw.shape, dtype=float)
            # A ring of the last measurements: delay is an index into it, and the same launch writes and reads.
            self._ring = wp.zeros((self._count, delay + 1, size), dtype=float)
            # Streams of their own: what a sensor draws does not change when another sensor is added.
            seed = zlib.crc32(where.encode()) % 2**31
            wp.launch(seed_streams, dim=self._count, inputs=[seed], outputs=[self._rng])
            # Biases are drawn for the first episode too, of environments that nobody has reset yet.
            self.restart(wp.full(self._count, value=True, dtype=wp.bool))

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that persist from step to step, by name."""
        names = {"rng": self._rng, "measured": self._measured, "bias": self._bias, "ring": self._ring, "out": self.out}
        return {f"corruption.{name}" if name != "rng" else name: array for name, array in names.items()}

    def launch(self, due: wp.array) -> None:
        """Turn :attr:`raw` into :attr:`out` where a measurement was taken.

        Args:
            due: Environments, bool, shape ``(num_envs,)``.
        """
        counters = [self._rng, self._first, self._measured]
        inputs = [due, self._draws, self._ring.shape[1]]
        wp.launch(kernels.begin_corruption, dim=self._count, inputs=inputs, outputs=counters)
        inputs = [due, self._steps, self._bias, self._first, self._measured, self.raw]
        wp.launch(kernels.corrupt, dim=self.raw.shape, inputs=inputs, outputs=[self._ring, self.out])

    def restart(self, env_mask: wp.array) -> None:
        """Begin episodes.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """
        inputs = [env_mask, self._biases, self._shared_biases]
        outputs = [self._rng, self._measured, self._bias]
        wp.launch(kernels.restart_corruption, dim=self._count, inputs=inputs, outputs=outputs)


class _Table:
    """Kind, operation and numbers of the noise of each float."""

    def __init__(self, size: int, where: str):
        self.where = where
        self.kind, self.operation = np.zeros(size, dtype=np.int32), np.zeros(size, dtype=np.int32)
        self.a, self.b = np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.float32)

    def add(self, part: slice, cfg: NoiseCfg) -> None:
        """Put noise on some of the floats."""
        kind = next((k for k in _KINDS if isinstance(cfg, k)), None)
        if kind is None:
            names = ", ".join(k.__name__ for k in _KINDS)
            raise ConfigError([f"{self.where}: is {type(cfg).__name__}, must be one of {names}"])
        self.kind[part], *fields = _KINDS[kind]
        self.operation[part] = _OPERATIONS[cfg.operation]
        for column, field in zip((self.a, self.b), fields):
            given = getattr(cfg, field) if field else 0.0
            value = torch.as_tensor(given, dtype=torch.float32).flatten().numpy(force=True)
            if len(value) not in (1, len(column[part])):
                have = f"has {len(value)} numbers, must have 1 or {len(column[part])}"
                raise ConfigError([f"{self.where}.{field}: {have}"])
            column[part] = value

    def struct(self) -> kernels.Noise:
        """The table as the struct that kernels read."""
        noise = kernels.Noise()
        noise.kind, noise.operation = wp.array(self.kind, dtype=int), wp.array(self.operation, dtype=int)
        noise.a, noise.b = wp.array(self.a, dtype=float), wp.array(self.b, dtype=float)
        return noise
