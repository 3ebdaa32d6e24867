# SPDX-License-Identifier: Apache-2.0
"""BoundedRatePPO: rsl_rl's PPO with another upper bound of its adaptive learning rate."""

from __future__ import annotations

from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage

__all__ = ["BoundedRatePPO"]


class BoundedRatePPO(PPO):
    """PPO whose adaptive learning rate stays at or below a bound; rsl_rl's is always 0.01."""

    def __init__(
        self,
        actor: MLPModel,
        critic: MLPModel,
        storage: RolloutStorage,
        *args: object,
        max_learning_rate: float,
        **kwargs: object,
    ) -> None:
        """Take the arguments of rsl_rl's ``PPO``, and the bound."""
        self._max_rate = max_learning_rate
        super().__init__(actor, critic, storage, *args, **kwargs)

    @property
    def learning_rate(self) -> float:
        """The learning rate. The update of rsl_rl sets it after each minibatch."""
        return self._rate

    @learning_rate.setter
    def learning_rate(self, value: float) -> None:
        self._rate = min(value, self._max_rate) if self.schedule == "adaptive" else value
