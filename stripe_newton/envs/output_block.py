# SPDX-License-Identifier: Apache-2.0
"""Output block: the results of a step in one block of memory, so that one copy gives the caller tensors to keep."""

from __future__ import annotations

import torch
import warp as wp

__all__ = ["OutputBlock"]

_TORCH = {wp.float32: torch.float32, wp.bool: torch.bool}
_ALIGN = 256
"""Alignment of an array [bytes], that of ``cudaMalloc``: kernels load vectors from its start."""
_FLOATS_AN_ENV = 256
"""Room in a chunk, in floats for each environment. Most tasks fit; others take another chunk, and one copy more."""


class OutputBlock:
    """Arrays that kernels write, and that :meth:`take` copies all at once."""

    def __init__(self, num_envs: int, device: str):
        self._capacity = num_envs * 4 * _FLOATS_AN_ENV + 2**16
        self._device = device
        self._arrays: dict[str, wp.array] = {}
        self._chunks: list[torch.Tensor] = []
        self._used: list[int] = []
        self._layout: dict[str, tuple[int, int, torch.dtype, tuple[int, ...]]] = {}
        self._prepared: tuple[list[torch.Tensor], dict[str, torch.Tensor]] | None = None

    def reserve(self, name: str, dtype: type, shape: tuple[int, ...]) -> wp.array:
        """An array of zeros in the block.

        Args:
            name: Its key in the results of :meth:`take` and :meth:`views`.
            dtype: ``wp.float32`` or ``wp.bool``.
            shape: Shape.
        """
        kind = _TORCH[dtype]
        size = kind.itemsize * int(torch.Size(shape).numel())
        self._prepared = None
        if not self._chunks or self._used[-1] + size > self._chunks[-1].numel():
            with torch.inference_mode(False):  # an inference tensor could not be written outside of inference mode
                self._chunks.append(torch.zeros(max(self._capacity, size), dtype=torch.uint8, device=self._device))
            self._used.append(0)
        start = self._used[-1]
        self._layout[name] = len(self._chunks) - 1, start, kind, shape
        self._used[-1] = start + (size + _ALIGN - 1) // _ALIGN * _ALIGN
        self._arrays[name] = wp.from_torch(self._view(self._chunks[-1], name), dtype=dtype)
        return self._arrays[name]

    @property
    def chunks(self) -> list[torch.Tensor]:
        """The blocks of memory that hold the arrays, uint8."""
        return list(self._chunks)

    def array(self, name: str) -> wp.array:
        """The array that was reserved under a name."""
        return self._arrays[name]

    def _view(self, chunk: torch.Tensor, name: str) -> torch.Tensor:
        _, start, kind, shape = self._layout[name]
        count = int(torch.Size(shape).numel())
        return chunk[start : start + kind.itemsize * count].view(kind).view(shape)

    def views(self) -> dict[str, torch.Tensor]:
        """The arrays themselves as tensors, by name. Every step overwrites them."""
        return {name: self._view(self._chunks[entry[0]], name) for name, entry in self._layout.items()}

    def prepare(self) -> None:
        """Allocate the tensors of the next :meth:`take` now, while the host would wait for the device anyway."""
        used = [chunk[: min(n, chunk.numel())] for chunk, n in zip(self._chunks, self._used, strict=True)]
        fresh = [torch.empty_like(chunk) for chunk in used]
        self._prepared = fresh, {name: self._view(fresh[entry[0]], name) for name, entry in self._layout.items()}

    def take(self) -> dict[str, torch.Tensor]:
        """Copies of the arrays by name. The tensors of one call share one block of memory, and with nothing else."""
        if self._prepared is None:
            self.prepare()
        assert self._prepared is not None
        fresh, values = self._prepared
        self._prepared = None
        for copy, chunk in zip(fresh, self._chunks, strict=True):
            copy.copy_(chunk[: copy.numel()])
        return values
