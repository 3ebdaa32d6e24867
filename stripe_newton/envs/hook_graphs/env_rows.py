# SPDX-License-Identifier: Apache-2.0
"""Environment rows: what arrays hold of the environments that a padded reset must not change.

A graph has fixed shapes. One that resets 64 environments also resets fewer, if what it does to others is undone: the
list of environments is filled up with some that are not to be reset, whose rows in all arrays are kept before the hook
and brought back after it. Nothing of that waits for the device.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch
import warp as wp

from stripe_kernels.env_rows import move_rows

__all__ = ["EnvRows"]


class EnvRows:
    """Rows of environments in some tensors, to be kept and brought back on the device."""

    def __init__(self, tensors: Iterable[torch.Tensor], num_envs: int, places: int, device: str):
        """Note where the rows are.

        Args:
            tensors: Tensors whose memory has a row for each environment, one after another. Others, and those on other
                devices, are left out.
            num_envs: Number of environments.
            places: Number of rows that there is room for.
            device: The device.
        """
        pieces = _pieces(tensors, num_envs, torch.device(device))
        self._address, self._stride, self._size = (
            wp.array(np.ascontiguousarray(column.astype(dtype)), device=device)
            for column, dtype in zip(pieces.T, (np.uint64, np.int32, np.int32), strict=True)
        )
        self._kept = wp.empty(places * len(pieces), dtype=wp.uint32, device=device)

    def keep(self, order: wp.array, count: wp.array, places: int) -> None:
        """Keep the rows of the environments in the first places of a list, but for the first ``count``.

        Args:
            order: The list, int64.
            count: Number of environments that are left out, int32, shape ``(1,)``.
            places: Number of places.
        """
        self._move(order, count, places, False)

    def restore(self, order: wp.array, count: wp.array, places: int) -> None:
        """Bring back what :meth:`keep` has kept, with the same arguments."""
        self._move(order, count, places, True)

    def _move(self, order: wp.array, count: wp.array, places: int, restores: bool) -> None:
        pieces = len(self._address)
        inputs = [order, count, self._address, self._stride, self._size, self._kept, restores]
        wp.launch(move_rows, (places, pieces), inputs, device=order.device)


def _pieces(tensors: Iterable[torch.Tensor], num_envs: int, device: torch.device) -> np.ndarray:
    """Address in environment 0, stride and size of each piece of a row, int64, shape ``(pieces, 3)``."""
    found: dict[int, np.ndarray] = {}
    for tensor in tensors:
        storage = tensor.untyped_storage()
        if storage.nbytes() == 0 or storage.nbytes() % num_envs or tensor.device.type != device.type:
            continue
        stride = storage.nbytes() // num_envs
        size = 1 if stride % 4 or storage.data_ptr() % 4 else 4
        offsets = np.arange(0, stride, size)
        columns = storage.data_ptr() + offsets, np.full(len(offsets), stride), np.full(len(offsets), size)
        found.setdefault(storage.data_ptr(), np.stack(columns, axis=1))
    return np.concatenate(list(found.values())) if found else np.zeros((0, 3), dtype=np.int64)
