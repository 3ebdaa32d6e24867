# SPDX-License-Identifier: Apache-2.0
"""Output block: the results of a step in one block of memory, so that one copy gives the caller tensors to keep."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import torch
import warp as wp

__all__ = ["OutputBlock"]

_TORCH = {wp.float32: torch.float32, wp.bool: torch.bool}
_ALIGN = 256
"""Alignment of an array [bytes], that of ``cudaMalloc``: kernels load vectors from its start."""
_FLOATS_AN_ENV = 256
"""Room in a chunk, in floats for each environment. Most tasks fit; others take another chunk, and one copy more."""
_SMALL = 4096
"""Largest size of a tensor of the log that has its place in the block [bytes]."""


class OutputBlock:
    """Arrays that kernels write, and that :meth:`take` copies all at once."""

    def __init__(self, num_envs: int, device: str):
        self._capacity = num_envs * 4 * _FLOATS_AN_ENV + 2**16
        self._device = device
        self._arrays: dict[str, wp.array] = {}
        self._chunks: list[torch.Tensor] = []
        self._used: list[int] = []
        self._layout: dict[str, _Place] = {}
        self._logged: dict[int, tuple[str, torch.Tensor]] = {}
        self._prepared: tuple[list[torch.Tensor], dict[str, torch.Tensor]] | None = None

    def reserve(self, name: str, dtype: type, shape: tuple[int, ...]) -> wp.array:
        """An array of zeros in the block.

        Args:
            name: Its key in the results of :meth:`take` and :meth:`views`.
            dtype: ``wp.float32`` or ``wp.bool``.
            shape: Shape.
        """
        self._arrays[name] = wp.from_torch(self._place(name, _TORCH[dtype], shape), dtype=dtype)
        return self._arrays[name]

    def reserve_logged(self, value: torch.Tensor) -> torch.Tensor:
        """A tensor like one of the log, in the block where it is small; :meth:`copies` gives what it holds.

        Hooks write it when they are replayed, and not otherwise, so it is none of :attr:`arrays`.
        """
        if value.numel() * value.itemsize > _SMALL or value.device.type != torch.device(self._device).type:
            return torch.empty_like(value, memory_format=torch.contiguous_format)
        name = f"logged.{len(self._logged)}"
        tensor = self._place(name, value.dtype, tuple(value.shape))
        self._logged[id(tensor)] = name, tensor  # kept, so that no other tensor gets its id
        return tensor

    def _place(self, name: str, dtype: torch.dtype, shape: tuple[int, ...]) -> torch.Tensor:
        size = (dtype.itemsize * math.prod(shape) + _ALIGN - 1) // _ALIGN * _ALIGN
        self._prepared = None
        if not self._chunks or self._used[-1] + size > self._chunks[-1].numel():
            with torch.inference_mode(False):  # an inference tensor could not be written outside of inference mode
                self._chunks.append(torch.zeros(max(self._capacity, size), dtype=torch.uint8, device=self._device))
            self._used.append(0)
        self._layout[name] = _Place(len(self._chunks) - 1, dtype, shape, self._used[-1] // dtype.itemsize)
        self._used[-1] += size
        return self._views(self._chunks, [name])[name]

    @property
    def arrays(self) -> dict[str, wp.array]:
        """The arrays that were reserved, by name, without those of the log."""
        return dict(self._arrays)

    def array(self, name: str) -> wp.array:
        """The array that was reserved under a name."""
        return self._arrays[name]

    def _views(self, chunks: list[torch.Tensor], names: Iterable[str]) -> dict[str, torch.Tensor]:
        """Tensors in some chunks, by name: one operation of torch for each, as all take part in every step."""
        typed: dict[tuple[int, torch.dtype], torch.Tensor] = {}
        found = {}
        for name in names:
            place = self._layout[name]
            key = place.chunk, place.dtype
            if key not in typed:
                typed[key] = chunks[place.chunk].view(place.dtype)
            found[name] = typed[key].as_strided(place.shape, place.strides, place.start)
        return found

    def views(self) -> dict[str, torch.Tensor]:
        """The arrays themselves as tensors, by name. Every step overwrites them."""
        return self._views(self._chunks, self._layout)

    def prepare(self) -> None:
        """Allocate the tensors of the next :meth:`take` now, while the host would wait for the device anyway.

        A second call before it does nothing.
        """
        if self._prepared is None:
            fresh = [torch.empty(used, dtype=torch.uint8, device=self._device) for used in self._used]
            self._prepared = fresh, self._views(fresh, self._layout)

    def take(self) -> dict[str, torch.Tensor]:
        """Copies of the arrays by name. The tensors of one call share one block of memory, and with nothing else."""
        self.prepare()
        assert self._prepared is not None
        fresh, values = self._prepared
        self._prepared = None
        for copy, chunk in zip(fresh, self._chunks, strict=True):
            copy.copy_(chunk[: copy.numel()])
        return values

    def copies(self, log: Mapping[str, object], values: Mapping[str, torch.Tensor]) -> dict[str, object]:
        """The entries of a log, with copies of its tensors.

        Args:
            log: Numbers and tensors by key.
            values: Result of :meth:`take` after they were written, which has those of :meth:`reserve_logged`.
        """
        found = dict(log)
        for key, value in log.items():
            if isinstance(value, torch.Tensor):
                known = self._logged.get(id(value))
                found[key] = value.clone() if known is None else values[known[0]]
        return found


@dataclass(frozen=True)
class _Place:
    """Where an array lies in the block."""

    chunk: int
    dtype: torch.dtype
    shape: tuple[int, ...]
    start: int
    """Its first element, counted in elements of its type."""

    @cached_property
    def strides(self) -> tuple[int, ...]:
        """Strides of rows one after another."""
        return tuple(math.prod(self.shape[i + 1 :]) for i in range(len(self.shape)))
