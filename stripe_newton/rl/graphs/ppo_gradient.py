# SPDX-License-Identifier: Apache-2.0
"""PPO gradient: losses of a minibatch and their gradients by the networks' outputs, in three kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
import warp as wp

from stripe_kernels.ppo import BLOCK, LOSS_TERMS, finish_ppo_loss, ppo_loss

from .flat_adam import as_array

if TYPE_CHECKING:
    from rsl_rl.modules.distribution import GaussianDistribution

    from .ppo import GraphPPO

__all__ = ["PpoGradient"]


class PpoGradient:
    """Losses and gradients of PPO for Gaussian actions whose standard deviation does not depend on the state.

    It reads the storage where it is, and writes the same memory in every call.

    Attributes:
        grad_mean: Gradient of the loss by the means of the actions, ``(samples, actions)``.
        grad_value: Gradient of the loss by the values, ``(samples, 1)``.
    """

    def __init__(
        self,
        algorithm: GraphPPO,
        batch_indices: torch.Tensor,
        losses: torch.Tensor,
        kl: torch.Tensor,
        mean_std: torch.Tensor,
    ):
        """Bind to the storage and the action distribution of an algorithm.

        Args:
            algorithm: PPO; its storage must have distribution parameters.
            batch_indices: Rows of the minibatch in the flattened storage, int64, ``(samples,)``; read in every call.
            losses: Value loss, surrogate and entropy are added to it, ``(3,)``.
            kl: Takes the mean KL divergence of the old distributions from the new ones, no dimensions.
            mean_std: Takes the mean standard deviation of the actions, no dimensions.
        """
        st, self._algorithm, self._batch_indices = algorithm.storage, algorithm, batch_indices
        samples, actions, device = len(batch_indices), st.actions.shape[-1], batch_indices.device
        self.grad_mean = torch.zeros(samples, actions, device=device)
        self.grad_value = torch.zeros(samples, 1, device=device)
        self._terms = torch.zeros(LOSS_TERMS + actions, samples, device=device)
        # Subtracted from an advantage, and dividing it after that.
        self._scale = torch.tensor([0.0, 1.0], device=device)
        old_mean, old_std = st.distribution_params
        self._advantages = st.advantages.flatten()
        rows = [t.flatten(0, 1) for t in (st.actions, old_mean, old_std)]
        flat = [st.actions_log_prob.flatten(), st.values.flatten(), self._advantages, st.returns.flatten()]
        self._rows = as_array(batch_indices)
        self._stored = [as_array(t) for t in (*rows, *flat, self._scale)]
        self._outputs = [as_array(t) for t in (self.grad_mean, self.grad_value.flatten(), self._terms)]
        self._totals = [as_array(t) for t in (losses, kl.view(1), mean_std.view(1))]
        self._std = self._std_arguments(algorithm.actor.distribution)

    @staticmethod
    def _std_arguments(distribution: GaussianDistribution) -> list[wp.array | float | bool]:
        is_log = distribution.std_type == "log"
        parameter = distribution.log_std_param if is_log else distribution.std_param
        bounds = distribution.log_std_range if is_log else distribution.std_range
        return [as_array(parameter.detach()), *bounds, is_log]

    @torch.no_grad()
    def compute(self, mean: torch.Tensor, values: torch.Tensor) -> None:
        """Compute losses and gradients, also that of the standard deviations, into their parameters' ``grad``.

        Args:
            mean: Means of the actions, ``(samples, actions)``.
            values: Values, ``(samples, 1)``.
        """
        algorithm, device = self._algorithm, self._rows.device
        if algorithm.normalize_advantage_per_mini_batch:
            advantages = self._advantages[self._batch_indices]
            self._scale.copy_(torch.stack((advantages.mean(), advantages.std() + 1e-8)))
        outputs = [as_array(mean.contiguous()), *self._std, as_array(values.flatten())]
        options = [algorithm.clip_param, algorithm.value_loss_coef, algorithm.use_clipped_value_loss]
        inputs = [self._rows, *outputs, *self._stored, *options, *self._outputs]
        wp.launch(ppo_loss, dim=len(mean), inputs=inputs, device=device, block_dim=BLOCK)
        means = as_array(self._terms.mean(dim=1))
        parameter = next(algorithm.actor.distribution.parameters())
        gradient = as_array(parameter.grad) if parameter.requires_grad else None
        inputs = [means, *self._std, algorithm.entropy_coef, *self._totals, gradient]
        wp.launch(finish_ppo_loss, dim=1, inputs=inputs, device=device, block_dim=BLOCK)
