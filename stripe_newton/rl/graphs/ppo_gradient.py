# SPDX-License-Identifier: Apache-2.0
"""PPO gradient: losses of a minibatch and their gradients by the networks' outputs, in one kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
import warp as wp

from stripe_kernels.ppo import LOSS_TERMS, ppo_loss

from .flat_adam import as_array

if TYPE_CHECKING:
    from .ppo import GraphPPO

__all__ = ["LossGradient", "PpoGradient"]


@dataclass
class LossGradient:
    """Losses of a minibatch and their gradients, on the device."""

    value_loss: torch.Tensor
    """Value loss, no dimensions."""
    surrogate_loss: torch.Tensor
    """Surrogate loss, no dimensions."""
    kl: torch.Tensor
    """Mean KL divergence of the old distributions from the new ones, no dimensions."""
    by_mean: torch.Tensor
    """Gradient of the loss, without entropy, by the means of the actions, ``(samples, actions)``."""
    by_std: torch.Tensor
    """The same by the standard deviations of the actions, ``(actions,)``."""
    by_value: torch.Tensor
    """The same by the values, ``(samples, 1)``."""


class PpoGradient:
    """Losses and gradients of PPO for Gaussian actions whose standard deviation does not depend on the state.

    It reads the storage where it is. The tensors that it returns are the same memory in every call.
    """

    def __init__(self, algorithm: GraphPPO, picked: torch.Tensor):
        """Bind to the storage of an algorithm.

        Args:
            algorithm: PPO; its storage must have distribution parameters.
            picked: Rows of the flattened storage that are the minibatch, int64, ``(samples,)``; read in every call.
        """
        st, self._algorithm, self._picked = algorithm.storage, algorithm, picked
        samples, actions, device = len(picked), st.actions.shape[-1], picked.device
        self._by_mean = torch.zeros(samples, actions, device=device)
        self._by_value = torch.zeros(samples, 1, device=device)
        self._terms = torch.zeros(LOSS_TERMS + actions, samples, device=device)
        # Subtracted from an advantage, and dividing it after that.
        self._scale = torch.tensor([0.0, 1.0], device=device)
        old_mean, old_std = st.distribution_params
        self._advantages = st.advantages.flatten()
        rows = [t.flatten(0, 1) for t in (st.actions, old_mean, old_std)]
        flat = [st.actions_log_prob.flatten(), st.values.flatten(), self._advantages, st.returns.flatten()]
        self._rows = as_array(picked)
        self._stored = [as_array(t) for t in (*rows, *flat, self._scale)]
        self._outputs = [as_array(t) for t in (self._by_mean, self._by_value.flatten(), self._terms)]

    @torch.no_grad()
    def compute(self, mean: torch.Tensor, std: torch.Tensor, values: torch.Tensor) -> LossGradient:
        """Losses and gradients.

        Args:
            mean: Means of the actions, ``(samples, actions)``.
            std: Standard deviations of the actions, ``(actions,)``.
            values: Values, ``(samples, 1)``.
        """
        algorithm = self._algorithm
        if algorithm.normalize_advantage_per_mini_batch:
            advantages = self._advantages[self._picked]
            self._scale.copy_(torch.stack((advantages.mean(), advantages.std() + 1e-8)))
        now = [as_array(t) for t in (mean.contiguous(), std.contiguous(), values.flatten())]
        options = [algorithm.clip_param, algorithm.value_loss_coef, algorithm.use_clipped_value_loss]
        inputs = [self._rows, *now, *self._stored, *options, *self._outputs]
        wp.launch(ppo_loss, dim=len(mean), inputs=inputs, device=self._rows.device)
        means = self._terms.mean(dim=1)
        surrogate, value, kl = means[:LOSS_TERMS].unbind()
        return LossGradient(value, surrogate, kl, self._by_mean, means[LOSS_TERMS:], self._by_value)
