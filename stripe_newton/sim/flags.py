# SPDX-License-Identifier: Apache-2.0
"""What the device tells the host without being waited for."""

from __future__ import annotations

import numpy as np
import warp as wp

__all__ = ["HostFlags"]


class HostFlags:
    """Whole numbers in pinned memory of the host, which kernels write and the host reads at any time.

    The host sees what the device had done by then; nobody waits.

    Attributes:
        array: The numbers for kernels, int32, shape ``(count,)``.
    """

    def __init__(self, count: int, device: str):
        on_gpu = device != "cpu"
        self._memory = wp.zeros(count, dtype=wp.int32, device="cpu", pinned=on_gpu)
        self._view: np.ndarray = self._memory.numpy()
        self.array = self._memory
        if on_gpu:  # under unified addressing the device knows pinned memory by the same address
            self.array = wp.array(ptr=self._memory.ptr, dtype=wp.int32, shape=(count,), device=device)

    def __getitem__(self, index: int) -> int:
        return int(self._view[index])

    def __setitem__(self, index: int, value: int) -> None:
        self._view[index] = value
