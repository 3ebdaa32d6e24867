# SPDX-License-Identifier: Apache-2.0
"""SkrlVecEnvWrapper: an environment for skrl's agents, and the last observations of episodes for those that use them.

The wrapper is skrl's own for the interface of Isaac Lab.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

try:
    from skrl.envs.wrappers.torch import wrap_env
    from skrl.utils.spaces.torch import flatten_tensorized_space, tensorize_space
except ImportError as error:
    raise ImportError("stripe_newton.rl.wrappers.skrl needs skrl: pip install stripe-newton[skrl]") from error

from stripe_newton.envs import DirectMARLEnv

if TYPE_CHECKING:
    import gymnasium
    from skrl.agents.torch import Agent
    from skrl.envs.wrappers.torch import MultiAgentEnvWrapper, Wrapper

__all__ = ["SkrlVecEnvWrapper", "use_final_observations"]


def SkrlVecEnvWrapper(
    env: gymnasium.vector.VectorEnv, ml_framework: str = "torch", wrapper: str = "isaaclab"
) -> Wrapper | MultiAgentEnvWrapper:
    """Wrap an environment for skrl's torch agents, with the wrapper that skrl has for Isaac Lab.

    It is ``skrl.envs.wrappers.torch.wrap_env`` with the right tag: that for several agents if ``env`` is a
    :class:`DirectMARLEnv`, else that for a single agent, also where ``multi_agent_to_single_agent`` made ``env``.
    Tensors stay on their device. The group ``"policy"`` is skrl's observation, the group ``"critic"`` its state.

    Args:
        env: The environment, or a gymnasium wrapper around it.
        ml_framework: ``"torch"``.
        wrapper: ``"isaaclab"``, or ``"isaaclab-single-agent"`` or ``"isaaclab-multi-agent"`` to insist on one.

    Raises:
        ValueError: for another framework, or a wrapper that does not fit the environment.
    """
    fitting = "isaaclab-multi-agent" if isinstance(env.unwrapped, DirectMARLEnv) else "isaaclab-single-agent"
    if ml_framework != "torch":
        raise ValueError(f"ml_framework is {ml_framework!r}, must be 'torch': the environments' tensors are torch's")
    if wrapper not in ("isaaclab", fitting):
        raise ValueError(
            f"wrapper is {wrapper!r}, must be 'isaaclab' or '{fitting}' for {type(env.unwrapped).__name__}"
        )
    return wrap_env(env, wrapper=fitting, verbose=False)


def use_final_observations(agent: Agent) -> None:
    """Make an agent of skrl record the last observation of an episode as the one that followed its last step.

    skrl's wrapper knows only what the environment returns, which after the last step is the first observation of the
    next episode. An agent that values the observation after a step (PPO with ``time_limit_bootstrap``, SAC and the
    like) would value a state of another episode. This replaces the agent's method ``record_transition``. The training
    goes on from the same observations as before. The environment must be made with ``compute_final_obs=True``; steps
    without ``"final_obs"`` are unchanged.

    Args:
        agent: An agent of ``skrl.agents.torch``.

    Raises:
        ValueError: if it is one of ``skrl.multi_agents``.
    """
    if hasattr(agent, "possible_agents"):  # agents of skrl.multi_agents alone have it
        raise ValueError(f"{type(agent).__name__} is one of skrl.multi_agents, must be one of skrl.agents.torch")
    record = agent.record_transition

    def record_transition(
        *, next_observations: torch.Tensor, next_states: torch.Tensor | None, infos: dict, **others: object
    ) -> None:
        if "final_obs" in infos:
            final, ended = infos["final_obs"], infos["_final_obs"].unsqueeze(-1)
            last = flatten_tensorized_space(tensorize_space(agent.observation_space, final["policy"]))
            next_observations = torch.where(ended, last, next_observations)
            if next_states is not None and "critic" in final:
                last = flatten_tensorized_space(tensorize_space(agent.state_space, final["critic"]))
                next_states = torch.where(ended, last, next_states)
        record(next_observations=next_observations, next_states=next_states, infos=infos, **others)

    agent.record_transition = record_transition
