# SPDX-License-Identifier: Apache-2.0
"""Buffers of ``isaaclab.utils.buffers``: pasts of batched tensors, for delays and histories in torch code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

__all__ = ["CircularBuffer", "DelayBuffer", "TimestampedBuffer"]

Rows = Sequence[int] | torch.Tensor | slice | None
"""Rows of the batch; ``None`` for all."""


class CircularBuffer:
    """The latest entries of a stream of tensors, one past for each row of the batch.

    The first entry of a row after a reset fills its whole past.
    """

    def __init__(self, max_len: int, batch_size: int, device: str):
        """Make an empty buffer.

        Args:
            max_len: Number of entries that are kept, at least 1.
            batch_size: Rows of each entry.
            device: Torch device of the entries.

        Raises:
            ValueError: ``max_len`` is less than 1.
        """
        if max_len < 1:
            raise ValueError(f"max_len is {max_len}, must be 1 or more")
        self.max_length, self.batch_size, self.device = max_len, batch_size, device
        self._pushes = torch.zeros(batch_size, dtype=torch.long, device=device)
        self._rows = torch.arange(batch_size, device=device)
        self._entries: torch.Tensor | None = None  # newest first, shape (max_len, batch_size, ...)

    @property
    def current_length(self) -> torch.Tensor:
        """Number of entries since the last reset, at most ``max_length``, shape ``(batch_size,)``."""
        return self._pushes.clamp(max=self.max_length)

    @property
    def buffer(self) -> torch.Tensor:
        """All entries, the oldest first, shape ``(batch_size, max_length, ...)``.

        Raises:
            RuntimeError: nothing was appended yet.
        """
        return self._filled().flip(0).transpose(0, 1)

    def reset(self, batch_ids: Rows = None) -> None:
        """Forget the past of rows; their entries are zero until the next :meth:`append`."""
        rows = slice(None) if batch_ids is None else batch_ids
        self._pushes[rows] = 0
        if self._entries is not None:
            self._entries[:, rows] = 0

    def append(self, data: torch.Tensor) -> None:
        """Add an entry.

        Args:
            data: Shape ``(batch_size, ...)``.

        Raises:
            ValueError: it has another number of rows.
        """
        if len(data) != self.batch_size:
            raise ValueError(f"data has {len(data)} rows, the buffer has {self.batch_size}")
        data = data.to(self.device)
        if self._entries is None:
            self._entries = data.expand(self.max_length, *data.shape).clone()
        else:
            self._entries = torch.cat([data[None], self._entries[:-1]])
        first = self._pushes == 0
        self._entries[:, first] = data[first]
        self._pushes += 1

    def __getitem__(self, key: torch.Tensor) -> torch.Tensor:
        """Entries of some steps ago, or the oldest since the last reset.

        Args:
            key: Steps back for each row, 0 for the newest entry, shape ``(batch_size,)``.

        Returns:
            Shape ``(batch_size, ...)``.

        Raises:
            ValueError: ``key`` has another length.
            RuntimeError: a row has no entry since the last reset.
        """
        if len(key) != self.batch_size:
            raise ValueError(f"key has {len(key)} rows, the buffer has {self.batch_size}")
        entries = self._filled()
        if bool((self._pushes == 0).any()):
            raise RuntimeError("a row of the buffer has no entry yet; call append() after a reset")
        return entries[torch.minimum(key.long(), self._pushes - 1).clamp(max=self.max_length - 1), self._rows]

    def _filled(self) -> torch.Tensor:
        if self._entries is None:
            raise RuntimeError("the buffer has no entries yet; call append() first")
        return self._entries


class DelayBuffer:
    """A stream of tensors that comes out some steps later, by a lag for each row of the batch."""

    def __init__(self, history_length: int, batch_size: int, device: str):
        """Make a buffer without a lag.

        Args:
            history_length: The largest lag [steps]; less than 0 counts as 0.
            batch_size: Rows of each entry.
            device: Torch device of the entries.
        """
        self.history_length, self.batch_size, self.device = max(history_length, 0), batch_size, device
        self._past = CircularBuffer(self.history_length + 1, batch_size, device)
        self.time_lags = torch.zeros(batch_size, dtype=torch.int, device=device)

    @property
    def min_time_lag(self) -> int:
        """Least lag of all rows [steps]."""
        return int(self.time_lags.min())

    @property
    def max_time_lag(self) -> int:
        """Largest lag of all rows [steps]."""
        return int(self.time_lags.max())

    def set_time_lag(self, time_lag: int | torch.Tensor, batch_ids: Rows = None) -> None:
        """Set the lag of rows.

        Args:
            time_lag: Lag [steps], one or one for each of the rows.
            batch_ids: The rows.

        Raises:
            TypeError: a lag is no whole number.
            ValueError: a lag is negative or larger than ``history_length``.
        """
        lags = torch.as_tensor(time_lag, device=self.device)
        if lags.is_floating_point() or lags.dtype == torch.bool:
            raise TypeError(f"time_lag has the type {lags.dtype}, must be whole numbers")
        if lags.numel() and (int(lags.min()) < 0 or int(lags.max()) > self.history_length):
            raise ValueError(
                f"time_lag is {time_lag}, must be from 0 to history_length, which is {self.history_length}"
            )
        self.time_lags[slice(None) if batch_ids is None else batch_ids] = lags.to(torch.int)

    def reset(self, batch_ids: Rows = None) -> None:
        """Forget the past of rows: the next entry comes out until it is as old as the lag."""
        self._past.reset(batch_ids)

    def compute(self, data: torch.Tensor) -> torch.Tensor:
        """Put in an entry and take out that of each row's lag, shape ``(batch_size, ...)``."""
        self._past.append(data)
        return self._past[self.time_lags]


@dataclass
class TimestampedBuffer:
    """A tensor and the time when it was written."""

    data: torch.Tensor | None = None
    """The tensor, or ``None`` before the first one."""
    timestamp: float = -1.0
    """Time of ``data`` [s], -1 before the first one."""
