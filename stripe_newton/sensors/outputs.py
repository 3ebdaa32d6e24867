# SPDX-License-Identifier: Apache-2.0
"""What a sensor writes and what is read of it, with noise and delay in between where the config asks for them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import warp as wp

from stripe_newton.noise import NoiseCfg, NoiseModelCfg

from .corruption import Corruption

__all__ = ["Outputs", "output_problems"]


class Outputs:
    """The arrays of a struct as columns of one block of floats, ``(num_envs, size)``.

    Attributes:
        raw: The struct that the sensor's kernels write.
        struct: The struct that is read; the same without noise and delay.
        arrays: What lasts from step to step, by name.
    """

    def __init__(
        self,
        struct: Any,
        fields: Mapping[str, tuple[Any, int | None]],
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
            delay: How many measurements old what is read is.
            where: Path of the config's noise, for errors and random numbers.

        Raises:
            ConfigError: for noise that does not fit.
        """
        self._struct, self._fields, self._parts, size = struct, fields, {}, 0
        for field, (kind, count) in fields.items():
            width = kind._length_ * (1 if count is None else count)
            self._parts[field] = slice(size, size + width)
            size += width
        block = wp.zeros((num_envs, size), dtype=float)
        self._corruption = None
        if noise or delay:
            parts = [(self._parts[field], cfg) for field, cfg in noise.items()]
            self._corruption = Corruption(block, parts, delay, where)
        self.raw = self._views(block)
        self.struct = self._views(self._corruption.out) if self._corruption else self.raw
        self.arrays = {"measured": block} | (self._corruption.arrays if self._corruption else {})

    def _views(self, block: wp.array) -> Any:
        made, values = self._struct(), wp.to_torch(block)
        for field, (kind, count) in self._fields.items():
            part = values[:, self._parts[field]]
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


def output_problems(cfg: Any, outputs: tuple[str, ...], what: str) -> Iterator[tuple[str, str]]:
    """What is wrong with the ``noise``, ``delay`` and ``history_length`` of a config.

    Args:
        cfg: The config.
        outputs: Outputs that may have noise.
        what: What the sensor is.
    """
    for name in cfg.noise:
        if name not in outputs:
            yield "noise", f"has '{name}', must be of {', '.join(outputs)}"
    if not isinstance(cfg.delay, int) or cfg.delay < 0:
        yield "delay", f"is {cfg.delay!r}, must be a whole number of measurements, 0 or more"
    if cfg.history_length:
        yield "history_length", f"is not kept by {what}; give the observation term a history instead"
