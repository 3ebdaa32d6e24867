# SPDX-License-Identifier: Apache-2.0
"""Settings of a runner: the dict for rsl_rl, which parts can be graphs, and mismatches of config and environment."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rsl_rl.utils import resolve_callable

from .batched_distillation import BatchedDistillation
from .bounded_rate_ppo import BoundedRatePPO
from .configs import RslRlBaseRunnerCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from .configs.model_cfg import RslRlRNNModelCfg
from .graphs.ppo import GraphPPO
from .graphs.rollout import why_no_rollout_graph
from .torch_vector_env import rl_env_of
from .wrappers.rsl_rl import RslRlVecEnvWrapper

__all__ = ["env_mismatches", "foreign_classes", "rsl_rl_settings", "why_no_graphs"]


_OWN_PACKAGES = ("rsl_rl", "stripe_newton", "stripe_tasks")
"""Packages whose classes are made as they must be."""


def rsl_rl_settings(cfg: RslRlBaseRunnerCfg) -> dict[str, object]:
    """The dict for rsl_rl's runner, with this package's algorithms in place of rsl_rl's if the config wants graphs."""
    settings = cfg.to_rsl_rl()
    algorithm = settings["algorithm"]
    if not isinstance(algorithm, dict):
        return settings
    own: dict[str, type] = {"PPO": GraphPPO, "Distillation": BatchedDistillation} if cfg.runner == "graph" else {}
    # rsl_rl's PPO does not take this bound, and has the default's.
    if algorithm.get("max_learning_rate") == RslRlPpoAlgorithmCfg().max_learning_rate:
        del algorithm["max_learning_rate"]
    elif "max_learning_rate" in algorithm and cfg.runner != "graph":
        own["PPO"] = BoundedRatePPO
    kind = own.get(algorithm["class_name"])
    if kind is not None:
        algorithm["class_name"] = f"{kind.__module__}:{kind.__qualname__}"
    return settings


def why_no_graphs(cfg: RslRlBaseRunnerCfg, env: RslRlVecEnvWrapper, algorithm: object) -> dict[str, str]:
    """Reason why ``"rollout"`` and ``"update"`` run rsl_rl's own code rather than graphs; empty if both are graphs."""
    if cfg.runner != "graph":
        return dict.fromkeys(("rollout", "update"), "runner is 'rsl_rl'")
    if isinstance(algorithm, GraphPPO):
        update = algorithm.why_no_update_graph
    else:
        update = f"the algorithm is {type(algorithm).__name__}"
    found = {"rollout": why_no_rollout_graph(env, algorithm), "update": update}
    return {name: reason for name, reason in found.items() if reason}


def env_mismatches(cfg: RslRlBaseRunnerCfg, env: RslRlVecEnvWrapper) -> Iterator[str]:
    """Problems of a config that depend on the environment, each as ``field: what is wrong``."""
    if cfg.regenerate_interval:
        inner = rl_env_of(env.unwrapped)
        problem = (
            "the environment has no scene of a specification" if inner is None else inner.scene.why_not_regenerable()
        )
        if problem:
            yield f"regenerate_interval: is {cfg.regenerate_interval}, but {problem}"
    groups = list(env.get_observations().keys())
    for name, wanted in cfg.obs_groups.items():
        for group in wanted:
            if group not in groups:
                there = ", ".join(groups)
                yield f"obs_groups.{name}: '{group}' is not an observation group; the environment has {there}"
    if isinstance(cfg, RslRlOnPolicyRunnerCfg):
        yield from _too_few_samples(cfg, env)
    yield from _unknown_classes(cfg.to_rsl_rl(), "")


def _unknown_classes(settings: Mapping[str, object], path: str) -> Iterator[str]:
    """Names of classes that rsl_rl would not find when it makes networks and algorithm."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from _unknown_classes(value, f"{path}{key}.")
        elif key == "class_name" and isinstance(value, str):
            try:
                known = callable(resolve_callable(value))
            except (ImportError, AttributeError, ValueError):
                known = False
            if not known:
                yield f"{path}{key}: '{value}' is not found; give a class of rsl_rl, or 'module:Name' of your own"


def foreign_classes(settings: Mapping[str, object]) -> list[str]:
    """Names of the classes in a runner's settings that are neither of rsl_rl nor of this project."""
    found: list[str] = []
    for key, value in settings.items():
        if isinstance(value, Mapping):
            found += foreign_classes(value)
        elif key == "class_name" and isinstance(value, str):
            package = value.partition(":")[0].partition(".")[0]
            if not value.isidentifier() and package not in _OWN_PACKAGES:
                found.append(value)
    return list(dict.fromkeys(found))


def _too_few_samples(cfg: RslRlOnPolicyRunnerCfg, env: RslRlVecEnvWrapper) -> Iterator[str]:
    # Minibatches of recurrent networks are whole trajectories, so their number is bounded by that of environments.
    recurrent = isinstance(cfg.actor, RslRlRNNModelCfg) or isinstance(cfg.critic, RslRlRNNModelCfg)
    samples = env.num_envs if recurrent else env.num_envs * cfg.num_steps_per_env
    if samples < cfg.algorithm.num_mini_batches:
        what = "environments (recurrent networks divide those)" if recurrent else "samples in an iteration"
        yield f"algorithm.num_mini_batches: is {cfg.algorithm.num_mini_batches}, but there are {samples} {what}"
