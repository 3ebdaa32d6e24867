# SPDX-License-Identifier: Apache-2.0
"""Graph step: an environment's step as a part of somebody else's CUDA graph."""

from __future__ import annotations

import torch

from .rl_env import Observations, RLEnv

__all__ = ["GraphStep", "why_not_capturable"]


def why_not_capturable(env: object) -> str:
    """Why the step of ``env`` cannot be a part of a graph of the caller's; empty if it can."""
    if not isinstance(env, RLEnv):
        return f"{type(env).__name__} is not an environment of this package"
    return env.why_not_capturable()


class GraphStep:
    """The step of an environment, launched kernel by kernel on fixed memory: recorded once, replayed by its owner.

    Before each replay call :meth:`before`; after some of them :meth:`after`.

    Attributes:
        observations: By group, shape ``(num_envs, n)``. They and the following are overwritten by each step.
        reward: ``(num_envs,)``.
        terminated, truncated: bool ``(num_envs,)``.
        log: Values of the episode log of the last step, in the order of ``log_keys``.
    """

    def __init__(self, env: RLEnv):
        """Bind to ``env``, which has been reset.

        Raises:
            ValueError: if its step cannot be a part of a graph.
        """
        problem = why_not_capturable(env)
        if problem:
            raise ValueError(f"the step cannot be a part of a graph: {problem}")
        self._env = env
        self.observations = env.observation_views()
        values = env.outputs.views()
        self.reward, self.terminated, self.truncated = (values[n] for n in ("reward", "terminated", "truncated"))
        self.log_keys = list(env.context.log.keys)
        self.log = values["log"][: len(self.log_keys)] if self.log_keys else values["reward"][:0]
        self._recaptures = env.sim.recaptures

    def launch(self, action: torch.Tensor) -> None:
        """Launch all kernels of a step on the current stream.

        Args:
            action: Shape ``(num_envs, num_actions)``.
        """
        self._env.launch_step(action)

    def before(self) -> bool:
        """What the host does before a step. Returns whether a graph that holds the step must be recorded anew.

        Raises:
            RuntimeError: if contacts or constraints were dropped, naming the size to set.
            ValueError: if actions were not finite and the config says to raise.
        """
        env = self._env
        env.begin_step()
        env.raise_for_actions()
        env.count_step()  # nothing on the host looks at the number within a replay
        stale, self._recaptures = env.sim.recaptures != self._recaptures, env.sim.recaptures
        return stale

    def after(self) -> Observations:
        """Make what the last step handed out the environment's own. Returns the observations, in new memory."""
        return self._env.finish_step()[0]
