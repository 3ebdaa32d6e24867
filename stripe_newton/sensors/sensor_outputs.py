# SPDX-License-Identifier: Apache-2.0
"""Sensor outputs: the struct that a sensor writes and the one that is read, with noise and delay in between."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Generic, TypeVar

import warp as wp

from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from .corruption import Corruption

__all__ = ["SensorOutputs", "output_problems"]

T = TypeVar("T")


class SensorOutputs(Generic[T]):
    """The arrays of a struct as columns of one block of floats, ``(num_envs, size)``.

    One block, so that noise and delay take two launches whatever the number of outputs.

    Attributes:
        raw: The struct that the sensor's kernels write.
        struct: The struct that is read; the same one without noise and delay.
        arrays: Arrays that persist from step to step, by name.
    """

    def __init__(
        self,
        struct: type[T],
        fields: Mapping[str, tuple[type, int | None]],
        num_envs: int,
        noise: Mapping[str, NoiseCfg | NoiseModelCfg],
        delay: int,
        where: str,
    ):
        """Allocate on the current device.

        Args:
            struct: Class of the struct.
            fields: Type of each of its arrays, and how many an environment has; None for arrays ``(num_envs,)``.
            num_envs: Number of environments.
            noise: Noise by array.
            delay: Age of what is read, in measurements.
            where: Path of the config's noise, for errors and random numbers.

        Raises:
            ConfigError: for noise that does not fit.
        """
        self._struct, self._fields = struct, fields
        self._columns, size = dict[str, slice](), 0
        for field, (kind, count) in fields.items():
            width = kind._length_ * (1 if count is None else count)  # type: ignore[attr-defined]  # a Warp vector
            self._columns[field] = slice(size, size + width)
            size += width
        block = wp.zeros((num_envs, size), dtype=float)
        self._corruption = None
        if noise or delay:
            parts = [(self._columns[field], cfg) for field, cfg in noise.items()]
            self._corruption = Corruption(block, parts, delay, where)
        self.raw = self._views(block)
        self.struct = self._views(self._corruption.out) if self._corruption else self.raw
        self.arrays = {"measured": block} | (self._corruption.arrays if self._corruption else {})

    def _views(self, block: wp.array) -> T:
        made, values = self._struct(), wp.to_torch(block)
        for field, (kind, count) in self._fields.items():
            # Warp takes strided views of torch's: the columns stay where they are.
            part = values[:, self._columns[field]]
            part = part if count is None else part.unflatten(1, (count, -1))
            setattr(made, field, wp.from_torch(part, dtype=kind))
        return made

    def launch(self, due: wp.array) -> None:
        """Hand out a measurement.

        Args:
            due: Environments that measured, bool, shape ``(num_envs,)``.
        """
        if self._corruption:
            self._corruption.launch(due)

    def restart(self, env_mask: wp.array) -> None:
        """Begin episodes.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """
        if self._corruption:
            self._corruption.restart(env_mask)


def output_problems(
    noise: Mapping[str, NoiseCfg | NoiseModelCfg], history_length: int, outputs: tuple[str, ...], what: str
) -> Iterator[tuple[str, str]]:
    """Problems of the ``noise`` and ``history_length`` of a config.

    Args:
        noise: Noise by output.
        history_length: Past measurements that the config asks for; these sensors keep none.
        outputs: Outputs that may have noise.
        what: What the sensor is, such as "an IMU".
    """
    for name in noise:
        if name not in outputs:
            yield "noise", f"has '{name}', must be of {', '.join(outputs)}"
    if history_length:
        yield "history_length", f"is not kept by {what}; give the observation term a history instead"
