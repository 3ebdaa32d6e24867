# SPDX-License-Identifier: Apache-2.0
"""GraphRollout: collects transitions with one CUDA graph a step, which holds policy, environment and storage."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import torch
import warp as wp
from rsl_rl.modules.distribution import GaussianDistribution, HeteroscedasticGaussianDistribution
from tensordict import TensorDict

from stripe_kernels.rollout import BLOCK, add_up_episodes, sample_actions, store_outcome
from stripe_newton.envs import RLEnv
from stripe_newton.envs.graph_step import GraphStep, why_not_capturable
from stripe_newton.rl.torch_vector_env import is_finite_horizon
from stripe_newton.rl.wrappers.rsl_rl import RslRlVecEnvWrapper

from .flat_adam import as_array
from .network_pass import network_output
from .ppo import GraphPPO
from .program import Program

__all__ = ["GraphRollout", "Report", "why_no_rollout_graph"]

_VALUES_AT_ONCE = 131072
"""Samples of which the critic computes values at once, which bounds the memory for its activations."""
_NORMAL = GaussianDistribution, HeteroscedasticGaussianDistribution


def why_no_rollout_graph(env: RslRlVecEnvWrapper, algorithm: object) -> str:
    """Reason why policy and environment step cannot be one graph; empty if they can."""
    if not isinstance(algorithm, GraphPPO):
        return f"the algorithm is {type(algorithm).__name__}"
    if algorithm.why_no_update_graph:
        return algorithm.why_no_update_graph
    if not isinstance(algorithm.actor.distribution, _NORMAL):
        return f"{type(algorithm.actor.distribution).__name__} samples with values from the host"
    if str(env.device) != str(algorithm.device):
        return f"the environment is on {env.device}, the networks are on {algorithm.device}"
    if env.env is not env.unwrapped:
        return f"the environment is wrapped by {type(env.env).__name__}"
    return why_not_capturable(env.unwrapped)


@dataclass
class Report:
    """Log of one rollout, on the host."""

    returns: list[float]
    """Returns of the episodes that ended, in the order of their ends."""
    lengths: list[float]
    """Lengths of the same episodes, in steps."""
    log: dict[str, float]
    """Means of the environment's log over the steps, by key."""
    problem: str
    """Names of the arrays that contained NaN, as a message; empty for none."""
    numbers: dict[str, float]
    """The values that were given to :meth:`GraphRollout.send_report`, by name."""


class GraphRollout:
    """Collects the transitions of a rollout into the storage of PPO, each step one graph launch.

    It computes what the loop of rsl_rl's runner does with ``PPO.act``, ``PPO.process_env_step`` and
    ``Logger.process_env_step``.
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
        """Bind to an environment; it is reset if it has not been before.

        Args:
            env: The wrapped environment.
            algorithm: PPO, whose storage takes the transitions.
            return_sum: Returns of the running episodes so far, float ``(num_envs,)``; updated in place.
            length_sum: Lengths of the running episodes so far, float ``(num_envs,)``; updated in place.
            check_for_nan: Whether :class:`Report` names arrays that contained NaN.
            keep: Largest number of ended episodes in a report; the last ones are kept.

        Raises:
            ValueError: if it cannot be a graph; see :func:`why_no_rollout_graph`.
        """
        problem = why_no_rollout_graph(env, algorithm)
        if problem:
            raise ValueError(f"the rollout cannot be a graph: {problem}")
        env.get_observations()
        inner = env.unwrapped
        assert isinstance(inner, RLEnv)  # `why_no_rollout_graph` has checked it
        self._env, self._algorithm, self._check, self._keep = env, algorithm, check_for_nan, keep
        self._return_sum, self._length_sum = return_sum, length_sum
        self._pinned: dict[tuple[str, int], torch.Tensor] = {}
        self._reports = 0
        self._step = GraphStep(inner)
        self._obs = TensorDict(self._step.observations, batch_size=[env.num_envs])
        self._finite_horizon = is_finite_horizon(inner)
        self._allocate()
        self._program = Program(self._act_and_step, env.device)
        self._end = Program(self._finish, env.device)

    @torch.inference_mode(False)
    @torch.no_grad()
    def _allocate(self) -> None:
        storage, env, device = self._algorithm.storage, self._env, self._env.device
        steps, count = storage.num_transitions_per_env, env.num_envs
        # The number of the step, on the device: one graph serves all steps of a rollout, so the row of the storage
        # that it writes cannot be a number of the host.
        self._index = torch.zeros(1, dtype=torch.int64, device=device)
        self._noise = torch.zeros(count, env.num_actions, device=device)
        self._returns = torch.zeros(steps, count, device=device)
        self._lengths = torch.zeros(steps, count, device=device)
        self._log = torch.zeros(steps, len(self._step.log_keys), device=device)
        self._names = [*self._step.observations, "rewards"]
        self._nan = torch.zeros(len(self._names), dtype=torch.bool, device=device)
        if storage.distribution_params is None:
            # rsl_rl allocates these with the first transition that it stores, which never comes here.
            actor = self._algorithm.actor
            actor.distribution.update(network_output(actor, self._obs))
            shapes = [p.shape for p in actor.output_distribution_params]
            storage.distribution_params = tuple(torch.zeros(steps, *shape, device=device) for shape in shapes)
        self._actions = torch.zeros(count, env.num_actions, device=device)
        self._cut_off = torch.zeros(steps, count, dtype=torch.bool, device=device)
        step, outcome = as_array(self._index), self._step
        dones, cut_off = as_array(storage.dones.squeeze(-1)), as_array(self._cut_off)
        values, rewards = as_array(storage.values.squeeze(-1)), as_array(storage.rewards.squeeze(-1))
        stored = (storage.actions, *storage.distribution_params, storage.actions_log_prob.squeeze(-1))
        self._sampled = [step, *(as_array(t) for t in (self._actions, *stored))]
        given = [as_array(t) for t in (outcome.reward, outcome.terminated, outcome.truncated)]
        self._outcome = [step, *given, rewards, dones, cut_off]
        sums = (self._return_sum, self._length_sum, self._returns, self._lengths)
        self._episodes = [rewards, dones, cut_off, values, *(as_array(t) for t in sums)]

    @property
    def recorded(self) -> bool:
        """Whether a step is a graph launch."""
        return self._program.recorded

    @torch.inference_mode(False)
    @torch.no_grad()
    def collect(self) -> TensorDict:
        """Take all steps of a rollout, without host synchronisation. Returns the observations after the last step."""
        self._index.zero_()
        storage = self._algorithm.storage
        for _ in range(storage.num_transitions_per_env):
            if self._step.before():
                self._program.invalidate()
                self._end.invalidate()
            self._program.run()
            # Observations are handed out for hooks alone: within a rollout the graph reads them where they are.
            if self._env.step_hooks:
                self._publish_observations()
                for hook in list(self._env.step_hooks):
                    hook()
        self._end.run()
        storage.step = storage.num_transitions_per_env
        return self._publish_observations()

    @torch.inference_mode(False)
    @torch.no_grad()
    def send_report(self, numbers: Mapping[str, float | torch.Tensor]) -> Callable[[], Report]:
        """Start to copy the log of the rollout to the host, without waiting for it.

        Args:
            numbers: Further values to send by name, tensors without dimensions.

        Returns:
            A function that waits for the copies and returns the report. Call it before this method is called twice
            more: two reports have memory on the host.
        """
        names = list(numbers)
        self._reports += 1
        values = torch.stack([torch.as_tensor(v, device=self._env.device).detach().float() for v in numbers.values()])
        # Small values in one tensor: each copy to the host has a latency of its own.
        packed = torch.cat((values, self._log.mean(dim=0), self._nan.float()))
        done = self._algorithm.storage.dones.squeeze(-1)
        sent = [
            self._copy_to_host(name, value)
            for name, value in (
                ("packed", packed),
                ("done", done),
                ("returns", self._returns),
                ("lengths", self._lengths),
            )
        ]
        arrived = torch.cuda.Event() if packed.is_cuda else None
        if arrived is not None:
            arrived.record()

        def report() -> Report:
            if arrived is not None:
                arrived.synchronize()
            # NumPy: torch would share out each of these small operations over all cores, which takes longer than they
            # do, and milliseconds where some of the cores are busy.
            values, (done, returns, lengths) = sent[0].tolist(), (value.numpy() for value in sent[1:])
            ended = done > 0
            log, nan = values[len(names) : -len(self._names)], values[-len(self._names) :]
            bad = [name for name, is_nan in zip(self._names, nan, strict=True) if is_nan]
            return Report(
                returns[ended][-self._keep :].tolist(),
                lengths[ended][-self._keep :].tolist(),
                dict(zip(self._step.log_keys, log, strict=True)),
                f"the environment returned NaN in {', '.join(bad)}" if bad else "",
                dict(zip(names, values, strict=False)),
            )

        return report

    def _copy_to_host(self, name: str, value: torch.Tensor) -> torch.Tensor:
        """A tensor on the host that will hold ``value`` once the device has copied it."""
        if not value.is_cuda:
            return value.clone()
        key = name, self._reports % 2
        if key not in self._pinned or self._pinned[key].shape != value.shape:
            # Only a copy to page-locked memory runs beside the host.
            self._pinned[key] = torch.empty_like(value, device="cpu", pin_memory=True)
        return self._pinned[key].copy_(value, non_blocking=True)

    def _publish_observations(self) -> TensorDict:
        return self._env.set_observations(self._step.after())

    # -- the graph

    def _act_and_step(self) -> None:
        """One step: act, step the environment, store the transition."""
        self._act()
        self._step.launch(self._actions)
        self._launch(store_outcome, self._outcome)
        if self._log.shape[1]:
            self._log.index_copy_(0, self._index, self._step.log.unsqueeze(0))
        self._index += 1

    def _act(self) -> None:
        """Store observations, and draw and store the actions of a step."""
        storage, actor, obs = self._algorithm.storage, self._algorithm.actor, self._obs
        # Observations first: the environment's step overwrites them in place.
        for name, value in obs.items():
            where = storage.observations[name]
            where.index_copy_(0, self._index, value.unsqueeze(0).to(where.dtype))
        actor.distribution.update(network_output(actor, obs))
        # The same random numbers as `Normal.sample()`, which synchronises with the device to check its arguments.
        now = [as_array(t) for t in (self._noise.normal_(), actor.output_mean, actor.output_std)]
        # The storage has the actions as drawn, the environment gets them clipped, as in rsl_rl.
        bound = self._env.clip_actions
        inputs = [self._sampled[0], *now, math.inf if bound is None else bound, *self._sampled[1:]]
        self._launch(sample_actions, inputs)

    def _finish(self) -> None:
        """Values of all steps at once, sums of episodes, and checks."""
        algorithm, storage = self._algorithm, self._algorithm.storage
        if self._check:
            arrays = [*storage.observations.values(), storage.rewards]
            latest = [*self._step.observations.values(), storage.rewards[0]]
            pairs = zip(arrays, latest, strict=True)
            self._nan.copy_(torch.stack([torch.isnan(a).any() | torch.isnan(b).any() for a, b in pairs]))
        # The values are not needed earlier, and a few large matrix products take less time than many small ones.
        obs, values = storage.observations.flatten(0, 1), storage.values.flatten(0, 1)
        for first in range(0, len(values), _VALUES_AT_ONCE):
            part = slice(first, first + _VALUES_AT_ONCE)
            values[part] = network_output(algorithm.critic, obs[part])
        discount = 0.0 if self._finite_horizon else algorithm.gamma
        inputs = [*self._episodes[:4], discount, *self._episodes[4:]]
        self._launch(add_up_episodes, inputs)

    def _launch(self, kernel: wp.Kernel, inputs: list[wp.array | float]) -> None:
        """Launch a kernel with a thread for each environment."""
        wp.launch(kernel, dim=self._env.num_envs, inputs=inputs, device=str(self._env.device), block_dim=BLOCK)
