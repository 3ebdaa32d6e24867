# SPDX-License-Identifier: Apache-2.0
"""GraphPPO: rsl_rl's PPO with its update as CUDA graphs and without host synchronisation."""

from __future__ import annotations

import torch
import warp as wp
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from rsl_rl.modules.distribution import GaussianDistribution
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from stripe_kernels.adam import adapt_rate
from stripe_kernels.rollout import BLOCK, estimate_advantages

from .flat_adam import FlatAdam, as_array
from .network_pass import EluPass, NetworkPass, network_output, network_pass
from .picture_layers import picture_latent
from .ppo_gradient import PpoGradient
from .program import Program
from .side_by_side import SideBySide

__all__ = ["GraphPPO", "update_normalizer_in_place"]

_MIN_RATE = 1.0e-5
"""Lower bound of the adaptive learning rate, rsl_rl's."""
_ADAMS = torch.optim.Adam, torch.optim.AdamW


class GraphPPO(PPO):
    """PPO whose update is three CUDA graphs: returns, an epoch, and the observation normalisers.

    It computes what rsl_rl computes, in the same order. Learning rate, KL divergence and gradient norms stay on the
    device, so the host never waits for it. With several GPUs a minibatch is two graphs, between which its gradients
    are averaged. Where a graph cannot hold the update (:attr:`why_no_update_graph`),
    rsl_rl's own update runs.

    Reference:
        Schulman et al. "Proximal policy optimization algorithms", arXiv:1707.06347 (2017).
    """

    optimizer: torch.optim.Optimizer
    _rate: torch.Tensor

    def __init__(
        self,
        actor: MLPModel,
        critic: MLPModel,
        storage: RolloutStorage,
        *args: object,
        max_learning_rate: float = 1.0e-2,
        **kwargs: object,
    ) -> None:
        """Take the arguments of rsl_rl's ``PPO``, and an upper bound of the adaptive learning rate."""
        self._max_rate = max_learning_rate
        super().__init__(actor, critic, storage, *args, **kwargs)
        self._programs: dict[str, Program] = {}
        self._passes: tuple[NetworkPass, ...] = ()
        self.why_no_update_graph = self._why_no_update_graph()
        """Reason why the update is rsl_rl's own; empty if it is a graph."""
        if not self.why_no_update_graph:
            self._adam = FlatAdam(self.optimizer, self.actor, self.critic, self._rate, self.max_grad_norm)

    # -- learning rate, on the device

    @property
    def learning_rate(self) -> float:
        """The learning rate. Reading it synchronises with the device; :attr:`rate` does not."""
        return float(self._rate)

    @learning_rate.setter
    def learning_rate(self, value: float) -> None:
        if "_rate" not in vars(self):  # rsl_rl's constructor is the first to set it
            # In float64 the repeated factors of the schedule round as rsl_rl's Python floats do.
            self._rate = torch.zeros((), dtype=torch.float64, device=self.device)
        self._rate.fill_(min(value, self._max_rate) if self.schedule == "adaptive" else value)

    @property
    def rate(self) -> torch.Tensor:
        """The learning rate on the device, float64, no dimensions. The same memory at all times, so values change."""
        return self._rate

    @property
    def std(self) -> torch.Tensor:
        """Mean standard deviation of the actions in the last minibatch, on the device. The same memory at all times."""
        return self._std

    # -- interface of rsl_rl's runner

    def compute_returns(self, obs: TensorDict) -> None:
        """Keep the last observations. Returns and advantages are computed in :meth:`update`."""
        if self.why_no_update_graph:
            super().compute_returns(obs)
            return
        if not self._programs:
            self._allocate(obs)
        for name, value in obs.items():
            self._last_obs[name].copy_(value)

    def update(self) -> dict[str, float | torch.Tensor]:
        """Compute returns, run all epochs over the minibatches, update the observation normalisers.

        Returns:
            Mean losses by name. Where the update is a graph they are tensors without dimensions on the device, in
            memory of their own, and the host has not waited for them.
        """
        if self.why_no_update_graph:
            return super().update()
        programs = self._programs
        programs["returns"].run()
        # The same permutation for all epochs, as rsl_rl's generator of minibatches has it.
        self._indices.copy_(torch.randperm(len(self._indices), device=self.device))
        for _ in range(self.num_learning_epochs):
            if self.is_multi_gpu:
                self._learn_epoch_with_ranks()
            else:
                programs["epoch"].run()
        if self.is_multi_gpu:
            self._finish()
        else:
            programs["finish"].run()
        self.storage.clear()
        # A copy: the next update overwrites the losses while these are on their way to the host.
        return dict(zip(self._loss_names, self._losses.clone().unbind(), strict=True))

    def save(self) -> dict[str, object]:
        """The state of networks and optimiser, in a form that rsl_rl's PPO can read too."""
        if not self.why_no_update_graph:
            for group in self.optimizer.param_groups:
                group["lr"] = self.learning_rate
        saved = super().save()
        if not self.why_no_update_graph:
            # Here all parameters share one count of steps. Torch's Adam would count it up once for each of them.
            optimizer = saved["optimizer_state_dict"]
            states = {key: state | {"step": state["step"].clone()} for key, state in optimizer["state"].items()}
            saved["optimizer_state_dict"] = optimizer | {"state": states}
        return saved

    def load(self, loaded_dict: dict, load_cfg: dict | None, strict: bool) -> bool:
        """Load what :meth:`save` or rsl_rl's PPO saved. The graphs are recorded again."""
        iteration = super().load(loaded_dict, load_cfg, strict)
        if not self.why_no_update_graph:
            self._adam.take_state()
            # The optimiser's settings may be other ones, and are recorded.
            for program in self._programs.values():
                program.invalidate()
        return iteration

    # -- construction

    def _why_no_update_graph(self) -> str:
        if self.rnd is not None:
            return "random network distillation reads values on the host"
        for name, model in (("actor", self._raw_actor), ("critic", self._raw_critic)):
            if model.is_recurrent:
                return f"the {name} is recurrent, its minibatches differ in size"
            # The update calls the parts of `MLPModel.forward` one by one and would skip a subclass's own.
            if model.forward.__func__ is not MLPModel.forward:
                return f"the {name}, a {type(model).__name__}, has a forward pass of its own"
            normalizer = model.obs_normalizer
            if isinstance(normalizer, EmpiricalNormalization):
                if normalizer.until is not None:
                    return f"the {name} stops updating its normaliser after a number of samples"
            elif not isinstance(normalizer, torch.nn.Identity):
                return f"the {name} has a {type(normalizer).__name__}"
        if self.actor is not self._raw_actor:
            return "the networks are compiled (torch_compile_mode)"
        if type(self.optimizer) not in _ADAMS:
            return f"the optimiser is {type(self.optimizer).__name__}, not Adam"
        return ""

    # rsl_rl's loop runs in inference mode, and a tensor made in it cannot be written outside of it.
    @torch.inference_mode(False)
    def _allocate(self, obs: TensorDict) -> None:
        storage, device = self.storage, self.device
        samples = storage.num_envs * storage.num_transitions_per_env // self.num_mini_batches
        self._indices = torch.zeros(samples * self.num_mini_batches, dtype=torch.int64, device=device)
        self._batch_indices = torch.zeros(samples, dtype=torch.int64, device=device)
        self._last_obs = obs.clone()
        self._loss_names = ["value", "surrogate", "entropy", *(["symmetry"] if self.symmetry else [])]
        self._losses = torch.zeros(len(self._loss_names), device=device)
        self._kl, self._std = torch.zeros((), device=device), torch.zeros((), device=device)
        if type(self.actor.distribution) is GaussianDistribution and not self.symmetry:
            copies = self._adam.make_copies() if self.use_mixed_precision else None
            self._passes = tuple(network_pass(m, copies) for m in (self.actor, self.critic))
            self._side_by_side = SideBySide(device, all(isinstance(network, EluPass) for network in self._passes))
            self._gradient = PpoGradient(self, self._batch_indices, self._losses, self._kl, self._std)
        functions = {"returns": self._compute_returns}
        if self.is_multi_gpu:
            # Averages over the ranks are collective calls, which stay outside the graphs: between gradients and step,
            # and within the normalisers' update.
            functions |= {"gradients": self._compute_gradients, "step": self._take_step}
        else:
            functions |= {"epoch": self._learn_epoch, "finish": self._finish}
        self._programs = {name: Program(function, device) for name, function in functions.items()}

    # -- parts of the update, each the function of a program

    @torch.no_grad()
    def _compute_returns(self) -> None:
        """Returns and advantages, by generalised advantage estimation (Schulman et al., arXiv:1506.02438)."""
        st = self.storage
        last_values = as_array(network_output(self.critic, self._last_obs).flatten())
        rewards, dones, values, returns, advantages = (
            as_array(t.squeeze(-1)) for t in (st.rewards, st.dones, st.values, st.returns, st.advantages)
        )
        inputs = [rewards, dones, values, last_values, self.gamma, self.lam, returns, advantages]
        wp.launch(estimate_advantages, dim=st.num_envs, inputs=inputs, device=rewards.device, block_dim=BLOCK)
        if not self.normalize_advantage_per_mini_batch:
            # In the same memory; rsl_rl binds a new tensor here, which the recorded minibatch would not see.
            mean, std = st.advantages.mean(), st.advantages.std()
            st.advantages.sub_(mean).div_(std + 1e-8)
        self._losses.zero_()

    def _learn_epoch(self) -> None:
        for batch_indices in self._indices.chunk(self.num_mini_batches):
            self._batch_indices.copy_(batch_indices)
            self._compute_gradients()
            self._take_step()

    def _learn_epoch_with_ranks(self) -> None:
        """The same in graphs for parts of a minibatch."""
        for batch_indices in self._indices.chunk(self.num_mini_batches):
            self._batch_indices.copy_(batch_indices)
            self._programs["gradients"].run()
            self._average_over_ranks()
            self._programs["step"].run()

    def _compute_gradients(self) -> None:
        """Losses, KL divergence and gradients of a minibatch."""
        if not self._passes:
            self._compute_gradients_by_autograd()
            return
        actor_pass, critic_pass = self._passes
        found, batch_indices = self._gradient, self._batch_indices
        stored = self.storage.observations.flatten(0, 1)
        self._adam.gradient.zero_()
        self._adam.update_copies()
        mean, values = self._side_by_side.run(
            lambda: actor_pass.forward(stored, batch_indices), lambda: critic_pass.forward(stored, batch_indices)
        )
        # rsl_rl draws actions here and does not use them. Drawing them keeps the random numbers that follow equal.
        torch.empty_like(mean).normal_()
        found.compute(mean, values)
        self._side_by_side.run(
            lambda: actor_pass.backward(found.grad_mean), lambda: critic_pass.backward(found.grad_value)
        )

    def _compute_gradients_by_autograd(self) -> None:
        """The same by torch's autograd, for what the fused loss does not cover."""
        batch, count = self._minibatch(), len(self._batch_indices)
        if self.symmetry:
            self.symmetry.augment_batch(batch, count)
        kind = torch.device(self.device).type
        # torch's cache of weights in bfloat16 must be off where a graph is recorded.
        with torch.autocast(kind, dtype=torch.bfloat16, enabled=self.use_mixed_precision, cache_enabled=False):
            actor = self.actor
            actor.distribution.update(actor.mlp(picture_latent(actor, batch.observations)))
            # rsl_rl draws actions here and does not use them. Drawing them keeps the random numbers that follow equal.
            torch.empty_like(actor.output_mean).normal_()
            log_prob = actor.get_output_log_prob(batch.actions)
            values = self.critic(batch.observations)
            # Entropy and KL divergence count the original samples alone, not the mirrored ones behind them.
            params = tuple(p[:count] for p in actor.output_distribution_params)
            entropy = actor.output_entropy[:count].mean()
            with torch.no_grad():
                self._kl.copy_(actor.get_kl_divergence(batch.old_distribution_params, params).mean())
            surrogate_loss = self._surrogate_loss(log_prob, batch)
            value_loss = self._value_loss(values, batch)
            loss = surrogate_loss + self.value_loss_coef * value_loss - self.entropy_coef * entropy
            losses = [value_loss, surrogate_loss, entropy]
            if self.symmetry:
                losses.append(self.symmetry.compute_loss(actor, batch, count))
                if self.symmetry.use_mirror_loss:
                    loss = loss + self.symmetry.mirror_loss_coeff * losses[-1]
        self._adam.gradient.zero_()
        loss.backward()
        with torch.no_grad():
            self._losses += torch.stack([value.detach().float() for value in losses])
            self._std.copy_(actor.output_std.mean())

    def _minibatch(self) -> RolloutStorage.Batch:
        """The samples that ``_batch_indices`` names."""
        st, batch_indices = self.storage, self._batch_indices
        rows = {name: value.flatten(0, 1)[batch_indices] for name, value in st.observations.items()}
        batch = RolloutStorage.Batch(
            observations=TensorDict(rows, batch_size=[len(batch_indices)]),
            old_distribution_params=tuple(p.flatten(0, 1)[batch_indices] for p in st.distribution_params),
            actions=st.actions.flatten(0, 1)[batch_indices],
            values=st.values.flatten(0, 1)[batch_indices],
            advantages=st.advantages.flatten(0, 1)[batch_indices],
            returns=st.returns.flatten(0, 1)[batch_indices],
            old_actions_log_prob=st.actions_log_prob.flatten(0, 1)[batch_indices],
        )
        if self.normalize_advantage_per_mini_batch:
            batch.advantages = (batch.advantages - batch.advantages.mean()) / (batch.advantages.std() + 1e-8)
        return batch

    def _surrogate_loss(self, log_prob: torch.Tensor, batch: RolloutStorage.Batch) -> torch.Tensor:
        """The clipped surrogate objective, equation 7 of Schulman et al. (2017), with its sign changed."""
        advantages = -torch.squeeze(batch.advantages)
        ratio = torch.exp(log_prob - torch.squeeze(batch.old_actions_log_prob))
        clipped = ratio.clamp(1.0 - self.clip_param, 1.0 + self.clip_param)
        return torch.max(advantages * ratio, advantages * clipped).mean()

    def _value_loss(self, values: torch.Tensor, batch: RolloutStorage.Batch) -> torch.Tensor:
        losses = (values - batch.returns).pow(2)
        if not self.use_clipped_value_loss:
            return losses.mean()
        clipped = batch.values + (values - batch.values).clamp(-self.clip_param, self.clip_param)
        return torch.max(losses, (clipped - batch.returns).pow(2)).mean()

    def _average_over_ranks(self) -> None:
        """Average KL divergence and gradients over the ranks."""
        torch.distributed.all_reduce(self._kl)
        self._kl /= self.gpu_world_size
        self.reduce_parameters()

    def _take_step(self) -> None:
        """Adapt the learning rate to the KL divergence, clip the gradients, take a step of the optimiser."""
        if self.desired_kl is not None and self.schedule == "adaptive":
            kl, rate = as_array(self._kl.view(1)), as_array(self._rate.view(1))
            inputs = [kl, self.desired_kl, _MIN_RATE, self._max_rate, rate]
            wp.launch(adapt_rate, dim=1, inputs=inputs, device=kl.device)
        self._adam.step()

    @torch.no_grad()
    def _finish(self) -> None:
        """Mean losses, and the observation normalisers' update with all samples of the rollout."""
        self._losses /= self.num_learning_epochs * self.num_mini_batches
        for model in (self.actor, self.critic):
            if isinstance(model.obs_normalizer, EmpiricalNormalization) and model.training and model.obs_groups:
                flat = self.storage.observations.flatten(0, 1)
                samples = torch.cat([flat[g] for g in model.obs_groups], dim=-1)
                update_normalizer_in_place(model.obs_normalizer, samples, self.gpu_world_size)


def update_normalizer_in_place(normalizer: EmpiricalNormalization, x: torch.Tensor, ranks: int) -> None:
    """``normalizer.update(x)`` without new memory and without values from the host (Chan et al. 1979).

    rsl_rl's method binds a new tensor as standard deviation, while recorded graphs go on reading the old one, and it
    makes its count from a number on the host, which would be copied in each replay.

    Args:
        normalizer: Normaliser to update.
        x: Samples, ``(samples, size)``.
        ranks: Number of ranks. With several the update is over the samples of all; each must have equally many.
    """
    variance, mean = torch.var_mean(x, dim=0, unbiased=False, keepdim=True)
    if ranks > 1:
        own = mean.clone()
        torch.distributed.all_reduce(mean)
        mean /= ranks
        # The variance about the mean of all is the own one plus the squared distance of the means.
        variance += (own - mean).square()
        torch.distributed.all_reduce(variance)
        variance /= ranks
    normalizer.count += len(x) * ranks
    rate = len(x) * ranks / normalizer.count
    change = mean - normalizer._mean
    normalizer._mean += rate * change
    normalizer._var += rate * (variance - normalizer._var + change * (mean - normalizer._mean))
    normalizer._std.copy_(torch.sqrt(normalizer._var))
