# SPDX-License-Identifier: Apache-2.0
"""Hook fusion: whether the recordings of one hook hold kernels of chains, and what that saves."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

import torch

from .chain import ChainCode
from .chain_kernels import compile_chains
from .function_check import check_functions
from .fusing_mode import FusingMode

__all__ = ["HookFusion"]


@dataclass(frozen=True)
class _Counts:
    """Launches of a hook."""

    operations: int
    launches: int


class HookFusion:
    """Fuses the operations of a hook, as long as that gives the same numbers.

    Attributes:
        reason: Why it is not fused; empty while it is or may be.
    """

    def __init__(self, device: str, num_envs: int):
        """Prepare.

        Args:
            device: Device of the environment.
            num_envs: Number of environments; 0 to fuse nothing.
        """
        self.reason = ""
        self._device, self._num_envs = device, num_envs
        self._counts: dict[int, _Counts] = {}
        self._tracing: int | None = None
        self._recorded: list[ChainCode] = []

    def is_untried(self, variant: int) -> bool:
        """Whether it is still to be tried for a variant of the hook."""
        return self._num_envs > 0 and not self.reason and variant not in self._counts

    def fuses(self, variant: int) -> bool:
        """Whether the recording of a variant holds kernels of chains."""
        return not self.reason and variant in self._counts

    @contextlib.contextmanager
    def tracing(self, variant: int) -> Iterator[None]:
        """Context in which a run of the hook's recorded form is watched, and its chains are compiled at the end."""
        check_functions(self._device)
        mode = FusingMode(torch.device(self._device), self._rows(variant), launches=False)
        self._tracing = variant
        try:
            with mode:
                yield
        finally:
            self._tracing = None
        compile_chains(mode.codes, self._device)
        self._counts[variant] = _Counts(mode.operations, mode.launched)

    @contextlib.contextmanager
    def recording(self, variant: int) -> Iterator[None]:
        """Context of a recording of a variant."""
        if self._tracing == variant or not self.fuses(variant):
            yield
            return
        mode = FusingMode(torch.device(self._device), self._rows(variant), launches=True)
        with mode:
            yield
        self._recorded += mode.codes  # keeps the memory that the recording writes

    def _rows(self, variant: int) -> tuple[int, ...]:
        return (self._num_envs, variant) if variant else (self._num_envs,)

    def give_up(self, reason: str) -> None:
        """Fuse nothing any more; the first reason is kept. Recordings that there are keep their memory."""
        self.reason = self.reason or reason
        self._counts.clear()

    def forget(self) -> None:
        """Drop what is known of recordings, which are made anew."""
        self._counts.clear()
        self._recorded.clear()

    @property
    def status(self) -> str:
        """Part of the description of the hook; empty if there is nothing to say."""
        if self.reason:
            return f"not fused: {self.reason}"
        if not self._counts:
            return ""
        counts = self._counts[max(self._counts)]
        return f"{counts.operations} operations in {counts.launches} launch{'' if counts.launches == 1 else 'es'}"
