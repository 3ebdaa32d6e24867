# SPDX-License-Identifier: Apache-2.0
"""Configs of rsl_rl as Isaac Lab 2.3 writes them, and their translation to those of :mod:`stripe_newton.rl`.

Isaac Lab has one ``policy`` with the fields of both networks; rsl_rl 5 has an actor and a critic. All numbers are kept.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stripe_newton.configclass import MISSING, ConfigError, configclass
from stripe_newton.rl import (
    RslRlMLPModelCfg,
    RslRlPpoAlgorithmCfg,
    RslRlRndCfg,
    RslRlRNNModelCfg,
    RslRlSymmetryCfg,
)
from stripe_newton.rl import RslRlOnPolicyRunnerCfg as NativeRunnerCfg

__all__ = [
    "RslRlBaseRunnerCfg",
    "RslRlOnPolicyRunnerCfg",
    "RslRlPpoActorCriticCfg",
    "RslRlPpoActorCriticRecurrentCfg",
    "RslRlPpoAlgorithmCfg",
    "RslRlRndCfg",
    "RslRlSymmetryCfg",
]


@configclass
class RslRlPpoActorCriticCfg:
    """Networks of PPO's actor and critic."""

    class_name: str = "ActorCritic"
    """Kind of network in rsl_rl 3."""
    init_noise_std: float = MISSING
    """Initial standard deviation of the actions."""
    noise_std_type: str = "scalar"
    """Learned parameter: the deviation (``"scalar"``) or its logarithm (``"log"``)."""
    state_dependent_std: bool = False
    """Whether the deviation is an output of the actor's network."""
    actor_obs_normalization: bool = False
    """Whether the actor's observations are normalised."""
    critic_obs_normalization: bool = False
    """Whether the critic's observations are normalised."""
    actor_hidden_dims: list[int] = MISSING
    """Widths of the actor's hidden layers."""
    critic_hidden_dims: list[int] = MISSING
    """Widths of the critic's hidden layers."""
    activation: str = MISSING
    """Activation function of both."""


@configclass
class RslRlPpoActorCriticRecurrentCfg(RslRlPpoActorCriticCfg):
    """Recurrent networks of PPO's actor and critic."""

    class_name: str = "ActorCriticRecurrent"
    """Kind of network in rsl_rl 3."""
    rnn_type: str = MISSING
    """``"lstm"`` or ``"gru"``."""
    rnn_hidden_dim: int = MISSING
    """Width of the recurrent state."""
    rnn_num_layers: int = MISSING
    """Number of recurrent layers."""


@configclass
class RslRlBaseRunnerCfg:
    """Fields of every training run."""

    seed: int = 42
    """Seed of the run."""
    device: str = "cuda:0"
    """No effect: networks are on the environment's device."""
    num_steps_per_env: int = MISSING
    """Steps of an iteration."""
    max_iterations: int = MISSING
    """Iterations of the run."""
    empirical_normalization: bool | None = None
    """Whether the observations of both networks are normalised; ``None`` leaves it to ``policy``."""
    obs_groups: dict[str, list[str]] = {}
    """Observation groups that the networks read. By default both read ``policy``, and the critic reads the group
    ``critic`` where the environment has one."""
    clip_actions: float | None = None
    """Bound of the actions' absolute value."""
    save_interval: int = MISSING
    """Iterations between checkpoints."""
    experiment_name: str = MISSING
    """Folder of the runs."""
    run_name: str = ""
    """Suffix of the run's folder."""
    logger: str = "tensorboard"
    """Only ``"tensorboard"`` is translated."""
    neptune_project: str = "isaaclab"
    """No effect without that logger."""
    wandb_project: str = "isaaclab"
    """No effect without that logger."""
    resume: bool = False
    """No effect: ``stripe-newton train --resume`` resumes."""
    load_run: str = ".*"
    """Run that Isaac Lab's own scripts load."""
    load_checkpoint: str = "model_.*.pt"
    """Checkpoint that Isaac Lab's own scripts load."""


@configclass
class RslRlOnPolicyRunnerCfg(RslRlBaseRunnerCfg):
    """A training run with PPO."""

    class_name: str = "OnPolicyRunner"
    """Kind of runner in rsl_rl 3."""
    policy: RslRlPpoActorCriticCfg | None = None
    """Networks of both, as Isaac Lab writes them for rsl_rl 3."""
    actor: RslRlMLPModelCfg | None = None
    """Network of the actor, as for rsl_rl 5, in place of ``policy``."""
    critic: RslRlMLPModelCfg | None = None
    """Network of the critic."""
    algorithm: RslRlPpoAlgorithmCfg = MISSING
    """Hyperparameters of PPO."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.logger != "tensorboard":
            yield "logger", f"is '{self.logger}', which the dialect does not translate; use 'tensorboard'"
        if (self.actor is None) != (self.critic is None):
            yield "actor", "and critic must both be given, or neither"
        if (self.actor is None) == (self.policy is None):
            yield "policy", "has no value; give it, or actor and critic"

    def to_native(self) -> NativeRunnerCfg:
        """The same run as a config of :mod:`stripe_newton.rl`.

        Raises:
            ConfigError: fields are missing or cannot be translated.
        """
        problems = list(_missing(self))
        problems += [f"{name}: {text}" for name, text in self.problems()]
        if problems:
            raise ConfigError(problems)
        groups = dict(self.obs_groups)
        groups.setdefault("actor", groups.pop("policy", ["policy"]))
        names = ("seed", "num_steps_per_env", "max_iterations", "clip_actions", "save_interval", "experiment_name")
        return NativeRunnerCfg(
            **{name: getattr(self, name) for name in names},
            run_name=self.run_name,
            obs_groups=groups,
            actor=_network(self, "actor") if self.actor is None else self.actor.copy(),
            critic=_network(self, "critic") if self.critic is None else self.critic.copy(),
            algorithm=self.algorithm.copy(),
        )


def _missing(cfg: RslRlOnPolicyRunnerCfg) -> Iterator[str]:
    """Fields of the run and its networks without a value."""
    for owner, prefix in ((cfg, ""), (cfg.policy, "policy.")):
        for name, value in vars(owner).items() if owner is not None else ():
            if value is MISSING:
                yield f"{prefix}{name}: has no value"


def _network(cfg: RslRlOnPolicyRunnerCfg, role: str) -> RslRlMLPModelCfg:
    """The network of the actor or the critic."""
    policy = cfg.policy
    assert policy is not None  # `problems` says so
    fields: dict[str, Any] = {
        "hidden_dims": tuple(getattr(policy, f"{role}_hidden_dims")),
        "activation": policy.activation,
        "obs_normalization": bool(cfg.empirical_normalization) or getattr(policy, f"{role}_obs_normalization"),
        "distribution_cfg": _distribution(policy) if role == "actor" else None,
    }
    if isinstance(policy, RslRlPpoActorCriticRecurrentCfg):
        recurrent = {name: getattr(policy, name) for name in ("rnn_type", "rnn_hidden_dim", "rnn_num_layers")}
        return RslRlRNNModelCfg(**fields, **recurrent)
    return RslRlMLPModelCfg(**fields)


def _distribution(
    policy: RslRlPpoActorCriticCfg,
) -> RslRlMLPModelCfg.GaussianDistributionCfg | RslRlMLPModelCfg.HeteroscedasticGaussianDistributionCfg:
    if policy.state_dependent_std:
        kind: Any = RslRlMLPModelCfg.HeteroscedasticGaussianDistributionCfg
    else:
        kind = RslRlMLPModelCfg.GaussianDistributionCfg
    return kind(init_std=policy.init_noise_std, std_type=policy.noise_std_type)
