# SPDX-License-Identifier: Apache-2.0
"""Episode log: values that kernels add up on the device, handed out once a step."""

from __future__ import annotations

import warp as wp

from stripe_kernels.episode import LOG_COUNT, LOG_LAST, LOG_MEAN, finish_log, log_add

from .scope import Scope
from .source import Code

__all__ = ["EpisodeLog"]

_CAPACITY = 1024
_KINDS = {"mean": int(LOG_MEAN), "count": int(LOG_COUNT), "last": int(LOG_LAST)}


class EpisodeLog:
    """Entries by key, such as ``Episode_Reward/alive``, to which kernels add; :meth:`finish` makes values of them.

    Kinds: ``"mean"`` over the environments whose episodes ended in the step, held until the next time some end;
    ``"count"``: sum over the environments in the step; ``"last"``: what was added last.
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
        """Values of the step, one number a key; replaced by :meth:`bind`."""

    def add(self, key: str, kind: str = "mean") -> int:
        """Register a key; its index.

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
        """The line of a section that adds the value of this environment to an entry."""
        return self._scope.call(log_add, *self._names, self.add(key, kind), value)

    def bind(self, values: wp.array) -> None:
        """Hand out from ``values``, float, shape ``(len(keys),)`` or more."""
        self.values = values

    capacity = _CAPACITY
    """Most keys there can be."""

    def clear(self) -> None:
        """Forget what was added since the last :meth:`finish`."""
        self.sums.zero_()
        self.counts.zero_()

    def finish(self) -> None:
        """Make the values of the step and clear the sums: one kernel."""
        if self.keys:
            inputs, outputs = [self._kinds, self.sums, self.counts], [self.values]
            wp.launch(finish_log, dim=len(self.keys), inputs=inputs, outputs=outputs, device=self.sums.device)
