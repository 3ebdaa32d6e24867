# SPDX-License-Identifier: Apache-2.0
"""Host flags: numbers that kernels write and the host reads without synchronisation."""

from __future__ import annotations

import numpy as np
import warp as wp

__all__ = ["HostFlags"]


class HostFlags:
    """Integers in pinned memory of the host, written by kernels and read by the host at any time.

    The host sees them as of the work that the device has finished, without waiting for the rest.

    Attributes:
        array: The integers for kernels, of ``dtype``, shape ``(count,)``.
    """

    def __init__(self, count: int, device: str, dtype: type = wp.int32):
        on_gpu = device != "cpu"
        self._memory = wp.zeros(count, dtype=dtype, device="cpu", pinned=on_gpu)
        self._view: np.ndarray = self._memory.numpy()
        self.array = self._memory
        if on_gpu:  # under unified addressing the device knows pinned memory by the same address
            self.array = wp.array(ptr=self._memory.ptr, dtype=dtype, shape=(count,), device=device)

    def __getitem__(self, index: int) -> int:
        return int(self._view[index])

    def __setitem__(self, index: int, value: int) -> None:
        self._view[index] = value
