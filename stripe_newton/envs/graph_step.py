# SPDX-License-Identifier: Apache-2.0
"""An environment's step as a part of somebody else's CUDA graph."""

from __future__ import annotations

from typing import Any

import torch

from .rl_env import RLEnv

__all__ = ["GraphStep", "obstacle_to_graph"]


def obstacle_to_graph(env: Any) -> str:
    """Why the step of ``env`` cannot be a part of a graph of the caller's; empty if it can."""
    if not isinstance(env, RLEnv):
        return f"{type(env).__name__} is not an environment of this package"
    changed = [n for n in _METHODS if getattr(type(env), n).__module__.partition(".")[0] != _OWN]
    if changed:
        return f"{type(env).__name__} has a {changed[0]} of its own"
    if env.plan.eager:
        stage, name, reason = env.plan.eager[0]
        return f"stage '{stage}' has {name}: {reason}"
    if getattr(env, "_noise_models", list)():
        return "noise models are torch modules"
    if any(isinstance(value, dict) for value in env.obs_buf.values()):
        return "an observation group is not concatenated"
    return ""


_OWN = __name__.partition(".")[0]
_METHODS = "step", "_take_action", "_hand_out", "_rewards", "_begin_extras"


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
        problem = obstacle_to_graph(env)
        if problem:
            raise ValueError(f"the step cannot be a part of a graph: {problem}")
        self._env = env
        values = env.outputs.views()
        env._stepping_now, stepping = False, env._stepping_now  # no final observations
        self.observations: dict[str, torch.Tensor] = env._hand_out(values)
        env._stepping_now = stepping
        self.reward, self.terminated, self.truncated = (values[n] for n in ("reward", "terminated", "truncated"))
        self.log_keys = list(env.context.log.keys)
        self.log = values["log"][: len(self.log_keys)] if self.log_keys else values["reward"][:0]
        self._recaptures = env.sim.recaptures

    def launch(self, action: torch.Tensor) -> None:
        """Launch all kernels of a step on the current stream.

        Args:
            action: Shape ``(num_envs, num_actions)``.
        """
        self._env._take_action(action)
        self._env.plan.launch()

    def before(self) -> bool:
        """What the host does before a step. Returns whether a graph that holds the step must be recorded anew.

        Raises:
            RuntimeError: if contacts or constraints were dropped, naming the size to set.
            ValueError: if actions were not finite and the config says to raise.
        """
        env = self._env
        env.sim.begin_step()
        if env.cfg.nonfinite_actions == "raise":
            env._safety.raise_for_actions()
        env.common_step_counter += 1
        stale, self._recaptures = env.sim.recaptures != self._recaptures, env.sim.recaptures
        return stale

    @torch.inference_mode(False)
    @torch.no_grad()
    def after(self) -> dict[str, torch.Tensor]:
        """Make what the last step handed out the environment's own. Returns the observations, in new memory."""
        env = self._env
        env.sim.pending = env._bodies_later
        values = env.outputs.take()
        env._begin_extras()
        env.obs_buf = env._hand_out(values)
        env.extras["log"] = dict(zip(self.log_keys, values["log"].unbind(), strict=False)) if self.log_keys else {}
        return env.obs_buf
