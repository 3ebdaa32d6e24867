# SPDX-License-Identifier: Apache-2.0
"""Reset mask: the environments that begin a new episode, from the terminations to the solver in one array."""

from __future__ import annotations

import torch
import warp as wp

from stripe_kernels.env_rows import BLOCK, count_masked, list_masked_first

from .host_flags import HostFlags

__all__ = ["ResetMask"]


_LOOKS = 200_000
"""Looks at a report before the host waits for the device instead: some hundredths of a second."""


class ResetMask:
    """Mask of the environments that begin a new episode, and their indices for torch code.

    Kernels and the solver read the mask. Torch hooks and terms need indices, and to know their number the host waits
    for the device. The first call in a step does; all others share the result.

    Attributes:
        array: The mask, bool, shape ``(num_envs,)``.
        worlds: The same memory in the form of Newton's solvers, bool, shape ``(num_envs + 1,)``. The last entry, for
            bodies that belong to no world, is always False.
        tensor: :attr:`array` as a tensor.
        order: The environments of the mask and behind them all others, both ascending, int64, shape ``(num_envs,)``,
            as of the last :meth:`launch_list`.
        count: Number of environments in the mask, int32, shape ``(1,)``, likewise.
        listed_in_step: Whether the step itself launches :meth:`launch_list`, before anybody asks for indices.
    """

    def __init__(self, num_envs: int, device: str):
        self.worlds = wp.zeros(num_envs + 1, dtype=wp.bool, device=device)
        self.array = self.worlds[:num_envs]
        self.tensor = wp.to_torch(self.array)
        self.order = wp.zeros(num_envs, dtype=wp.int64, device=device)
        self.count = wp.zeros(1, dtype=int, device=device)
        self._counts = wp.zeros(-(-num_envs // int(BLOCK)), dtype=int, device=device)
        self._report = HostFlags(1, device, dtype=wp.int64)
        self._lists_made = wp.zeros(1, dtype=int, device=device)
        self.listed_in_step = False
        self._listed = False
        self._lists = 0
        """How often the list has been made, or will have been once all that was launched is done."""
        self._awaited = True
        """Whether the report of the last list has been seen: one that is still to come could be taken for the next."""
        self._number: int | None = None
        self._on_device: torch.Tensor | None = None
        self._on_host: torch.Tensor | None = None

    def begin_step(self) -> None:
        """Drop the indices of the last step. Call it before the mask is written."""
        if not self._awaited:  # an error ended the last step
            self._synchronize()
        self._listed, self._awaited = False, not self.listed_in_step
        self._number = self._on_device = self._on_host = None

    def choose(self, env_mask: torch.Tensor) -> None:
        """Set the mask; ``env_mask`` is bool, shape ``(num_envs,)``."""
        self.begin_step()
        self.tensor.copy_(env_mask)

    def launch_list(self) -> None:
        """Launch the kernels that list the environments. They may be part of a graph."""
        num_envs, device = len(self.order), self.array.device
        wp.launch(count_masked, len(self._counts), [self.array], [self._counts], device=device)
        inputs, outputs = [self.array, self._counts], [self.order, self.count, self._lists_made, self._report.array]
        wp.launch(list_masked_first, num_envs, inputs, outputs, device=device)
        if not device.is_capturing:
            self._note_list()

    def _note_list(self) -> None:
        self._lists += 1
        self._listed, self._awaited = True, False

    @property
    def number(self) -> int:
        """Number of environments in the mask. The first call of a step waits for the device."""
        if self._number is None:
            self._list()
            self.wait()
            self._number = self._report[0] & 0xFFFFFFFF
        return self._number

    def wait(self) -> None:
        """Wait until the device has reported the number.

        The host looks at memory that the kernel writes, which is some tens of microseconds faster than to wait for a
        stream. If the report does not come, as nobody launched the list, it waits for all that was launched.
        """
        for _ in range(_LOOKS):
            if self._report[0] >> 32 == self._lists:
                self._awaited = True
                return
        self._synchronize()

    def _synchronize(self) -> None:
        wp.synchronize_device(self.array.device)
        self._lists, self._awaited = self._report[0] >> 32, True

    def indices(self) -> torch.Tensor:
        """Indices of the environments, int64, shape ``(n,)``, on the device. The first call of a step waits for it."""
        if self._on_device is None:
            number = self.number
            self._list()
            self._on_device = wp.to_torch(self.order)[:number].clone()  # whoever asks may keep it
        return self._on_device

    def indices_on_host(self) -> torch.Tensor:
        """The same on the CPU."""
        if self._on_host is None:
            self._on_host = self.tensor.cpu().nonzero().squeeze(-1)
            self._number = len(self._on_host)
        return self._on_host

    def _list(self) -> None:
        if self._listed:
            return
        if self.listed_in_step:  # by a graph
            self._note_list()
        else:
            self.launch_list()
