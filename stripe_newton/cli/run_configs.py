# SPDX-License-Identifier: Apache-2.0
"""Configs of a command: those of the task, with the values of an earlier run where one is given."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING

from stripe_newton.configclass import ConfigError, check_types, validate
from stripe_newton.rl import RslRlOnPolicyRunnerCfg, RunFolder
from stripe_newton.rl.configs import RunnerCfg
from stripe_newton.trusted_code import trust

from .field_options import apply_saved
from .tasks import load_cfg
from .user_error import UserError

if TYPE_CHECKING:
    from stripe_newton.envs import RLEnvCfg

__all__ = ["Configs", "check", "is_same_task", "load_configs", "use_one_minibatch"]


@dataclass
class Configs:
    """Configs of a task: of its environment and, in commands that need it, of its agent."""

    env: RLEnvCfg
    agent: RunnerCfg | None = None

    def need_agent(self) -> RunnerCfg:
        """The agent's config, in a command that has loaded it."""
        assert self.agent is not None
        return self.agent

    def check_types(self) -> None:
        """Check the types of all fields, before the values are used to complete the configs.

        Raises:
            ConfigError: all values that do not fit, with paths as on the command line.
        """
        check_types(*((name, cfg) for name, cfg in vars(self).items() if cfg is not None))


def is_same_task(of_run: str | None, task: str) -> bool:
    """Whether the task of a run is ``task``, or the one whose ``-Play-`` form ``task`` is."""
    return of_run in (task, task.replace("-Play-", "-"))


def load_configs(task: str, run: RunFolder | None, *, agent: bool = True, same_device: bool = False) -> Configs:
    """The configs of a task, with the values of an earlier run if one is given.

    A run of ``NAME-v0`` fits ``NAME-Play-v0`` too, whose environment then keeps its own values.

    Args:
        task: The task.
        run: The earlier run.
        agent: Whether the config of the agent is loaded.
        same_device: Whether the device of the run is taken over.

    Raises:
        UserError: if that run is of another task.
    """
    of_run = task if run is None else run.read_task() or task
    if not is_same_task(of_run, task):
        raise UserError(f"{run.path if run else ''} is a run of {of_run}, not of {task}")
    configs = Configs(load_cfg(task, "env"), load_cfg(task, "agent") if agent else None)
    for cfg in vars(configs).values():
        trust(type(cfg).__module__)  # a run of a task may name code of the task's own package
    if run is not None:
        saved = run.read_params()
        # Another machine may play a policy than trained it. What is no name of a device stays, and is an error.
        sim = _group(saved["env"], "sim")
        if not same_device and isinstance(sim.get("device"), str | None):
            sim.pop("device", None)
        scenery = _group(saved["env"], "scene").get("scenery")
        if of_run == task and isinstance(scenery, str):
            configs.env.scene.scenery = scenery
            configs.env.complete()  # it brings terms of its own, which the run's values are compared with
        leftovers = apply_saved(configs.env, saved["env"], "env") if of_run == task else []
        leftovers += [] if configs.agent is None else apply_saved(configs.agent, saved["agent"], "agent")
        if leftovers:
            lines = "\n".join(f"  {line}" for line in leftovers)
            print(f"warning: the task has changed since {run.path} was made:\n{lines}", file=sys.stderr)
        configs.check_types()
    return configs


def _group(saved: dict, name: str) -> dict:
    """A group of fields of a saved config; empty if it is none, which shows when its values are applied."""
    found = saved.get(name)
    return found if isinstance(found, dict) else {}


def check(configs: Configs) -> None:
    """Validate both configs.

    Raises:
        ConfigError: all problems of both, with paths as on the command line.
    """
    problems: list[str] = []
    for name, cfg in (("env", configs.env), ("agent", configs.agent)):
        try:
            if cfg is not None:
                validate(cfg)
        except ConfigError as error:
            problems += [f"{name}.{problem}" for problem in error.problems]
    if problems:
        raise ConfigError(problems)


def use_one_minibatch(agent: RunnerCfg) -> None:
    """Allow fewer environments than the training had minibatches, in a command that makes none of them."""
    if isinstance(agent, RslRlOnPolicyRunnerCfg):
        agent.algorithm.num_mini_batches = 1
