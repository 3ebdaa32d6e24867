# SPDX-License-Identifier: Apache-2.0
"""rsl_rl's PPO whose update neither waits for the device nor is launched operation by operation."""

from __future__ import annotations

from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from .graph_program import Program

__all__ = ["GraphPPO"]

_MIN_RATE, _MAX_RATE = 1.0e-5, 1.0e-2
_FUSED = torch.optim.Adam, torch.optim.AdamW


class GraphPPO(PPO):
    """PPO of which returns, a minibatch and the normalizers are a CUDA graph each; nobody waits for the device.

    What rsl_rl computes, in its order; learning rate, KL divergence and norms of gradients stay on the device. With
    several GPUs the gradients of each minibatch are averaged between two graphs. Adam is the fused one. Where a graph
    cannot hold the update (:attr:`obstacle`), rsl_rl's own update runs.

    Reference:
        Schulman et al. "Proximal policy optimization algorithms", arXiv:1707.06347 (2017).
    """

    optimizer: torch.optim.Optimizer

    def __init__(self, actor: MLPModel, critic: MLPModel, storage: RolloutStorage, *args: Any, **kwargs: Any):
        """Take the arguments of rsl_rl's ``PPO``."""
        super().__init__(actor, critic, storage, *args, **kwargs)
        self._programs: dict[str, Program] = {}
        self.obstacle = self._find_obstacle()
        """Why the update is rsl_rl's own; empty if it is a graph."""
        if not self.obstacle:
            self._make_optimizer()

    # -- the learning rate, kept on the device

    @property
    def learning_rate(self) -> float:
        """The learning rate; reading waits for the device."""
        return float(self._rate)

    @learning_rate.setter
    def learning_rate(self, value: float) -> None:
        if not hasattr(self, "_rate"):
            self._rate = torch.zeros((), dtype=torch.float64, device=self.device)
            self._rate32 = torch.zeros((), device=self.device)
        self._rate.fill_(value)
        self._rate32.fill_(value)

    @property
    def rate(self) -> torch.Tensor:
        """The learning rate, float64, as it is on the device; its memory changes."""
        return self._rate

    @property
    def std(self) -> torch.Tensor:
        """Mean standard deviation of the actions in the last minibatch, as it is on the device; its memory changes."""
        return self._std

    # -- what rsl_rl's runner calls

    def compute_returns(self, obs: TensorDict) -> None:
        """Keep the last observations; returns and advantages are a part of the update."""
        if self.obstacle:
            super().compute_returns(obs)
            return
        if not self._programs:
            self._allocate(obs)
        for name, value in obs.items():
            self._last_obs[name].copy_(value)

    def update(self) -> dict[str, Any]:
        """Compute returns, run all epochs over the minibatches, update the normalizers.

        Returns:
            Mean losses by name; numbers of the device, that nobody has waited for.
        """
        if self.obstacle:
            return super().update()
        indices = torch.randperm(len(self._picked) * self.num_mini_batches, device=self.device)
        run = {name: program.run for name, program in self._programs.items()}
        run["begin"]()
        for picked in indices.chunk(self.num_mini_batches) * self.num_learning_epochs:
            self._picked.copy_(picked)
            if self.is_multi_gpu:
                run["gradients"]()
                self._average()
                run["step"]()
            else:
                run["minibatch"]()
        run.get("end", self._end)()
        self.storage.clear()
        return dict(zip(self._loss_names, self._losses.clone().unbind(), strict=True))

    def save(self) -> dict:
        """The state of networks and optimizer, in the form in which rsl_rl's PPO reads it, too."""
        saved = super().save()
        if not self.obstacle:
            optimizer = saved["optimizer_state_dict"]
            plain = {"lr": self.learning_rate, "fused": None, "capturable": False}
            optimizer["param_groups"] = [
                g | {k: v for k, v in plain.items() if k in g} for g in optimizer["param_groups"]
            ]
        return saved

    def load(self, loaded_dict: dict, load_cfg: dict | None, strict: bool) -> bool:
        """Load what was saved; graphs are recorded anew."""
        iteration = super().load(loaded_dict, load_cfg, strict)
        if not self.obstacle:
            self._prepare_optimizer()
            for program in self._programs.values():
                program.forget()
        return iteration

    # -- construction

    def _find_obstacle(self) -> str:
        if self.rnd is not None:
            return "random network distillation looks at values on the host"
        for name, model in (("actor", self._raw_actor), ("critic", self._raw_critic)):
            if model.is_recurrent:
                return f"the {name} is recurrent, its minibatches differ in size"
            if model.forward.__func__ is not MLPModel.forward:
                return f"the {name}, a {type(model).__name__}, has a forward pass of its own"
            if not isinstance(model.obs_normalizer, (EmpiricalNormalization, torch.nn.Identity)):
                return f"the {name} has a {type(model.obs_normalizer).__name__}"
            if getattr(model.obs_normalizer, "until", None) is not None:
                return f"the {name} stops to normalize at a number of samples"
        if self.actor is not self._raw_actor:
            return "the networks are compiled (torch_compile_mode)"
        if type(self.optimizer) not in _FUSED:
            return f"{type(self.optimizer).__name__} has no fused form"
        return ""

    def _parameters(self) -> list[torch.nn.Parameter]:
        return [*self.actor.parameters(), *self.critic.parameters()]

    def _make_optimizer(self) -> None:
        kind: Any = type(self.optimizer)
        self.optimizer = kind(self._parameters(), lr=self._rate32, fused=True)
        self._prepare_optimizer()

    def _prepare_optimizer(self) -> None:
        """Let the optimizer read the learning rate from the device, also after a state was loaded."""
        for group in self.optimizer.param_groups:
            group |= {"lr": self._rate32, "fused": True, "capturable": torch.device(self.device).type == "cuda"}
        for state in self.optimizer.state.values():
            state["step"] = torch.as_tensor(state["step"], dtype=torch.float32, device=self.device)

    @torch.inference_mode(False)  # rsl_rl's loop is in one, and what is made there cannot be written elsewhere
    def _allocate(self, obs: TensorDict) -> None:
        storage = self.storage
        samples = storage.num_envs * storage.num_transitions_per_env // self.num_mini_batches
        make: dict[str, Any] = {"device": self.device}
        self._picked = torch.zeros(samples, dtype=torch.int64, **make)
        self._last_obs = obs.clone()
        self._loss_names = ["value", "surrogate", "entropy", *(["symmetry"] if self.symmetry else [])]
        self._losses = torch.zeros(len(self._loss_names), **make)
        self._kl, self._std = torch.zeros((), **make), torch.zeros((), **make)
        alone = {"minibatch": self._learn_minibatch, "end": self._end}
        together = {"gradients": self._gradients, "step": self._step}  # what comes between speaks to other processes
        functions = {"begin": self._begin, **(together if self.is_multi_gpu else alone)}
        self._programs = {name: Program(function, self.device) for name, function in functions.items()}

    # -- the update

    def _learn_minibatch(self) -> None:
        self._gradients()
        self._step()

    def _average(self) -> None:
        """Average KL divergence and gradients over the ranks."""
        torch.distributed.all_reduce(self._kl)
        self._kl /= self.gpu_world_size
        self.reduce_parameters()

    @torch.no_grad()
    def _begin(self) -> None:
        """Returns and advantages, by generalized advantage estimation (Schulman et al., arXiv:1506.02438)."""
        st = self.storage
        following: torch.Tensor = self.critic(self._last_obs)
        advantage = torch.zeros_like(following)
        for step in reversed(range(st.num_transitions_per_env)):
            going_on = 1.0 - st.dones[step].float()
            delta = st.rewards[step] + going_on * self.gamma * following - st.values[step]
            advantage = delta + going_on * self.gamma * self.lam * advantage
            st.returns[step] = advantage + st.values[step]
            following = st.values[step]
        advantages = st.returns - st.values
        if not self.normalize_advantage_per_mini_batch:
            advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        st.advantages.copy_(advantages)
        self._losses.zero_()

    @torch.no_grad()
    def _end(self) -> None:
        self._losses /= self.num_learning_epochs * self.num_mini_batches
        for model in (self.actor, self.critic):
            if isinstance(model.obs_normalizer, EmpiricalNormalization) and model.training and model.obs_groups:
                flat = self.storage.observations.flatten(0, 1)
                samples = torch.cat([flat[g] for g in model.obs_groups], dim=-1)
                _learn_moments(model.obs_normalizer, samples, self.gpu_world_size)

    def _batch(self) -> RolloutStorage.Batch:
        st, picked = self.storage, self._picked
        rows = {name: value.flatten(0, 1)[picked] for name, value in st.observations.items()}
        batch = RolloutStorage.Batch(
            observations=TensorDict(rows, batch_size=[len(picked)]),
            old_distribution_params=tuple(p.flatten(0, 1)[picked] for p in st.distribution_params),
            actions=st.actions.flatten(0, 1)[picked],
            values=st.values.flatten(0, 1)[picked],
            advantages=st.advantages.flatten(0, 1)[picked],
            returns=st.returns.flatten(0, 1)[picked],
            old_actions_log_prob=st.actions_log_prob.flatten(0, 1)[picked],
        )
        if self.normalize_advantage_per_mini_batch:
            batch.advantages = (batch.advantages - batch.advantages.mean()) / (batch.advantages.std() + 1e-8)
        return batch

    def _gradients(self) -> None:
        """Losses, KL divergence and gradients of a minibatch."""
        batch, count = self._batch(), len(self._picked)
        if self.symmetry:
            self.symmetry.augment_batch(batch, count)
        kind = torch.device(self.device).type
        with torch.autocast(kind, dtype=torch.bfloat16, enabled=self.use_mixed_precision, cache_enabled=False):
            actor = self.actor
            actor.distribution.update(actor.mlp(actor.get_latent(batch.observations)))
            torch.empty_like(actor.output_mean).normal_()  # rsl_rl draws actions here: the same random numbers follow
            log_prob = actor.get_output_log_prob(batch.actions)
            values = self.critic(batch.observations)
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
        self.optimizer.zero_grad()
        loss.backward()
        with torch.no_grad():
            self._losses += torch.stack([value.detach().float() for value in losses])
            self._std.copy_(actor.output_std.mean())

    def _surrogate_loss(self, log_prob: torch.Tensor, batch: RolloutStorage.Batch) -> torch.Tensor:
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

    def _step(self) -> None:
        """Adapt the learning rate to the KL divergence, clip the gradients, take a step."""
        if self.desired_kl is not None and self.schedule == "adaptive":
            rate, kl = self._rate, self._kl
            slower, faster = (rate / 1.5).clamp(min=_MIN_RATE), (rate * 1.5).clamp(max=_MAX_RATE)
            rate = torch.where((kl < 0.5 * self.desired_kl) & (kl > 0.0), faster, rate)
            self._rate.copy_(torch.where(kl > 2.0 * self.desired_kl, slower, rate))
            self._rate32.copy_(self._rate)
        for model in (self.actor, self.critic):
            torch.nn.utils.clip_grad_norm_(model.parameters(), self.max_grad_norm)
        self.optimizer.step()


def _learn_moments(normalizer: EmpiricalNormalization, x: torch.Tensor, ranks: int) -> None:
    """``normalizer.update(x)`` in the same memory and without a number from the host (Chan et al. 1979).

    With several ``ranks``, which have as many samples each, over the samples of all.
    """
    variance, mean = torch.var_mean(x, dim=0, unbiased=False, keepdim=True)
    if ranks > 1:
        own = mean.clone()
        torch.distributed.all_reduce(mean)
        mean /= ranks
        variance += (own - mean).square()
        torch.distributed.all_reduce(variance)
        variance /= ranks
    normalizer.count += len(x) * ranks
    rate = len(x) * ranks / normalizer.count
    change = mean - normalizer._mean
    normalizer._mean += rate * change
    normalizer._var += rate * (variance - normalizer._var + change * (mean - normalizer._mean))
    normalizer._std.copy_(torch.sqrt(normalizer._var))
