# SPDX-License-Identifier: Apache-2.0
"""Configs of skrl's PPO, as Isaac Lab's tasks have them in YAML, translated to those of :mod:`stripe_newton.rl`.

Tasks that have no config for rsl_rl so train with it. Networks over flat observations and over one image are
translated; what has no counterpart is said in one log line.
"""

from __future__ import annotations

import importlib
import logging
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from stripe_newton.configclass import ConfigError
from stripe_newton.rl import (
    RslRlCNNModelCfg,
    RslRlMLPModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlPpoAlgorithmCfg,
)

__all__ = ["read_skrl_config", "runner_of_skrl"]

_log = logging.getLogger(__name__)
Config = Mapping[str, Any]


def read_skrl_config(entry_point: str) -> RslRlOnPolicyRunnerCfg:
    """The training run of a task's entry point, ``"package:file.yaml"``.

    Raises:
        ConfigError: the config is of another algorithm or has a network that is not translated.
    """
    package, _, file = entry_point.partition(":")
    folder = Path(str(importlib.import_module(package).__file__)).parent
    return runner_of_skrl(yaml.safe_load((folder / file).read_text()), entry_point)


def runner_of_skrl(config: Config, where: str) -> RslRlOnPolicyRunnerCfg:
    """A training run of rsl_rl with the numbers of a config of skrl.

    Args:
        config: The config.
        where: Its name, for messages.

    Raises:
        ConfigError: the config is of another algorithm or has a network that is not translated.
    """
    agent, policy, value = config["agent"], config["models"]["policy"], config["models"]["value"]
    if problems := list(_problems(agent, policy)):
        raise ConfigError([f"{where}: {text}; train this task with skrl itself" for text in problems])
    if any("STATES" in str(block["input"]) for block in policy["network"]):  # skrl 1: a policy reads no states
        policy, value = _of_skrl_2(policy), _of_skrl_2(value)
    normalized = agent.get("state_preprocessor") is not None
    steps = int(agent["rollouts"])
    if left_out := list(_left_out(config)):
        _log.warning("%s is read for rsl_rl, without %s", where, ", ".join(left_out))
    distribution = RslRlMLPModelCfg.GaussianDistributionCfg(
        init_std=math.exp(policy.get("initial_log_std", 0.0)), std_type="log"
    )
    return RslRlOnPolicyRunnerCfg(
        seed=int(config.get("seed", 42)),
        num_steps_per_env=steps,
        max_iterations=max(1, int(config["trainer"]["timesteps"]) // steps),
        save_interval=50,
        experiment_name=agent["experiment"]["directory"],
        obs_groups={"actor": ["policy"]},
        actor=_network(policy, normalized, distribution, where),
        critic=_network(value, normalized, None, where),
        algorithm=_algorithm(agent),
    )


def _problems(agent: Config, policy: Config) -> Iterator[str]:
    if agent["class"] != "PPO":
        yield f"agent.class: is '{agent['class']}', only 'PPO' has a counterpart in rsl_rl"
    if policy["class"] != "GaussianMixin":
        yield f"models.policy.class: is '{policy['class']}', rsl_rl has continuous actions alone"


def _left_out(config: Config) -> Iterator[str]:
    """Entries of a config that have no counterpart."""
    agent = config["agent"]
    if agent.get("rewards_shaper_scale", 1.0) != 1.0:
        yield f"agent.rewards_shaper_scale {agent['rewards_shaper_scale']}"
    if agent.get("value_preprocessor") is not None:
        yield "agent.value_preprocessor"
    if not config["models"].get("separate", True):
        yield "one network for actor and critic"


def _algorithm(agent: Config) -> RslRlPpoAlgorithmCfg:
    target = (agent.get("learning_rate_scheduler_kwargs") or {}).get("kl_threshold", 0.01)
    return RslRlPpoAlgorithmCfg(
        num_learning_epochs=int(agent["learning_epochs"]),
        num_mini_batches=int(agent["mini_batches"]),
        clip_param=float(agent["ratio_clip"]),
        gamma=float(agent["discount_factor"]),
        lam=float(agent["lambda"]),
        value_loss_coef=float(agent["value_loss_scale"]),
        entropy_coef=float(agent["entropy_loss_scale"]),
        learning_rate=float(agent["learning_rate"]),
        max_grad_norm=float(agent["grad_norm_clip"]),
        use_clipped_value_loss=bool(agent["clip_predicted_values"]),
        schedule="adaptive" if agent.get("learning_rate_scheduler") == "KLAdaptiveLR" else "fixed",
        desired_kl=float(target),
    )


def _network(
    model: Config, normalized: bool, distribution: RslRlMLPModelCfg.GaussianDistributionCfg | None, where: str
) -> RslRlMLPModelCfg:
    """A network over flat observations, or over one image.

    Raises:
        ConfigError: it has other inputs or layers.
    """
    blocks: Sequence[Config] = model["network"]
    last = blocks[-1]
    shared: dict[str, Any] = {
        "hidden_dims": tuple(int(width) for width in last["layers"]),
        "activation": str(last["activations"]),
        "distribution_cfg": distribution,
    }
    inputs = [str(block["input"]).replace(" ", "") for block in blocks]
    if inputs == ["OBSERVATIONS"]:
        return RslRlMLPModelCfg(obs_normalization=normalized, **shared)
    if inputs == ["permute(OBSERVATIONS,(0,3,1,2))", blocks[0]["name"]]:
        return RslRlCNNModelCfg(cnn_cfg=_encoder(blocks[0]), **shared)
    text = f"{where}: models: a network over {', '.join(inputs)} is not translated; train this task with skrl itself"
    raise ConfigError([text])


def _of_skrl_2(model: Config) -> Config:
    """A model of skrl 1, which calls the observations STATES, as skrl 2 writes it."""
    blocks = [
        {**block, "input": re.sub(r"\bSTATES\b", "OBSERVATIONS", str(block["input"]))} for block in model["network"]
    ]
    return {**model, "network": blocks}


def _encoder(block: Config) -> RslRlCNNModelCfg.CNNCfg:
    layers = [layer["conv2d"] for layer in block["layers"] if isinstance(layer, Mapping)]
    return RslRlCNNModelCfg.CNNCfg(
        output_channels=tuple(int(layer["out_channels"]) for layer in layers),
        kernel_size=tuple(int(layer["kernel_size"]) for layer in layers),
        stride=tuple(int(layer["stride"]) for layer in layers),
        activation=str(block["activations"]),
    )
