# SPDX-License-Identifier: Apache-2.0
"""Reset mask: the environments that begin a new episode, from the terminations to the solver in one array."""

from __future__ import annotations

import torch
import warp as wp

__all__ = ["ResetMask"]


class ResetMask:
    """Mask of the environments that begin a new episode, and their indices for torch code.

    Kernels and the solver read the mask. Torch hooks and terms need indices, and computing them waits for the device.
    The first call in a step computes them; all others share the result.

    Attributes:
        array: The mask, bool, shape ``(num_envs,)``.
        worlds: The same memory in the form of Newton's solvers, bool, shape ``(num_envs + 1,)``. The last entry, for
            bodies that belong to no world, is always False.
        tensor: :attr:`array` as a tensor.
    """

    def __init__(self, num_envs: int, device: str):
        self.worlds = wp.zeros(num_envs + 1, dtype=wp.bool, device=device)
        self.array = self.worlds[:num_envs]
        self.tensor = wp.to_torch(self.array)
        self._on_host: torch.Tensor | None = None
        self._on_device: torch.Tensor | None = None
        self._pinned: torch.Tensor | None = None

    def begin_step(self) -> None:
        """Drop the indices of the last step. Call it before the mask is written."""
        self._on_host = self._on_device = None

    def choose(self, env_mask: torch.Tensor) -> None:
        """Set the mask; ``env_mask`` is bool, shape ``(num_envs,)``."""
        self.begin_step()
        self.tensor.copy_(env_mask)

    def indices_on_host(self) -> torch.Tensor:
        """Indices of the environments, int64, shape ``(n,)``, on the CPU. The first call of a step waits."""
        if self._on_host is None:
            # The mask is copied and searched here: ``nonzero`` on a GPU waits, too, and would then have to be copied.
            self._on_host = self.tensor.cpu().nonzero().squeeze(-1)
        return self._on_host

    def indices(self) -> torch.Tensor:
        """Indices of the environments, int64, shape ``(n,)``, on the device. The first call of a step waits for it."""
        if self._on_device is None:
            self._on_device = self._to_device(self.indices_on_host())
        return self._on_device

    def _to_device(self, indices: torch.Tensor) -> torch.Tensor:
        if not self.tensor.is_cuda:
            return indices
        # From pinned memory: a copy from any other waits for the device once more. The memory is written again when
        # indices are asked for again, and that waits for the device and so for this copy.
        if self._pinned is None:
            self._pinned = torch.empty(len(self.tensor), dtype=torch.int64, pin_memory=True)
        sent = self._pinned[: len(indices)].copy_(indices)
        return sent.to(self.tensor.device, non_blocking=True)
