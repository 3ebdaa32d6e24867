# SPDX-License-Identifier: Apache-2.0
"""Reset mask: the environments whose episode ended, in the one form that the step hands on, down to the solver."""

from __future__ import annotations

import torch
import warp as wp

__all__ = ["ResetMask"]


class ResetMask:
    """Which environments begin a new episode: a mask on the device, and its indices for those who need them.

    Kernels and the solver read the mask. Torch hooks and terms want indices, which are a wait for the device: they are
    taken once a step, by the first who asks, and shared by all.

    Attributes:
        array: The mask, bool, shape ``(num_envs,)``.
        worlds: The same memory as Newton's solvers want it, bool, shape ``(num_envs + 1,)``. The last entry stands for
            what belongs to no world and is always False.
        tensor: :attr:`array` as a tensor.
    """

    def __init__(self, num_envs: int, device: str):
        self.worlds = wp.zeros(num_envs + 1, dtype=wp.bool, device=device)
        self.array = self.worlds[:num_envs]
        self.tensor = wp.to_torch(self.array)
        self._on_host: torch.Tensor | None = None
        self._on_device: torch.Tensor | None = None

    def begin_step(self) -> None:
        """Forget the indices of the step before. Call this before the mask is written anew."""
        self._on_host = self._on_device = None

    def indices_on_host(self) -> torch.Tensor:
        """Indices of the environments, int64, shape ``(n,)``, on the CPU. The first call of a step waits."""
        if self._on_host is None:
            # The mask is copied and searched here: ``nonzero`` on a GPU waits, too, and would then have to be copied.
            self._on_host = self.tensor.cpu().nonzero().squeeze(-1)
        return self._on_host

    def indices(self) -> torch.Tensor:
        """Indices of the environments, int64, shape ``(n,)``, on the device. The first call of a step waits for it."""
        if self._on_device is None:
            self._on_device = self.indices_on_host().to(self.tensor.device)
        return self._on_device
