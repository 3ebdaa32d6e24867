# SPDX-License-Identifier: Apache-2.0
"""What a runner makes of its config: what rsl_rl is told, what can be graphs, what does not fit the environment."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from .config import RslRlBaseRunnerCfg, RslRlOnPolicyRunnerCfg, RslRlRNNModelCfg
from .graph_ppo import GraphPPO
from .graph_rollout import obstacle_to_rollout
from .vec_env import RslRlVecEnvWrapper

__all__ = ["misfits", "settings_of", "why_no_graphs"]


def settings_of(cfg: RslRlBaseRunnerCfg) -> dict[str, Any]:
    """What rsl_rl is told, with the algorithm in its form as graphs if it has one."""
    settings = cfg.to_rsl_rl()
    if cfg.runner == "graph" and settings["algorithm"]["class_name"] == "PPO":
        settings["algorithm"]["class_name"] = f"{GraphPPO.__module__}:{GraphPPO.__qualname__}"
    return settings


def why_no_graphs(cfg: RslRlBaseRunnerCfg, env: RslRlVecEnvWrapper, algorithm: Any) -> dict[str, str]:
    """Why ``"rollout"`` and ``"update"`` are rsl_rl's own and no graphs; empty for none."""
    if cfg.runner != "graph":
        return dict.fromkeys(("rollout", "update"), "runner is 'rsl_rl'")
    update = algorithm.obstacle if isinstance(algorithm, GraphPPO) else f"the algorithm is {type(algorithm).__name__}"
    found = {"rollout": obstacle_to_rollout(env, algorithm), "update": update}
    return {name: reason for name, reason in found.items() if reason}


def misfits(cfg: RslRlBaseRunnerCfg, env: RslRlVecEnvWrapper) -> Iterator[str]:
    """Problems of a config that show only beside the environment."""
    if cfg.regenerate_interval:
        scene = getattr(env.unwrapped, "scene", None)
        check = getattr(scene, "obstacle_to_regenerating", None)
        problem = "the environment has no scene of a specification" if check is None else check()
        if problem:
            yield f"regenerate_interval: is {cfg.regenerate_interval}, but {problem}"
    groups = list(env.get_observations().keys())
    for name, wanted in cfg.obs_groups.items():
        for group in wanted:
            if group not in groups:
                yield f"obs_groups.{name}: '{group}' is no observation group, the environment has {', '.join(groups)}"
    if not isinstance(cfg, RslRlOnPolicyRunnerCfg):
        return
    recurrent = isinstance(cfg.actor, RslRlRNNModelCfg) or isinstance(cfg.critic, RslRlRNNModelCfg)
    samples = env.num_envs if recurrent else env.num_envs * cfg.num_steps_per_env
    if samples < cfg.algorithm.num_mini_batches:
        what = "environments (recurrent networks divide those)" if recurrent else "samples in an iteration"
        yield f"algorithm.num_mini_batches: is {cfg.algorithm.num_mini_batches}, but there are {samples} {what}"
