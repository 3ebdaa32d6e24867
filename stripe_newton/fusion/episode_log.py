# SPDX-License-Identifier: Apache-2.0
"""Episode log: values that kernels sum on the device and that a step returns.

>>> from stripe_newton.fusion import EpisodeLog, Scope
>>> log = EpisodeLog(Scope(), "cpu")
>>> log.line("Episode_Reward/alive", "sums[env, 0]").text
'log_add(log_sums, log_counts, 0, sums[env, 0])'
"""

from __future__ import annotations

import warp as wp

from stripe_kernels.episode import LOG_COUNT, LOG_LAST, LOG_MEAN, finish_log, log_add

from .scope import Scope
from .source import Code

__all__ = ["EpisodeLog"]

_CAPACITY = 1024
_KINDS = {"mean": int(LOG_MEAN), "count": int(LOG_COUNT), "last": int(LOG_LAST)}
"""Numbers of the kinds of entries in the kernels."""


class EpisodeLog:
    """Log entries by key, such as ``Episode_Reward/alive``. Kernels add to them; :meth:`finish` computes their values.

    Kinds of entries: ``"mean"`` is the mean over the environments whose episodes ended in the step, kept until the next
    ones end; ``"count"`` is the sum over the environments in the step; ``"last"`` is the value added last.
    """

    def __init__(self, scope: Scope, device: str):
        self._scope = scope
        self.keys: list[str] = []
        """Keys in order of ``values``."""
        self._kinds = wp.zeros(_CAPACITY, dtype=int, device=device)
        self.sums = wp.zeros(_CAPACITY, dtype=float, device=device)
        self.counts = wp.zeros(_CAPACITY, dtype=int, device=device)
        self._names = scope.name("log_sums", self.sums), scope.name("log_counts", self.counts)
        self.values = wp.zeros(_CAPACITY, dtype=float, device=device)
        """Values of the step, one for each key; :meth:`bind` replaces the array."""

    def add(self, key: str, kind: str = "mean") -> int:
        """Register a key. Returns its index in :attr:`values`.

        Raises:
            ValueError: for an unknown kind, or too many keys.
        """
        if kind not in _KINDS:
            raise ValueError(f"log '{key}': kind is '{kind}', must be one of {', '.join(_KINDS)}")
        if key not in self.keys:
            if len(self.keys) == _CAPACITY:
                raise ValueError(f"log '{key}': more than {_CAPACITY} keys")
            wp.to_torch(self._kinds)[len(self.keys)] = _KINDS[kind]
            self.keys.append(key)
        return self.keys.index(key)

    def line(self, key: str, value: Code | str, kind: str = "mean") -> Code:
        """Source line that adds a value of one environment to an entry, which is registered if it is new."""
        return self._scope.call(log_add, *self._names, self.add(key, kind), value)

    def bind(self, values: wp.array) -> None:
        """Let :meth:`finish` write to another array, float, shape ``(capacity,)``.

        Call it before graphs are recorded, as they hold the address of the array.
        """
        self.values = values

    capacity = _CAPACITY
    """Largest number of keys. Arrays do not grow, as graphs hold their addresses."""

    def clear(self) -> None:
        """Discard everything added since the last :meth:`finish`."""
        self.sums.zero_()
        self.counts.zero_()

    def finish(self) -> None:
        """Compute the values of the step and clear the sums, by one kernel."""
        if self.keys:
            inputs, outputs = [self._kinds, self.sums, self.counts], [self.values]
            wp.launch(finish_log, dim=len(self.keys), inputs=inputs, outputs=outputs, device=self.sums.device)
