# SPDX-License-Identifier: Apache-2.0
"""Graph step: the step of an environment as part of a CUDA graph that its user records, such as a whole rollout."""

from __future__ import annotations

from collections.abc import Callable

import torch

from .rl_env import Observations, RLEnv

__all__ = ["GraphStep", "why_not_capturable"]


def why_not_capturable(env: object) -> str:
    """Reason why the step of ``env`` cannot be recorded in a user's CUDA graph; empty if it can."""
    if not isinstance(env, RLEnv):
        return f"{type(env).__name__} is not an environment of this package"
    return env.why_not_capturable()


class GraphStep:
    """The step of an environment in parts, so that a user can record its kernels in a CUDA graph and replay them.

    Record :meth:`launch` once. Call :meth:`before` before each replay; it does the host's part of a step. Call
    :meth:`after` after a replay whose observations the host wants, such as the last one of a rollout.

    Attributes:
        observations: Observations by group, float, shape ``(num_envs, n)``. Each step overwrites these arrays.
        reward: Rewards, float, shape ``(num_envs,)``.
        terminated, truncated: Ends of episodes, bool, shape ``(num_envs,)``.
        log: Values of the episode log of the last step, in the order of ``log_keys``.
    """

    def __init__(self, env: RLEnv):
        """Bind to ``env``, which has been reset.

        Raises:
            ValueError: with the reason, if its step cannot be recorded.
        """
        problem = why_not_capturable(env)
        if problem:
            raise ValueError(f"the step cannot be a part of a graph: {problem}")
        self._env = env
        self.observations = env.observation_views()
        values = env.outputs.views()
        self.reward, self.terminated, self.truncated = (values[n] for n in ("reward", "terminated", "truncated"))
        own = list(env.context.log.keys)
        self._hook_keys = [key for key in env.hook_log_keys() if key not in own]
        self.log_keys = own + self._hook_keys
        self._own_log = self.log = values["log"][: len(own)] if own else values["reward"][:0]
        self._after: list[Callable[[], None]] = []
        self._is_open = False
        self._recaptures = env.sim.recaptures

    def launch(self, action: torch.Tensor) -> None:
        """Launch all kernels of a step on the current stream.

        Args:
            action: Shape ``(num_envs, num_actions)``.
        """
        self._after = self._env.launch_step(action)
        if self._hook_keys:
            # What torch hooks log lies in memory of this recording alone.
            found = self._env.hook_log(self._after)
            self.log = torch.cat((self._own_log, torch.stack([found[k].reshape(()).float() for k in self._hook_keys])))

    def before(self) -> bool:
        """Do the host's part before a replay of the step.

        Returns:
            Whether a graph that holds the step must be recorded anew, as an array that it reads has been replaced.

        Raises:
            RuntimeError: if contacts or constraints were dropped, naming the size to set.
            ValueError: if actions were not finite and the config says to raise.
        """
        env = self._env
        self._end_step()
        env.begin_step()
        self._is_open = True
        env.raise_for_actions()
        # RLEnv.step counts between physics and dones, where torch hooks read the count. A replay runs none of them.
        env.count_step()
        stale, self._recaptures = env.sim.recaptures != self._recaptures, env.sim.recaptures
        if env.why_not_capturable():
            # A number that a recorded torch hook reads has changed: the hook is watched and recorded again.
            env.settle_hooks()
            env.begin_step()
            stale = True
        return stale

    def after(self) -> Observations:
        """Update the environment's attributes, such as ``obs_buf`` and ``extras``, from the last step.

        Returns:
            Observations by group, in new memory.
        """
        self._end_step()
        return self._env.finish_step()[0]

    def _end_step(self) -> None:
        """Do the host's part of recorded torch hooks, once for each replay."""
        if self._is_open:
            self._is_open = False
            for function in self._after:
                function()
