# SPDX-License-Identifier: Apache-2.0
"""A rollout of which each step is one CUDA graph: policy, sampling, the environment's step, storage, bookkeeping."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from rsl_rl.modules.distribution import GaussianDistribution, HeteroscedasticGaussianDistribution
from tensordict import TensorDict

from stripe_newton.envs.graph_step import GraphStep, why_not_capturable

from .graph_ppo import GraphPPO
from .graph_program import Program
from .vec_env import RslRlVecEnvWrapper

__all__ = ["GraphRollout", "Report", "obstacle_to_rollout"]

_NORMAL = GaussianDistribution, HeteroscedasticGaussianDistribution


def obstacle_to_rollout(env: RslRlVecEnvWrapper, algorithm: Any) -> str:
    """Why policy and step cannot be in one graph; empty if they can."""
    if not isinstance(algorithm, GraphPPO):
        return f"the algorithm is {type(algorithm).__name__}"
    if algorithm.obstacle:
        return algorithm.obstacle
    if not isinstance(algorithm.actor.distribution, _NORMAL):
        return f"{type(algorithm.actor.distribution).__name__} draws with values of the host"
    if str(env.device) != str(algorithm.device):
        return f"the environment is on {env.device}, the networks are on {algorithm.device}"
    if env.env is not env.unwrapped:
        return f"the environment is wrapped by {type(env.env).__name__}"
    return why_not_capturable(env.unwrapped)


@dataclass
class Report:
    """What is logged of an iteration, on the host.

    Attributes:
        returns: Of the episodes that ended, in their order.
        lengths: Their steps.
        log: Means of the environment's log over the steps, by key.
        problem: What was NaN, empty for nothing.
        numbers: What was given to :meth:`GraphRollout.tell`, by name.
    """

    returns: list[float]
    lengths: list[float]
    log: dict[str, float]
    problem: str
    numbers: dict[str, float]


class GraphRollout:
    """Collects transitions into the storage of the algorithm.

    Computes what rsl_rl's runner and ``PPO.act``, ``process_env_step`` and ``Logger.process_env_step`` do.
    """

    def __init__(
        self,
        env: RslRlVecEnvWrapper,
        algorithm: GraphPPO,
        return_sum: torch.Tensor,
        length_sum: torch.Tensor,
        check_for_nan: bool = True,
        keep: int = 100,
    ):
        """Bind to an environment, which is reset if it was not yet.

        Args:
            env: The wrapped environment.
            algorithm: Where the transitions go.
            return_sum: Rewards of the running episodes, float ``(num_envs,)``; kept up to date.
            length_sum: Their steps, float ``(num_envs,)``; kept up to date.
            check_for_nan: Whether :class:`Report` names what was NaN.
            keep: Ended episodes that are reported at most, the last ones.

        Raises:
            ValueError: if it cannot be a graph; see :func:`obstacle_to_rollout`.
        """
        problem = obstacle_to_rollout(env, algorithm)
        if problem:
            raise ValueError(f"the rollout cannot be a graph: {problem}")
        env.get_observations()
        self._env, self._algorithm, self._check, self._keep = env, algorithm, check_for_nan, keep
        self._return_sum, self._length_sum = return_sum, length_sum
        self._sent: dict[str, torch.Tensor] = {}
        self._step = GraphStep(env.unwrapped)
        self._obs = TensorDict(self._step.observations, batch_size=[env.num_envs])
        self._finite_horizon = bool(getattr(env.cfg, "is_finite_horizon", False))
        self._allocate()
        self._program = Program(self._launch, env.device)

    @torch.inference_mode(False)
    @torch.no_grad()
    def _allocate(self) -> None:
        storage, env = self._algorithm.storage, self._env
        steps, count, make = storage.num_transitions_per_env, env.num_envs, {"device": env.device}
        self._index = torch.zeros(1, dtype=torch.int64, **make)
        self._noise = torch.zeros(count, env.num_actions, **make)
        self._returns = torch.zeros(steps, count, **make)
        self._lengths = torch.zeros(steps, count, **make)
        self._log = torch.zeros(steps, len(self._step.log_keys), **make)
        self._names = [*self._step.observations, "rewards"]
        self._nan = torch.zeros(len(self._names), dtype=torch.bool, **make)
        if storage.distribution_params is None:
            actor = self._algorithm.actor
            actor.distribution.update(actor.mlp(actor.get_latent(self._obs)))
            shapes = [p.shape for p in actor.output_distribution_params]
            storage.distribution_params = tuple(torch.zeros(steps, *shape, **make) for shape in shapes)

    @property
    def recorded(self) -> bool:
        """Whether a step is a graph launch."""
        return self._program.recorded

    @torch.inference_mode(False)
    @torch.no_grad()
    def collect(self) -> TensorDict:
        """Take all steps of a rollout; nobody waits for the device. Returns the observations after them."""
        self._index.zero_()
        self._nan.zero_()
        storage = self._algorithm.storage
        for _ in range(storage.num_transitions_per_env):
            if self._step.before():
                self._program.forget()
            self._program.run()
            if self._env.step_hooks:
                self._hand_out()
                for hook in list(self._env.step_hooks):
                    hook()
        storage.step = storage.num_transitions_per_env
        return self._hand_out()

    @torch.inference_mode(False)
    @torch.no_grad()
    def tell(self, numbers: dict[str, torch.Tensor]) -> Callable[[], Report]:
        """Let the device send what happened in the rollout, without waiting for it.

        Args:
            numbers: Values of no dimension that come along.

        Returns:
            Waits for it and gives the report; to be called before this method is called again.
        """
        names = list(numbers)
        values = torch.stack([value.detach().float() for value in numbers.values()])
        packed = torch.cat((values, self._log.mean(dim=0), self._nan.float()))
        done = self._algorithm.storage.dones.squeeze(-1)
        sent = [
            self._send(name, v) for name, v in (("p", packed), ("d", done), ("r", self._returns), ("l", self._lengths))
        ]
        arrived = torch.cuda.Event() if packed.is_cuda else None
        if arrived is not None:
            arrived.record()

        def report() -> Report:
            if arrived is not None:
                arrived.synchronize()
            values, done, returns, lengths = sent[0].tolist(), sent[1] > 0, sent[2], sent[3]
            log, nan = values[len(names) : -len(self._names)], values[-len(self._names) :]
            bad = [name for name, is_nan in zip(self._names, nan, strict=True) if is_nan]
            return Report(
                returns[done][-self._keep :].tolist(),
                lengths[done][-self._keep :].tolist(),
                dict(zip(self._step.log_keys, log, strict=True)),
                f"the environment returned NaN in {', '.join(bad)}" if bad else "",
                dict(zip(names, values, strict=False)),
            )

        return report

    def _send(self, name: str, value: torch.Tensor) -> torch.Tensor:
        if not value.is_cuda:
            return value.clone()
        if name not in self._sent or self._sent[name].shape != value.shape:
            self._sent[name] = torch.empty_like(value, device="cpu", pin_memory=True)
        return self._sent[name].copy_(value, non_blocking=True)

    def _hand_out(self) -> TensorDict:
        return self._env.hand_out(self._step.after())

    def _launch(self) -> None:
        algorithm, env, storage, index = self._algorithm, self._env, self._algorithm.storage, self._index
        actor, obs = algorithm.actor, self._obs

        def store(where: torch.Tensor, value: torch.Tensor) -> None:
            where.index_copy_(0, index, value.view(1, *where.shape[1:]).to(where.dtype))

        for name, value in obs.items():
            store(storage.observations[name], value)
        actor.distribution.update(actor.mlp(actor.get_latent(obs)))
        mean, std = actor.output_mean, actor.output_std
        actions = self._noise.normal_() * std + mean  # Normal.sample() does the same, and waits for the device
        values = algorithm.critic(obs)
        store(storage.actions, actions)
        store(storage.values, values)
        store(storage.actions_log_prob, actor.get_output_log_prob(actions))
        for where, value in zip(storage.distribution_params, actor.output_distribution_params, strict=True):
            store(where, value)
        clip = env.clip_actions
        self._step.launch(actions if clip is None else actions.clamp(-clip, clip))
        reward, terminated, truncated = self._step.reward, self._step.terminated, self._step.truncated
        done = terminated | truncated
        if self._finite_horizon:
            store(storage.rewards, reward)
        else:
            store(
                storage.rewards,
                reward + algorithm.gamma * torch.squeeze(values * (truncated & ~terminated)[:, None], 1),
            )
        store(storage.dones, done)
        self._account(reward, done)
        index += 1

    def _account(self, reward: torch.Tensor, done: torch.Tensor) -> None:
        self._return_sum += reward
        self._length_sum += 1.0
        for where, value in ((self._returns, self._return_sum), (self._lengths, self._length_sum)):
            where.index_copy_(0, self._index, value.unsqueeze(0))
            value.masked_fill_(done, 0.0)
        if self._log.shape[1]:
            self._log.index_copy_(0, self._index, self._step.log.unsqueeze(0))
        if self._check:
            self._nan |= torch.stack([torch.isnan(t).any() for t in (*self._step.observations.values(), reward)])
